"""The shortest time between two stops that limits of speed, acceleration and jerk allow.

It is the reference for a run: without control law, brake delay or resistance.
"""

import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

from firmware_py.trackdb import LineMap
from metro_hil.model.mission import Journey
from vobc.ato.settings.ato import AtoConfig

BISECTIONS = 60
"""Number of halvings of a speed range; the rest is below what a float resolves."""


class LimitedStretch(NamedTuple):
    """Stretch of the front's way under one limit, by length."""

    length_m: float
    limit_mps: float


def journey_fastest_s(journey: Journey, config: AtoConfig) -> Mapping[str, float]:
    """Shortest time to each stop from the stop before, by station, under the comfort limits."""
    limits, length_m = config.limits, config.train_length_m
    times_s: dict[str, float] = {}
    from_m = journey.start.stop_m
    for stop in journey.stops:
        if stop.stop_m > from_m:
            way = limited_stretches(journey.line, from_m, stop.stop_m, train_length_m=length_m)
            times_s[stop.name] = fastest_run_s(
                way, accel_mps2=limits.accel_mps2, jerk_mps3=limits.jerk_mps3
            )
        from_m = stop.stop_m
    return times_s


def limited_stretches(
    line: LineMap, from_m: float, to_m: float, *, train_length_m: float
) -> list[LimitedStretch]:
    """The way of the front, divided where the lowest limit under the whole train changes."""
    edges_m = {from_m, to_m}
    for section in line.speed_sections:
        edges_m.update((section.start_m, section.end_m + train_length_m))
    inside_m = sorted(edge_m for edge_m in edges_m if from_m <= edge_m <= to_m)
    stretches: list[LimitedStretch] = []
    for begin_m, end_m in itertools.pairwise(inside_m):
        middle_m = (begin_m + end_m) / 2.0
        limit_mps = line.least_limit_mps(middle_m - train_length_m, middle_m)
        if stretches and stretches[-1].limit_mps == limit_mps:
            stretches[-1] = LimitedStretch(stretches[-1].length_m + end_m - begin_m, limit_mps)
        else:
            stretches.append(LimitedStretch(end_m - begin_m, limit_mps))
    return stretches


def fastest_run_s(
    stretches: Sequence[LimitedStretch], *, accel_mps2: float, jerk_mps3: float
) -> float:
    """Time of the run from rest to rest whose jerk is at its limit wherever no other limit is.

    A change of speed from u to v takes (u + v) / 2 * T(v - u) metres, where T(d) = d / a + a / j,
    or 2 * sqrt(d / j) while d is below a**2 / j. Where the limit changes, the speed is constant.

    Raises:
        ValueError: a length or a limit is not positive.
    """
    for value in (accel_mps2, jerk_mps3, *(number for one in stretches for number in one)):
        if value <= 0.0:
            raise ValueError(f"{value} is not positive, as limits and lengths must be")

    def ramp_s(change_mps: float) -> float:
        if change_mps >= accel_mps2**2 / jerk_mps3:
            return change_mps / accel_mps2 + accel_mps2 / jerk_mps3
        return 2.0 * math.sqrt(change_mps / jerk_mps3)

    def ramp_m(low_mps: float, high_mps: float) -> float:
        return (low_mps + high_mps) / 2.0 * ramp_s(high_mps - low_mps)

    pairs = itertools.pairwise(stretches)
    edges_mps = [0.0, *(min(a.limit_mps, b.limit_mps) for a, b in pairs), 0.0]
    for i, here in enumerate(stretches):
        edges_mps[i + 1] = _reached_mps(edges_mps[i], edges_mps[i + 1], here.length_m, ramp_m)
    for i, here in reversed(list(enumerate(stretches))):
        edges_mps[i] = _reached_mps(edges_mps[i + 1], edges_mps[i], here.length_m, ramp_m)
    total_s = 0.0
    for here, (begin_mps, end_mps) in zip(stretches, itertools.pairwise(edges_mps), strict=True):
        top_mps = _top_mps(begin_mps, end_mps, here, ramp_m)
        rest_m = here.length_m - ramp_m(begin_mps, top_mps) - ramp_m(end_mps, top_mps)
        total_s += ramp_s(top_mps - begin_mps) + ramp_s(top_mps - end_mps)
        total_s += max(0.0, rest_m) / top_mps
    return total_s


def _reached_mps(
    from_mps: float, to_mps: float, length_m: float, ramp_m: Callable[[float, float], float]
) -> float:
    """Speed after a stretch: `to_mps`, or what can be reached on the way to it."""
    if to_mps <= from_mps:
        return to_mps
    return _greatest(lambda speed_mps: ramp_m(from_mps, speed_mps) <= length_m, from_mps, to_mps)


def _top_mps(
    begin_mps: float,
    end_mps: float,
    here: LimitedStretch,
    ramp_m: Callable[[float, float], float],
) -> float:
    """Greatest speed on a stretch between two edges."""
    return _greatest(
        lambda top_mps: ramp_m(begin_mps, top_mps) + ramp_m(end_mps, top_mps) <= here.length_m,
        max(begin_mps, end_mps),
        here.limit_mps,
    )


def _greatest(fits: Callable[[float], bool], low: float, high: float) -> float:
    """Greatest value for which the condition holds, which holds up to some value."""
    if fits(high):
        return high
    for _ in range(BISECTIONS):
        middle = (low + high) / 2.0
        low, high = (middle, high) if fits(middle) else (low, middle)
    return low
