"""Controller and plant in one process in virtual time: same code, same frames, no waiting."""

from collections import Counter
from collections.abc import Callable, Collection, Sequence
from contextlib import ExitStack, closing
from dataclasses import dataclass
from typing import TYPE_CHECKING

from can_dbc.nodes import Node
from firmware_py.buses.inproc import VirtualBus, open_bus
from firmware_py.clock.clock import Clock, LockstepClock, WallClock
from firmware_py.clock.executive import Executive, Task, run
from firmware_py.interrupts import Interrupts, never
from firmware_py.ports import CanFrame, CanPort, RadioPort, SerialPort
from firmware_py.radio.inproc_radio import InprocRadio
from firmware_py.radio.recorded_radio import RecordedRadio
from firmware_py.storage.port_log import PORTS_LOG, PortLog
from firmware_py.storage.recorder import CandumpWriter, LineLog, RadioLog, SerialLog
from firmware_py.tag_reader.inproc_line import inproc_line
from firmware_py.tag_reader.recorded_line import RecordedLine
from firmware_py.trackdb import PlatformSide, Station
from metro_hil.external_controller.choice import SHIPPED, ControllerSide
from metro_hil.faults.bus import COMMANDED, BusFaults, FaultyPort
from metro_hil.faults.frames import FrameFaults
from metro_hil.faults.process import BenchDevice, ControllerProcess
from metro_hil.foreign_plant.checks import received_ids
from metro_hil.foreign_plant.choice import (
    NODES,
    PLANT_PORT,
    read_plant,
    start_nodes,
    start_plant,
)
from metro_hil.foreign_plant.node_wire import NodeWire
from metro_hil.foreign_plant.plant import ForeignPlant
from metro_hil.model.case import ControllerSpec, PlantSpec
from metro_hil.model.end_condition import ARRIVED, DURATION, INTERRUPTED, ArrivalWatch, Ending
from metro_hil.model.gc_tuning import rarely_collected
from metro_hil.model.mission import Journey
from metro_hil.model.native import use_native
from metro_hil.model.run_folder import RunFolder
from metro_hil.model.run_options import BROWSER, ELSEWHERE, RunOptions
from metro_hil.run.radio_tap import TappedRadio
from plant_emulator.cli.by_hand import TrainByHand, open_by_hand
from plant_emulator.faults.fitting import targets_of
from plant_emulator.faults.kinds import FaultPlace
from plant_emulator.faults.plan import FaultPlan
from plant_emulator.process import TRUTH_COLUMNS, PlantDevice, TruthLog
from plant_emulator.truth import Truth
from plant_emulator.wayside.interlocking import SharedNetwork
from plant_emulator.wayside.railway import subscriptions
from plant_emulator.world import STEP_NS, TrainScenario, plan_scenario
from vobc.config import VobcConfig, load_config
from vobc.process import CYCLE_COLUMNS, EventLines
from vobc.wire import RECEIVED_IDS
from zenoh_config import keys

if TYPE_CHECKING:
    # Only trains that command themselves need this module.
    from vobc.process.line_command import LineCommand

BIT_RATE = 250_000
BUS_NAME = "vcan0"
SHIPPED_PLANT = PlantSpec()
LIMIT_S = 4.0 * 3600.0
"""Longest run, s; a train that has not arrived by then never will."""
STANDS_S = 900.0
"""Standstill after which a run without given duration ends, s; no regular stop lasts so long."""
STUCK = f"stands for good: not moved for {STANDS_S / 60.0:.0f} min"
TIME_UP = f"not arrived within {LIMIT_S / 3600.0:.0f} h"
WATCH_MS = 500.0
FLUSH_NS = 50_000_000
"""Time between two updates of the page."""
CATCH_UP_NS = 250_000_000
"""Lag behind real time beyond which virtual time does not catch up."""
NOT_BY_HAND = TrainByHand()
BUS_FAULT_MS = 1.0
NS_PER_S = 1_000_000_000


@dataclass(frozen=True, slots=True)
class Taps:
    """Observers that a campaign attaches to a run; the devices do not notice them."""

    frame: Callable[[int, int, bytes], None] | None = None
    """Receives time of the end, identifier and data of every frame."""
    said: Callable[[int, int, bytes], None] | None = None
    """Receives the same of each frame that the controller sends, at the time of sending."""
    truth: Callable[[Truth, int], None] | None = None
    """Receives the true state after every step of the plant."""
    rows: TruthLog | None = None
    """Receives the rows of the truth log."""
    radio: Callable[[bytes], None] | None = None
    """Receives the payload of every radio message that reaches the controller."""


UNTAPPED = Taps()
_Log = LineLog | CandumpWriter | PortLog | EventLines | SerialLog | RadioLog


class Lockstep:
    """One train and its world on a bus in virtual time, ready to run."""

    def __init__(
        self,
        config: VobcConfig,
        scenario: TrainScenario,
        journey: Journey,
        folder: RunFolder | None = None,
        *,
        faults: Sequence[FaultPlan] = (),
        places: Collection[FaultPlace] = (),
        reports: bool = False,
        taps: Taps = UNTAPPED,
        controller: ControllerSpec = SHIPPED,
        plant: PlantSpec = SHIPPED_PLANT,
        by_hand: TrainByHand = NOT_BY_HAND,
        shared: SharedNetwork | None = None,
        command: "LineCommand | None" = None,
    ) -> None:
        """Without a folder, nothing is logged.

        Raises RecorderError for a log, ControllerStartError or PlantStartError for a program.

        Args:
            faults: planned faults; `plant.schedule.plan` may change them later.
            places: places where faults may act, now or later.
            reports: later faults may depend on what the controller reports.
            controller: the controller under test.
            plant: the plant, or the program that emulates parts of it.
            by_hand: what a person does to the train while it runs.
            shared: the network that the train shares with others.
            command: train-to-train control. Authorities then come only from it.
        """
        use_native()
        self.clock = LockstepClock()
        self._stack, self._logs = ExitStack(), list[_Log]()
        self.bus = self._open_bus(self._candump(folder, "bus.log"), taps.frame)
        self.nodes: NodeWire | None = None
        """LS-BUS nodes on the bus."""
        self.foreign = self._foreign_plant(plant, scenario)
        radio, (controller_end, reader_end) = InprocRadio(), inproc_line()
        self.plant = PlantDevice(
            scenario,
            open_port=self._open_node,
            tags=reader_end,
            radio=radio.port("wayside", subscriptions(journey.line.name)),
            truth=_tee(self._log(folder, "truth.csv", TRUTH_COLUMNS), taps.rows),
            start_ns=0,
            faults=faults,
            observer=taps.truth,
            reports=reports,
            foreign=self.foreign,
            desk=by_hand.desk,
            by_hand=by_hand.faults,
            shared=shared,
        )
        self._bus_faults: BusFaults | None = None
        self._executives = [self.plant.executive]
        self._side = self._controller_side(controller, config, journey, folder, taps, command)
        places = {*places, *by_hand.fault_places, *(plan.kind.place for plan in faults)}
        topics = _topics_of(journey.line.name, config.address)
        accepted = RECEIVED_IDS if controller.kind == SHIPPED.kind else None
        self.vobc = self._connected(
            self._controller_port(accepted, scenario.seed, faulty=FaultPlace.BUS in places),
            self._recorded(controller_end, folder),
            self._recorded_radio(radio.port("train", topics), folder, taps.radio),
            faulty=FaultPlace.PROCESS in places,
        )
        self._arrival = _arrival_at(journey.end)
        self.arrived, self._moved_ns = False, 0
        """Whether the train has stood with open doors at its last station for a while."""
        self._executives.append(Executive([Task("watch", WATCH_MS, self._watch)], 0))

    def _controller_side(
        self,
        controller: ControllerSpec,
        config: VobcConfig,
        journey: Journey,
        folder: RunFolder | None,
        taps: Taps,
        command: "LineCommand | None",
    ) -> ControllerSide:
        side = ControllerSide(
            controller,
            config,
            journey,
            clock=self.clock,
            cycle_log=self._log(folder, "cycles.csv", CYCLE_COLUMNS),
            port_log=self._port_log(folder),
            said=taps.said,
            event_log=self._event_log(folder),
            command=command,
        )
        self._stack.callback(side.close)
        return side

    def _foreign_plant(self, plant: PlantSpec, scenario: TrainScenario) -> ForeignPlant | None:
        """Start the program or the nodes; if that fails, all logs are closed."""
        if plant.kind == SHIPPED_PLANT.kind:
            return None
        try:
            if plant.kind == NODES:
                self.nodes = start_nodes(plant, self.bus, COMMANDED)
                self._stack.callback(self.nodes.retire)
                return None
            port = self.bus.port(PLANT_PORT, received_ids())
            foreign = self._stack.enter_context(closing(start_plant(plant, scenario, port)))
        except BaseException:
            self._stack.close()
            raise
        return foreign

    def _connected(
        self, can: CanPort, tags: SerialPort, radio: RadioPort, *, faulty: bool
    ) -> BenchDevice:
        """The controller on its ports. If it does not start, all logs are closed."""
        try:
            device = self._side.device(can, tags, radio, faulty=faulty)
        except BaseException:
            self._stack.close()
            raise
        if isinstance(device, ControllerProcess):
            self._on_fault(FaultPlace.PROCESS, device.change)
        self._executives.append(device.executive)
        return device

    def _controller_port(
        self, accept_ids: Collection[int] | None, seed: int, *, faulty: bool
    ) -> CanPort:
        """Port on the bus; if bus faults may act, they stand between port and controller."""
        port = self.bus.port(Node.VOBC.name, accept_ids)
        if not faulty:
            return port
        between = FaultyPort(port, FrameFaults(seed))
        self._bus_faults = BusFaults(self.bus, between, seed, self.nodes)
        self._on_fault(FaultPlace.BUS, self._bus_faults.change)
        self._executives.append(Executive([Task("bus faults", BUS_FAULT_MS, between.poll)], 0))
        return between

    def _on_fault(self, place: FaultPlace, change: Callable[[FaultPlan, bool, int], None]) -> None:
        def listener(plan: FaultPlan, active: bool, now_ns: int) -> None:
            if plan.kind.place is place:
                change(plan, active, now_ns)

        self.plant.schedule.listen(listener)

    def run(
        self,
        duration_s: float | None = None,
        interrupted: Callable[[], bool] = never,
        pace: Callable[[int], None] | None = None,
    ) -> str:
        """Run until the train arrives, is stuck, or time is over; a given duration disables the
        check for a stuck train.

        Args:
            interrupted: whether the user has asked to end the run.
            pace: called before each step of the plant, with its instant. The run then ends only at
                such an instant, and a train may stand for as long as the person at the page likes.
        """
        limit_s = LIMIT_S if duration_s is None else min(duration_s, LIMIT_S)
        end_ns = self.clock.now_ns() + int(limit_s * NS_PER_S)
        stands_s = LIMIT_S if duration_s is not None or pace is not None else STANDS_S

        paced_ns, asked = -1, False

        def over(now_ns: int) -> bool:
            nonlocal paced_ns, asked
            if pace is None:
                asked = interrupted()
            elif now_ns % STEP_NS:
                return False
            elif now_ns > paced_ns:
                paced_ns = now_ns
                pace(now_ns)
                # Later releases of this instant would leave the step incomplete.
                asked = interrupted()
            return now_ns >= end_ns or self.arrived or self._stood_s(now_ns) >= stands_s or asked

        self.run_until(over)
        if asked:
            return INTERRUPTED
        if self.arrived:
            return ARRIVED
        if self._stood_s(self.clock.now_ns()) >= stands_s:
            return STUCK
        return DURATION if limit_s == duration_s else TIME_UP

    def run_until(self, over: Callable[[int], bool]) -> None:
        """Run on; `over` is called before each release. Pieces of a run equal one run without
        stops."""
        with rarely_collected():
            run(self._executives, self.clock, over)

    def reseed(self, seed: int) -> None:
        """From now on all random values come from another seed."""
        self.plant.world.reseed(seed)
        if self._bus_faults is not None:
            self._bus_faults.reseed(seed)

    def bus_story(self) -> Sequence[tuple[int, str]]:
        """Times and texts of what the bus faults did."""
        faults = [] if self._bus_faults is None else self._bus_faults.story()
        nodes = [] if self.nodes is None else self.nodes.story()
        # A change of error state is in both stories.
        return sorted({*faults, *nodes}) if nodes else faults

    @property
    def touched(self) -> Counter[int]:
        """Number of frames, telegrams, messages, cycles or values that each fault changed, by its
        index. A fault that never began is missing."""
        found = self.plant.touched
        if self._bus_faults is not None:
            found.update(self._bus_faults.touched)
        if isinstance(self.vobc, ControllerProcess):
            found.update(self.vobc.touched)
        return found

    def without_controller(self) -> None:
        """Continue without a controller, because its process has died."""
        if self.vobc.executive in self._executives:
            self._executives.remove(self.vobc.executive)

    def with_controller(self) -> None:
        """Continue with the controller again, which was only stopped."""
        if self.vobc.executive not in self._executives:
            self._executives.append(self.vobc.executive)

    def close(self) -> None:
        """Stop the devices, deliver their last frames, and close the logs."""
        now_ns = self.clock.now_ns()
        if self.vobc.executive in self._executives:
            self.vobc.stop(now_ns)
        try:
            self.plant.stop(now_ns)
            if self.foreign is not None:
                self.foreign.stop()
                self.plant.pass_on(self.foreign, now_ns)
            if self.nodes is not None:
                self.nodes.retire()
            self.bus.advance(now_ns + NS_PER_S)
        finally:
            self._stack.close()

    def flush(self) -> None:
        """Pass everything that the page of a run shows to the operating system."""
        for log in self._logs:
            if isinstance(log, CandumpWriter | EventLines):
                log.flush()

    @property
    def lost_log_lines(self) -> int:
        """Number of log lines that the disk has refused."""
        return sum(log.lost_lines for log in self._logs)

    def _stood_s(self, now_ns: int) -> float:
        return (now_ns - self._moved_ns) / NS_PER_S

    def _watch(self, now_ns: int) -> None:
        motion = self.vobc.output.motion
        if motion is None:
            return
        if not motion.standing:
            self._moved_ns = now_ns
        if self._arrival.arrived(now_ns, self.vobc.output.ato_phase, motion.front_m.best):
            self.arrived = True

    def _open_node(self, node: Node, accept_ids: frozenset[int]) -> CanPort:
        return self.bus.port(node.name, accept_ids)

    def _open_bus(
        self, writer: CandumpWriter | None, tap: Callable[[int, int, bytes], None] | None
    ) -> VirtualBus:
        def record(frame: CanFrame, _: str) -> None:
            assert tap is not None
            tap(frame[0], frame[1], frame[2])

        return open_bus(
            *(BUS_NAME, BIT_RATE),
            record=None if tap is None else record,
            log=None if writer is None else writer.lines,
        )

    def _candump(self, folder: RunFolder | None, name: str) -> CandumpWriter | None:
        if folder is None:
            return None
        writer = CandumpWriter(folder.path / name, BUS_NAME)
        self._logs.append(writer)
        self._stack.callback(writer.close)
        return writer

    def _log(self, folder: RunFolder | None, name: str, columns: tuple[str, ...]) -> LineLog | None:
        if folder is None:
            return None
        log = LineLog(folder.path / name, columns)
        self._logs.append(log)
        self._stack.callback(log.close)
        return log

    def _event_log(self, folder: RunFolder | None) -> EventLines | None:
        if folder is None:
            return None
        log = EventLines(folder.events_log)
        self._logs.append(log)
        self._stack.callback(log.close)
        return log

    def _port_log(self, folder: RunFolder | None) -> PortLog | None:
        if folder is None:
            return None
        log = PortLog(folder.path / PORTS_LOG)
        self._logs.append(log)
        self._stack.callback(log.close)
        return log

    def _recorded_radio(
        self, port: RadioPort, folder: RunFolder | None, heard: Callable[[bytes], None] | None
    ) -> RadioPort:
        if heard is not None:
            port = TappedRadio(port, heard)
        if folder is None:
            return port
        log = RadioLog(folder.path / "radio.log")
        self._logs.append(log)
        recorded = RecordedRadio(port, log)
        self._stack.callback(recorded.close)
        return recorded

    def _recorded(self, port: SerialPort, folder: RunFolder | None) -> SerialPort:
        if folder is None:
            return port
        log = SerialLog(folder.serial_log)
        self._logs.append(log)
        recorded = RecordedLine(port, log)
        self._stack.callback(recorded.close)
        return recorded


def _arrival_at(end: Station) -> ArrivalWatch:
    return ArrivalWatch(end.stop_m, doors=end.side is not PlatformSide.NONE)


def _topics_of(line_name: str, train: int) -> tuple[str, str]:
    """Radio topics to which a train subscribes."""
    return keys.authorities(line_name, train), keys.orders(line_name, train)


class _Tee:
    """Writes each row to two logs."""

    def __init__(self, one: TruthLog, other: TruthLog) -> None:
        self._one, self._other = one, other

    def row(self, *values: object) -> None:
        self._one.row(*values)
        self._other.row(*values)


def _tee(one: TruthLog | None, other: TruthLog | None) -> TruthLog | None:
    if one is None or other is None:
        return one or other
    return _Tee(one, other)


def scenario_of(options: RunOptions) -> TrainScenario:
    """The plant's side of a run. Raises SettingsError."""
    return plan_scenario(
        line=options.line,
        consist=options.consist,
        seed=options.seed,
        start=options.start,
        end=options.end,
        load_ratio=options.load_ratio,
        odometer_error_ratio=options.odometer_error,
        desk_mode=_desk_mode(options.desk),
        driver=options.driver,
        desk_recording=options.desk_recording,
        desk_elsewhere=options.desk in ELSEWHERE,
    )


def _desk_mode(desk: str) -> str:
    """Return the mode of the desk at the start."""
    if desk == BROWSER:
        return "manual"
    return "auto" if desk in ELSEWHERE else desk


def config_of(options: RunOptions) -> VobcConfig:
    """The controller's side of a run. Raises SettingsError."""
    return load_config(
        options.params, cycle_ms=options.cycle_ms, law=options.ato, stage=options.output
    )


class RealPace:
    """Holds virtual time back to real time, so that a person at the page can act."""

    def __init__(self, wall: Clock, flush: Callable[[], None]) -> None:
        self._wall, self._flush = wall, flush
        self._zero_ns = wall.now_ns()
        """Instant of the wall clock at which virtual time was 0."""
        self._flushed_ns = 0

    def __call__(self, now_ns: int) -> None:
        wall_ns = self._wall.now_ns() - self._zero_ns
        if wall_ns - now_ns > CATCH_UP_NS:
            # The program was stopped for a while; virtual time goes on from here.
            self._zero_ns += wall_ns - now_ns
        if now_ns - self._flushed_ns >= FLUSH_NS:
            self._flushed_ns = now_ns
            self._flush()
        self._wall.wait_until(self._zero_ns + now_ns)


def _by_hand(
    options: RunOptions, folder: RunFolder | None, scenario: TrainScenario, stack: ExitStack
) -> TrainByHand:
    if not options.by_hand or folder is None:
        return NOT_BY_HAND
    return open_by_hand(
        folder.path,
        options.by_hand,
        stack,
        mode=scenario.desk_mode,
        start_ns=0,
        targets=targets_of(scenario),
        places=frozenset(FaultPlace),
    )


def run_lockstep(
    options: RunOptions,
    journey: Journey,
    folder: RunFolder | None,
    *,
    scenario: TrainScenario | None = None,
    ended: Callable[[Lockstep], None] | None = None,
    pace: Callable[[int], None] | None = None,
) -> Ending:
    """Run a train from start to end and return how the run ended.

    Args:
        scenario: the plant's side; default: that of the options.
        ended: receives the bench at the end of the run, before its devices stop.
        pace: holds a run by hand back at each step; default: to real time.
    """
    wall = WallClock()
    scenario = scenario or scenario_of(options)
    plant = read_plant(options.plant)
    stack = ExitStack()
    by_hand = _by_hand(options, folder, scenario, stack)
    bench = Lockstep(config_of(options), scenario, journey, folder, plant=plant, by_hand=by_hand)
    began_ns = wall.now_ns()
    interrupts = Interrupts()
    if by_hand is not NOT_BY_HAND:
        pace = pace or RealPace(wall, bench.flush)
    try:
        with interrupts.caught():
            reason = bench.run(options.duration_s, lambda: interrupts.asked, pace)
        if ended is not None:
            ended(bench)
    finally:
        bench.close()
        stack.close()
    elapsed_ns = max(1, wall.now_ns() - began_ns)
    statistics, virtual_ns = bench.bus.statistics(), bench.clock.now_ns()
    return Ending(
        exit_reason=reason,
        failed=reason not in (ARRIVED, DURATION, INTERRUPTED),
        frames=statistics.frames,
        bus_load_ratio=statistics.load_ratio(max(1, virtual_ns)),
        rejected_frames=dict(bench.plant.wire.refusals),
        real_time_factor=virtual_ns / elapsed_ns,
        lost_log_lines=bench.lost_log_lines,
        nodes=() if bench.nodes is None else bench.nodes.tallies(),
    )
