"""A line of real processes, brought up, broken, mended and ended by its commands."""

import os
import signal
from pathlib import Path

import pytest

from firmware_py.radio.zenoh_radio import pick_endpoint
from hil_tests.real_time.process_rig import until_gone
from metro_hil.cli.vobc import main


def pid_of(run: Path, program: str) -> int:
    return int((run / f"{program}.pid").read_text().split()[0])


def kill(pid: int) -> None:
    os.kill(pid, signal.SIGKILL)
    assert until_gone([pid]) == []


def test_a_line_runs_on_without_one_arbiter_and_its_programs_can_be_started_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    where, run = ["--line-radio", pick_endpoint()], tmp_path / "line"
    of_run = ["--out", str(run)]
    up = ["line", "up", "--trains", "1", "--priority", "0", *where, *of_run]
    assert main(up) == 0
    try:
        assert "train 1 commands" in capsys.readouterr().out
        plant = pid_of(run, "T1/plant")
        kill(pid_of(run, "arbiter1"))
        assert main(["master", *where]) == 0
        kill(pid_of(run, "T1/controller"))

        assert main(["line", "status", *of_run]) == 3
        assert "2 of 8 programs ended" in capsys.readouterr().err
        assert main(["line", "restart", "T1", "arbiter1", *of_run]) == 0
        assert main(["line", "status", *of_run]) == 0
        assert pid_of(run, "T1/plant") == plant
    finally:
        assert main(["line", "down", *of_run]) == 0
    assert main(["line", "down", *of_run]) == 3
