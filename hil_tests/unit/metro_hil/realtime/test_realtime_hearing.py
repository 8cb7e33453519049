"""Which judge gets which frames of one segment or two, and from which instant on."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import pytest

from can_dbc.binding import can_id
from can_dbc.brake import BrakeCommand, BrakeStatus
from can_dbc.codec import Decoder
from firmware_py.ports import CanFrame, LinkCounters
from firmware_py.storage.recorder import CandumpWriter
from metro_hil.realtime.merge import HOLD_NS
from metro_hil.realtime.observer import RunObserver, SegmentTap
from plant_emulator.truth import Truth

S = 1_000_000_000
COMMAND_ID = can_id(BrakeCommand)
(TWIN_ID,) = Decoder([BrakeCommand]).ids - {COMMAND_ID}
STATUS_ID = can_id(BrakeStatus)


@dataclass
class Wire:
    """A port that returns prepared frames."""

    coming: list[CanFrame] = field(default_factory=list)
    counters: LinkCounters = field(default_factory=LinkCounters)

    def receive(self, now_ns: int) -> Sequence[CanFrame]:
        coming, self.coming = self.coming, []
        return coming

    def send(self, now_ns: int, can_id: int, data: bytes) -> None:
        raise AssertionError("a tap says nothing")

    def close(self) -> None: ...


@dataclass
class Judges:
    """Monitors that record what they get."""

    told: list[tuple[str, int, bytes]] = field(default_factory=list)

    def frame(self, stamp_ns: int, can_id: int, data: bytes) -> None:
        self.told.append(("frame", stamp_ns, data))

    def said(self, now_ns: int, can_id: int, data: bytes) -> None:
        self.told.append(("said", now_ns, data))

    def sample(self, truth: Truth, now_ns: int) -> None: ...


@dataclass
class Rig:
    """A reception whose run begins at 1 s of the machine's clock."""

    hearing: RunObserver
    judges: Judges
    train: Wire
    controller: Wire
    cycles: list[int]

    def hear(self, now_ns: int) -> list[tuple[str, int, bytes]]:
        self.hearing.frames(now_ns)
        self.hearing.judge(now_ns + HOLD_NS)
        return self.judges.told


def rig_of(folder: Path, *, split: bool) -> Rig:
    judges, cycles = Judges(), list[int]()
    wires = [Wire(), Wire()] if split else [Wire()]
    taps = [
        SegmentTap(wire, CandumpWriter(folder / f"{number}.log", "can"), 0)
        for number, wire in enumerate(wires)
    ]
    hearing = RunObserver(
        judges, train=taps[0], controller=taps[-1], cycle_id=COMMAND_ID, on_cycle=cycles.append
    )
    hearing.truth(Truth(), 1 * S)
    return Rig(hearing, judges, wires[0], wires[-1], cycles)


def test_on_one_segment_every_frame_is_passed_on_once(tmp_path: Path) -> None:
    rig = rig_of(tmp_path, split=False)
    rig.train.coming = [CanFrame(2 * S, COMMAND_ID, b"a"), CanFrame(3 * S, STATUS_ID, b"b")]

    assert rig.hear(3 * S) == [("frame", 1 * S, b"a"), ("frame", 2 * S, b"b")]
    assert rig.cycles == [2 * S]


def test_with_a_gateway_the_controller_is_judged_by_sent_and_the_units_by_received_frames(
    tmp_path: Path,
) -> None:
    """A vital command counts only with its twin.

    The train's frames also come through the gateway and must not be passed on twice.
    """
    rig = rig_of(tmp_path, split=True)
    rig.controller.coming = [
        CanFrame(2 * S, COMMAND_ID, b"a"),
        CanFrame(2 * S + 1, TWIN_ID, b"A"),
        CanFrame(4 * S, STATUS_ID, b"b"),
    ]
    rig.train.coming = [CanFrame(3 * S, STATUS_ID, b"b"), CanFrame(5 * S, COMMAND_ID, b"forged")]

    assert rig.hear(5 * S) == [
        ("said", 1 * S, b"a"),
        ("said", 1 * S + 1, b"A"),
        ("frame", 2 * S, b"b"),
        ("frame", 4 * S, b"forged"),
    ]
    assert rig.cycles == [2 * S]


def test_frames_that_a_gateway_forges_are_no_sign_of_life_of_the_controller(
    tmp_path: Path,
) -> None:
    rig = rig_of(tmp_path, split=True)
    rig.train.coming = [CanFrame(2 * S, COMMAND_ID, b"forged")]

    rig.hear(2 * S)

    assert not rig.hearing.controller_heard
    assert rig.hearing.controller_last_ns is None


@pytest.mark.parametrize("split", [False, True])
def test_nothing_from_before_the_start_is_judged_and_each_start_of_the_controller_is_known(
    tmp_path: Path, split: bool
) -> None:
    rig = rig_of(tmp_path, split=split)
    rig.controller.coming = [CanFrame(S // 2, COMMAND_ID, b"early")]
    assert rig.hear(S // 2) == []

    rig.hearing.await_start()
    rig.controller.coming = [CanFrame(n * S, COMMAND_ID, b"") for n in (7, 8)]
    rig.hear(8 * S)

    assert rig.hearing.starts_ns == [S // 2, 7 * S]
