"""The plant on its wires: bytes in and bytes out, on the lockstep bus and on a shared port."""

import hashlib
import itertools
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from functools import partial

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from can_dbc.analogue import AnalogueCommand
from can_dbc.binding import Frame, can_id, kinds, period_s, sender
from can_dbc.brake import BrakeCommand, BrakeStatus
from can_dbc.cab import CabMode, Desk
from can_dbc.codec import Decoder, Encoder, Rejected
from can_dbc.diagnostics import EMERGENCIES, HEARTBEATS, Emergency, NodeState, TimeOfDay
from can_dbc.doors import DoorCommand
from can_dbc.nodes import Direction, Node
from can_dbc.odometer import Tacho
from can_dbc.traction import TractionCommand, TractionStatus
from firmware_py.buses.inproc import InprocBus
from firmware_py.clock.clock import LockstepClock
from firmware_py.clock.executive import Executive, Task, run
from firmware_py.ports import CanFrame, LinkCounters
from firmware_py.radio.inproc_radio import InprocRadio
from firmware_py.tag_reader.inproc_line import inproc_line
from firmware_py.tag_reader.telegram import HealthTelegram, TagTelegram, TelegramParser
from firmware_py.trackdb import load_line
from firmware_py.trackdb.version import database_version
from plant_emulator.process import TRUTH_COLUMNS, PlantDevice
from plant_emulator.wire import COMMAND_IDS, PHASES_MS, PLANT_NODES, ROUND_MS, timetable
from plant_emulator.world import STEP_NS, TrainScenario, plan_scenario
from zenoh_config import codec, keys
from zenoh_config.codec import unpack
from zenoh_config.messages import MovementAuthority, PositionReport

pack = partial(codec.pack, database=database_version(load_line("florence")))


RELEASED = BrakeCommand(service_decel_mps2=0.0, emergency_released=True, holding_released=True)
PULLING = TractionCommand(force_n=100_000.0, direction=Direction.FORWARD, traction_permitted=True)
CLOSED = DoorCommand(enable_left=False, enable_right=False, open_left=False, open_right=False)
GO = (RELEASED, PULLING, CLOSED)
CONTROL_IDS = frozenset(can_id(kind) for kind in kinds() if sender(kind) != Node.VOBC.name)


Spoil = Callable[[int, bytes], bytes | None]
"""How a command is changed on its way; None loses it."""


class Rows:
    """A truth log in memory."""

    def __init__(self) -> None:
        self.rows: list[dict[str, object]] = []

    def row(self, *values: object) -> None:
        self.rows.append(dict(zip(TRUTH_COLUMNS, values, strict=True)))

    def numbers(self, name: str) -> list[float]:
        return [float(row[name]) for row in self.rows]  # type: ignore[arg-type]


class Stand:
    """A plant on a virtual bus, with a port for the test's controller."""

    def __init__(self, scenario: TrainScenario | None = None, start_ns: int = 0) -> None:
        self.log = hashlib.sha256()
        self.sent: Counter[tuple[str, int]] = Counter()
        self.bus = InprocBus("vcan0", 250_000, self._record)
        self.port = self.bus.port("VOBC", CONTROL_IDS)
        plant_line, self.line = inproc_line()
        air = InprocRadio(0.02)
        self.radio = air.port("train", (keys.authorities("florence", 1),))
        self.truth = Rows()
        self.start_ns = start_ns
        self.clock = LockstepClock(start_ns)
        self.plant = PlantDevice(
            scenario or plan_scenario(seed=1),
            open_port=lambda node, ids: self.bus.port(node.name, ids),
            tags=plant_line,
            radio=air.port("wayside", (keys.reports("florence"),)),
            truth=self.truth,
            start_ns=start_ns,
        )
        self.decoder = Decoder(kind for kind in kinds() if sender(kind) != Node.VOBC.name)
        self.encoder = Encoder()
        self.commands: Sequence[Frame] = ()
        self.spoil: Spoil = lambda identifier, data: data
        self.heard: list[tuple[int, Frame]] = []
        self.rejected: list[Rejected] = []
        self._life = Executive([Task("control", 50.0, self._control, offset_ms=1.0)], start_ns)

    def _record(self, frame: CanFrame, node: str) -> None:
        self.sent[node, frame.can_id] += 1
        self.log.update(f"{frame.stamp_ns} {frame.can_id:x} {frame.data.hex()}\n".encode())

    def _control(self, now_ns: int) -> None:
        self.take(now_ns)
        for frame in self.commands:
            for identifier, data in self.encoder.encode(frame):
                spoiled = self.spoil(identifier, data)
                if spoiled is not None:
                    self.port.send(now_ns, identifier, spoiled)

    def take(self, now_ns: int) -> None:
        for frame in self.port.receive(now_ns):
            heard = self.decoder.decode(frame.can_id, frame.data, frame.stamp_ns)
            if isinstance(heard, Rejected):
                self.rejected.append(heard)
            elif heard is not None:
                self.heard.append((frame.stamp_ns, heard))

    def run(self, duration_s: float, commands: Iterable[Frame] = ()) -> "Stand":
        self.commands = tuple(commands)
        end_ns = self.clock.now_ns() + round(duration_s * 1e9)
        run([self._life, self.plant.executive], self.clock, lambda now_ns: now_ns >= end_ns)
        self.take(end_ns)
        return self

    def latest(self, kind: type[Frame]) -> Frame:
        return next(frame for _, frame in reversed(self.heard) if type(frame) is kind)

    def all(self, kind: type[Frame]) -> list[tuple[int, Frame]]:
        return [(at_ns, frame) for at_ns, frame in self.heard if type(frame) is kind]


def test_the_schedule_has_every_cyclic_frame_of_the_trains_nodes_at_its_period() -> None:
    ours = {kind for kind in kinds() if sender(kind) in {node.name for node in PLANT_NODES}}
    cyclic = {kind for kind in ours if period_s(kind) > 0.0}
    counted = Counter(sending.kind for slot in timetable() for sending in slot)

    assert set(PHASES_MS) == cyclic
    assert ours - cyclic == {EMERGENCIES[node] for node in PLANT_NODES}
    for kind in cyclic:
        assert counted[kind] == round(ROUND_MS / 1000.0 / period_s(kind))


def test_every_frame_passes_the_decoder_and_comes_from_its_own_node() -> None:
    stand = Stand().run(5.0, GO)

    assert stand.rejected == []
    assert {type(frame) for _, frame in stand.heard} == set(PHASES_MS)
    by_id = {can_id(kind): sender(kind) for kind in PHASES_MS}
    for (node, identifier), count in stand.sent.items():
        if node != "VOBC":
            assert by_id[identifier] == node
            assert count >= 4


def test_frames_come_at_their_periods_within_the_arbitration_time() -> None:
    stand = Stand().run(5.0, GO)
    for kind, tolerance_ns in ((Tacho, 3_000_000), (BrakeStatus, 3_000_000), (Desk, 3_000_000)):
        stamps_ns = [at_ns for at_ns, _ in stand.all(kind)]
        wanted_ns = round(period_s(kind) * 1e9)
        gaps_ns = [later - earlier for earlier, later in itertools.pairwise(stamps_ns)]
        assert max(abs(gap_ns - wanted_ns) for gap_ns in gaps_ns) <= tolerance_ns


def test_without_a_controller_the_train_stands_braked_and_reports_it() -> None:
    stand = Stand().run(3.0)
    brake, traction = stand.latest(BrakeStatus), stand.latest(TractionStatus)
    assert isinstance(brake, BrakeStatus)
    assert isinstance(traction, TractionStatus)
    assert brake.emergency_applied
    assert brake.holding_applied
    assert traction.traction_cut
    assert stand.plant.world.front_m == 0.0


def test_commands_in_valid_pairs_move_the_train() -> None:
    stand = Stand().run(10.0, GO)
    tacho = stand.latest(Tacho)
    assert isinstance(tacho, Tacho)
    assert stand.plant.world.front_m > 5.0
    assert tacho.pulses_a > 500
    assert tacho.direction is Direction.FORWARD
    assert stand.plant.wire.refusals == {}
    assert stand.plant.command_losses == {"BCU": 0, "TCU": 0, "DCU": 0}


def test_half_a_pair_is_no_command() -> None:
    """Without the inverted twins every command is missing, and the train stays braked."""
    stand = Stand()
    first_halves = {can_id(kind) for kind in (BrakeCommand, TractionCommand, DoorCommand)}
    stand.spoil = lambda identifier, data: data if identifier in first_halves else None
    stand.run(5.0, GO)

    assert stand.plant.wire.commands == 0
    assert stand.plant.world.front_m == 0.0
    assert sum(stand.plant.wire.refusals.values()) > 0


def test_silence_ends_in_the_emergency_brake_and_an_emergency_message() -> None:
    stand = Stand().run(12.0, GO)
    assert stand.plant.world.speed_mps > 3.0
    from_ns = stand.clock.now_ns()

    stand.run(8.0)

    assert stand.plant.world.speed_mps == 0.0
    assert stand.plant.command_losses == {"BCU": 1, "TCU": 1, "DCU": 1}
    asked_s = next(
        float(str(row["t_s"]))
        for row in stand.truth.rows
        if row["emergency"] and float(str(row["t_s"])) * 1e9 > from_ns
    )
    # The last pair was sent 49 ms before; rows of the log are 50 ms apart.
    assert asked_s - from_ns / 1e9 <= 0.15 - 0.049 + 0.05 + 0.001
    errors = [frame for _, frame in stand.heard if isinstance(frame, Emergency)]
    assert {frame.node for frame in errors} == {Node.BCU, Node.TCU, Node.DCU}
    assert all(frame.error_code == 0x8130 for frame in errors)

    stand.run(1.0, GO)

    cleared = [frame for _, frame in stand.heard if isinstance(frame, Emergency)][len(errors) :]
    assert {frame.node for frame in cleared} == {Node.BCU, Node.TCU, Node.DCU}
    assert all(frame.error_code == 0 for frame in cleared)


@settings(max_examples=25)
@given(bit=st.integers(0, 47))
def test_one_flipped_bit_in_every_command_leaves_the_train_braked(bit: int) -> None:
    def flip(identifier: int, data: bytes) -> bytes:
        at = bit % (8 * len(data))
        return bytes(byte ^ (1 << at % 8) * (at // 8 == n) for n, byte in enumerate(data))

    stand = Stand()
    stand.spoil = flip
    stand.run(1.0, GO)

    assert stand.plant.wire.commands == 0
    assert stand.plant.world.brake.emergency_wanted
    assert stand.plant.wire.refused > 0


def test_a_command_that_is_only_repeated_goes_stale() -> None:
    """The plant accepts the first pair; its copies have a stuck counter."""
    first: dict[int, bytes] = {}
    stand = Stand()
    stand.spoil = first.setdefault
    stand.run(3.0, GO)

    assert stand.plant.wire.commands == 3
    assert stand.plant.world.brake.emergency_wanted
    assert stand.plant.world.brake.losses == 1


def test_frames_that_are_no_commands_change_nothing() -> None:
    alone, crowded = Stand(), Stand()
    foreign = crowded.bus.port("FOREIGN", ())
    for number in range(40):
        for stand in (alone, crowded):
            stand.run(0.05, GO)
        foreign.send(crowded.clock.now_ns(), 0x7A0 + number % 16, bytes([number] * 8))
    assert crowded.plant.world.front_m == pytest.approx(alone.plant.world.front_m, abs=1e-3)
    assert crowded.plant.command_losses == {"BCU": 0, "TCU": 0, "DCU": 0}


def digest(seed: int, consist: str = "florence4", start_ns: int = 0) -> str:
    stand = Stand(plan_scenario(seed=seed, consist=consist), start_ns)
    stand.run(6.0, GO)
    stand.run(4.0, (replace(RELEASED, service_decel_mps2=0.7), PULLING, CLOSED))
    return stand.log.hexdigest()


def test_the_same_seed_gives_the_same_bytes() -> None:
    assert digest(4) == digest(4)
    assert digest(4) != digest(5)


def test_tags_reach_the_serial_line_as_telegrams() -> None:
    stand = Stand()
    stand.run(40.0, GO)
    parser = TelegramParser()
    heard = [
        each
        for chunk in stand.line.receive(stand.clock.now_ns())
        for each in parser.feed(chunk.data)
    ]
    tags = [each.tag_id for each in heard if isinstance(each, TagTelegram)]
    # The tag of the starting point is under the antenna; its noise puts it before or behind.
    assert [tag_id for tag_id in tags if tag_id != 4] == [1150, 1400]
    assert sum(isinstance(each, HealthTelegram) for each in heard) >= 79
    assert parser.torn == {}


def test_the_wayside_answers_on_the_radio() -> None:
    stand = Stand(plan_scenario(end="II"))
    report = PositionReport(1, 7, 1, 5, -0.5, 0.5, -69.1, 0.0, True)
    stand.radio.send(0, keys.report("florence", 1), pack(report))
    stand.run(0.2)
    [message] = stand.radio.receive(stand.clock.now_ns())
    authority = unpack(message.payload)
    assert isinstance(authority, MovementAuthority)
    assert (authority.boot, authority.echo_stamp_ns, authority.end_m) == (7, 5, 3060.0)
    # The delay is two times 20 ms on the radio plus the wayside's cycle of 50 ms.
    assert message.stamp_ns <= 90_000_000


def test_the_truth_is_logged_every_50_ms_and_at_every_change_of_standstill() -> None:
    stand = Stand().run(8.0, GO)
    stand.run(20.0, (replace(RELEASED, service_decel_mps2=1.0), CLOSED))
    rows = stand.truth
    times_s, speeds_mps = rows.numbers("t_s"), rows.numbers("speed_mps")

    gaps_s = [later - earlier for earlier, later in itertools.pairwise(times_s)]
    assert max(gaps_s) <= 0.0501
    assert min(gaps_s) >= 0.0099
    still = [speed_mps == 0.0 for speed_mps in speeds_mps]
    assert still[0]
    assert still[-1]
    assert sum(now != before for before, now in itertools.pairwise(still)) == 2
    arrived = len(still) - 1 - still[::-1].index(False) + 1
    assert rows.numbers("front_m")[arrived] == pytest.approx(stand.plant.world.front_m, abs=1e-3)


def test_the_step_in_which_the_train_comes_to_rest_is_in_the_log() -> None:
    """The test stops the train at ten different instants of the grid of rows."""
    for offset in range(10):
        truth = Rows()
        plant, _ = process_plant(truth)
        consist = plant.world.consist
        consist.car_speeds_mps[:] = [1.0 + 0.012 * offset] * 4
        consist.speed_mps = consist.car_speeds_mps[0]
        step = 0
        while consist.speed_mps != 0.0 or step == 0:
            plant.step(step * STEP_NS)
            step += 1
        stopped_s = plant.elapsed_s
        for _ in range(10):
            plant.step(step * STEP_NS)
            step += 1
        rows = [(row["t_s"], row["speed_mps"]) for row in truth.rows]
        assert (f"{stopped_s:.3f}", 0.0) in rows


def test_the_acceleration_in_the_log_is_the_change_of_its_speed() -> None:
    rows = Stand(plan_scenario(consist="florence4_ideal")).run(15.0, GO).truth
    speeds_mps, accels_mps2 = rows.numbers("speed_mps"), rows.numbers("accel_mps2")
    for at in range(150, 250):
        change = (speeds_mps[at + 1] - speeds_mps[at - 1]) / 0.1
        assert accels_mps2[at] == pytest.approx(change, abs=0.02)


def test_a_start_at_any_instant_is_the_same_run() -> None:
    early, late = Stand(), Stand(start_ns=987_654_320_000_000)
    for stand in (early, late):
        stand.run(6.0, GO)
    assert early.truth.rows == late.truth.rows


def test_time_of_day_comes_from_the_given_clock() -> None:
    stand = Stand()
    plant = PlantDevice(
        plan_scenario(),
        open_port=lambda node, ids: InprocBus("x", 250_000).port(node.name, ids),
        tags=stand.line,
        radio=stand.radio,
        truth=None,
        start_ns=0,
        epoch_offset_ns=1_700_000_000 * 1_000_000_000,
    )
    frame = plant._time_of_day(5_000_000)
    assert isinstance(frame, TimeOfDay)
    # This is 2023-11-14 22:13:20 UTC.
    assert frame.days_since_1984 == 14562
    assert frame.since_midnight_ms == pytest.approx(((22 * 60 + 13) * 60 + 20) * 1000.0 + 5.0)


class SharedPort:
    """A port as a process has it: one for all nodes."""

    def __init__(self) -> None:
        self.counters = LinkCounters()
        self.frames: list[tuple[int, int]] = []
        self.asked = 0

    def send(self, now_ns: int, can_id: int, data: bytes) -> None:
        self.frames.append((now_ns, can_id))

    def receive(self, now_ns: int) -> Sequence[CanFrame]:
        self.asked += 1
        return ()

    def close(self) -> None: ...


def process_plant(truth: Rows | None = None) -> tuple[PlantDevice, SharedPort]:
    port = SharedPort()
    line, _ = inproc_line()
    radio = InprocRadio().port("wayside", ())
    plant = PlantDevice(
        plan_scenario(),
        open_port=lambda node, ids: port,
        tags=line,
        radio=radio,
        truth=truth,
        start_ns=0,
    )
    return plant, port


def test_all_nodes_may_share_one_port_that_is_read_once() -> None:
    plant, port = process_plant()
    for step in range(200):
        plant.step(step * STEP_NS)
    wanted = sum(len(slot) for slot in timetable()) * 2
    assert len(port.frames) == wanted
    assert port.asked == 200


def test_late_steps_are_caught_up_and_their_frames_sent_once() -> None:
    plant, port = process_plant()
    plant.step(0)
    port.frames.clear()

    plant.step(30 * STEP_NS + 4_000_000)

    assert plant.world.now_ns == 30 * STEP_NS
    assert plant.late_steps == 29
    assert plant.lost_steps == 0
    assert max(Counter(identifier for _, identifier in port.frames).values()) == 1

    plant.step(31 * STEP_NS + 1)
    assert plant.late_steps == 29


@pytest.mark.parametrize("held_up_s", [0.11, 0.155, 0.4, 5.0])
def test_a_pause_of_the_plant_itself_loses_no_command(held_up_s: float) -> None:
    """A host that pauses all processes must not look like a silent controller."""
    stand = Stand().run(12.0, GO)

    stand.clock.wait_until(stand.clock.now_ns() + round(held_up_s * 1e9))
    stand.run(1.0, GO)

    assert stand.plant.command_losses == {"BCU": 0, "TCU": 0, "DCU": 0}
    assert not stand.plant.world.brake.emergency_wanted


@pytest.mark.parametrize("held_up_s", [0.155, 0.4])
def test_a_command_missing_after_a_pause_counts_as_lost(held_up_s: float) -> None:
    stand = Stand().run(12.0, GO)

    stand.clock.wait_until(stand.clock.now_ns() + round(held_up_s * 1e9))
    stand.run(0.19)

    assert stand.plant.command_losses == {"BCU": 1, "TCU": 1, "DCU": 0}
    assert stand.plant.world.brake.emergency_wanted


def test_slightly_late_steps_delay_no_timeout() -> None:
    plant, _ = process_plant()
    plant.step(0)
    plant.world.brake.hear(RELEASED, 0)
    for step in range(1, 16):
        plant.step(step * STEP_NS + STEP_NS - 1)
    assert plant.command_losses["BCU"] == 0
    plant.step(17 * STEP_NS - 1)
    assert plant.command_losses["BCU"] == 1


def test_a_plant_paused_for_minutes_skips_the_lost_time() -> None:
    plant, _ = process_plant()
    plant.step(0)
    plant.step(60_000 * STEP_NS)
    assert plant.world.now_ns == 60_000 * STEP_NS
    assert plant.lost_steps == 60_000 - 100
    assert plant.late_steps == 99


def test_nodes_boot_and_stop_as_canopen_requires() -> None:
    stand = Stand().run(3.5)
    stand.plant.stop(stand.clock.now_ns())
    stand.run(0.05)
    states = [frame.state for _, frame in stand.heard if type(frame) is HEARTBEATS[Node.BCU]]
    assert states[0] is NodeState.BOOT_UP
    assert states[1] is NodeState.OPERATIONAL
    assert states[-1] is NodeState.STOPPED


def test_the_desk_is_in_the_mode_it_was_put_in() -> None:
    stand = Stand(plan_scenario(desk_mode=CabMode.MANUAL)).run(0.3)
    desk = stand.latest(Desk)
    assert isinstance(desk, Desk)
    assert desk.mode is CabMode.MANUAL


def test_a_filter_on_the_shared_port_passes_all_commands() -> None:
    assert {can_id(BrakeCommand), can_id(BrakeCommand) + 1} <= COMMAND_IDS
    assert can_id(AnalogueCommand) in COMMAND_IDS
    assert len(COMMAND_IDS) == 9
