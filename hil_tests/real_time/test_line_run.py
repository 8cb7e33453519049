"""A whole line as processes over real zenoh with a killed master, and the relay that cuts
radios."""

import json
import socket
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest

from can_dbc.vobc import Cause
from firmware_py.clock.clock import WallClock
from firmware_py.ports import RadioMessage
from firmware_py.radio.zenoh_radio import SessionRole, ZenohRadio, open_radio
from metro_hil.cli.hil import main
from metro_hil.line.exercise import real_time
from metro_hil.line.exercise.relay import Relay
from metro_hil.model.run_options import EXIT_ENVIRONMENT
from metro_hil.supervision.radio_log import figures_of, read_log
from metro_hil.supervision.radio_log_filter import RadioLogSelection
from zenoh_config.codec import BENCH_KEY

NEAR = ("authority ends only", "stands in")
"""Complaints that no slowness of the machine explains."""


def test_a_killed_master_is_replaced_and_no_train_comes_too_close(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "run"
    words = ["--trains", "3", "--for", "5", "--kill-master-at", "1", "--down-for", "1"]

    main(["run", "line", *words, "--out", str(out)])

    told = capsys.readouterr().out
    assert "is ended by SIGKILL" in told
    assert "is started again" in told
    assert not [line for line in told.splitlines() if any(words in line for words in NEAR)]
    figures = figures_of(RadioLogSelection().pass_on(read_log(out / "line.log", BENCH_KEY)))
    assert figures.refused == 0
    assert max(len(terms) for terms in figures.terms.values()) > 1
    assert {("T1", "TrainReport"), ("T2", "TrainReport"), ("rails", "Place")} <= set(figures.counts)


def test_emergency_brakes_without_radio_are_reported_from_the_trains_own_logs(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "run"
    words = ["--trains", "2", "--for", "9", "--crash-arbiter-at", "5", "--down-for", "3"]

    main(["run", "line", *words, "--out", str(out)])

    told = capsys.readouterr().out
    assert told.index("arbiters is killed") < told.index("arbiters is started again")
    results = json.loads((out / "results.json").read_text())
    logged = {
        number: [
            Cause(event["value"]).name.lower().replace("_", " ")
            for event in _events(out / f"train{number}" / "events.jsonl")
            if event["kind"] == "EMERGENCY_APPLIED"
        ]
        for number in (1, 2)
    }
    for train in results["trains"]:
        assert [each["cause"] for each in train["emergencies"]] == logged[train["train"]]
        for cause in logged[train["train"]]:
            assert f"train {train['train']} applies its emergency brake: {cause}" in told
    assert logged[1]
    assert "crash-arbiter" in (out / "run.toml").read_text()


class LateRadio:
    """A session that delivers its messages one second late."""

    def __init__(self, radio: ZenohRadio, clock: WallClock) -> None:
        self._radio, self._clock = radio, clock
        self._waiting: list[RadioMessage] = []
        self.counters, self.close = radio.counters, radio.close

    def receive(self, now_ns: int) -> Sequence[RadioMessage]:
        self._waiting += self._radio.receive(now_ns)
        due = [each for each in self._waiting if each.stamp_ns <= now_ns - 1_000_000_000]
        self._waiting = self._waiting[len(due) :]
        return [each._replace(stamp_ns=now_ns) for each in due]


def test_a_run_whose_observer_lags_by_a_second_is_invalid(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def late_radio(
        role: SessionRole, endpoint: str, topics: Sequence[str], clock: WallClock, **options: Any
    ) -> LateRadio:
        return LateRadio(open_radio(role, endpoint, topics, clock, **options), clock)

    monkeypatch.setattr(real_time, "open_radio", late_radio)

    code = main(["run", "line", "--trains", "2", "--for", "2", "--out", str(tmp_path / "run")])

    told = capsys.readouterr().out
    assert code == EXIT_ENVIRONMENT
    assert "invalid: the observer lagged: the newest" in told
    assert "invalid: the run proves nothing" in told
    results = json.loads((tmp_path / "run" / "results.json").read_text())
    assert results["verdict"] == "invalid"
    assert "the observer lagged" in results["doubts"][0]


def _events(path: Path) -> list[dict[str, Any]]:
    return [json.loads(line) for line in path.read_text().splitlines()]


def test_a_relay_forwards_both_ways_holds_during_a_cut_and_loses_nothing() -> None:
    server = socket.create_server(("127.0.0.1", 0))
    relay = Relay(["T1", "T2"], "127.0.0.1", server.getsockname()[1])
    with server, socket.create_connection(("127.0.0.1", relay.ports["T1"])) as near:
        relay.step(1.0)
        far, _ = server.accept()
        with far:
            near.sendall(b"to the wayside")
            far.sendall(b"to the train")
            for _ in range(3):
                relay.step(0.2)
            assert (far.recv(99), near.recv(99)) == (b"to the wayside", b"to the train")

            relay.cut("T1", cut=True)
            near.sendall(b"held, ")
            near.sendall(b"late")
            for _ in range(3):
                relay.step(0.1)
            far.setblocking(False)
            with pytest.raises(BlockingIOError):
                far.recv(99)

            relay.cut("T1", cut=False)
            relay.step(0.1)
            assert far.recv(99) == b"held, late"
    relay.step(0.1)
