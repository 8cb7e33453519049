"""Two trains of a line in real time, each on its own bus, with externally started controllers."""

import json
import os
import subprocess
import sys
import time
from pathlib import Path

PATIENCE_S = 300.0
"""Timeout far above every duration here; only a hang reaches it, s."""
PLANT = [sys.executable, "-m", "plant_emulator", "run", "--trains", "2", "--duration", "600"]


def wait_for(log: Path, words: str) -> None:
    end = time.monotonic() + PATIENCE_S
    while words not in log.read_text(encoding="utf-8"):
        assert time.monotonic() < end, log.read_text(encoding="utf-8")
        time.sleep(0.1)


def test_controllers_attach_and_the_first_train_leaves_by_the_timetable(tmp_path: Path) -> None:
    runtime, said, out = tmp_path / "rt", tmp_path / "said", tmp_path / "out"
    runtime.mkdir(mode=0o700)
    place = {**os.environ, "XDG_RUNTIME_DIR": str(runtime), "PYTHONUNBUFFERED": "1"}
    with said.open("w", encoding="utf-8") as log:
        plant = subprocess.Popen([*PLANT, "--out", str(out)], env=place, stdout=log, stderr=log)
    try:
        wait_for(said, "--bus embedded:train2")
        controllers = [
            subprocess.Popen(
                [
                    *(sys.executable, "-m", "vobc", "--bus", f"embedded:train{train}"),
                    *("--line", "changping", "--consist", "typeB4", "--from", start),
                    *("--ato", "green", "--duration", "60"),
                ],
                env=place,
                stderr=subprocess.DEVNULL,
            )
            for train, start in ((1, "Gonghuacheng"), (2, "Zhuxinzhuang"))
        ]
        wait_for(said, "the timetable begins")
        wait_for(said, "train 2, ")
        wait_for(said, "leaves 0.")
        plant.terminate()
        assert plant.wait(PATIENCE_S) == 0
        for controller in controllers:
            controller.terminate()
            assert controller.wait(PATIENCE_S) == 0
    finally:
        plant.kill()
    told = json.loads((out / "line.json").read_text(encoding="utf-8"))
    assert told["unconverged"] == 0
    assert told["solved"] > 10
    assert told["actual_kwh"] > 0.0
    assert all(told["trains"][name]["commands"] > 20 for name in ("train1", "train2"))
    assert (out / "train2" / "truth.csv").stat().st_size > 1000
