"""The plant as a device on the bus.

It receives commands, steps the world, and sends frames and telegrams.
"""

from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, Final, Protocol

from can_dbc.alarms import TrainAlarms
from can_dbc.analogue import AnalogueCommand
from can_dbc.binding import Frame
from can_dbc.brake import BrakeCommand, BrakeStatus
from can_dbc.cab import Desk
from can_dbc.diagnostics import EMERGENCIES, HEARTBEATS, NodeState, TcmsStatus, TimeOfDay
from can_dbc.doors import DoorCars, DoorCommand, DoorState, DoorStatus
from can_dbc.energy import EnergyMeter, LineSupply
from can_dbc.nodes import Node
from can_dbc.odometer import ColdMovement, Doppler, Imu, Tacho
from can_dbc.tags import TagReaderHealth
from can_dbc.traction import TractionCommand, TractionStatus
from firmware_py.clock.executive import Executive, Task
from firmware_py.ports import RadioPort, SerialPort
from plant_emulator.desk.attendant import Attendant, attendant
from plant_emulator.desk.display import KINDS as DISPLAYED
from plant_emulator.desk.display import DeskDisplay
from plant_emulator.faults.by_hand import FaultsByHand
from plant_emulator.faults.declared_train import SensorRestart
from plant_emulator.faults.kinds import FaultPlace
from plant_emulator.faults.plan import FaultPlan
from plant_emulator.faults.radio_faults import RadioFaults
from plant_emulator.faults.schedule import Schedule
from plant_emulator.faults.serial_faults import SerialFaults
from plant_emulator.faults.stage import FaultStage, Observer
from plant_emulator.foreign import ForeignParts
from plant_emulator.truth import REPORTS
from plant_emulator.wayside.interlocking import Interlocking, SharedNetwork
from plant_emulator.wayside.railway import Railway
from plant_emulator.wayside.zone_controller import ZoneController
from plant_emulator.wire import (
    GRID_MS,
    PLANT_NODES,
    ROUND_MS,
    OpenPort,
    Sending,
    Wire,
    timetable,
)
from plant_emulator.world import STEP_NS, TrainScenario, World, world_of

TRUTH_COLUMNS: Final = (
    "t_s",
    "front_m",
    "speed_mps",
    "accel_mps2",
    "accel_first_car_mps2",
    "car_speeds_mps",
    "traction_force_n",
    "brake_force_n",
    "gradient_permille",
    "emergency",
    "holding",
    "doors_locked",
    "door_left",
    "door_right",
    "odometer_error_m",
    "tags_read",
    "traction_j",
    "regenerated_j",
    "drawn_j",
    "returned_j",
)
"""Columns of the truth log. Speed and acceleration are those of the whole train; the speed is
exactly 0 only at standstill. `car_speeds_mps` has one number for each car, from the front,
separated by blanks. Energies are those of the train's own meter since its start: of the motors, and
with auxiliaries at the collector. They are empty if another program emulates these parts."""
UNMETERED: Final = ("", "", "", "")
METERED: Final = frozenset({Node.TCU, Node.BCU, Node.HVB})
"""Nodes whose emulation the energy meter needs."""

TRUTH_STEPS: Final = 5
"""Plant steps between rows of the truth log (50 ms). The log gets one more row whenever the train
stops or starts."""
SLOW_STEPS: Final = 5
"""Plant steps (50 ms) between two checks of the radio and of missing commands."""
ROUND_STEPS: Final = ROUND_MS // GRID_MS
CATCH_UP_STEPS: Final = 100
"""Maximum number of late steps that the plant makes up for. It skips and counts all steps beyond
that and continues from the present instant."""
NS_PER_S: Final = 1_000_000_000
NS_PER_MS: Final = 1_000_000
MS_PER_DAY: Final = 86_400_000
DAYS_1970_TO_1984: Final = 5113
COMMAND_MISSING: Final = 0x8130
"""EMCY code of CiA 301 for a partner whose frames are missing."""
COMMUNICATION_REGISTER: Final = 0x11


class TruthLog(Protocol):
    """Takes one row with a value for each of TRUTH_COLUMNS."""

    def row(self, *values: object) -> None: ...


class CommandListener(Protocol):
    """An actuator unit that supervises the arrival of its command."""

    @property
    def silent(self) -> bool: ...

    @property
    def losses(self) -> int: ...


class PlantDevice:
    """The whole plant on the other end of the controller's wires. Run `executive` to run it."""

    def __init__(
        self,
        scenario: TrainScenario,
        *,
        open_port: OpenPort,
        tags: SerialPort,
        radio: RadioPort,
        truth: TruthLog | None,
        start_ns: int,
        epoch_offset_ns: int = 0,
        faults: Sequence[FaultPlan] = (),
        observer: Observer | None = None,
        reports: bool = False,
        foreign: ForeignParts | None = None,
        desk: Attendant | None = None,
        by_hand: FaultsByHand | None = None,
        shared: SharedNetwork | None = None,
    ) -> None:
        """Args:
        open_port: called once for each node. In lockstep it returns a separate port for every node;
            between processes one port may serve all of them.
        faults: faults of the bus and of the controller's process are only passed on to the
            listeners of `schedule`.
        observer: receives the truth before the first step and after each step.
        reports: faults that are planned later may depend on what the controller reports.
        foreign: program that emulates parts of the train; it sends the frames of its nodes.
        desk: operator of the desk; None: that of the scenario.
        by_hand: what a person does to the faults while the train runs.
        shared: the network that the train shares with others; None: it is alone.
        epoch_offset_ns: difference between nanoseconds since 1970 and the plant's clock.
        """
        self.scenario = scenario
        self.world = world_of(scenario, start_ns, foreign)
        self._attendant = desk or attendant(
            scenario.driver,
            scenario.desk_recording,
            mode=scenario.desk_mode,
            start_ns=start_ns,
        )
        self._display = DeskDisplay()
        reports = reports or any(plan.window.reads_controller for plan in faults)
        self.wire = Wire(open_port, DISPLAYED if scenario.driver else REPORTS if reports else ())
        self._absent = _absent_nodes(scenario, foreign)
        self.railway = _railway(scenario, self.world, start_ns, shared)
        self._platform_doors = self.railway.doors
        self._tags, self._radio, self._truth = tags, radio, truth
        self._start_ns, self._epoch_offset_ns = start_ns, epoch_offset_ns
        self._metered = METERED.isdisjoint(self._absent)
        self._slots = timetable(self._absent)
        self._steps = 0
        self.lost_steps = 0
        """Steps that the plant skipped because its process was delayed for too long."""
        self.late_steps = 0
        """Steps that the plant ran late, in one go."""
        self._standing = True
        self._life = NodeState.BOOT_UP
        self._frames = self._frame_sources()
        self._units = self._command_listeners()
        self._receivers = self._receivers_of_frames()
        self._silent = [False] * len(self._units)
        self._restarting: Node | None = None
        """A fault: this node sends nothing until it has restarted."""
        self.schedule = Schedule(faults)
        """Tells which faults are active, if there are faults or an observer."""
        self._serial_faults: SerialFaults | None = None
        self._radio_faults: RadioFaults | None = None
        staged = faults or observer is not None or by_hand is not None
        self._stage = self._staged(observer, by_hand) if staged else None
        self.executive = Executive([Task("step", GRID_MS, self.step)], start_ns)
        self._write_truth()

    def _command_listeners(self) -> tuple[tuple[Node, CommandListener], ...]:
        world = self.world
        return (Node.BCU, world.brake), (Node.TCU, world.traction), (Node.DCU, world.doors)

    def _receivers_of_frames(self) -> Mapping[type[Frame], Callable[[Any, int], None]]:
        world = self.world
        return {
            BrakeCommand: self._take_brake,
            TractionCommand: world.traction.hear,
            DoorCommand: world.doors.hear,
            DoorCars: world.doors.hear_cars,
            AnalogueCommand: world.hear_currents,
            **dict.fromkeys(DISPLAYED, self._take_report),
        }

    def _staged(self, observer: Observer | None, by_hand: FaultsByHand | None) -> FaultStage:
        stage = FaultStage(
            self.world,
            self.schedule,
            start_ns=self._start_ns,
            observer=observer,
            railway=self.railway,
            by_hand=by_hand,
        )
        self.schedule.listen(self._change_wires)
        return stage

    def _frame_sources(self) -> Mapping[type[Frame], Callable[[int], Frame]]:
        world = self.world
        sources: dict[type[Frame], Callable[[int], Frame]] = {
            Tacho: world.tachos.frame,
            BrakeStatus: lambda now_ns: world.brake.status(),
            TractionStatus: lambda now_ns: world.traction.status(world.brake.electric_n),
            Doppler: lambda now_ns: world.doppler.frame(world.consist.car_speeds_mps[0]),
            Imu: lambda now_ns: world.imu.frame(
                now_ns, world.consist.car_speeds_mps[0], world.consist.slope_mps2
            ),
            DoorStatus: lambda now_ns: world.doors.status(),
            Desk: self._desk,
            LineSupply: lambda now_ns: world.power.supply(),
            EnergyMeter: lambda now_ns: world.power.meter(),
            TagReaderHealth: world.tag_reader.frame,
            TcmsStatus: lambda now_ns: world.load_status(),
            TrainAlarms: lambda now_ns: world.alarms,
            ColdMovement: lambda now_ns: world.cold.frame(),
            TimeOfDay: self._time_of_day,
        }
        for node in PLANT_NODES:
            sources[HEARTBEATS[node]] = self._heartbeat_of(node)
        return sources

    def _desk(self, now_ns: int) -> Frame:
        if self._attendant is not None:
            self.world.put_desk(self._attendant(self._display, now_ns))
        return self.world.desk

    def _heartbeat_of(self, node: Node) -> Callable[[int], Frame]:
        said = {life: HEARTBEATS[node](life) for life in NodeState}
        return lambda now_ns: said[self._life]

    def _time_of_day(self, now_ns: int) -> Frame:
        days, since_midnight_ms = divmod((now_ns + self._epoch_offset_ns) / NS_PER_MS, MS_PER_DAY)
        return TimeOfDay(
            since_midnight_ms=since_midnight_ms,
            days_since_1984=max(0, int(days) - DAYS_1970_TO_1984),
        )

    def step(self, now_ns: int) -> None:
        """Receive commands, advance the world to `now_ns`, and send the frames that are due."""
        wire, world, frames = self.wire, self.world, self._frames
        if self._stage is not None:
            self._attend_faults(self._stage, now_ns)
        if (held_up_ns := now_ns - world.now_ns - STEP_NS) >= STEP_NS:
            world.excuse(held_up_ns)
        wire.hear(now_ns, self._take)
        for kind, node in self._catch_up(now_ns):
            if node is not self._restarting:
                wire.send(now_ns, node, frames[kind](world.now_ns))
        if world.foreign is not None:
            self.pass_on(world.foreign, now_ns)
        if now_ns >= world.tag_reader.due_ns and Node.BTM not in self._absent:
            for telegram in world.tag_reader.telegrams(now_ns):
                self._tags.send(now_ns, telegram)
        if self._steps % SLOW_STEPS == 0:
            self._report_silence(now_ns)
            front_m = world.front_m
            self.railway.observe(now_ns, front_m=front_m, rear_m=front_m - world.length_m)
            self._answer_radio(now_ns)

    def pass_on(self, foreign: ForeignParts, now_ns: int) -> None:
        """Send what the nodes of another program sent in this step."""
        for node, can_id, data in foreign.take_frames():
            if node is not self._restarting:
                self.wire.forward(now_ns, node, can_id, data)
        for piece in foreign.take_serial():
            self._tags.send(now_ns, piece)

    def _attend_faults(self, stage: FaultStage, now_ns: int) -> None:
        if not stage.began:
            stage.look(self.authority_end_m)
        if self._serial_faults is not None:
            self._serial_faults.poll(now_ns)
        if self._radio_faults is not None:
            self._radio_faults.poll(now_ns)

    def _change_wires(self, plan: FaultPlan, active: bool, now_ns: int) -> None:
        """Insert the faulty serial line or radio when its first fault begins; restart a node."""
        if plan.kind.place is FaultPlace.SERIAL:
            if self._serial_faults is None:
                self._tags = self._serial_faults = SerialFaults(self._tags, self.world.seed)
            self._serial_faults.change(plan, active, now_ns)
        elif plan.kind.place is FaultPlace.RADIO:
            if self._radio_faults is None:
                self._radio = self._radio_faults = RadioFaults(self._radio, self.world.seed)
            self._radio_faults.change(plan, active, now_ns)
        elif isinstance(plan.parameters, SensorRestart):
            self._restarting = Node.ODO if active else None
            if not active:
                self.world.tachos.restart(now_ns)
                self.wire.restart(Node.ODO)

    @property
    def pending(self) -> bool:
        """Whether a fault or the recording of the desk will change something by time alone."""
        recording = self.scenario.desk_recording
        if (
            recording is not None
            and self.world.now_ns - self._start_ns < recording.end_s * NS_PER_S
        ):
            return True
        return self.schedule.pending

    @property
    def touched(self) -> Counter[int]:
        """Number of values of the train and its wires that each fault has changed, by the fault's
        index.
        """
        layers = (self._stage, self._serial_faults, self._radio_faults)
        found: Counter[int] = Counter()
        for layer in layers:
            found.update({} if layer is None else layer.touched)
        return found

    @property
    def zone(self) -> ZoneController:
        return self.railway.zone

    @property
    def authority_end_m(self) -> float:
        """Farthest end of all authorities so far; before the first one, the train's front at the
        start.
        """
        farthest_m = self.railway.farthest_end_m
        return self.scenario.start.stop_m if farthest_m is None else farthest_m

    def _take(self, command: Frame, heard_ns: int) -> None:
        self._receivers[type(command)](command, heard_ns)

    def _take_brake(self, command: BrakeCommand, heard_ns: int) -> None:
        self.world.brake.hear(command, heard_ns)
        self.world.cold.attended(self.world.front_m)

    def _take_report(self, report: Frame, heard_ns: int) -> None:
        self._display.hear(report, heard_ns)
        if self._stage is not None:
            self._stage.truth.report(report)

    def _catch_up(self, now_ns: int) -> Iterable[Sending]:
        """Advance the world to now and return the frames to send.

        Each frame that was due during late steps is sent once, with the present values.
        """
        due = (now_ns - self.world.now_ns) // STEP_NS
        if due == 1:
            return self._advance()
        if due > CATCH_UP_STEPS:
            given_up = due - CATCH_UP_STEPS
            self.lost_steps += given_up
            self.world.pass_over(given_up)
            due = CATCH_UP_STEPS
        if due == 0:
            return self._slots[0] if self._steps == 0 else ()
        self.late_steps += due - 1
        return dict.fromkeys(sending for _ in range(due) for sending in self._advance())

    def _advance(self) -> tuple[Sending, ...]:
        world = self.world
        world.step()
        if not self._platform_doors.resting:
            self._platform_doors.step(world.now_ns)
        if self._stage is not None:
            self._stage.look(self.authority_end_m)
        self._steps = steps = self._steps + 1
        standing = world.speed_mps == 0.0
        if steps % TRUTH_STEPS == 0 or standing is not self._standing:
            self._standing = standing
            self._write_truth()
        if steps == ROUND_STEPS:
            self._life = NodeState.OPERATIONAL
        return self._slots[steps % ROUND_STEPS]

    def _report_silence(self, now_ns: int) -> None:
        """Send an emergency message when a unit's command goes missing, and another when it
        returns.
        """
        for index, (node, unit) in enumerate(self._units):
            if unit.silent is not self._silent[index] and node not in self._absent:
                self._silent[index] = unit.silent
                code, register = (
                    (COMMAND_MISSING, COMMUNICATION_REGISTER) if unit.silent else (0, 0)
                )
                self.wire.send(now_ns, node, EMERGENCIES[node](code, register, unit.losses))
        self.world.cold.look(self.world.front_m, silent=all(self._silent))

    def _answer_radio(self, now_ns: int) -> None:
        heard = self._radio.receive(now_ns)
        if heard:
            for key, payload in self.railway.answers(heard, now_ns):
                self._radio.send(now_ns, key, payload)

    def _write_truth(self) -> None:
        if self._truth is None:
            return
        world = self.world
        consist, brake, doors, told = world.consist, world.brake, world.doors, world.told
        power = world.power
        self._truth.row(
            f"{self.elapsed_s:.3f}",
            consist.car_fronts_m[0],
            consist.speed_mps,
            consist.accel_mps2,
            consist.car_accels_mps2[0],
            tuple(consist.car_speeds_mps),
            world.drive_n,
            world.brake_n,
            world.gradient_permille,
            world.emergency_wanted,
            told["holding"] != 0.0 if "holding" in told else brake.holding_mps2 > 0.0,
            world.doors_locked,
            _door_state(told["left_open"]) if "left_open" in told else doors.left.state,
            _door_state(told["right_open"]) if "right_open" in told else doors.right.state,
            told.get("odometer_error_m", world.odometer_error_m),
            int(told.get("tags_read", world.tag_reader.tags_read)),
            *(
                (power.traction_j, power.braking_j, power.drawn_j, power.returned_j)
                if self._metered
                else UNMETERED
            ),
        )

    @property
    def elapsed_s(self) -> float:
        """Time of the world since its start, s."""
        return (self.world.now_ns - self._start_ns) / NS_PER_S

    @property
    def command_losses(self) -> dict[str, int]:
        """Number of times that each unit lost its command, by node."""
        return {node.name: unit.losses for node, unit in self._units}

    def stop(self, now_ns: int) -> None:
        """Announce on the bus that all nodes stop."""
        self._life = NodeState.STOPPED
        for node in PLANT_NODES:
            if node not in self._absent:
                self.wire.send(now_ns, node, HEARTBEATS[node](NodeState.STOPPED))
        self._write_truth()


def _railway(
    scenario: TrainScenario, world: World, start_ns: int, shared: SharedNetwork | None
) -> Railway:
    """The rest of the railway, with an interlocking if the network has switches."""
    interlocking = None
    if scenario.tracks is not None:
        network, path = scenario.tracks
        interlocking = Interlocking(
            network,
            path,
            to_m=scenario.destination.stop_m,
            front_m=world.front_m,
            rear_m=world.front_m - world.length_m,
            shared=shared,
        )
    railway = Railway(scenario.wayside_line or scenario.line, scenario.destination, interlocking)
    railway.keep_until(start_ns + round(scenario.layover_s * NS_PER_S))
    return railway


def _absent_nodes(scenario: TrainScenario, foreign: ForeignParts | None) -> frozenset[Node]:
    """The nodes that this plant does not emulate."""
    absent = frozenset({Node.DESK} if scenario.desk_elsewhere else ())
    return absent if foreign is None else absent | foreign.nodes


def _door_state(is_open: float) -> DoorState:
    """State of a side of doors of which only the truth signal is known."""
    return DoorState.LOCKED if is_open == 0.0 else DoorState.OPEN
