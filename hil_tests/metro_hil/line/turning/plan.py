"""The plan of a service of several trains: what each trip needs, and when trains are due."""

from dataclasses import dataclass, replace
from typing import Final

from firmware_py.settings import SettingsError
from firmware_py.trackdb.line_map import LineMap
from firmware_py.trackdb.network import TrackNetwork
from metro_hil.metrics.fastest_run import fastest_run_s, limited_stretches
from metro_hil.model.case import Setup
from metro_hil.model.mission import Journey, check_reference, plan_journey
from metro_hil.model.network_supply import supply_of
from metro_hil.model.run_options import RunOptions
from metro_hil.model.service import TRAINS_MAX, PlannedTrip, Service, needs_switches, read_service
from metro_hil.run.lockstep import config_of, scenario_of
from metro_hil.run.turnback import options_of, timed_journey, timed_scenario, trips_of
from plant_emulator.power.supplies import Supply
from plant_emulator.traffic.member import SEEDS
from plant_emulator.wayside.interlocking import sections_of
from plant_emulator.wayside.route_objects import check_masters
from plant_emulator.world import TrainScenario
from vobc.ato.settings.ato import AtoConfig
from vobc.config import VobcConfig
from vobc.plausible import check_plausible

NS_PER_S: Final = 1_000_000_000


@dataclass(frozen=True, slots=True)
class TripPlan:
    """One trip with the two sides of its run."""

    trip: PlannedTrip
    journey: Journey
    scenario: TrainScenario
    entry: "Entry | None"
    """Where the train needs the route to its last stop; None without a switch before that."""


@dataclass(frozen=True, slots=True)
class Entry:
    """The way to a last stop behind a switch."""

    start_m: float
    """The stop before."""
    signal_m: float
    """Signal before the last switch, not before that stop."""
    brake_m: float
    """Where a train on its shortest run begins to brake if the signal shows stop."""
    brake_s: float
    """Time from the start of that run to the begin of the brake."""


@dataclass(frozen=True, slots=True)
class MasterStrike:
    """A fault of a train that commands."""

    at_s: float
    kills: bool
    """Whether its controller dies; otherwise its radio is cut for a moment."""


@dataclass(frozen=True, slots=True)
class FleetPlan:
    """All trains of a service. Every train makes the same trips."""

    network: TrackNetwork
    config: VobcConfig
    service: Service
    trains: int
    trips: tuple[TripPlan, ...]
    """The trips of all round trips."""
    seed: int
    masters: bool = False
    """Whether the trains command themselves."""
    strike: "MasterStrike | None" = None
    supply: Supply | None = None
    """Supply network of all trains; None: each train has a source of its own."""

    @property
    def round_s(self) -> float:
        """Time between two departures of one train on the first trip; 0 without a timetable."""
        return self.trains * self.service.headway_s

    def first_trip(self, index: int) -> bool:
        """Whether a trip is the first one of a round trip."""
        return index % len(self.service.trips) == 0

    def due_ns(self, train: int, index: int) -> int:
        """Instant before which a train does not begin a trip; trains count from 1."""
        if not self.first_trip(index):
            return 0
        round_trip = index // len(self.service.trips)
        due_s = (train - 1) * self.service.headway_s + round_trip * self.round_s
        return round(due_s * NS_PER_S)

    def seed_of(self, train: int) -> int:
        """Seed of a train; no two trains share one."""
        return self.seed * SEEDS + train


def trains_of(options: RunOptions) -> int:
    """Number of trains of a run with a service. Raises SettingsError."""
    assert options.service is not None
    named = read_service(options.service).trains
    return named if options.trains is None else options.trains


def plan_fleet(options: RunOptions) -> FleetPlan:
    """Plan all trips. Raises SettingsError if parts do not fit each other."""
    assert options.service is not None
    service, trains = read_service(options.service), trains_of(options)
    if trains > TRAINS_MAX:
        raise SettingsError(f"--trains {trains}: with a service there are 1 to {TRAINS_MAX}")
    config = config_of(options)
    plans: dict[str, TripPlan] = {}
    trips: list[TripPlan] = []
    planned = trips_of(options)
    for trip, chosen in zip(planned, options_of(options, planned), strict=True):
        key = repr(
            (trip.line, trip.start, trip.end, trip.stops, dict(trip.dwell_s), dict(trip.run_s))
        )
        if key not in plans:
            plans[key] = _trip_plan(trip, chosen, config)
        trips.append(replace(plans[key], trip=trip))
    tracks = trips[0].scenario.tracks
    if tracks is None:
        raise SettingsError(f"{options.service}: {needs_switches(trains, service.line)}")
    masters = options.masters or options.is_networked
    if masters:
        departures = [(each.trip.path, each.trip.start) for each in trips]
        check_masters(tracks[0], departures, str(options.service))
    return FleetPlan(
        tracks[0],
        config,
        service,
        trains,
        tuple(trips),
        options.seed,
        masters,
        strike_of(options),
        None if options.supply is None else supply_of(options.supply, tracks[0], planned),
    )


def strike_of(asked: RunOptions | Setup) -> MasterStrike | None:
    """The fault of a master that a command line or a case asks for."""
    for at_s, kills in ((asked.kill_master_at_s, True), (asked.cut_master_at_s, False)):
        if at_s is not None:
            return MasterStrike(at_s, kills)
    return None


def _trip_plan(trip: PlannedTrip, chosen: RunOptions, config: VobcConfig) -> TripPlan:
    journey = timed_journey(trip, plan_journey(chosen))
    scenario = timed_scenario(trip, scenario_of(chosen))
    check_plausible(config, journey.line)
    check_reference(config, scenario.train)
    return TripPlan(trip, journey, scenario, entry_of(scenario, journey, config))


def entry_of(scenario: TrainScenario, journey: Journey, config: VobcConfig) -> Entry | None:
    if scenario.tracks is None:
        return None
    last_m = journey.end.stop_m
    sections = [each for each in sections_of(*scenario.tracks) if each.crossings[0].at_m < last_m]
    if not sections:
        return None
    stops_m = [journey.start.stop_m, *(stop.stop_m for stop in journey.stops)]
    start_m = max(stop_m for stop_m in stops_m if stop_m < last_m)
    return approach(journey.line, config.ato, start_m, sections[-1].signal_m)


def approach(line: LineMap, config: AtoConfig, start_m: float, signal_m: float) -> Entry:
    """The shortest run from a stop to a signal at stop."""
    if signal_m <= start_m:
        return Entry(start_m, start_m, start_m, 0.0)
    accel_mps2, jerk_mps3 = config.limits.accel_mps2, config.limits.jerk_mps3
    way = limited_stretches(line, start_m, signal_m, train_length_m=config.train_length_m)
    run_s = fastest_run_s(way, accel_mps2=accel_mps2, jerk_mps3=jerk_mps3)
    top_mps = max(each.limit_mps for each in way)
    ramp_s = top_mps / accel_mps2 + accel_mps2 / jerk_mps3
    if 2.0 * ramp_s >= run_s:
        # The train does not reach the limit, so it brakes from the middle on.
        return Entry(start_m, signal_m, (start_m + signal_m) / 2.0, run_s / 2.0)
    return Entry(start_m, signal_m, signal_m - top_mps * ramp_s / 2.0, run_s - ramp_s)
