"""Headway of whole trains, each with its controller, plant and bus, one behind the other.

All start at once, as far apart as they travel in one interval. They stop once, so that ATO learns
its brake as in service. There they are held until the last one stands. Then they are released
together, reach their speed, and run through one station.
"""

import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Final, NamedTuple

from can_dbc.vobc import Supervision
from firmware_py.trackdb.areas import Area, AreaMap, TrackSection
from metro_hil.line.train_group import LineBench, TrainRun
from plant_emulator.wayside.centre import NORMAL
from vobc.config import load_config
from vobc.train_to_train.vocabulary import T2tConfig
from zenoh_config.timers import TIMERS_B

SPEED_MPS: Final = 60.0 / 3.6
LIMIT_MPS: Final = 17.12
"""Civil limit with which ATO, keeping its margin, runs at 60 km/h."""
DOORS_S: Final = 21.65
"""Time for which doors stay open; together with closing and departing a train stands for 30 s."""
CARS: Final = 4
LENGTH_M: Final = 81.2
"""Length of the trains; their cars are longer than those of `florence4`."""
WARM_M: Final = 350.0
RUN_UP_M: Final = 1500.0
RUN_OUT_M: Final = 1200.0
EDGE_M: Final = 200.0
SECTION_M: Final = 100.0
TAG_M: Final = 200.0
CLEAR_OF_STOP_M: Final = 60.0
LOOK_S: Final = 0.1
SETTLED_S: Final = 5.0
BEFORE_M: Final = 1000.0
GONE_M: Final = 100.0
LIMIT_S: Final = 1200.0
BRAKES_MPS2: Final = 0.05
AT_STOP_M: Final = 2.0
STANDS_MPS: Final = 0.01
STOP_TAGS: Final = ((-52.0, "t1"), (-12.0, "t2"), (-3.5, "t3"), (-2.0, "stop"))
PROTECTED: Final = (Supervision.SERVICE, Supervision.EMERGENCY)
NS_PER_S: Final = 1e9


class Passage(NamedTuple):
    """Passage of one train through the station."""

    came_s: float
    """Instant at which it was 1000 m before the stop."""
    stopped_s: float
    dwell_s: float
    braked_m: float
    """Position of its first braking after that, relative to the stop."""
    short_m: float
    """Position at which it stood, relative to the stop."""
    protected: bool
    """Whether ATP braked the train, by service or emergency brake."""


class _Track(NamedTuple):
    starts_m: Sequence[float]
    """Starting positions, the foremost first."""
    stop_m: float
    end_m: float


def passages(trains: int, interval_s: float) -> list[Passage]:
    """Return the passages, the foremost train first.

    Raises TimeoutError if a train does not arrive.
    """
    with approach(trains, interval_s) as (bench, stop_m):
        _let_go_together(bench, interval_s)
        watches = {number: _Watch() for number in bench.trains}
        while not all(watch.gone for watch in watches.values()):
            if bench.clock.now_ns() > LIMIT_S * NS_PER_S:
                raise TimeoutError("a train did not come through the station")
            bench.run(LOOK_S)
            for number, watch in watches.items():
                train = bench.trains[number]
                world, output = train.plant.world, train.vobc.output
                watch.looks(
                    bench.clock.now_ns() / NS_PER_S,
                    world.front_m - stop_m,
                    world.speed_mps,
                    output.accel_demand_mps2,
                    protected=output.supervision in PROTECTED,
                )
    return [watches[number].passage() for number in sorted(watches)]


def _let_go_together(bench: LineBench, interval_s: float) -> None:
    """Run until all trains stand at their first stop, and release them together."""
    plants = [train.plant for train in bench.trains.values()]
    starts_m = _starts_m(len(plants), interval_s)
    while any(
        plant.world.speed_mps > 0.0 or plant.world.front_m < start_m + WARM_M - AT_STOP_M
        for plant, start_m in zip(plants, starts_m, strict=True)
    ):
        if bench.clock.now_ns() > LIMIT_S * NS_PER_S:
            raise TimeoutError("a train did not come to where it stops first")
        bench.run(LOOK_S)
        for plant, start_m in zip(plants, starts_m, strict=True):
            # An earlier order to hold would keep the train at its start.
            if plant.world.front_m > start_m + WARM_M / 2.0:
                plant.railway.centre.standing = replace(NORMAL, hold=True)
    bench.run(SETTLED_S)
    for plant in plants:
        plant.railway.centre.standing = NORMAL


def _starts_m(trains: int, interval_s: float) -> list[float]:
    """Return the starting positions, the foremost first."""
    return [EDGE_M + interval_s * SPEED_MPS * n for n in reversed(range(trains))]


@contextmanager
def approach(
    trains: int, interval_s: float, run_up_m: float = RUN_UP_M
) -> Iterator[tuple[LineBench, float]]:
    """Yield the bench before its run, foremost train first, and the station's stopping point.

    Args:
        run_up_m: distance from the first stop to the station.
    """
    starts_m = _starts_m(trains, interval_s)
    stop_m = starts_m[0] + WARM_M + run_up_m
    track = _Track(starts_m, stop_m, stop_m + RUN_OUT_M)
    edge_m = track.end_m + EDGE_M
    joints_m = [*(at_m for at_m in _steps(0.0, edge_m, SECTION_M) if at_m < edge_m), edge_m]
    sections = [TrackSection(n + 1, a, b) for n, (a, b) in enumerate(pairwise(joints_m))]
    areas = AreaMap("headway", (Area(1, 0.0, edge_m),), tuple(sections))
    runs = [TrainRun(f"H{n}", "END", (f"W{n}", "STOP", "END")) for n in range(trains)]
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "headway.toml"
        path.write_text("\n".join(_line(track)), encoding="utf-8")
        config = load_config("florence4")
        config = replace(config, train=replace(config.train, length_m=LENGTH_M))
        cars = {f"cars.{n}.length_m": LENGTH_M / CARS for n in range(CARS)}
        t2t = T2tConfig(timers=TIMERS_B)
        yield LineBench(config, areas, runs, line=str(path), real=cars, t2t=t2t), stop_m


class _Watch:
    """Records one train's passage."""

    def __init__(self) -> None:
        self.gone = False
        self._came_s: float | None = None
        self._braked_m: float | None = None
        self._stopped_s: float | None = None
        self._went_s: float | None = None
        self._short_m = 0.0
        self._protected = False

    def looks(
        self, at_s: float, place_m: float, speed_mps: float, demand_mps2: float, *, protected: bool
    ) -> None:
        self.gone = place_m > GONE_M
        if place_m < -BEFORE_M:
            return
        self._protected |= protected and speed_mps > STANDS_MPS
        if self._came_s is None:
            self._came_s = at_s
        if self._braked_m is None and demand_mps2 < -BRAKES_MPS2:
            self._braked_m = place_m
        stands = speed_mps < STANDS_MPS
        if stands and abs(place_m) < AT_STOP_M:
            self._stopped_s = at_s if self._stopped_s is None else self._stopped_s
            self._short_m = place_m
        elif self._stopped_s is not None and not stands and self._went_s is None:
            self._went_s = at_s

    def passage(self) -> Passage:
        assert self._came_s is not None
        assert self._braked_m is not None
        if self._stopped_s is None or self._went_s is None:
            raise TimeoutError("a train did not stop at the station")
        return Passage(
            self._came_s,
            self._stopped_s,
            self._went_s - self._stopped_s,
            self._braked_m,
            self._short_m,
            self._protected,
        )


def _line(track: _Track) -> Iterator[str]:
    """Yield the lines of the file of a level line for these trains."""
    yield from ('name = "headway"', "start_m = 0.0", f"end_m = {track.end_m + EDGE_M}")
    stations = [("STOP", track.stop_m, DOORS_S, 200.0), ("END", track.end_m, 0.0, 200.0)]
    for number, start_m in enumerate(track.starts_m):
        stations.append((f"H{number}", start_m, 0.0, 200.0))
        stations.append((f"W{number}", start_m + WARM_M, 0.0, 60.0))
    stations.sort(key=lambda each: each[1])
    for at, (name, stop_m, dwell_s, run_s) in enumerate(stations):
        yield from ("[[stations]]", f'name = "{name}"', f"stop_m = {stop_m}")
        yield from (f"platform_start_m = {stop_m - 85.0}", f"platform_end_m = {stop_m + 5.0}")
        yield from ('side = "right"', "platform_doors = true", f"dwell_s = {dwell_s}")
        if at:
            yield f"run_s = {run_s}"
    yield from ("[[speed_sections]]", "start_m = 0.0", f"end_m = {track.end_m + EDGE_M}")
    yield f"limit_mps = {LIMIT_MPS}"
    served = [each for each in stations if not each[0].startswith("H")]
    tags = [(stop_m + at_m, kind, name) for name, stop_m, *_ in served for at_m, kind in STOP_TAGS]
    tags += [
        (at_m, "balise", "")
        for at_m in _steps(EDGE_M + 50.0, track.end_m, TAG_M)
        if all(abs(at_m - stop_m + 30.0) > CLEAR_OF_STOP_M for _, stop_m, *_ in served)
    ]
    for number, (at_m, kind, name) in enumerate(sorted(tags), start=101):
        yield from ("[[tags]]", f"tag_id = {number}", f"position_m = {at_m}", f'kind = "{kind}"')
        if name:
            yield f'station = "{name}"'


def _steps(start_m: float, end_m: float, step_m: float) -> list[float]:
    return [start_m + step_m * n for n in range(int((end_m - start_m) // step_m) + 1)]
