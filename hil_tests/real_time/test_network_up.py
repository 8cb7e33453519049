"""Trains of a service as processes on a network: on a secured line, and under a killed wayside."""

import json
from pathlib import Path
from typing import Final

import pytest

from firmware_py.clock.clock import WallClock
from firmware_py.radio.zenoh_radio import pick_endpoint
from metro_hil.cli.hil import main as hil
from metro_hil.cli.vobc import main
from metro_hil.model.run_options import EXIT_ENVIRONMENT

NETWORK: Final = """
name = "hop"
buffer_stops = ["south.start", "east.end", "west.end"]
switches = [{ name = "W1", tip = "south.end", left = "west.start", right = "east.start" }]
routes = [
    { name = "out", legs = ["south up", "east up"] },
    { name = "back", legs = ["west down", "south down"] },
]

[[tracks]]
name = "south"
start_m = 0.0
end_m = 250.0
limits = [{ start_m = 0.0, end_m = 250.0, limit_mps = 15.0 }]
platforms = [
    { station = "First", start_m = 20.0, end_m = 105.0, side = "none", stop_up_m = 100.0, stop_down_m = 30.0, dwell_s = 0.0 },
    { station = "Second", start_m = 35.0, end_m = 115.0, side = "none", stop_up_m = 110.0, stop_down_m = 41.4, dwell_s = 0.0 },
]

[[tracks]]
name = "east"
start_m = 250.0
end_m = 450.0
limits = [{ start_m = 250.0, end_m = 450.0, limit_mps = 15.0 }]
platforms = [{ station = "East", start_m = 330.0, end_m = 410.0, stop_up_m = 400.0 }]

[[tracks]]
name = "west"
start_m = 250.0
end_m = 450.0
limits = [{ start_m = 250.0, end_m = 450.0, limit_mps = 15.0 }]
platforms = [{ station = "West", start_m = 330.0, end_m = 410.0, stop_down_m = 340.0 }]
"""  # noqa: E501
SERVICE: Final = """
line = "hop.toml"
trains = 2

[[trips]]
route = "out"
start = "First"
end = "Second"

[[trips]]
route = "back"
end = "First"
"""
PATIENCE_S: Final = 120.0
"""Time for a trip of 10 m on a busy machine."""
POLL_NS: Final = 100_000_000
NS_PER_S: Final = 1e9


def wait_for(logs: list[Path], text: str) -> Path:
    """Wait until one of the logs has a text after the last line about a change of ends."""
    clock = WallClock()
    end_ns = clock.now_ns() + round(PATIENCE_S * NS_PER_S)
    while clock.now_ns() < end_ns:
        for log in logs:
            _, _, later = log.read_text().partition("changes ends at Second, trip 2 of 2")
            if text in later:
                return log
        clock.wait_until(clock.now_ns() + POLL_NS)
    raise TimeoutError("; ".join(log.read_text() for log in logs))


@pytest.fixture(autouse=True)
def service(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "hop.toml").write_text(NETWORK)
    (tmp_path / "service.toml").write_text(SERVICE)


def test_a_train_changes_ends_and_commands_on_its_way_back_while_another_waits(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """All programs have certificates."""
    assert main(["demo-ca", "secure", "--service", "service.toml", "--trains", "2"]) == 0
    run = tmp_path / "line"
    up = ["line", "up", "--service", "service.toml", "--line-radio", pick_endpoint()]
    up += ["--secure", "secure"]

    # The set C of timers suits a machine that runs other tests.
    assert main([*up, "--line-timers", "C", "--priority", "0", "--out", str(run)]) == 0
    try:
        logs = [run / "T1" / "train.log", run / "T2" / "train.log"]
        turned = wait_for(logs, "commands areas: 1")
        assert main(["line", "status", "--out", str(run)]) == 0
    finally:
        assert main(["line", "down", "--out", str(run)]) == 0

    (waiting,) = [log for log in logs if log != turned]
    assert "arrives at Second" in turned.read_text()
    assert "enters" not in waiting.read_text()
    assert "T2/train" in capsys.readouterr().out
    results = json.loads((turned.parent / "train" / "results.json").read_text())
    assert [trip["turned"] for trip in results["trips"]] == [False, True]
    assert results["trips"][0]["ended_s"] is not None
    assert results["protection_brakes"] == []


def test_a_killed_wayside_is_started_again_and_no_train_that_commands_no_other_is_struck(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run = tmp_path / "line"
    words = ["--service", "service.toml", "--trains", "1", "--for", "7", "--down-for", "0.5"]
    words += ["--crash-arbiter-at", "5", "--kill-master-at", "6", "--line-timers", "C"]

    assert hil(["run", "line", *words, "--priority", "0", "--out", str(run)]) == EXIT_ENVIRONMENT

    told = capsys.readouterr().out
    assert told.index("arbiters is killed") < told.index("arbiters is started again")
    assert (run / "story.txt").read_text().splitlines()[0] in told
    assert "hop-out, area 1: train 1 commands, term" in told
    assert "invalid: kill-master: the run ended before, or no train commanded an area" in told
    results = json.loads((run / "results.json").read_text())
    assert (results["violations"], results["strikes"]) == ([], [])
    assert results["trips"]
