"""The controller's log of its line radio: complete, and never written in a control cycle."""

import argparse
from collections.abc import Collection, Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest

from firmware_py.clock.clock import WallClock
from firmware_py.radio.inproc_radio import InprocRadio, InprocRadioPort
from firmware_py.storage.recorder import RadioLog
from firmware_py.trackdb import load_line
from firmware_py.trackdb.areas import load_areas
from firmware_py.trackdb.version import database_version
from metro_hil.cli.vobc import main as vobc_command
from vobc.cli import line as line_options
from vobc.cli.line import LINE_LOG, open_line
from vobc.config import load_config
from vobc.process.line_command import LineCommand
from vobc.vocabulary import Interval, Motion
from zenoh_config import t2t_keys
from zenoh_config.codec import pack
from zenoh_config.t2t import BROADCAST, Heartbeat, Phase

S = 1_000_000_000
MS = 1_000_000
BEAT = Heartbeat(2, BROADCAST, 1, 1, 1, 1, 0, Phase.ISSUING, 0, 1)
WORDS = argparse.Namespace(
    line_radio="tcp/127.0.0.1:7448", line_peer=None, line_memory=None, line_timers="A", arbiters=1
)
STANDING = Motion(
    front_m=Interval(799.0, 800.0, 801.0),
    speed_mps=Interval(0.0, 0.0, 0.0),
    accel_mps2=0.0,
    travel_m=0.0,
    standing=True,
    standstill=True,
    localised=True,
    slip=False,
    accepted_tag_ids=(),
)


@pytest.fixture
def stack() -> Iterator[ExitStack]:
    with ExitStack() as stack:
        yield stack


@pytest.fixture
def air(monkeypatch: pytest.MonkeyPatch) -> InprocRadio:
    """An in-process radio; the bare controller gets a port of it instead of a session."""
    air = InprocRadio(0.0)

    def port(
        _role: object, _endpoint: str, wanted: Collection[str], *_: object, **__: object
    ) -> InprocRadioPort:
        return air.port("T1", wanted)

    monkeypatch.setattr(line_options, "open_radio", port)
    return air


PACKED = pack(BEAT, database=database_version(load_line("loop")))


def opened(stack: ExitStack, log: Path | None) -> tuple[LineCommand, int]:
    """The opened line command, and the instant at which its log is zero."""
    clock, line = WallClock(), load_line("loop")
    start_ns = clock.now_ns()
    parts = (load_config("florence4"), line, load_areas("loop"))
    said = None if log is None else RadioLog(log, start_ns)
    return open_line(WORDS, *parts, clock, stack, None, said), start_ns


def lines(folder: Path) -> list[list[str]]:
    return [line.split(",") for line in (folder / LINE_LOG).read_text().splitlines()[1:]]


def test_the_messages_of_a_control_cycle_are_logged_after_it(
    tmp_path: Path, stack: ExitStack, air: InprocRadio
) -> None:
    command, start_ns = opened(stack, tmp_path / LINE_LOG)
    other, topic = air.port("T2", ()), t2t_keys.key_of("loop", BEAT)
    for second in range(1, 5):
        now_ns = start_ns + second * S
        command.apply(now_ns, STANDING)
        command.send(now_ns)
        other.send(now_ns, topic, PACKED)
    # Each full second flushes what was written before; here nothing was.
    assert lines(tmp_path) == []

    command.beat(start_ns + 4 * S + 5 * MS, STANDING)
    assert lines(tmp_path) != []
    stack.close()
    heard = [row for row in lines(tmp_path) if row[1] == "rx"]
    assert [row[0] for row in heard] == ["1.000000", "2.000000", "3.000000", "4.000000"]
    assert heard[0][2:] == [topic, PACKED.hex().upper()]


def test_sent_messages_are_in_the_log_too_and_line_log_reads_it(
    tmp_path: Path, stack: ExitStack, air: InprocRadio, capsys: pytest.CaptureFixture[str]
) -> None:
    command, start_ns = opened(stack, tmp_path / LINE_LOG)
    heard = air.port("wayside", ("m/loop/**",))
    for ms in range(0, 5000, 10):
        command.beat(start_ns + ms * MS, STANDING)
    said = [message.key for message in heard.receive(start_ns + 6 * S)]
    air.port("T2", ()).send(start_ns + 5 * S, t2t_keys.key_of("loop", BEAT), PACKED)
    command.beat(start_ns + 5 * S + 10 * MS, STANDING)
    stack.close()

    assert said
    assert [row[2] for row in lines(tmp_path) if row[1] == "tx"][: len(said)] == said
    assert vobc_command(["line-log", str(tmp_path), "--kind", "hb"]) == 0
    assert "T2 > all  area 1 term 1" in capsys.readouterr().out


def test_without_a_run_folder_nothing_is_written(
    tmp_path: Path, stack: ExitStack, air: InprocRadio
) -> None:
    command, start_ns = opened(stack, None)
    air.port("T2", ()).send(start_ns, t2t_keys.key_of("loop", BEAT), PACKED)
    command.beat(start_ns + S, STANDING)
    stack.close()

    assert list(tmp_path.iterdir()) == []


def test_rejected_messages_are_reported_by_reason_and_not_one_by_one(
    stack: ExitStack, air: InprocRadio
) -> None:
    command, start_ns = opened(stack, None)
    other, topic = air.port("T2", ()), t2t_keys.key_of("loop", BEAT)

    def rejections(ms: int, *payloads: bytes) -> list[tuple[str, int]]:
        now_ns = start_ns + S + ms * MS
        for payload in payloads:
            other.send(now_ns - MS, topic, payload)
        command.beat(now_ns, STANDING)
        due = command.refusals.due(now_ns)
        return [(each.reason, each.count) for each in due]

    # In its first step the train only sends where it stands, which selects what it listens to.
    assert rejections(0) == []
    spoilt, good = PACKED[:-1] + b"!", PACKED
    assert rejections(10, spoilt, spoilt, good) == [("wrong safety code", 2)]
    assert rejections(20, spoilt, good) == [("repeated or out of order", 1)]
    assert rejections(900, spoilt) == []
    assert rejections(1010) == [("wrong safety code", 2)]
    assert rejections(3000) == []


def test_a_silent_line_is_reported_and_messages_of_the_centre_end_the_silence(
    stack: ExitStack, air: InprocRadio
) -> None:
    command, start_ns = opened(stack, None)

    assert command.silence(start_ns, 0) is None
    assert command.silence(start_ns + 4 * S, 0) is None
    assert command.silence(start_ns + 5 * S, 0) is not None
    assert WORDS.line_radio in command.silence_words
    assert command.silence(start_ns + 6 * S, 1) is not None
    assert command.silence_words == ""
