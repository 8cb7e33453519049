"""Bus faults on the bench in virtual time: each acts where it is declared."""

from typing import Any

import pytest

from can_dbc.brake import BrakeCommand, BrakeStatus
from can_dbc.codec import Decoder, Encoder
from can_dbc.traction import TractionCommand
from firmware_py.buses.confinement import ErrorState
from firmware_py.buses.inproc import open_bus
from firmware_py.ports import CanFrame
from metro_hil.faults.bus import BusFaults, FaultyPort
from metro_hil.faults.frames import FrameFaults
from plant_emulator.faults.plan import FaultPlan, read_faults

MS = 1_000_000
S = 1000 * MS
SEED = 3
COMMAND = BrakeCommand(service_decel_mps2=0.5, emergency_released=True, holding_released=True)
STATUS = BrakeStatus(0.5, 100.0, False, False, False, True)
COMMANDS = (BrakeCommand, TractionCommand)


class Train:
    """A controller that sends commands every 50 ms and a train that answers, for some seconds.

    As in the plant, the brake unit's port receives all commands.
    """

    def __init__(self) -> None:
        self.log: list[tuple[CanFrame, str]] = []
        self.bus = open_bus("can0", 250_000, lambda frame, node: self.log.append((frame, node)))
        self.commands = Decoder(COMMANDS)
        self.answers = Decoder([BrakeStatus])
        vobc = self.bus.port("VOBC", self.answers.ids)
        self.port = FaultyPort(vobc, FrameFaults(SEED))
        self.faults = BusFaults(self.bus, self.port, SEED)
        self.bcu = self.bus.port("BCU", self.commands.ids)
        self.tcu = self.bus.port("TCU", ())
        self.encoder = Encoder()
        self.by_train: list[tuple[int, Any]] = []
        self.by_vobc: list[tuple[int, Any]] = []

    def run(self, plan: FaultPlan, *, begin_ns: int, end_ns: int, until_ns: int = 3 * S) -> None:
        for now_ns in range(0, until_ns, MS):
            if now_ns == begin_ns:
                self.faults.change(plan, True, now_ns)
            if now_ns == end_ns:
                self.faults.change(plan, False, now_ns)
            self.port.poll(now_ns)
            if now_ns % (10 * MS) == 0:
                self._step(now_ns)

    def _step(self, now_ns: int) -> None:
        self._hear(self.bcu.receive(now_ns), self.commands, self.by_train)
        if now_ns % (50 * MS) == 0:
            self._hear(self.port.receive(now_ns), self.answers, self.by_vobc)
            for frame in (COMMAND, TractionCommand(0.0, *_traction())):
                for can_id, data in self.encoder.encode(frame):
                    self.port.send(now_ns, can_id, data)
            for can_id, data in self.encoder.encode(STATUS):
                self.bcu.send(now_ns, can_id, data)

    def _hear(self, frames: Any, decoder: Decoder, into: list[tuple[int, Any]]) -> None:
        for frame in frames:
            heard = decoder.decode(frame.can_id, frame.data, frame.stamp_ns)
            if isinstance(heard, (*COMMANDS, BrakeStatus)):
                into.append((frame.stamp_ns, heard))

    def brakes(self, from_ns: int, to_ns: int) -> int:
        """Number of brake commands that the train accepted in that time."""
        return sum(
            from_ns <= at_ns < to_ns and isinstance(each, BrakeCommand)
            for at_ns, each in self.by_train
        )

    def tractions(self, from_ns: int, to_ns: int) -> int:
        return sum(
            from_ns <= at_ns < to_ns and isinstance(each, TractionCommand)
            for at_ns, each in self.by_train
        )

    def answered(self, from_ns: int, to_ns: int) -> int:
        return sum(from_ns <= at_ns < to_ns for at_ns, _ in self.by_vobc)


def _traction() -> tuple[Any, ...]:
    from can_dbc.nodes import Direction

    return Direction.FORWARD, False


def plan(kind: str, **parameters: Any) -> FaultPlan:
    return read_faults([{"kind": kind, **parameters}], "test")[0]


def driven(fault: FaultPlan, *, begin_ns: int = 1 * S, end_ns: int = 2 * S) -> Train:
    train = Train()
    train.run(fault, begin_ns=begin_ns, end_ns=end_ns)
    return train


def test_nothing_changes_before_the_fault_begins() -> None:
    """The bus log is identical to the byte, although all frames pass the fault layer."""
    plain, faulty = Train(), Train()
    plain.run(plan("frame_drop"), begin_ns=-1, end_ns=-1, until_ns=S)
    faulty.run(plan("bus_off"), begin_ns=2 * S, end_ns=-1, until_ns=S)
    direct = Train()
    direct.port.faults.offer = None  # type: ignore[assignment,method-assign]
    direct.port.send = direct.port._port.send  # type: ignore[method-assign]
    direct.port.poll = lambda now_ns: None  # type: ignore[method-assign]
    direct.port.receive = direct.port._port.receive  # type: ignore[method-assign]
    direct.run(plan("frame_drop"), begin_ns=-1, end_ns=-1, until_ns=S)

    assert plain.log == faulty.log == direct.log
    assert plain.by_vobc == direct.by_vobc


def test_a_bus_off_controller_neither_sends_nor_receives_and_comes_back() -> None:
    train = driven(plan("bus_off"))

    assert train.brakes(0, S) == 20
    assert train.brakes(S, 2 * S) == 0
    assert train.answered(S + 50 * MS, 2 * S) == 0
    # The node is back within the 5.6 ms of an idle bus, so only the command of that instant is
    # missing.
    assert train.brakes(2 * S, 3 * S) == 19
    assert train.answered(2 * S, 3 * S) == 18
    assert train.faults.error_frames == {"VOBC": 32}
    states = [told for _, told in train.faults.story() if told.startswith("VOBC")]
    assert states == ["VOBC is error passive", "VOBC is bus off", "VOBC is error active"]
    assert sum(train.faults.done.values()) == 32


def test_a_controller_that_does_not_recover_stays_off() -> None:
    train = driven(plan("bus_off", recovers=False))

    assert train.brakes(S, 3 * S) == 0
    assert train.faults.errors_of("VOBC", 3 * S).state is ErrorState.OFF


def test_a_reconnected_controller_sends_again() -> None:
    train = driven(plan("link_cut"))

    assert train.brakes(S, 2 * S) == 0
    assert train.answered(S + 50 * MS, 2 * S) == 0
    assert train.brakes(2 * S, 3 * S) == 20


@pytest.mark.parametrize(
    ("node", "brakes", "tractions", "answers"), [("bcu", 0, 20, 0), ("tcu", 20, 0, 19)]
)
def test_a_cut_unit_misses_its_own_commands_only(
    node: str, brakes: int, tractions: int, answers: int
) -> None:
    """This holds although one node of the plant receives all commands."""
    train = driven(plan("link_cut", node=node))

    assert (train.brakes(S, 2 * S), train.tractions(S, 2 * S)) == (brakes, tractions)
    assert train.answered(S + 50 * MS, 2 * S) == answers
    assert train.brakes(2 * S, 3 * S) >= 19
    assert train.tractions(2 * S, 3 * S) >= 19


def test_a_babbling_idiot_blocks_all_higher_identifiers() -> None:
    train = driven(plan("babbling_idiot", can_id=0x100))

    assert train.brakes(S + 50 * MS, 2 * S) == 0
    babbled = sum(frame.can_id == 0x100 for frame, _ in train.log)
    assert babbled == pytest.approx(250_000 / 115, rel=0.05)
    # All waiting commands come now, first halves before second ones by their identifiers.
    assert train.brakes(2 * S, 3 * S) >= 19


def test_a_babbling_idiot_above_the_commands_does_not_affect_them() -> None:
    train = driven(plan("babbling_idiot", can_id=0x7FF))

    assert train.brakes(S, 2 * S) == 20
    assert train.answered(S, 2 * S) == 20


def test_frames_destroyed_on_the_wire_are_late_but_none_is_lost() -> None:
    """The error rate is one in ten; from one in nine the counters rise until the sender is bus
    off."""
    corrupt = plan("frame_corrupt", damage="on_wire", share_ratio=0.1)
    train = driven(corrupt)

    assert train.brakes(0, 3 * S) == train.tractions(0, 3 * S) == 60
    assert train.faults.error_frames["VOBC"] > 2
    assert not train.commands.rejections


def test_a_sender_with_every_frame_destroyed_goes_bus_off_until_the_fault_ends() -> None:
    train = driven(plan("frame_corrupt", damage="on_wire", way="to_train"))

    assert train.brakes(S, 2 * S) == 0
    assert train.brakes(2 * S, 3 * S) >= 19
    assert train.faults.error_frames == {"VOBC": 32}


def test_a_masquerading_node_has_its_own_name_on_the_bus() -> None:
    mask = plan("masquerade", frame="BRAKE_CMD", values={"service_decel_mps2": 0.0}, period_s=0.013)
    train = driven(mask)

    strange = [frame for frame, node in train.log if node == "STRANGER"]
    assert len(strange) == 2 * 77
    assert train.brakes(0, S) == 20
    assert any(isinstance(each, BrakeCommand) and each != COMMAND for _, each in train.by_train)


def test_late_frames_carry_the_instant_at_which_they_get_through() -> None:
    train = driven(plan("frame_delay", way="to_vobc", delay_s=0.1))

    ended = {frame.stamp_ns for frame, node in train.log if node == "BCU"}
    during = [at_ns for at_ns, _ in train.by_vobc if 1100 * MS <= at_ns < 2 * S]
    assert len(during) == 18
    assert {at_ns - 100 * MS for at_ns in during} <= ended


def test_faults_of_other_places_are_ignored() -> None:
    train = driven(plan("wheel_slip"))

    assert train.brakes(0, 3 * S) == 60
    assert not train.faults.done


def test_the_same_run_has_the_same_log() -> None:
    def log() -> list[tuple[CanFrame, str]]:
        return driven(plan("frame_corrupt", damage="on_wire", share_ratio=0.3)).log

    assert log() == log()
