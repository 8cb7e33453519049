"""The worst motion that the safe braking model declares, integrated in small time steps.

It is an independent reference for braking curves. It uses no formula of the controller: gradients
come from the line's sections, and the motion is summed step by step.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Final

from firmware_py.trackdb import GradientSection, LineMap, SpeedSection, Station
from vobc.atp.braking import SafeBraking
from vobc.atp.ceiling import CeilingMap
from vobc.atp.config import AtpConfig
from vobc.config import load_config
from vobc.vocabulary import Interval

CONFIG: Final = load_config("florence4").atp
CYCLE_S: Final = 0.05
LINE_END_M: Final = 6000.0
FAR_M: Final = 1e6
KMH: Final = 1.0 / 3.6
STEP_S: Final = 0.005
EDGE_S: Final = 1e-12
"""Precision with which a step ends at a change of gradient, s. A step meets at most one change,
because sections are longer."""
GRAVITY_MPS2: Final = 9.81

Section = tuple[float, float, float]
"""Start, end and value."""


@dataclass(frozen=True, slots=True)
class WorstCase:
    """Parameters of the motion that the safe braking model declares."""

    runaway_mps2: float
    runaway_s: float
    build_up_s: float
    guaranteed_decel_mps2: float

    @classmethod
    def of(cls, config: AtpConfig, cycle_s: float = CYCLE_S) -> "WorstCase":
        return cls(
            config.runaway_mps2,
            config.sensing_s + (1 + config.overruns_max) * cycle_s + config.traction_cut_s,
            config.brake_build_up_s,
            config.guaranteed_decel_mps2,
        )


def line_of(
    gradients: Sequence[Section] = (),
    speed_limits: Sequence[Section] = ((0.0, LINE_END_M, 25.0),),
) -> LineMap:
    return LineMap(
        "by chance",
        speed_limits[0][0],
        speed_limits[-1][1],
        (Station("A", 100.0, 20.0, 110.0),),
        tuple(SpeedSection(*limit) for limit in speed_limits),
        tuple(GradientSection(*gradient) for gradient in gradients),
    )


def sections(pieces: Iterable[tuple[float, float, float]]) -> tuple[Section, ...]:
    """Gradients from the start of a line on; each piece has gap before, length and per mille."""
    found: list[Section] = []
    at_m = 0.0
    for gap_m, run_m, gradient_permille in pieces:
        start_m, at_m = at_m + gap_m, at_m + gap_m + run_m
        if at_m > LINE_END_M:
            break
        found.append((start_m, at_m, gradient_permille))
    return tuple(found)


def limits(first_mps: float, changes: Iterable[tuple[float, float]]) -> tuple[Section, ...]:
    """Speed limits of the whole line from chainages and the limits from there on, in any order."""
    at = {0.0: first_mps} | {at_m: limit_mps for at_m, limit_mps in changes if at_m < LINE_END_M}
    starts_m = sorted(at)
    ends_m = [*starts_m[1:], LINE_END_M]
    return tuple(
        (start_m, end_m, at[start_m]) for start_m, end_m in zip(starts_m, ends_m, strict=True)
    )


def intervals(front_m: float, below_m: float, above_m: float) -> Interval:
    return Interval(front_m - below_m, front_m, front_m + above_m)


def ceilings(
    line: LineMap, *, length_m: float, config: AtpConfig = CONFIG, case: WorstCase | None = None
) -> CeilingMap:
    case = case or WorstCase.of(config)
    braking = SafeBraking(
        guaranteed_decel_mps2=case.guaranteed_decel_mps2,
        runaway_mps2=case.runaway_mps2,
        runaway_s=case.runaway_s,
        build_up_s=case.build_up_s,
    )
    return CeilingMap(config, braking, line, train_length_m=length_m)


def declared_reach_m(front_m: Interval, length_m: float) -> float:
    """Train length plus width of the interval, rounded up to the next multiple of the set step."""
    width_m = 0.0
    while width_m < front_m.high - front_m.low:
        width_m += CONFIG.interval_step_m
    return length_m + width_m


def declared_fall_mps2(line: LineMap, at_m: float, reach_m: float) -> float:
    """Acceleration by the steepest fall on which any part of the train may be, m/s²."""
    steepest_permille = 0.0
    for section in line.gradients:
        if section.start_m <= at_m and section.end_m > at_m - reach_m:
            steepest_permille = max(steepest_permille, -section.gradient_permille)
    return GRAVITY_MPS2 * steepest_permille / 1000.0


def worst_stop_m(
    line: LineMap,
    case: WorstCase,
    front_m: float,
    speed_mps: float,
    *,
    reach_m: float,
    target_mps: float = 0.0,
    lead_s: float = 0.0,
) -> float:
    """Distance of the declared motion until it reaches the target speed, in small steps, m.

    The acceleration is constant in a step, so the only error is rounding.
    """
    at_m = front_m + speed_mps * lead_s
    for push_mps2, lasts_s in (
        (case.runaway_mps2, case.runaway_s),
        (0.0, case.build_up_s),
    ):
        left_s = lasts_s
        while left_s > 0.0:
            accel_mps2 = push_mps2 + declared_fall_mps2(line, at_m, reach_m)
            step_s = min(left_s, _clear_step_s(line, at_m, speed_mps, accel_mps2, reach_m))
            at_m += (speed_mps + 0.5 * accel_mps2 * step_s) * step_s
            speed_mps += accel_mps2 * step_s
            left_s -= step_s
    while speed_mps > target_mps:
        decel_mps2 = case.guaranteed_decel_mps2 - declared_fall_mps2(line, at_m, reach_m)
        clear_s = _clear_step_s(line, at_m, speed_mps, -decel_mps2, reach_m)
        rest_s = (speed_mps - target_mps) / decel_mps2
        step_s = min(clear_s, rest_s)
        at_m += (speed_mps - 0.5 * decel_mps2 * step_s) * step_s
        speed_mps = target_mps if rest_s <= clear_s else speed_mps - decel_mps2 * step_s
    return at_m - front_m


def _clear_step_s(
    line: LineMap, at_m: float, speed_mps: float, accel_mps2: float, reach_m: float
) -> float:
    """Length of a step in which the gradient is constant, or that ends just beyond its change,
    s."""
    fall_mps2 = declared_fall_mps2(line, at_m, reach_m)

    def changed(step_s: float) -> bool:
        then_m = at_m + (speed_mps + 0.5 * accel_mps2 * step_s) * step_s
        return declared_fall_mps2(line, then_m, reach_m) != fall_mps2

    before_s, after_s = 0.0, STEP_S
    if not changed(after_s):
        return after_s
    while after_s - before_s > EDGE_S:
        middle_s = 0.5 * (before_s + after_s)
        if changed(middle_s):
            after_s = middle_s
        else:
            before_s = middle_s
    return after_s


def steps_blur_m(speed_mps: float) -> float:
    """Error bound for steps of STEP_S that meet each change of gradient up to one step late, m.

    A fall of 0.4 m/s² that comes one step late changes the speed by 2 mm/s. It changes the distance
    by less than that times the braking time. There are at most a dozen changes.
    """
    return 0.02 + 12 * 0.4 * STEP_S * (speed_mps + 2.0) / 0.55 * 0.2


def fastest_by_halving(
    limit_m: float, distance_of: Callable[[float], float], *, top_mps: float = 40.0
) -> float:
    """The highest speed from which the distance stays within the limit."""
    low_mps, high_mps = 0.0, top_mps
    while high_mps - low_mps > 1e-3:
        middle_mps = 0.5 * (low_mps + high_mps)
        if distance_of(middle_mps) <= limit_m:
            low_mps = middle_mps
        else:
            high_mps = middle_mps
    return low_mps
