"""A train that changes ends in virtual time: what it keeps, and what its other cab starts with."""

from dataclasses import dataclass, replace

from firmware_py.settings import SettingsError
from firmware_py.trackdb.circuit import load_path, split_route, with_route
from firmware_py.trackdb.network import Running
from firmware_py.trackdb.paths import Path
from metro_hil.model.mission import Journey
from metro_hil.model.run_options import RunOptions
from metro_hil.run.lockstep import Lockstep
from plant_emulator.train_config import seen_from_other_cab
from plant_emulator.world import TrainScenario, TurnedTrain
from vobc.atp.change_ends import OtherPath
from vobc.process import VobcDevice
from vobc.vocabulary import OdometryRecord


@dataclass(frozen=True, slots=True)
class Departure:
    """A train at the terminal, on the path by which it leaves."""

    turned: TurnedTrain
    handed_over: OdometryRecord
    """Place by the controller of the cab that was switched off."""

    def scenario(self, planned: TrainScenario) -> TrainScenario:
        """The plant of the run back: the same train, seen from its other cab."""
        return replace(planned, train=seen_from_other_cab(planned.train), turned=self.turned)

    def journey(self, planned: Journey) -> Journey:
        """The journey back, with the place that was handed over."""
        return replace(planned, handed_over=self.handed_over)


def both_ways(options: RunOptions) -> tuple[RunOptions, RunOptions]:
    """The options of the run out and of the run back. Raises SettingsError."""
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
    out = replace(options, line=with_route(base, route), and_back=None)
    stations = load_path(out.line).line.stations
    back = replace(
        out,
        line=with_route(base, back_route),
        start=options.end or stations[-1].name,
        end=options.start or stations[0].name,
    )
    if options.out is not None:
        return replace(out, out=f"{options.out}/out"), replace(back, out=f"{options.out}/back")
    return out, back


def check_turn(came: Path, leaves: Path, terminal: str) -> None:
    """Check that the path back leaves the terminal over the same track, in the other direction.

    Raises SettingsError.
    """
    place = came.to_track(came.line.station(terminal).stop_m)
    for leg in leaves.legs:
        if leg.track.name == place.track and leg.running is place.running.other:
            return
    raise SettingsError(
        f"--and-back: {leaves.line.name} does not leave {terminal} over track {place.track} "
        f"{place.running.other.value}; choose a route that does"
    )


def change_ends(bench: Lockstep, came: Path, leaves: Path) -> Departure:
    """Change ends at the end of a run. The train and its controller are as the run left them.

    Args:
        came: path of that run.
        leaves: path of the other direction.

    Raises SettingsError if part of the train stands on a track that it does not leave by.
    """

    def translate(at_m: float) -> float:
        place = came.to_track(at_m)
        try:
            return leaves.to_path(place)
        except KeyError:
            raise SettingsError(
                f"--and-back: the train also stands on track {place.track}, and "
                f"{leaves.line.name} does not run over it; choose a route that does"
            ) from None

    shared = {leg.track.name for leg in leaves.legs}

    world = bench.plant.world
    reader = world.tag_reader
    # Each car has the chainage that the front would have if no coupler were stretched.
    rear_m = world.consist.car_fronts_m[-1] - world.length_m
    assert isinstance(bench.vobc, VobcDevice)
    return Departure(
        TurnedTrain(
            front_m=translate(rear_m),
            tags_m={
                site.tag_id: translate(reader.felt_m(site.tag_id))
                for site in reader.tags
                if came.to_track(reader.felt_m(site.tag_id)).track in shared
            },
            seed=world.seed + 1,
        ),
        bench.vobc.hand_over(OtherPath(leaves.line.start_m, leaves.line.end_m, translate)),
    )
