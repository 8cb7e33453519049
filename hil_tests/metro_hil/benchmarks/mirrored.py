"""Runs a line both ways, and its mirrored copy: the mirrored line must give the mirrored run.

`python -m metro_hil.benchmarks.mirrored LINE[,CONSIST,PARAMS] …` prints one row for each line and
direction, and exits with 1 if a run differs from the mirrored one.
"""

import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

from firmware_py.settings import SettingsError
from firmware_py.trackdb import LineMap, load_line
from firmware_py.trackdb.network import (
    PlatformEdge,
    Running,
    Serves,
    Track,
    TrackLimit,
    TrackTag,
    TrackZone,
)
from firmware_py.trackdb.one_track import network_of
from firmware_py.trackdb.paths import CHAINAGE_DIGITS, OTHER_SIDE, make_path
from firmware_py.trackdb.sites import CurveSection, GradientSection
from metro_hil.metrics.case import MemoryLog
from metro_hil.metrics.stops import measure_stops
from metro_hil.model.frame_hash import FrameHash
from metro_hil.model.mission import Journey
from metro_hil.model.run_options import EXIT_FAILED, EXIT_OK, EXIT_USAGE
from metro_hil.run.lockstep import Lockstep, Taps
from plant_emulator.world import plan_scenario
from vobc.config import load_config, plan_mission
from vobc.plausible import check_plausible

TRAIN: Final = "florence4"


@dataclass(frozen=True, slots=True)
class OneWay:
    """A run over a line in one direction."""

    ended: str
    frame_hash: str
    frames: int
    stop_errors_m: tuple[float | None, ...]

    @property
    def made_count(self) -> int:
        """Number of stops that the train made."""
        return sum(error_m is not None for error_m in self.stop_errors_m)

    @property
    def worst_m(self) -> float:
        return max((abs(each) for each in self.stop_errors_m if each is not None), default=0.0)


def main(words: Sequence[str]) -> int:
    """Run the lines of the command line. Returns the exit code."""
    same = True
    try:
        for word in words:
            name, consist, params = (*word.split(","), TRAIN, TRAIN)[:3]
            line = load_line(name)
            for running in Running:
                run, mirror = (one_way(each, consist, params) for each in directions(line, running))
                same = same and run == mirror
                print(
                    f"{name} {running.value}: {run.ended}, {run.made_count} of "
                    f"{len(run.stop_errors_m)} stops, worst {100.0 * run.worst_m:.1f} cm, "
                    f"{run.frames} frames, {'the same' if run == mirror else 'NOT the same'} "
                    "on the mirrored line"
                )
    except SettingsError as error:
        print(f"mirrored: {error}", file=sys.stderr)
        return EXIT_USAGE
    return EXIT_OK if same else EXIT_FAILED


def directions(line: LineMap, running: Running) -> tuple[LineMap, LineMap]:
    """The line in one direction, and its mirrored copy in the other one."""
    network = network_of(line)
    (track,) = network.tracks
    mirrored = replace(network, tracks=(flipped(track),))
    return (
        make_path(network, line.name, ((track.name, running),)).line,
        make_path(mirrored, line.name, ((track.name, running.other),)).line,
    )


def one_way(line: LineMap, consist: str, params: str) -> OneWay:
    """Run the whole line. Raises SettingsError."""
    config = load_config(params)
    fitted = line.for_train(config.train.length_m)
    check_plausible(config, fitted)
    scenario = plan_scenario(consist=consist)
    true_line = line.for_train(scenario.train.length_m)
    first, last = true_line.stations[0], true_line.stations[-1]
    journey = Journey(fitted, plan_mission(fitted, None, None))
    frames, rows = FrameHash(), MemoryLog()
    bench = Lockstep(
        config,
        replace(scenario, line=true_line, start=first, destination=last),
        journey,
        taps=Taps(frame=frames.frame, rows=rows),
    )
    try:
        ended = bench.run()
    finally:
        bench.close()
    stops = measure_stops(rows.columns(), journey.stops)
    return OneWay(ended, frames.value, frames.frames, tuple(each.error_m for each in stops))


def flipped(track: Track) -> Track:
    """The same track with its chainage counted from the other end, written part by part."""

    def at(value_m: float) -> float:
        return round(track.start_m + track.end_m - value_m, CHAINAGE_DIGITS)

    def turned(serves: Serves) -> Serves:
        return {Serves.UP: Serves.DOWN, Serves.DOWN: Serves.UP}.get(serves, serves)

    def zones(found: tuple[TrackZone, ...]) -> tuple[TrackZone, ...]:
        return tuple(
            TrackZone(at(x.end_m), at(x.start_m), x.name, turned(x.direction))
            for x in reversed(found)
        )

    return Track(
        track.name,
        track.start_m,
        track.end_m,
        tuple(
            TrackLimit(at(x.end_m), at(x.start_m), x.limit_mps, turned(x.direction))
            for x in reversed(track.limits)
        ),
        tuple(
            PlatformEdge(
                station=x.station,
                start_m=at(x.end_m),
                end_m=at(x.start_m),
                side=OTHER_SIDE[x.side],
                stop_up_m=None if x.stop_down_m is None else at(x.stop_down_m),
                stop_down_m=None if x.stop_up_m is None else at(x.stop_up_m),
                dwell_s=x.dwell_s,
                platform_doors=x.platform_doors,
                run_up_s=x.run_down_s,
                run_down_s=x.run_up_s,
                short_up=tuple(replace(each, stop_m=at(each.stop_m)) for each in x.short_down),
                short_down=tuple(replace(each, stop_m=at(each.stop_m)) for each in x.short_up),
            )
            for x in reversed(track.platforms)
        ),
        tuple(
            GradientSection(at(x.end_m), at(x.start_m), -x.gradient_permille)
            for x in reversed(track.gradients)
        ),
        tuple(CurveSection(at(x.end_m), at(x.start_m), x.radius_m) for x in reversed(track.curves)),
        tuple(
            TrackTag(x.tag_id, at(x.position_m), x.kind, x.station, turned(x.direction))
            for x in reversed(track.tags)
        ),
        tunnels=tuple(
            replace(x, start_m=at(x.end_m), end_m=at(x.start_m)) for x in reversed(track.tunnels)
        ),
        neutral_sections=zones(track.neutral_sections),
        power_sections=zones(track.power_sections),
        no_stop_zones=zones(track.no_stop_zones),
        evacuation_stops=zones(track.evacuation_stops),
    )


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
