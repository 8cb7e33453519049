"""Ctrl-C in virtual time: exit code 130, and the results so far are printed and written."""

import json
import multiprocessing
import os
import signal
from pathlib import Path

import pytest

from metro_hil.cli.vobc import main
from metro_hil.line.virtual.coordinator import conduct
from metro_hil.line.virtual.member import plan_line
from metro_hil.model.end_condition import INTERRUPTED
from metro_hil.run.lockstep import Lockstep
from plant_emulator.traffic.coupling import INTERVAL_S

AT_NS = 20_000_000_000


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
@pytest.mark.sources
def test_an_interrupted_run_is_measured_and_written(
    number: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    watch = Lockstep._watch

    def interrupted(bench: Lockstep, now_ns: int) -> None:
        watch(bench, now_ns)
        if now_ns == AT_NS:
            os.kill(os.getpid(), number)

    monkeypatch.setattr(Lockstep, "_watch", interrupted)
    out = tmp_path / "run"

    code = main(["run", "--lockstep", "--to", "II", "--out", str(out), "--json"])

    said = capsys.readouterr()
    results = json.loads(said.out)
    assert code == 130
    assert said.err.splitlines()[-1] == "vobc: interrupted; these are the results until then"
    assert results["exit_reason"] == INTERRUPTED
    assert json.loads((out / "results.json").read_text()) == results
    last = (out / "truth.csv").read_text().splitlines()[-1]
    assert float(last.split(",")[0]) == pytest.approx(AT_NS / 1e9, abs=0.1)


@pytest.mark.parametrize("processors", [1, 3])
@pytest.mark.parametrize("after", [0, 1, 120, 149])
def test_an_interrupted_line_reports_every_train(after: int, processors: int) -> None:
    plan = plan_line(
        line="changping", trains=3, consist="typeB4", params="typeB4", seed=1, law="green",
        supply=None, cycle_ms=100.0, stage=None, load_ratio=None, odometer_error_ratio=None,
    )  # fmt: skip
    asked = iter(range(after + 1))

    record = conduct(
        plan,
        150 * INTERVAL_S,
        folders=[None] * 3,
        processors=processors,
        interrupted=lambda: next(asked, None) == after,
    )

    assert record.duration_s == pytest.approx(after * INTERVAL_S)
    assert [report.train for report in record.reports] == [start.train for start in plan.starts]
    assert multiprocessing.active_children() == []


def test_an_interrupted_line_is_written_with_its_results_so_far(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    from rich.status import Status

    def interrupt(status: Status, text: str) -> None:
        if text.startswith("5 s"):
            os.kill(os.getpid(), signal.SIGINT)

    monkeypatch.setattr(Status, "update", interrupt)
    words = ["run", "--lockstep", "--trains", "2", "--no-logs", "--duration", "60", "--json"]

    code = main([*words, "--out", str(tmp_path / "run")])

    results = json.loads(capsys.readouterr().out)
    assert code == 130
    assert results["exit_reason"] == INTERRUPTED
    assert results["duration_s"] == pytest.approx(5.0 + INTERVAL_S)
    assert json.loads((tmp_path / "run" / "results.json").read_text()) == results
