"""The device alone: what it sends in which cycle, what it stores, and what it hands over."""

import math
from dataclasses import replace
from typing import Any

import pytest

from can_dbc.analogue import AnalogueCommand
from can_dbc.binding import Frame, can_id
from can_dbc.brake import BrakeCommand, BrakeStatus
from can_dbc.codec import Decoder
from can_dbc.diagnostics import EMERGENCIES, HEARTBEATS, NodeState
from can_dbc.doors import DoorCars, DoorCommand
from can_dbc.nodes import Node
from can_dbc.traction import TractionCommand
from can_dbc.vobc import (
    Cause,
    EventKind,
    Supervision,
    VobcEvent,
    VobcLimits,
    VobcMode,
    VobcMotion,
    VobcPosition,
    VobcStatus,
    VobcSupervision,
    VobcTarget,
)
from firmware_py.handed_ports import HandedPorts
from firmware_py.ports import CanFrame, RadioMessage, SerialChunk
from firmware_py.settings import SettingsError
from firmware_py.storage.nvram import Nvram, NvramRecord
from firmware_py.trackdb import load_line
from hil_tests.unit.vobc.test_vobc_wire import DRIVING, MOTION, orders
from vobc.atp.change_ends import OtherPath
from vobc.config import VobcConfig, load_config, plan_mission
from vobc.controller import Controller
from vobc.process import CYCLE_COLUMNS, VobcDevice
from vobc.process.identity import identity_of
from vobc.vocabulary import (
    SAFE_OUTPUT,
    CycleInput,
    CycleOutput,
    Event,
    OdometryRecord,
    PlaceProof,
)
from vobc.wire.refusals import Refusals
from zenoh_config.codec import BENCH_KEY, pack, unpack
from zenoh_config.messages import PositionReport, TrainStatus

LINE, CONFIG = load_line("florence"), load_config("florence4")
MS = 1_000_000
START_NS = 1000 * MS
STANDING = replace(DRIVING, motion=replace(MOTION, standstill=True, standing=True))
PLACE = OdometryRecord(1234.0, 0.4, 0.01)
LOOP = replace(
    CONFIG, ato=replace(CONFIG.ato, output=replace(CONFIG.ato.output, stage="current_loop"))
)
KINDS: dict[int, type[Frame]] = {
    can_id(kind): kind
    for kind in (
        BrakeCommand, TractionCommand, DoorCommand, DoorCars, AnalogueCommand, VobcStatus,
        VobcMotion, VobcPosition, VobcTarget, VobcMode, VobcLimits, VobcSupervision, VobcEvent,
        HEARTBEATS[Node.VOBC], EMERGENCIES[Node.VOBC],
    )
}  # fmt: skip


class Says:
    """Stands for the controller: it decides what the test sets, and keeps its images."""

    rejected_tags = 4
    verdict = "of protection"

    def __init__(self) -> None:
        self.output: CycleOutput = DRIVING
        self.images: list[CycleInput] = []
        self.kept = PLACE

    def step(self, image: CycleInput) -> CycleOutput:
        self.images.append(image)
        return self.output

    def record(self) -> OdometryRecord:
        return self.kept


class Lines:
    """An event log and a cycle log in memory."""

    def __init__(self) -> None:
        self.entries: list[dict[str, Any]] = []
        self.flushed = 0
        self.rows: list[dict[str, object]] = []

    def event(self, entry: dict[str, Any]) -> None:
        self.entries.append(entry)

    def flush(self) -> None:
        self.flushed += 1

    def row(self, *values: object) -> None:
        self.rows.append(dict(zip(CYCLE_COLUMNS, values, strict=True)))

    def words(self, kind: EventKind) -> list[str]:
        return [each["words"] for each in self.entries if each["kind"] == kind.name]


class Bench:
    """A device whose controller says what the test sets."""

    def __init__(
        self, config: VobcConfig = CONFIG, record: NvramRecord | None = None, **options: Any
    ) -> None:
        self.ports, self.lines = HandedPorts(), Lines()
        self.nvram = Nvram(None, record or NvramRecord(boot_count=40))
        self.device = VobcDevice(
            config, LINE, plan_mission(LINE, "II", "III"), can=self.ports.can,
            tags=self.ports.tags, radio=self.ports.radio, nvram=self.nvram,
            cycle_log=self.lines, event_log=self.lines, start_ns=START_NS, **options,
        )  # fmt: skip
        self.real = self.device._controller
        self.controller = Says()
        self.device._controller = self.controller  # type: ignore[assignment]
        self.now_ns = START_NS

    def sent(self) -> list[type[Frame] | int]:
        """Kinds of the frames sent since the last call; the twin of a frame is its number."""
        found, self.ports.can.sent = self.ports.can.sent, []
        return [KINDS.get(each, each) for each, _ in found]

    def cycle(self, **changes: Any) -> list[type[Frame] | int]:
        """Run one cycle and return what it sent."""
        if changes:
            self.controller.output = replace(self.controller.output, **changes)
        self.sent()
        self.device.control_cycle(self.now_ns)
        self.now_ns += 50 * MS
        return self.sent()


def decoded(bench: Bench, kind: type[Frame]) -> Any:
    """The last frame of a kind among those sent."""
    decoder = Decoder((kind,))
    heard = [decoder.decode(number, data, 0) for number, data in bench.ports.can.sent]
    return [each for each in heard if isinstance(each, kind)][-1]


@pytest.mark.parametrize(
    ("cycle_ms", "doors", "motion", "target", "status"),
    [(50.0, "101010", "101010", "100010", "111111"), (40.0, "101010", "101010", "100001", "111111"),
     (100.0, "111", "111", "101", "111"),
     (200.0, "111", "111", "111", "111"), (25.0, "100010", "100010", "100000", "101010")],
)  # fmt: skip
def test_each_frame_comes_in_the_first_cycle_and_then_in_its_period(
    cycle_ms: float, doors: str, motion: str, target: str, status: str
) -> None:
    bench = Bench(replace(CONFIG, cycle_ms=cycle_ms))

    cycles = [bench.cycle() for _ in doors]

    def pattern(kind: type[Frame]) -> str:
        return "".join("1" if kind in sent else "0" for sent in cycles)

    assert pattern(BrakeCommand) == "1" * len(doors)
    assert pattern(DoorCommand) == doors
    assert pattern(VobcStatus) == status
    for kind in (VobcMotion, VobcPosition, VobcMode, VobcLimits, VobcSupervision):
        assert pattern(kind) == motion
    assert pattern(VobcTarget) == target
    assert all(sent[0] is BrakeCommand for sent in cycles)
    assert not any(kind in sent for sent in cycles for kind in (AnalogueCommand, DoorCars))


def test_a_train_with_current_loops_gets_its_currents_with_each_command() -> None:
    bench = Bench(LOOP)

    assert AnalogueCommand in bench.cycle()
    bench.device.stop(bench.now_ns)
    assert bench.sent().count(AnalogueCommand) == 1


@pytest.mark.parametrize("left", [True, False])
@pytest.mark.parametrize("right", [True, False])
def test_single_cars_of_either_side_are_withdrawn_once(*, left: bool, right: bool) -> None:
    bench = Bench()
    enabled = bench.cycle(door_cars=0b01, enable_left=left, enable_right=right)
    bench.cycle()

    after = [DoorCars in bench.cycle(enable_left=False, enable_right=False) for _ in range(4)]

    assert (DoorCars in enabled) is (left or right)
    assert after == [left or right, False, False, False]


def test_the_tasks_have_their_periods_and_places() -> None:
    slow = Bench(replace(CONFIG, cycle_ms=100.0))
    line = Bench(command=Command())

    def table(bench: Bench) -> dict[str, tuple[float, float, float | None]]:
        tasks = bench.device._tasks()
        return {each.name: (each.period_ms, each.offset_ms, each.budget_ms) for each in tasks}

    common = {"report": (200.0, 1.0, None), "life_sign": (1000.0, 2.0, None)}
    assert table(Bench()) == {"control": (50.0, 0.0, 25.0), **common}
    assert table(slow) == {
        "control": (100.0, 0.0, 50.0), "repeat": (50.0, 0.0, 25.0), **common
    }  # fmt: skip
    assert table(line) == {"control": (50.0, 0.0, 25.0), "line": (10.0, 3.0, None), **common}


def test_a_slow_controller_repeats_its_commands_between_its_cycles_and_not_after_them() -> None:
    bench = Bench(replace(CONFIG, cycle_ms=100.0))
    bench.device.repeat_vital(START_NS)
    assert bench.sent() == []
    began_ns = bench.now_ns = START_NS + 1000 * MS
    bench.cycle()

    def repeats(after_ms: float) -> bool:
        bench.device.repeat_vital(began_ns + round(after_ms * MS))
        return BrakeCommand in bench.sent()

    assert [repeats(ms) for ms in (24.9, 25, 49.9, 50)] == [False, True, False, True]
    assert [repeats(ms) for ms in (200, 200.001, 300)] == [True, False, False]


def test_an_image_has_the_time_since_the_cycle_before_and_counts_what_was_missed() -> None:
    bench = Bench()
    missed = iter((0, 2, 1))
    bench.device.executive.slips_before = lambda _name: next(missed)  # type: ignore[assignment]
    bench.cycle()
    bench.now_ns += 100 * MS

    bench.cycle()
    bench.cycle()

    images = bench.controller.images
    assert [image.dt_s for image in images] == [0.05, 0.15, 0.05]
    assert [image.overruns for image in images] == [0, 2, 1]
    assert bench.device.slips == 3
    assert [row["slips"] for row in bench.lines.rows] == [0, 2, 3]
    assert [row["t_s"] for row in bench.lines.rows] == [0.0, 0.15, 0.2]


def test_work_and_lateness_are_in_microseconds() -> None:
    bench = Bench()
    bench.device.executive.execution_ns = lambda _name: 320_000  # type: ignore[assignment]
    bench.device.executive.lateness_ns = lambda _name: 12_000  # type: ignore[assignment]

    bench.device.control_cycle(START_NS)

    assert (bench.lines.rows[0]["work_us"], bench.lines.rows[0]["lateness_us"]) == (320.0, 12.0)
    assert decoded(bench, VobcStatus).work_us == 320.0


def test_the_refused_inputs_are_counted_by_their_wire() -> None:
    bench = Bench()
    noise = bytes.fromhex("7e0102037e")
    bench.ports.can.inbox = [CanFrame(START_NS, 0x7F0, b"")]
    bench.ports.tags.inbox = [SerialChunk(START_NS, noise), SerialChunk(START_NS, noise)]
    bench.ports.radio.inbox = [RadioMessage(START_NS, "key", b"noise")] * 3

    bench.cycle()

    assert bench.device.verdict == "of protection"
    assert bench.device.refused == {
        "frames": 1, "telegrams": 2, "radio": 3, "tags": 4, "overflow": 0
    }  # fmt: skip
    assert bench.lines.words(EventKind.FRAME_REJECTED)[0].startswith("1 frame 0x7f0 refused: ")
    (radio,) = bench.lines.words(EventKind.RADIO_REFUSED)
    assert radio.startswith("3 messages on the radio refused: ")
    entry = next(each for each in bench.lines.entries if each["kind"] == "RADIO_REFUSED")
    assert entry["value"] == 3


def test_a_refused_frame_of_a_known_unit_is_named() -> None:
    bench = Bench()
    bench.ports.can.inbox = [CanFrame(START_NS, can_id(BrakeStatus), b"\x00")] * 2

    bench.cycle()

    assert bench.lines.words(EventKind.FRAME_REJECTED)[0].startswith(
        "2 frames BRAKE_STATUS (0x182) refused: "
    )


def test_an_emergency_is_said_when_it_begins_and_when_it_ends() -> None:
    bench = Bench()
    emcy = EMERGENCIES[Node.VOBC]
    begun = {"supervision": Supervision.EMERGENCY, "emergency_cause": Cause.BUTTON}

    ended = {"supervision": Supervision.NOMINAL}

    said = [emcy in bench.cycle(**each) for each in ({}, begun, {}, ended, {})]

    assert said == [False, True, False, True, False]


def test_an_emergency_message_has_the_cause_and_its_end_has_none() -> None:
    bench, emcy = Bench(), EMERGENCIES[Node.VOBC]
    begun = replace(DRIVING, supervision=Supervision.EMERGENCY, emergency_cause=Cause.BUTTON)
    said = []

    for output in (begun, replace(begun, supervision=Supervision.NOMINAL)):
        bench.controller.output = output
        bench.sent()
        bench.device.control_cycle(bench.now_ns)
        said.append(decoded(bench, emcy))

    assert said == [emcy(0xFF01, 0x81, int(Cause.BUTTON)), emcy(0, 0, 0)]


def test_an_event_is_said_in_the_cycle_of_its_change_and_not_again() -> None:
    bench = Bench()
    bench.cycle()
    bench.cycle()
    said = len(bench.lines.entries)

    bench.cycle()
    assert len(bench.lines.entries) == said
    bench.cycle(supervision=Supervision.WARNING)
    assert len(bench.lines.words(EventKind.SUPERVISION)) == 2


def test_position_and_status_are_reported_and_the_memory_is_of_this_start() -> None:
    bench = Bench()
    bench.cycle()

    bench.device.report_position(START_NS + MS)

    report, status = (unpack(payload) for _, payload in bench.ports.radio.sent)
    assert isinstance(report, PositionReport)
    assert isinstance(status, TrainStatus)
    assert report.boot == status.boot == bench.nvram.record.boot_count == 41
    assert bench.nvram.record.standing is False


def test_a_life_sign_begins_with_the_boot_up_and_flushes_the_events() -> None:
    bench = Bench()
    bench.sent()

    for _ in range(2):
        bench.device.life_sign(START_NS)

    beat = HEARTBEATS[Node.VOBC]
    found = bench.ports.can.sent
    assert [data[0] for number, data in found if KINDS.get(number) is beat] == [
        NodeState.BOOT_UP,
        NodeState.OPERATIONAL,
    ]
    assert bench.lines.flushed == 2


def test_the_last_message_is_the_safe_output_and_its_events_are_flushed() -> None:
    bench = Bench()
    bench.cycle()

    bench.device.stop(bench.now_ns)

    sent = bench.sent()
    assert sent[0] is BrakeCommand
    assert [each for each in sent if not isinstance(each, int)][1:] == [
        TractionCommand, DoorCommand, VobcStatus, VobcSupervision, VobcEvent, HEARTBEATS[Node.VOBC]
    ]  # fmt: skip
    assert bench.device.output == replace(SAFE_OUTPUT, cause="controller ends")
    assert "controller ends" in bench.lines.entries[-1]["words"]
    assert bench.lines.flushed == 1


STOOD = OdometryRecord(1234.0, 2.0, 0.86 * math.pi / 256)


@pytest.mark.parametrize(
    ("kept", "standing"),
    [
        (STOOD, True),
        (replace(STOOD, bound_m=math.nextafter(2.0, 3.0)), False),
        (replace(STOOD, proof=PlaceProof.UNKNOWN), False),
        (replace(STOOD, proof=PlaceProof.REMEMBERED), True),
    ],
)
def test_place_wheel_and_term_are_stored_once_at_each_stop(
    kept: OdometryRecord, *, standing: bool
) -> None:
    bench = Bench()
    bench.controller.kept = kept
    bench.cycle()

    bench.controller.output = STANDING
    bench.cycle()
    stored = bench.nvram.record
    bench.controller.kept = replace(kept, front_m=9.0)
    bench.cycle()

    assert bench.nvram.record is stored
    assert stored.wheel_diameter_m == pytest.approx(0.86)
    own = identity_of(CONFIG, LINE).stamped(NvramRecord(boot_count=41))
    assert replace(stored, wheel_diameter_m=None) == replace(own, front_m=1234.0, standing=standing)


@pytest.mark.parametrize("moving", [DRIVING, replace(STANDING, supervision=Supervision.EMERGENCY)])
def test_a_train_that_moves_or_is_in_an_emergency_has_no_stored_place(moving: CycleOutput) -> None:
    bench = Bench()
    stood = []
    for output in (DRIVING, STANDING, moving):
        bench.controller.output = output
        bench.cycle()
        stood.append(bench.nvram.record.standing)
    assert stood == [False, True, False]

    bench.controller.output = STANDING
    bench.cycle()
    assert bench.nvram.record.standing


def test_a_train_that_never_moved_stores_nothing_and_keeps_what_it_had() -> None:
    bench = Bench()
    for output in (STANDING, SAFE_OUTPUT, STANDING, replace(DRIVING, motion=None), STANDING):
        bench.controller.output = output
        bench.cycle()

    assert bench.nvram.record == NvramRecord(boot_count=41)


def test_parameters_that_contradict_each_other_start_no_device() -> None:
    wide = replace(CONFIG, odometry=replace(CONFIG.odometry, tag_bound_m=0.4))

    with pytest.raises(SettingsError, match=r"tag_bound_m: 0\.4 is not less"):
        Bench(wide)


PATH = OtherPath(0.0, 5000.0, lambda at_m: 5000.0 - at_m)


@pytest.mark.parametrize(
    ("output", "proof"),
    [
        (STANDING, PlaceProof.REMEMBERED),
        (DRIVING, PlaceProof.UNKNOWN),
        (SAFE_OUTPUT, PlaceProof.UNKNOWN),
        (replace(STANDING, supervision=Supervision.EMERGENCY), PlaceProof.UNKNOWN),
    ],
)
def test_a_standing_train_hands_its_place_over(output: CycleOutput, proof: PlaceProof) -> None:
    bench = Bench()
    bench.device.output = output

    found = bench.device.hand_over(PATH)

    assert found.proof is proof
    if proof is PlaceProof.REMEMBERED:
        assert found.front_m == 5000.0 - (1234.0 - CONFIG.train.length_m)


def test_a_lost_or_foreign_memory_is_said_and_a_good_one_is_not() -> None:
    own = identity_of(CONFIG, LINE).stamped(NvramRecord(front_m=1.0, standing=True))

    assert Bench(record=own).lines.entries == []
    assert [e["kind"] for e in Bench(forgotten=True).lines.entries] == ["MEMORY_LOST"]
    foreign = Bench(record=replace(own, line="hefei"))
    (said,) = foreign.lines.words(EventKind.MEMORY_LOST)
    assert "it belongs to line hefei, this is line florence" in said
    assert foreign.nvram.record.front_m is None
    start = OdometryRecord(2000.0, 0.5, 0.01)
    assert isinstance(foreign.real, Controller)
    assert Bench(start=start).real.record().front_m == 2000.0
    assert foreign.real.record().front_m == plan_mission(LINE, "II", "III").start.stop_m


class Command:
    """Stands for train-to-train control, and notes when it is called."""

    class Radio:
        key = BENCH_KEY

    def __init__(self) -> None:
        self.radio, self.refusals = self.Radio(), Refusals()
        self.calls: list[str] = []
        self.event: Any = None
        self.silence_words = "silent"

    def apply(self, _now_ns: int, _motion: Any) -> None:
        self.calls.append("apply")

    def hold_on(self, _link: Any) -> None:
        self.calls.append("hold_on")

    def send(self, _now_ns: int) -> None:
        self.calls.append("send")

    def beat(self, _now_ns: int, _motion: Any) -> None:
        self.calls.append("beat")

    def silence(self, _now_ns: int, from_centre: int) -> Any:
        self.calls.append(f"silence {from_centre}")
        return self.event


def test_other_trains_are_heard_before_the_cycle_and_answered_after_it() -> None:
    command = Command()
    command.refusals.note(0, "too old", "from the line", 3)
    bench = Bench(command=command)
    bench.ports.radio.inbox = [RadioMessage(START_NS, "key", pack(orders()))]

    bench.cycle()
    bench.device.line_beat(START_NS)
    bench.device.life_sign(START_NS)

    assert command.calls == ["apply", "hold_on", "send", "beat", "silence 1"]
    assert bench.device.waits_for_line == "silent"
    refused = bench.lines.words(EventKind.RADIO_REFUSED)
    assert refused[-1] == "3 messages on the radio refused: too old, from the line"
    command.event = Event(EventKind.INPUT_LOST, "the line is silent")
    bench.device.life_sign(START_NS)
    assert bench.lines.entries[-1]["words"] == "the line is silent"
    bench.ports.radio.sent.clear()
    bench.device.report_position(START_NS)
    assert [type(unpack(each)) for _, each in bench.ports.radio.sent] == [TrainStatus]
    alone = Bench()
    alone.device.line_beat(START_NS)
    assert alone.device.waits_for_line == ""
