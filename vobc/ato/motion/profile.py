"""Reference speeds: braking curves, peak speeds of short sections, limits under the whole train."""

import itertools
import math
from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final, NamedTuple

from firmware_py.trackdb import LineMap
from vobc.ato.motion import gradient, trapezoid
from vobc.ato.settings.ato import AtoConfig, Braking

STEEP_WEAK_FACTOR: Final = 1.6
"""Factor on the assumed deviation of the brake gain where the demand also holds the gradient. With
the default of `weak_ratio` a gain of 0.75 still stops the train."""
LEAST_DECEL_MPS2: Final = 0.15
"""Least planned deceleration, however steep the downhill gradient."""


SEARCH_STEPS: Final = 40
"""Number of bisections of a speed range. The result is far finer than 1 mm/s."""


@dataclass(frozen=True, slots=True)
class CurvePoint:
    """Point of a braking curve at a given speed."""

    time_to_go_s: float
    distance_m: float
    """Distance to the end of the curve."""
    decel_mps2: float
    ease_mps3: float
    """Decrease of the deceleration per second from here on, zero or more."""


class _Piece(NamedTuple):
    """Piece of the curve, counted backwards from its end: start, deceleration there and its
    slope.
    """

    time_s: float
    speed_mps: float
    distance_m: float
    decel_mps2: float
    ease_mps3: float


class ReferenceBrakingCurve:
    """Braking curve with a deceleration that is piecewise linear in time, down to `end_mps`.

    Counted backwards from its end, the deceleration begins with `decels_mps2[0]`. It rises to each
    next value at the rate of `eases_mps3` and keeps the last one. All results have a closed form.
    """

    __slots__ = ("_pieces", "end_mps", "steady_decel_mps2")

    def __init__(
        self, end_mps: float, decels_mps2: Sequence[float], eases_mps3: Sequence[float]
    ) -> None:
        assert len(eases_mps3) == len(decels_mps2) - 1
        assert min(decels_mps2) > 0.0
        self.end_mps = end_mps
        self.steady_decel_mps2 = decels_mps2[-1]
        time_s, speed_mps, distance_m = 0.0, end_mps, 0.0
        pieces: list[_Piece] = []
        for index, ease_mps3 in enumerate(eases_mps3):
            decel_mps2, next_mps2 = decels_mps2[index], decels_mps2[index + 1]
            if next_mps2 <= decel_mps2:
                continue
            pieces.append(_Piece(time_s, speed_mps, distance_m, decel_mps2, ease_mps3))
            t_s = (next_mps2 - decel_mps2) / ease_mps3
            distance_m += (
                speed_mps * t_s + decel_mps2 * t_s * t_s / 2.0 + ease_mps3 * t_s * t_s * t_s / 6.0
            )
            speed_mps += decel_mps2 * t_s + ease_mps3 * t_s * t_s / 2.0
            time_s += t_s
        pieces.append(_Piece(time_s, speed_mps, distance_m, decels_mps2[-1], 0.0))
        self._pieces = tuple(reversed(pieces))

    def at_speed(self, speed_mps: float) -> CurvePoint:
        """The point with this speed. Below the end speed: the end."""
        for piece in self._pieces:
            if speed_mps > piece.speed_mps:
                break
        start_s, start_mps, start_m, decel_mps2, ease_mps3 = piece
        rise_mps = max(0.0, speed_mps - start_mps)
        if ease_mps3 > 0.0:
            root_mps2 = math.sqrt(decel_mps2 * decel_mps2 + 2.0 * ease_mps3 * rise_mps)
            t_s = (root_mps2 - decel_mps2) / ease_mps3
        else:
            t_s = rise_mps / decel_mps2
        return CurvePoint(
            start_s + t_s,
            start_m + t_s * (start_mps + t_s * (decel_mps2 / 2.0 + t_s * ease_mps3 / 6.0)),
            decel_mps2 + ease_mps3 * t_s,
            ease_mps3,
        )


def stopping_curve(
    shape: Braking, *, steady_mps2: float, final_mps2: float
) -> ReferenceBrakingCurve:
    """Curve to a standstill: constant, eased to the plateau, then decreasing linearly to the last
    step.

    From speed v2 at the plateau b2 the linear decrease to bf takes 2 * v2 / (b2 + bf).
    """
    plateau_mps2 = min(max(shape.plateau_decel_mps2, final_mps2), steady_mps2)
    fall_mps2 = plateau_mps2 - final_mps2
    ease_mps3 = fall_mps2 * (plateau_mps2 + final_mps2) / (2.0 * shape.plateau_speed_mps)
    return ReferenceBrakingCurve(
        0.0,
        (min(final_mps2, steady_mps2), plateau_mps2, steady_mps2),
        (max(ease_mps3, 1e-6), shape.ease_jerk_mps3),
    )


def curve_to_stop(
    config: AtoConfig,
    line: LineMap,
    at_m: float,
    *,
    gain_ratio: float | None = None,
    late_friction: bool = False,
) -> ReferenceBrakingCurve:
    """Braking curve to a stop.

    Uphill traction carries the train through the last metres, so the last step is that of level
    track. Notches of traction are too coarse for this: the last step then is larger by the
    gradient.
    """
    shape = late_shape(config.braking) if late_friction else config.braking
    steady_mps2 = steady_decel_mps2(config, line, at_m, gain_ratio)
    final_mps2 = shape.final_decel_mps2
    if config.output.stage == "notches":
        final_mps2 += max(0.0, gradient.decel_at_mps2(config, line, at_m))
    return stopping_curve(shape, steady_mps2=steady_mps2, final_mps2=final_mps2)


def late_shape(shape: Braking) -> Braking:
    """Shape of the braking of a train with late friction."""
    return replace(
        shape,
        plateau_decel_mps2=shape.late_plateau_decel_mps2,
        plateau_speed_mps=shape.late_plateau_speed_mps,
        final_decel_mps2=shape.late_final_decel_mps2,
    )


def curve_to_authority(
    config: AtoConfig, line: LineMap, at_m: float, *, gain_ratio: float | None = None
) -> ReferenceBrakingCurve:
    """Curve to a standstill before the end of authority, below protection's own curve.

    `gain_ratio` is as for `steady_decel_mps2`.
    """
    shape = config.authority
    steady_mps2 = min(shape.decel_mps2, steady_decel_mps2(config, line, at_m, gain_ratio))
    uphill_mps2 = max(0.0, gradient.decel_at_mps2(config, line, at_m))
    final_mps2 = min(shape.final_decel_mps2 + uphill_mps2, steady_mps2)
    knee_mps2 = min(max(shape.knee_decel_mps2, final_mps2), steady_mps2)
    return ReferenceBrakingCurve(
        0.0, (final_mps2, knee_mps2, steady_mps2), (shape.creep_ease_mps3, shape.ease_mps3)
    )


def slowing_curve(shape: Braking, *, end_mps: float, steady_mps2: float) -> ReferenceBrakingCurve:
    """Curve to a lower limit: constant, then eased off."""
    return ReferenceBrakingCurve(
        end_mps, (min(shape.final_decel_mps2, steady_mps2), steady_mps2), (shape.ease_jerk_mps3,)
    )


def steady_decel_mps2(
    config: AtoConfig, line: LineMap, at_m: float, gain_ratio: float | None = None
) -> float:
    """Deceleration to plan towards `at_m`, within the limit of the demand.

    It is lower where the track falls or the brake is weak. The function considers the whole braking
    from the speed limit there.

    Args:
        gain_ratio: least relative deviation of the brake gain. The law then raises the demand of a
            weak brake beyond the comfort limit. None: unknown, and the demand keeps the limit.
    """
    shape = config.braking
    top_mps = line.limit_mps(at_m - 1.0)
    reach_m = top_mps * top_mps / (2.0 * shape.decel_mps2) + 2.0 * top_mps
    worst_permille = min(0.0, line.worst_gradient_permille(at_m - reach_m, at_m))
    falling_mps2 = -gradient.decel_on_mps2(config, worst_permille)
    weak_ratio = shape.weak_ratio if gain_ratio is None else gain_ratio
    limits, weak_ratio = config.limits, min(0.0, weak_ratio)
    if gain_ratio is None:
        demand_most_mps2 = limits.brake_most_mps2(falling_mps2)
    else:
        demand_most_mps2 = limits.brake_demand_max_mps2
    # A demand beyond the comfort limit is planned for a still weaker brake. A train that needs more
    # than the greatest demand would not stop.
    most_mps2 = max(
        limits.accel_mps2 * (1.0 + weak_ratio),
        min(
            limits.accel_mps2 + falling_mps2,
            demand_most_mps2 * (1.0 + STEEP_WEAK_FACTOR * weak_ratio),
        ),
    )
    room_mps2 = most_mps2 - shape.reserve_mps2 - falling_mps2
    return max(LEAST_DECEL_MPS2, min(shape.decel_mps2, room_mps2))


def peak_speed_mps(
    from_mps: float,
    distance_m: float,
    curve: ReferenceBrakingCurve,
    *,
    accel_mps2: float,
    jerk_mps3: float,
    change_over_s: float,
    limit_mps: float,
) -> float:
    """The highest speed up to `limit_mps` that is worth reaching before `curve` ends in
    `distance_m`.

    The train accelerates trapezoidally, runs on for `change_over_s`, builds the brake up at the
    jerk limit and follows the curve. If even the present speed is too high, it is the result.
    """

    def needed_m(peak_mps: float) -> float:
        rise_m = trapezoid.ramp_m(from_mps, peak_mps, accel_mps2=accel_mps2, jerk_mps3=jerk_mps3)
        after_mps, build_up_m = trapezoid.swing(
            peak_mps, from_mps2=0.0, to_mps2=-curve.steady_decel_mps2, jerk_mps3=jerk_mps3
        )
        braking_m = curve.at_speed(max(0.0, after_mps)).distance_m
        return rise_m + peak_mps * change_over_s + max(0.0, build_up_m) + braking_m

    if limit_mps <= from_mps or needed_m(limit_mps) <= distance_m:
        return limit_mps
    low_mps, high_mps = from_mps, limit_mps
    for _ in range(SEARCH_STEPS):
        middle_mps = (low_mps + high_mps) / 2.0
        if needed_m(middle_mps) <= distance_m:
            low_mps = middle_mps
        else:
            high_mps = middle_mps
    return low_mps


@dataclass(frozen=True, slots=True)
class LowerLimit:
    """A place ahead where the speed limit becomes lower."""

    at_m: float
    curve: ReferenceBrakingCurve


class SpeedLimits:
    """Civil limits for a train: lowered at its front, released behind its rear."""

    __slots__ = ("_line", "_lowerings", "_starts_m", "_train_length_m")

    def __init__(self, config: AtoConfig, line: LineMap) -> None:
        self._line = line
        self._train_length_m = config.train_length_m
        lowerings: list[LowerLimit] = []
        for before, after in itertools.pairwise(line.speed_sections):
            if after.limit_mps >= before.limit_mps:
                continue
            steady_mps2 = steady_decel_mps2(config, line, after.start_m)
            end_mps = max(0.0, after.limit_mps - config.speed.margin_mps)
            curve = slowing_curve(config.braking, end_mps=end_mps, steady_mps2=steady_mps2)
            lowerings.append(LowerLimit(after.start_m, curve))
        self._lowerings = tuple(lowerings)
        self._starts_m = tuple(lowering.at_m for lowering in lowerings)

    def under_train_mps(self, front_m: float) -> float:
        return self._line.least_limit_mps(front_m - self._train_length_m, front_m)

    def next_lowering(self, front_m: float) -> int:
        """Index of the first lowering beyond the front, for `lowering`."""
        return bisect_right(self._starts_m, front_m)

    def lowering(self, index: int) -> LowerLimit | None:
        return self._lowerings[index] if index < len(self._lowerings) else None
