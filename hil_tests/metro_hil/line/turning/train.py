"""One train of a service: it enters the network, makes trip after trip, and leaves."""

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Final, Protocol

from can_dbc.vobc import Supervision
from firmware_py.trackdb import LineMap
from firmware_py.trackdb.paths import TrackPlace
from metro_hil.line.turning.plan import FleetPlan
from metro_hil.metrics.case import MemoryLog
from metro_hil.metrics.hops import HopEnergy, measure_hops
from metro_hil.metrics.stops import StationStop, measure_stops
from metro_hil.model.mission import Journey
from metro_hil.model.run_folder import RunFolder
from metro_hil.run.lockstep import Lockstep, Taps
from metro_hil.run.turnback import Departure, go_on
from plant_emulator.power import HighVoltageBox
from plant_emulator.power.box import Due
from plant_emulator.traffic.coupling import INTERVAL_S, TrainFeed
from plant_emulator.wayside.interlocking import (
    AT_STOP_M,
    CLEAR_M,
    Interlocking,
    SharedNetwork,
    SignalBox,
)
from plant_emulator.wayside.separation import REAR_M
from plant_emulator.world import STEP_NS, TrainScenario, World
from vobc.config import VobcConfig
from vobc.process.line_command import LineCommand

NS_PER_S: Final = 1_000_000_000
BRAKES: Final = (Supervision.SERVICE, Supervision.EMERGENCY)


@dataclass(frozen=True, slots=True)
class ProtectionBrake:
    """A brake that protection applied to a moving train."""

    at_s: float
    train: int
    kind: str
    cause: str


@dataclass(slots=True)
class TripRecord:
    """How one trip went. Times are those of the network."""

    train: int
    index: int
    start: str
    end: str
    began_s: float
    due_s: float | None
    """Planned departure on the first trip of a round trip."""
    turned: bool
    """Whether the train changed ends before the trip."""
    left_s: float | None = None
    """First movement."""
    entered_s: float | None = None
    """When the train needed the route to its last stop, see `Entry`, and had the authority."""
    hindered: bool = False
    """Whether it had none there, and so braked for the signal. Its turn then began later, and says
    nothing about the least headway."""
    clear_s: float | None = None
    """When the rear was clear of the first switch."""
    ended_s: float | None = None
    """When the train had arrived; None: it did not."""
    stops: list[StationStop] = field(default_factory=list)
    hops: list[HopEnergy] = field(default_factory=list)
    frames: int = 0


class MastersOfTrain(Protocol):
    """The lines of masters in which a train takes part."""

    def config_of(self, config: VobcConfig, train: int) -> VobcConfig: ...

    def enter(self, line: LineMap, config: VobcConfig, began_ns: int) -> LineCommand: ...

    def leave(self, path: str, train: int) -> None: ...


class TurningTrain:
    """A train with its controller, plant and bus; each trip has a bench of its own."""

    def __init__(
        self,
        plan: FleetPlan,
        number: int,
        box: SignalBox,
        folder: Path | None = None,
        masters: MastersOfTrain | None = None,
    ) -> None:
        """Args:
        number: from 1.
        folder: for the logs of all trips; None: nothing is logged.
        masters: issue all authorities; None: the wayside does.
        """
        self.number, self.name = number, f"train {number}"
        self.trips: list[TripRecord] = []
        self.brakes: list[ProtectionBrake] = []
        self.gone = False
        """Whether the train has made all trips."""
        self.silent = False
        """Whether the controller does not run, because it was killed or is stopped."""
        self.lost_log_lines = 0
        self.bench: Lockstep | None = None
        self.power: HighVoltageBox | None = None
        """The box by which a supply network feeds the train, the same on all trips; None before
        the train enters, and without such a network."""
        self._plan, self._box, self._folder, self._masters = plan, box, folder, masters
        self._config = plan.config
        self._command: LineCommand | None = None
        self._departs_ns = 0
        """Instant of the trip before which the train does not depart."""
        self._departure: Departure | None = None
        self._cab_b = False
        """Whether the train runs with the cab ahead that was behind at first."""
        self._began_ns = 0
        self._rows = MemoryLog()
        self._supervision = Supervision.NO_AUTHORITY

    @property
    def place_m(self) -> float:
        """True chainage of the front on the path of the trip."""
        assert self.bench is not None
        return self.bench.plant.world.front_m

    @property
    def on_network(self) -> bool:
        """Whether the train has entered and not left."""
        return self.bench is not None

    @property
    def front(self) -> TrackPlace:
        """True place of the train's front. Call it for a train on the network only."""
        body = self.interlocking.body
        return body.path.to_track(body.end_m)

    @property
    def middle(self) -> TrackPlace:
        """True place of the train's middle. Call it for a train on the network only."""
        body = self.interlocking.body
        return body.path.to_track((body.rear_m + body.end_m) / 2.0)

    @property
    def moving(self) -> bool:
        return self.bench is not None and self.bench.plant.world.speed_mps != 0.0

    @property
    def wait_s(self) -> float:
        """Time until a train that masters command may depart; 0 once that is over."""
        assert self.bench is not None
        return max(0.0, (self._departs_ns - self.bench.clock.now_ns()) / NS_PER_S)

    @property
    def interlocking(self) -> Interlocking:
        """The routes of the train. Call it for a train on the network only."""
        assert self.bench is not None
        found = self.bench.plant.railway.interlocking
        assert found is not None
        return found

    @property
    def authority_number(self) -> tuple[int, ...]:
        """Trip, and number of the newest authority in it. Under masters, the report that the oldest
        of its parts answers: one for each area that the authority leads over.
        """
        assert self.bench is not None
        if self._command is not None:
            held = self._command.held
            return (len(self.trips),) if held is None else (len(self.trips), held.echo_ns)
        return len(self.trips), self.bench.plant.railway.zone.answered

    @property
    def authority_end_m(self) -> float | None:
        """End of the newest authority of the trip; None before the first one."""
        assert self.bench is not None
        if self._command is not None:
            held = self._command.held
            return None if held is None else held.end_m
        latest = self.bench.plant.railway.zone.latest
        return None if latest is None else latest.end_m

    def enter(self, now_ns: int) -> bool:
        """Put the train on the network if it is due and there is room."""
        first = self._plan.trips[0]
        if now_ns < self._plan.due_ns(self.number, 0):
            return False
        assert first.scenario.tracks is not None
        front_m, length_m = first.scenario.start.stop_m, first.scenario.train.length_m
        path, rear_m = first.scenario.tracks[1], front_m - length_m
        if not self._box.has_room(path, front_m=front_m, rear_m=rear_m):
            self._box.wait_to_enter(self.name, path, front_m=front_m, rear_m=rear_m)
            return False
        self._begin(0, now_ns)
        return True

    def advance(self, until_ns: int) -> None:
        """Run on to an instant of the network. A trip that ends before is followed by the next."""
        while self.bench is not None:
            bench, end_ns = self.bench, until_ns - self._began_ns

            def over(now_ns: int, bench: Lockstep = bench, end_ns: int = end_ns) -> bool:
                arrived = bench.arrived and not self.silent
                return now_ns >= end_ns or (arrived and now_ns % STEP_NS == 0)

            if self._command is not None:
                self._be_commanded(bench, self._command)
            bench.run_until(over)
            self._look(bench)
            if not bench.arrived or self.silent or bench.clock.now_ns() >= end_ns:
                return
            self._next(bench)

    def kill(self) -> None:
        """Kill the controller. The train's units brake, and its plant goes on."""
        self.stop()
        self._fall_silent()

    def stop(self) -> None:
        """Stop the controller until `go_on`. The train's units brake, and its plant goes on."""
        assert self.bench is not None
        self.bench.without_controller()
        self.silent = True

    def go_on(self) -> None:
        """Let a stopped controller go on."""
        assert self.bench is not None
        self.bench.with_controller()
        self.silent = False

    def _fall_silent(self) -> None:
        """Take part in no line any more, because the controller is dead."""
        if self._masters is not None:
            self._masters.leave(self._path_name(), self.number)
            self._command = None

    def feed(self, feed: TrainFeed, due: Due) -> None:
        """Take what the supply network gives.

        Args:
            due: energies of the interval, as `HighVoltageBox.take_load` gave them.
        """
        assert self.power is not None
        self.power.fed(feed.voltage_v, feed.chopped_ratio, feed.effort_ratio, due, INTERVAL_S)
        if self.bench is not None:
            self.bench.plant.world.traction.feed(self.power.effort_ratio)

    def _connect(self, world: World) -> None:
        """Let the supply network feed the train."""
        if self.power is None:
            self.power = world.power
            self.power.join()
        else:
            world.keep_power(self.power)

    def _be_commanded(self, bench: Lockstep, command: LineCommand) -> None:
        """Keep the stretch of a train that masters command, and let it wait until it is due."""
        routes = self.interlocking
        early = bench.clock.now_ns() < self._departs_ns
        command.waits = early or (not self.moving and routes.behind_unknown)
        end_m, body = self.authority_end_m, routes.body
        routes.keep(rear_m=body.rear_m - REAR_M, end_m=max(body.end_m, end_m or body.end_m))
        # A master that is about to leave hands over while it still commands.
        stop_m = self._plan.trips[self.trips[-1].index].journey.end.stop_m
        command.out_of_service = not self.moving and abs(body.end_m - stop_m) < AT_STOP_M

    def _look(self, bench: Lockstep) -> None:
        """Note what the train and its controller do now."""
        now_s = (self._began_ns + bench.clock.now_ns()) / NS_PER_S
        record, output = self.trips[-1], bench.vobc.output
        if self.moving:
            if record.left_s is None:
                record.left_s = now_s
            if output.supervision in BRAKES and output.supervision is not self._supervision:
                kind = output.supervision.name.lower()
                brake = ProtectionBrake(now_s, self.number, kind, output.cause)
                self.brakes.append(brake)
        self._supervision = output.supervision
        entry = self._plan.trips[record.index].entry
        decided = record.hindered or record.entered_s is not None
        if not decided and entry is not None and self.place_m >= entry.brake_m:
            end_m = self.authority_end_m
            record.hindered = end_m is None or end_m <= entry.signal_m
            record.entered_s = None if record.hindered else now_s
        if record.clear_s is None and record.left_s is not None:
            first_m = self.interlocking.first_switch_m
            if self.interlocking.body.rear_m > first_m + CLEAR_M:
                record.clear_s = now_s

    def _begin(self, index: int, now_ns: int) -> None:
        planned = self._plan.trips[index]
        due_ns = self._plan.due_ns(self.number, index)
        wait_s = max(planned.trip.layover_s, (due_ns - now_ns) / NS_PER_S)
        scenario = replace(planned.scenario, seed=self._plan.seed_of(self.number), layover_s=wait_s)
        journey, turned = planned.journey, False
        if self._departure is not None:
            turned = self._departure.cab_b is not self._cab_b
            scenario = self._departure.scenario(scenario)
            journey = self._departure.journey(journey)
            self._cab_b = self._departure.cab_b
        stops_m = tuple(stop.stop_m for stop in journey.stops)
        self._began_ns, self._rows = now_ns, MemoryLog()
        self._supervision = Supervision.NO_AUTHORITY
        self._config = self._plan.config
        if self._masters is not None:
            self._config = self._masters.config_of(self._config, self.number)
            self._command = self._masters.enter(journey.line, self._config, now_ns)
            self._departs_ns = round(wait_s * NS_PER_S)
        shared = SharedNetwork(self._box, self.name, now_ns, stops_m)
        self.bench = self._open(index, scenario, journey, shared)
        if self._plan.supply is not None:
            self._connect(self.bench.plant.world)
        due_s = due_ns / NS_PER_S if self._plan.first_trip(index) else None
        trip = planned.trip
        self.trips.append(
            TripRecord(
                *(self.number, index, trip.start, trip.end, now_ns / NS_PER_S, due_s, turned)
            )
        )

    def _open(
        self, index: int, scenario: TrainScenario, journey: Journey, shared: SharedNetwork
    ) -> Lockstep:
        """Set up the bench of a trip."""
        return Lockstep(
            self._config,
            scenario,
            journey,
            self._trip_folder(index),
            taps=Taps(rows=self._rows),
            shared=shared,
            command=self._command,
        )

    def _end(self, bench: Lockstep) -> None:
        """End the bench of a trip."""
        bench.close()

    def _next(self, bench: Lockstep) -> None:
        """End a trip whose train has arrived, and begin the next one."""
        record, index = self.trips[-1], self.trips[-1].index
        now_ns = self._began_ns + bench.clock.now_ns()
        record.ended_s = now_ns / NS_PER_S
        departure: Departure | None = None
        if index + 1 < len(self._plan.trips):
            came, leaves = self._plan.trips[index], self._plan.trips[index + 1]
            departure = go_on(bench, came.trip, leaves.trip, cab_b=self._cab_b)
        self.close()
        self._departure = departure
        if departure is None:
            self.gone = True
            self._box.leave(self.name)
        else:
            self._begin(index + 1, now_ns)

    def close(self) -> None:
        """End the bench of the present trip, if there is one, and measure the trip."""
        bench, self.bench = self.bench, None
        if bench is None:
            return
        self._end(bench)
        record = self.trips[-1]
        if self._masters is not None:
            self._masters.leave(self._path_name(), self.number)
        record.frames = bench.bus.statistics().frames
        stops, truth = self._plan.trips[record.index].journey.stops, self._rows.columns()
        record.stops = measure_stops(truth, stops)
        record.hops = measure_hops(truth, record.start, record.stops)
        self.lost_log_lines += bench.lost_log_lines

    def _path_name(self) -> str:
        return self._plan.trips[self.trips[-1].index].trip.path.line.name

    def _trip_folder(self, index: int) -> RunFolder | None:
        if self._folder is None:
            return None
        path = self._folder / f"trip-{index + 1}"
        path.mkdir(parents=True)
        return RunFolder(path)
