"""The controller as a device on a bus in virtual time, beside a train that only stands."""

import itertools
import json
import math
from collections import Counter
from dataclasses import replace
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import pytest

from can_dbc import binding
from can_dbc.alarms import TrainAlarms
from can_dbc.brake import BrakeCommand, BrakeStatus
from can_dbc.cab import CabMode, Desk
from can_dbc.codec import Decoder, Encoder, Rejected
from can_dbc.diagnostics import EMERGENCIES, HEARTBEATS, NodeHeartbeat, NodeState
from can_dbc.doors import DoorCars, DoorCommand, DoorState, DoorStatus
from can_dbc.nodes import Direction, Node
from can_dbc.odometer import ColdMovement, Tacho
from can_dbc.tags import TagReaderHealth
from can_dbc.traction import TractionCommand, TractionStatus
from can_dbc.vobc import (
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
from firmware_py.buses.inproc import InprocBus
from firmware_py.clock.clock import LockstepClock
from firmware_py.clock.executive import Executive, Task, run
from firmware_py.radio.inproc_radio import InprocRadio
from firmware_py.settings import SettingsError
from firmware_py.storage.nvram import Nvram, NvramRecord
from firmware_py.storage.recorder import LineLog
from firmware_py.tag_reader.inproc_line import inproc_line
from firmware_py.trackdb import load_line
from firmware_py.trackdb.version import database_version
from hil_tests.unit.vobc.atp.heard_rig import DESK
from vobc.config import load_config, plan_mission
from vobc.process import (
    CYCLE_COLUMNS,
    EventLines,
    VobcDevice,
    commissioned_start,
    remembered_start,
)
from vobc.process.event_log import FRAMES_PER_CYCLE
from vobc.process.identity import identity_of
from vobc.process.line_command import LineCommand
from vobc.process.line_silence import LineSilence
from vobc.vocabulary import SAFE_OUTPUT, Event
from vobc.wire.refusals import Refusals
from zenoh_config import keys
from zenoh_config.codec import BENCH_KEY, pack, unpack
from zenoh_config.messages import MovementAuthority, PositionReport, TrainOrders, TrainStatus

LINE = load_line("florence")
LEARN_S = load_config("florence4").odometry.learn_s
NS_PER_MS = 1_000_000
BABBLE_ID = 0x7F0
SENT = (
    BrakeCommand, TractionCommand, DoorCommand, DoorCars, VobcStatus, VobcMotion, VobcPosition,
    VobcTarget, VobcMode, VobcLimits, VobcSupervision, VobcEvent, HEARTBEATS[Node.VOBC],
    EMERGENCIES[Node.VOBC],
)  # fmt: skip


class World:
    """A standing train, a wayside that grants 500 m, a centre, and a listener on the bus."""

    def __init__(
        self,
        *,
        cycle_ms: float = 50.0,
        nvram: Nvram | None = None,
        log: LineLog | None = None,
        events: EventLines | None = None,
        forgotten: bool = False,
        command: LineCommand | None = None,
    ) -> None:
        self.clock = LockstepClock()
        bus = InprocBus("test", 250_000)
        self.port, self.ear = bus.port("TRAIN"), bus.port("EAR")
        self.bus = bus
        air = InprocRadio(0.02)
        self.radio = air.port("wayside", (keys.reports(LINE.name), keys.statuses(LINE.name)))
        controller_end, self.reader = inproc_line()
        self.encoder, self.decoder = Encoder(), Decoder(SENT)
        self.pulses = 0
        self.desk = DESK
        self.heard: list[tuple[int, object]] = []
        self.reports: list[PositionReport] = []
        self.statuses: list[TrainStatus] = []
        self.hold = False
        self.nvram = nvram or Nvram(None)
        config = load_config("florence4", cycle_ms=cycle_ms)
        self.vobc = VobcDevice(
            config,
            LINE,
            plan_mission(LINE, "II", "III"),
            can=bus.port("VOBC"),
            tags=controller_end,
            radio=air.port(
                "train",
                (
                    keys.authorities(LINE.name, config.address),
                    keys.orders(LINE.name, config.address),
                ),
            ),
            nvram=self.nvram,
            cycle_log=log,
            event_log=events,
            forgotten=forgotten,
            start_ns=0,
            command=command,
        )
        self.executive = Executive(
            [Task("train", 20.0, self.train), Task("listen", 5.0, self.listen)], 0
        )

    def train(self, now_ns: int) -> None:
        counter = self.pulses % 65536
        for frame in (
            Tacho(counter, counter % 1024, Direction.NEUTRAL, True, True, now_ns // 10**6 % 256),
            BrakeStatus(0.0, 0.0, False, True, False, True),
            TractionStatus(0.0, 1.0, True, True),
            DoorStatus(True, DoorState.LOCKED, DoorState.LOCKED, True),
            self.desk,
            TagReaderHealth(True, 0, 0.0),
            TrainAlarms(no_obstacle=True, no_fire=True),
            ColdMovement(moved_m=0.0, monitored=True),
        ):
            for can_id, payload in self.encoder.encode(frame):
                self.port.send(now_ns, can_id, payload)
        for message in self.radio.receive(now_ns):
            heard = unpack(message.payload)
            if isinstance(heard, PositionReport):
                self.reports.append(heard)
                self.grant(now_ns, heard)
            else:
                assert isinstance(heard, TrainStatus)
                self.statuses.append(heard)
                self.order(now_ns, heard)

    def answer(self, now_ns: int, key: str, message: MovementAuthority | TrainOrders) -> None:
        self.radio.send(now_ns, key, pack(message, database=database_version(LINE)))

    def grant(self, now_ns: int, report: PositionReport) -> None:
        answer = MovementAuthority(
            report.train,
            report.boot,
            4,
            len(self.reports),
            report.stamp_ns,
            3500.0,
            parameters=report.parameters,
        )
        self.answer(now_ns, keys.authority(LINE.name, 0, report.train), answer)

    def order(self, now_ns: int, status: TrainStatus) -> None:
        answer = TrainOrders(
            train=status.train,
            boot=status.boot,
            sequence=len(self.statuses),
            echo_stamp_ns=status.stamp_ns,
            awake=True,
            hold=self.hold,
            skip_next=False,
            stop_next=False,
            emergency=False,
            releases=0,
            creep=False,
            restricted=False,
            doors_left=False,
            doors_right=False,
            platform_doors_locked=True,
        )
        self.answer(now_ns, keys.order(LINE.name, 0, status.train), answer)

    def listen(self, now_ns: int) -> None:
        for frame in self.ear.receive(now_ns):
            if frame.can_id == BABBLE_ID:
                continue
            heard = self.decoder.decode(frame.can_id, frame.data, frame.stamp_ns)
            assert not isinstance(heard, Rejected), heard
            if heard is not None:
                self.heard.append((frame.stamp_ns, heard))

    def run(self, seconds: float) -> None:
        end_ns = self.clock.now_ns() + round(seconds * 1e9)
        run([self.executive, self.vobc.executive], self.clock, lambda now_ns: now_ns >= end_ns)

    def of(self, kind: type) -> list[object]:
        return [frame for _, frame in self.heard if isinstance(frame, kind)]

    def last_words(self) -> list[object]:
        """The frames on the bus from now on."""
        self.heard.clear()
        self.bus.advance(self.clock.now_ns() + 1_000_000_000)
        self.listen(self.clock.now_ns() + 1_000_000_000)
        return [frame for _, frame in self.heard]


def test_from_the_first_cycle_the_train_is_braked_until_it_may_move() -> None:
    world = World()

    world.run(3.0)

    brakes, states = world.of(BrakeCommand), world.of(VobcStatus)
    assert isinstance(brakes[0], BrakeCommand)
    assert not brakes[0].emergency_released
    assert isinstance(states[0], VobcStatus)
    assert states[0].supervision is Supervision.NO_AUTHORITY
    assert isinstance(brakes[-1], BrakeCommand)
    assert brakes[-1].emergency_released
    assert isinstance(states[-1], VobcStatus)
    assert states[-1].supervision is Supervision.NOMINAL


@pytest.mark.parametrize(
    ("cycle_ms", "expected"),
    [
        (
            50.0,
            {
                BrakeCommand: 60,
                DoorCommand: 30,
                VobcStatus: 60,
                VobcMotion: 30,
                VobcLimits: 30,
                VobcSupervision: 30,
                VobcTarget: 15,
            },
        ),
        (
            5.0,
            {BrakeCommand: 600, DoorCommand: 30, VobcStatus: 60, VobcMotion: 30, VobcTarget: 15},
        ),
        (
            20.0,
            {BrakeCommand: 150, DoorCommand: 30, VobcStatus: 75, VobcMotion: 30, VobcTarget: 15},
        ),
        (
            100.0,
            {BrakeCommand: 60, DoorCommand: 30, VobcStatus: 30, VobcMotion: 30, VobcTarget: 15},
        ),
        (
            200.0,
            {BrakeCommand: 60, DoorCommand: 15, VobcStatus: 15, VobcMotion: 15, VobcTarget: 15},
        ),
    ],
)
def test_every_frame_has_its_period_whatever_the_cycle_time(
    cycle_ms: float, expected: dict[type, int]
) -> None:
    """The test counts over three seconds once odometry reports; the edges allow one frame more
    or less."""
    world = World(cycle_ms=cycle_ms)
    world.run(LEARN_S)
    world.heard.clear()

    world.run(3.0)

    counted = Counter(type(frame) for _, frame in world.heard)
    for kind, count in expected.items():
        assert abs(counted[kind] - count) <= count // 12 + 1, (kind, counted[kind])
    stamps_ns = [stamp for stamp, frame in world.heard if isinstance(frame, BrakeCommand)]
    gaps_ns = [b - a for a, b in itertools.pairwise(stamps_ns)]
    assert max(gaps_ns) < 60 * NS_PER_MS


def test_the_brake_command_is_the_first_frame_of_a_cycle() -> None:
    world = World()

    world.run(0.01)

    assert isinstance(world.heard[0][1], BrakeCommand)
    assert isinstance(world.heard[1][1], TractionCommand)


def test_single_cars_are_sent_while_they_are_enabled_and_withdrawn_once() -> None:
    world = World()
    world.run(0.2)
    single = replace(world.vobc.output, enable_right=True, open_right=True, door_cars=0b11)

    for at, output in enumerate((SAFE_OUTPUT, single, single, SAFE_OUTPUT, SAFE_OUTPUT)):
        world.vobc._send_doors(world.clock.now_ns() + at * 100 * NS_PER_MS, output)

    said = [frame for frame in world.last_words() if isinstance(frame, DoorCars | DoorCommand)]
    assert [frame for frame in said if isinstance(frame, DoorCars)] == [
        DoorCars(0, 0b11), DoorCars(0, 0b11), DoorCars(0, 0),
    ]  # fmt: skip
    assert not any(frame.enable_right for frame in said if isinstance(frame, DoorCommand))


def test_parameters_that_do_not_fit_the_line_never_start() -> None:
    config = load_config("florence4", changes={"train.length_m": 90.0})

    with pytest.raises(SettingsError, match="no door of the train of 90 m"):
        VobcDevice(
            config,
            LINE,
            plan_mission(LINE, "II", "III"),
            can=Mock(),
            tags=Mock(),
            radio=Mock(),
            nvram=Nvram(None),
            cycle_log=None,
            start_ns=0,
        )


def test_a_crash_in_a_cycle_sends_the_safe_output_and_ends_the_process(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    world = World()
    world.run(3.0)
    assert world.vobc.output.emergency_released

    def crash(*_: object) -> None:
        raise ZeroDivisionError("made by the test")

    monkeypatch.setattr(world.vobc._controller, "step", crash)
    world.listen(world.clock.now_ns())
    world.heard.clear()
    with pytest.raises(ZeroDivisionError, match="made by the test"):
        world.run(1.0)

    words = world.last_words()
    assert BrakeCommand(2.0, False, False) in words
    assert TractionCommand(0.0, Direction.NEUTRAL, False) in words
    assert DoorCommand(False, False, False, False) in words
    assert HEARTBEATS[Node.VOBC](NodeState.STOPPED) in words


def test_repetitions_do_not_hide_a_crash_of_a_slow_controller(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Repetitions end with the cycles, even if no fault was detected."""
    world = World(cycle_ms=200.0)
    world.run(3.0)
    monkeypatch.setattr(world.vobc, "control_cycle", lambda now_ns: None)
    frozen = Executive([Task("repeat", 50.0, world.vobc.repeat_vital)], world.clock.now_ns())
    world.listen(world.clock.now_ns())
    world.heard.clear()

    end_ns = world.clock.now_ns() + 2_000_000_000
    run([world.executive, frozen], world.clock, lambda now_ns: now_ns >= end_ns)

    assert 1 <= len(world.of(BrakeCommand)) <= 9


def test_the_last_frames_of_a_stopped_controller_are_the_safe_output() -> None:
    world = World()
    world.run(3.0)
    world.listen(world.clock.now_ns())

    world.vobc.stop(world.clock.now_ns())

    words = world.last_words()
    assert words[0] == BrakeCommand(2.0, False, False)
    assert isinstance(words[-1], NodeHeartbeat)
    assert world.vobc.output.cause == "controller ends"


def test_an_emergency_is_reported_once_at_its_begin_and_once_at_its_end() -> None:
    world = World()
    world.run(3.0)
    for pressed, reset in ((True, False), (False, False), (False, True), (False, False)):
        world.desk = Desk(CabMode.AUTO, 0.0, not pressed, True, False, reset, False, False)
        world.run(3.0)

    emcy = EMERGENCIES[Node.VOBC]
    told = world.of(emcy)
    assert [frame.error_code for frame in told if isinstance(frame, emcy)] == [0xFF01, 0]
    assert world.vobc.output.supervision is Supervision.NOMINAL


def test_heartbeats_come_every_second_and_begin_with_the_boot_up() -> None:
    world = World()

    world.run(3.5)

    states = [beat.state for beat in world.of(NodeHeartbeat) if isinstance(beat, NodeHeartbeat)]
    assert states == [NodeState.BOOT_UP] + 3 * [NodeState.OPERATIONAL]


def test_position_reports_come_five_times_a_second_with_the_incarnation_of_this_start() -> None:
    world = World(nvram=Nvram(None, NvramRecord(boot_count=41)))
    world.run(LEARN_S)

    world.run(2.1)

    assert 9 <= len(world.reports) <= 11
    assert {report.boot for report in world.reports} == {42}
    sequences = [report.sequence for report in world.reports]
    assert sequences == list(range(sequences[0], sequences[0] + len(sequences)))
    assert world.reports[-1].front_min_m <= 3000.0 <= world.reports[-1].front_max_m


def test_each_start_is_counted_on_disk_before_the_first_frame(tmp_path: Path) -> None:
    path = tmp_path / "nvram"

    World(nvram=Nvram(path))
    World(nvram=Nvram(path))

    record = Nvram(path).record
    assert record.boot_count == 2
    assert not record.standing


def test_position_and_wheel_are_stored_at_the_first_standstill_after_a_run(tmp_path: Path) -> None:
    path = tmp_path / "nvram"
    world = World(nvram=Nvram(path))
    world.run(3.0)
    for _ in range(10):
        world.pulses += 2
        world.run(0.04)
    world.run(4.0)
    world.nvram.close()

    record = Nvram(path).record
    assert record.standing
    assert record.front_m == pytest.approx(3000.0 + 20 * math.pi * 0.86 / 256, abs=0.05)
    assert record.wheel_diameter_m == pytest.approx(0.86, rel=0.05)
    assert record.highest_term == 4


def test_the_memory_of_a_moving_train_does_not_say_that_it_stands(tmp_path: Path) -> None:
    """The test reads the memory as after a power cut in motion, without an orderly end of the
    process."""
    path = tmp_path / "nvram"
    world = World(nvram=Nvram(path))
    world.run(3.0)
    for _ in range(10):
        world.pulses += 2
        world.run(0.04)
    world.run(4.0)
    assert world.nvram.record.standing

    for _ in range(20):
        world.pulses += 10
        world.run(0.02)
    world.nvram.close()

    assert not Nvram(path).record.standing
    assert remembered_start(load_config("florence4"), LINE, Nvram(path).record) is None


def test_a_power_cycle_does_not_end_a_latched_emergency() -> None:
    """The memory does not store latched causes, but the position stays unknown until they are
    released."""
    world = World()
    world.run(3.0)
    assert world.nvram.record.standing

    world.desk = replace(world.desk, emergency_released=False)
    world.run(1.0)
    assert not world.nvram.record.standing

    world.desk = replace(world.desk, emergency_released=True)
    world.run(1.0)
    assert not world.nvram.record.standing

    world.desk = replace(world.desk, reset_requested=True)
    world.run(0.5)
    assert world.nvram.record.standing


def test_the_cycle_log_has_a_row_for_each_cycle_and_no_torn_field(tmp_path: Path) -> None:
    path = tmp_path / "cycles.csv"
    log = LineLog(path, CYCLE_COLUMNS)
    world = World(log=log)

    world.run(3.0)
    log.close()

    rows = [line.split(",") for line in path.read_text(encoding="utf-8").splitlines()]
    assert rows[0] == list(CYCLE_COLUMNS)
    assert len(rows) == 1 + 60
    column = {name: index for index, name in enumerate(CYCLE_COLUMNS)}
    last = rows[-1]
    assert float(last[column["t_s"]]) == pytest.approx(2.95)
    assert float(last[column["front_m"]]) == pytest.approx(3000.0)
    assert last[column["supervision"]] == "nominal"


def entries(path: Path) -> list[dict[str, Any]]:
    return [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()]


def test_every_event_is_on_the_bus_and_in_the_log_under_the_same_number(tmp_path: Path) -> None:
    log = EventLines(tmp_path / "events.jsonl")
    world = World(events=log)

    world.run(3.0)
    world.hold = True
    world.run(1.0)
    log.close()

    told, on_bus = entries(log.path), world.of(VobcEvent)
    assert [entry["number"] for entry in told] == list(range(1, len(told) + 1))
    assert [frame.number for frame in on_bus if isinstance(frame, VobcEvent)] == [
        entry["number"] for entry in told
    ]
    assert [frame.event.name for frame in on_bus if isinstance(frame, VobcEvent)] == [
        entry["kind"] for entry in told
    ]
    held = next(entry for entry in told if "hold at the platform" in entry["words"])
    assert held["kind"] == "ORDERS_CHANGED"
    assert held["t_s"] >= 3.0


def test_an_event_names_the_frames_that_it_was_decided_from(tmp_path: Path) -> None:
    log = EventLines(tmp_path / "events.jsonl")
    world = World(events=log)
    world.run(3.0)

    world.desk = Desk(CabMode.AUTO, 0.0, False, True, False, False, False, False)
    world.run(1.0)
    log.close()

    (brake,) = (entry for entry in entries(log.path) if entry["kind"] == "EMERGENCY_APPLIED")
    (source,) = brake["sources"]
    assert (source["source"], source["id"]) == ("DESK", binding.can_id(Desk))
    heard = Decoder([Desk]).decode(source["id"], bytes.fromhex(source["payload"]), 0)
    assert isinstance(heard, Desk)
    assert not heard.emergency_released
    assert 0.0 <= brake["t_s"] - source["heard_s"] <= 0.1
    (frame,) = (
        each
        for each in world.of(VobcEvent)
        if isinstance(each, VobcEvent) and each.event is EventKind.EMERGENCY_APPLIED
    )
    assert (frame.frame_a, frame.frame_b) == (binding.can_id(Desk), 0)


def test_a_babbling_node_causes_one_counting_event_per_second(tmp_path: Path) -> None:
    log = EventLines(tmp_path / "events.jsonl")
    world = World(events=log)
    for _ in range(60):
        world.port.send(world.clock.now_ns(), BABBLE_ID, b"noise")
        world.run(0.05)
    log.close()

    told = [entry for entry in entries(log.path) if entry["kind"] == "FRAME_REJECTED"]
    assert 3 <= len(told) <= 4
    assert {entry["value"] for entry in told} == {BABBLE_ID}
    assert "0x7f0 refused" in told[1]["words"]
    assert sum(int(entry["words"].split()[0]) for entry in told) <= 60
    assert world.vobc.refused["frames"] in (59, 60), "the last one may still be on its way"


def test_a_burst_of_events_is_sent_a_few_at_a_time_without_loss() -> None:
    world = World()
    burst = [Event(EventKind.TAG_REJECTED, f"tag {number}", (), number) for number in range(30)]

    world.vobc._events.tell(0, burst)
    world.run(3.0)

    per_cycle = Counter(
        stamp_ns // (50 * NS_PER_MS) for stamp_ns, frame in world.heard
        if isinstance(frame, VobcEvent)
    )  # fmt: skip
    assert max(per_cycle.values()) <= 2 * FRAMES_PER_CYCLE
    numbers = [frame.number for frame in world.of(VobcEvent) if isinstance(frame, VobcEvent)]
    assert numbers[:30] == list(range(1, 31))


def test_a_lost_memory_is_the_first_event(tmp_path: Path) -> None:
    log = EventLines(tmp_path / "events.jsonl")
    world = World(events=log, forgotten=True)

    world.run(0.2)
    log.close()

    kinds = [entry["kind"] for entry in entries(log.path)]
    assert kinds[:3] == ["MEMORY_LOST", "SUPERVISION", "MODE"]


def test_silence_and_rejections_on_a_line_are_events_on_the_bus_and_in_the_log(
    tmp_path: Path,
) -> None:
    silence, refusals = LineSilence("tcp/127.0.0.1:7448"), Refusals()
    refusals.note(0, "too old", "from the line", 3)
    radio = Mock(key=BENCH_KEY)
    command = Mock(held=None, radio=radio, silence=silence.look, refusals=refusals)
    log = EventLines(tmp_path / "events.jsonl")
    world = World(events=log, command=command)
    # The wayside stops sending orders of the centre, too.
    world.order = lambda now_ns, status: None  # type: ignore[method-assign]

    world.run(8.0)
    log.close()

    (lost,) = [each for each in entries(log.path) if "line's radio" in each["words"]]
    assert (lost["kind"], lost["value"]) == ("INPUT_LOST", 0)
    (refused,) = [each for each in entries(log.path) if each["kind"] == "RADIO_REFUSED"]
    assert refused["words"] == "3 messages on the radio refused: too old, from the line"
    told = [(each.event, each.cause) for _, each in world.heard if isinstance(each, VobcEvent)]
    assert (EventKind.INPUT_LOST, 0) in told


def test_status_is_sent_five_times_a_second_with_or_without_a_position() -> None:
    world = World()

    world.run(4.0)

    assert 19 <= len(world.statuses) <= 20
    assert len(world.statuses) >= len(world.reports)
    stamps_ns = [status.stamp_ns for status in world.statuses]
    assert {b - a for a, b in itertools.pairwise(stamps_ns)} == {200 * NS_PER_MS}
    assert world.statuses[-1].doors_locked


def test_two_runs_of_the_same_world_send_the_same_frames_at_the_same_instants() -> None:
    first, second = World(), World()

    first.run(4.0)
    second.run(4.0)

    assert first.heard == second.heard
    assert len(first.heard) > 300


def test_where_a_train_may_stand_after_a_power_cycle() -> None:
    config, mission = load_config("florence4"), plan_mission(LINE, "II", None)
    own = identity_of(config, LINE)
    stood = own.stamped(NvramRecord(front_m=1234.0, standing=True, wheel_diameter_m=0.84))

    remembered = remembered_start(config, LINE, stood)
    commissioned = commissioned_start(config, LINE, mission, stood)

    assert remembered is not None
    assert (remembered.front_m, remembered.bound_m) == (1234.0, config.odometry.cold_movement_m)
    assert (commissioned.front_m, commissioned.bound_m) == (3000.0, config.odometry.start_bound_m)
    assert commissioned.m_per_pulse == pytest.approx(math.pi * 0.84 / 256)
    assert remembered_start(config, LINE, replace(stood, standing=False)) is None
    assert remembered_start(config, LINE, NvramRecord()) is None
