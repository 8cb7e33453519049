"""A train that goes on over another path: what it keeps, and what its controller starts with."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

from firmware_py.settings import SettingsError
from firmware_py.trackdb.circuit import split_route
from firmware_py.trackdb.network import Running
from firmware_py.trackdb.paths import Path, TrackPlace
from metro_hil.model.mission import Journey
from metro_hil.model.run_options import RunOptions
from metro_hil.model.service import (
    PlannedTrip,
    Service,
    Trip,
    load_service,
    plan_trips,
)
from metro_hil.run.lockstep import Lockstep
from plant_emulator.train_config import seen_from_other_cab
from plant_emulator.world import TrainScenario, TurnedTrain
from vobc.atp.change_ends import OtherPath
from vobc.process import VobcDevice
from vobc.vocabulary import OdometryRecord


@dataclass(frozen=True, slots=True)
class Departure:
    """A train at the end of a trip, on the path by which it leaves."""

    turned: TurnedTrain
    handed_over: OdometryRecord
    """Place by the controller of the trip before."""
    cab_b: bool
    """Whether the train leaves with the cab at its other end than at first in front."""

    def scenario(self, planned: TrainScenario) -> TrainScenario:
        """The plant of the next trip: the same train, seen from the cab that it leaves with."""
        train = seen_from_other_cab(planned.train) if self.cab_b else planned.train
        return replace(planned, train=train, turned=self.turned)

    def journey(self, planned: Journey) -> Journey:
        """The journey of the next trip, with the place that was handed over."""
        return replace(planned, handed_over=self.handed_over)


def trips_of(options: RunOptions) -> tuple[PlannedTrip, ...]:
    """The trips of a run out and back, or of a service. Raises SettingsError."""
    if options.service is not None:
        return load_service(options.service)
    base, route = split_route(options.line)
    back_route = options.and_back
    if not back_route:
        try:
            running = Running(route or Running.UP.value)
        except ValueError:
            raise SettingsError(
                f"--and-back: {route} of {base} is no direction of a line; name the route back, "
                "such as --and-back ROUTE"
            ) from None
        route, back_route = running.value, running.other.value
    out = Trip(str(route), options.start, options.end)
    service = Service(base, (out, Trip(back_route, end=options.start)))
    return plan_trips(service, base, "--and-back")


def options_of(options: RunOptions, trips: Sequence[PlannedTrip]) -> tuple[RunOptions, ...]:
    """The options of the run of each trip."""
    names = ["out", "back"] if options.service is None else [f"{n + 1}" for n in range(len(trips))]
    return tuple(
        replace(
            options,
            line=trip.line,
            start=trip.start,
            end=trip.end,
            and_back=None,
            service=None,
            out=None if options.out is None else f"{options.out}/{name}",
        )
        for name, trip in zip(names, trips, strict=True)
    )


def timed_journey(trip: PlannedTrip, planned: Journey) -> Journey:
    """The journey with the stops and dwell times of its trip."""
    line = trip.timed(planned.line)
    return replace(planned, line=line, mission=trip.mission(line))


def timed_scenario(trip: PlannedTrip, planned: TrainScenario) -> TrainScenario:
    """The plant with the dwell times and the layover of its trip."""
    return replace(planned, line=trip.timed(planned.line), layover_s=trip.layover_s)


def changes_ends(leaves: Path, place: TrackPlace) -> bool | None:
    """Whether a path leads over a track in the other direction than that of a place on it.

    None: the path does not run over the track.
    """
    ways = {leg.track.name: leg.running for leg in leaves.legs}
    return None if place.track not in ways else ways[place.track] is not place.running


def go_on(bench: Lockstep, came: PlannedTrip, leaves: PlannedTrip, *, cab_b: bool) -> Departure:
    """Put a train that has ended a trip on the path of the next one.

    If that path leads back over the track on which the front stands, the train changes ends.

    Args:
        cab_b: whether the train came with cab B in front.

    Raises SettingsError if part of the train stands on a track that the path does not run over, or
    runs over in another way than over the track of the front.
    """
    front = came.path.to_track(came.path.line.station(came.end).stop_m)
    turns = changes_ends(leaves.path, front) is True

    def translate(at_m: float) -> float:
        place = came.path.to_track(at_m)
        if changes_ends(leaves.path, place) is not turns:
            raise SettingsError(
                f"{leaves.start}: the train also stands on track {place.track}, and "
                f"{leaves.path.line.name} does not run over it that way; choose a route that does"
            )
        return leaves.path.to_path(place)

    world = bench.plant.world
    reader = world.tag_reader
    felt = [(tag.tag_id, came.path.to_track(reader.felt_m(tag.tag_id))) for tag in reader.tags]
    # Each car has the chainage that the front would have if no coupler were stretched.
    front_m = world.consist.car_fronts_m[-1 if turns else 0]
    rear_m = front_m - world.length_m
    translate(rear_m)
    assert isinstance(bench.vobc, VobcDevice)
    line = leaves.path.line
    return Departure(
        TurnedTrain(
            front_m=translate(rear_m if turns else front_m),
            tags_m={
                tag_id: leaves.path.to_path(place)
                for tag_id, place in felt
                if changes_ends(leaves.path, place) is turns
            },
            seed=world.seed + 1,
        ),
        bench.vobc.hand_over(OtherPath(line.start_m, line.end_m, translate, turns)),
        cab_b is not turns,
    )
