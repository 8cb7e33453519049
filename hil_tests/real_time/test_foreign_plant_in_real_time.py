"""A train in another program, in real time: its truth is judged, and its failures say why."""

import shlex
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Final

import msgspec
import pytest

from firmware_py.buses.hub_control import start_hub
from metro_hil.foreign_plant.realtime import main
from metro_hil.model.case import BenchKind, Case, PlantSpec, Setup
from metro_hil.model.run_folder import RunFolder
from metro_hil.realtime import run_realtime_case
from metro_hil.realtime.without_truth import DETAIL as WITHOUT_TRUTH

EXAMPLE: Final = Path(__file__).parents[2] / "docs/examples/plant/point_mass.py"
BRAKED: Final = """\
import json, sys
for line in sys.stdin:
    message = json.loads(line)
    answer = {"type": "ready", "version": 1, "provides": ["BCU"]}
    if message["type"] != "hello":
        truth = {"brake_n": 9e4, "emergency": True, "emergency_mps2": 1.2, "holding": True}
        answer = {"type": "yield", "now_ns": message["now_ns"], "truth": truth}
        if message["now_ns"] >= int(sys.argv[1]):
            sys.exit("out of air")
    print(json.dumps(answer), flush=True)
"""
"""A brake unit that sends no frames, and ends at an instant of its own time."""
BUS: Final = "foreign0"


def test_invariants_judge_the_truth_that_the_program_reports(tmp_path: Path) -> None:
    command = shlex.join([sys.executable, str(EXAMPLE)])
    case = Case(
        id="one",
        index=0,
        scenario="hop",
        seed=1,
        bench=BenchKind.PROCESSES,
        setup=Setup(start="II", end="III", duration_s=2.0),
        plant=PlantSpec(kind="command", command=command),
    )

    result = run_realtime_case(case, folder=RunFolder(tmp_path))

    assert result.exit_reason == "duration over", result.reason
    assert not [each.name for each in result.monitors if each.detail == WITHOUT_TRUTH]
    assert result.measures["speed_max_mps"] is not None


def serve(folder: Path, end_ns: int, *words: str) -> int:
    """Serve a train with the brake unit in this process."""
    path = folder / "braked.py"
    path.write_text(BRAKED)
    command = shlex.join([sys.executable, str(path), str(end_ns)])
    spec = msgspec.json.encode(PlantSpec(kind="command", command=command)).decode()
    return main(
        [spec, "run", "--bus", f"embedded:{BUS}", "--radio", "auto", "--priority", "0", *words]
    )


@pytest.fixture
def hub(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    with tempfile.TemporaryDirectory() as folder:
        monkeypatch.setenv("XDG_RUNTIME_DIR", folder)
        handle = start_hub(BUS, bound=True)
        yield
        handle.stop()


def test_a_fault_in_a_part_of_the_program_is_refused(
    hub: None, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    faults = tmp_path / "weak.toml"
    faults.write_text('[[fault]]\nkind = "brake_weak"\ngain_ratio = 0.5\nstart_s = 1.0\n')

    assert serve(tmp_path, 0, "--faults", str(faults)) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "brake_weak acts in the bench's own BCU, which the plant provides" in line


def test_a_program_that_dies_ends_the_plant_and_says_why(
    hub: None, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert serve(tmp_path, 50_000_000) == 3
    (line,) = capsys.readouterr().err.splitlines()
    assert line == "plant: plant died at t=0.050 s: exit code 1: out of air"
