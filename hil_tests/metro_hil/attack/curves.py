"""Attacks on the braking curves: what protection permits, against the worst declared motion.

The four limits of a situation come from the shipped protection. A train at a limit must then reach
each lower limit ahead slowly enough, and stop before the end of its authority, wherever its front
is in the interval.
"""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Final

from metro_hil.attack.oracle import DeclaredMotion, FallsUnder, follow
from metro_hil.attack.situations import AttackSituation, situation
from vobc.atp.braking import SafeBraking
from vobc.atp.ceiling import CeilingMap
from vobc.atp.energy_check import EnergyCheck

CYCLE_S: Final = 0.05
BELOW_MPS: Final = 1e-9
"""A speed at a limit counts as over it. The tried speed is this much below."""
TOLERANCE_MPS: Final = 1e-5
"""Rounding of a curve and of the motion over a kilometre of short sections."""
TOLERANCE_M: Final = 1e-4
NAMES: Final = ("permitted", "warning", "service", "emergency")
HALVED_TO_MPS: Final = 1e-6
FRONTS_RATIO: Final = (1.0, 0.0, 0.5)
"""Tried fronts, as shares of the interval from its low end."""


@dataclass(frozen=True, slots=True)
class CurveFinding:
    """Outcome of one situation."""

    seed: int
    problem: str
    """Empty: every limit is safe."""
    moves: bool
    """The situation permits a movement at all."""


def attack_curve(seed: int) -> CurveFinding:
    """Judge the limits of the situation of a seed."""
    attacked = situation(seed)
    judge = _Judge(attacked)
    atp = attacked.config.atp
    braking = SafeBraking(
        guaranteed_decel_mps2=atp.guaranteed_decel_mps2,
        runaway_mps2=atp.runaway_mps2,
        runaway_s=atp.runaway_s(CYCLE_S),
        build_up_s=atp.brake_build_up_s,
    )
    ceilings = CeilingMap(atp, braking, attacked.line, train_length_m=attacked.length_m)
    front, end_m = attacked.front_m, attacked.authority_end_m
    ceiling = ceilings.at(front, end_m, attacked.restrictions)
    check = EnergyCheck(atp, attacked.line, train_length_m=attacked.length_m, cycle_s=CYCLE_S)
    passed_mps = _passed_mps(
        lambda mps: not check.exceeded(front, mps, end_m, attacked.restrictions),
        ceiling.emergency_mps + atp.replica_band_mps,
    )
    limits_mps = [
        ceiling.permitted_mps,
        ceiling.warning_mps,
        ceiling.service_mps,
        ceiling.emergency_mps,
    ]
    problem = next(judge.problems(limits_mps), "")
    if not problem and passed_mps is not None:
        problem = judge.second_alone(passed_mps)
    return CurveFinding(seed, problem and f"{problem}; {attacked.text()}", limits_mps[3] > 0.0)


def _passed_mps(passes: Callable[[float], bool], most_mps: float) -> float | None:
    """The greatest speed up to `most_mps` that the second computation lets pass; None: not even 0.

    It has no limit of its own to ask for, so its limit is found by halving.
    """
    if passes(most_mps):
        return most_mps
    low_mps, high_mps = 0.0, most_mps
    while high_mps - low_mps > HALVED_TO_MPS:
        middle_mps = 0.5 * (low_mps + high_mps)
        if passes(middle_mps):
            low_mps = middle_mps
        else:
            high_mps = middle_mps
    return low_mps if passes(low_mps) else None


class _Judge:
    """Follows the worst motion of one situation from any speed."""

    def __init__(self, attacked: AttackSituation) -> None:
        atp = self._atp = attacked.config.atp
        self._attacked = attacked
        self._declared = DeclaredMotion(
            runaway_mps2=atp.runaway_mps2,
            # Sensing, the cycle that decides and those that may be missed, and cutting traction.
            runaway_s=atp.sensing_s + (1 + atp.overruns_max) * CYCLE_S + atp.traction_cut_s,
            build_up_s=atp.brake_build_up_s,
            brake_mps2=atp.guaranteed_decel_mps2,
        )
        gradients = [(g.start_m, g.end_m, g.gradient_permille) for g in attacked.line.gradients]
        self._falls = FallsUnder(gradients, attacked.length_m)
        self._limits = _limits(attacked)

    def problems(self, limits_mps: Sequence[float]) -> Iterator[str]:
        """Every problem of the four limits. The order of the limits is checked first."""
        atp = self._atp
        if not 0.0 <= limits_mps[0] <= limits_mps[1] <= limits_mps[2] <= limits_mps[3] < math.inf:
            yield f"the limits are not in order: {limits_mps}"
        margins_mps = (
            *(0.0, atp.warning_margin_mps),
            *(atp.service_margin_mps, atp.emergency_margin_mps),
        )
        warning_s = atp.service_lead_s + atp.warning_lead_s
        leads_s = (warning_s + atp.permitted_lead_s, warning_s, atp.service_lead_s, 0.0)
        for name, limit_mps, margin_mps, lead_s in zip(
            NAMES, limits_mps, margins_mps, leads_s, strict=True
        ):
            if limit_mps > 0.0:
                for text in self._unsafe(limit_mps - BELOW_MPS, margin_mps, lead_s):
                    yield f"{name} limit {limit_mps:.4f} m/s: {text}"

    def second_alone(self, speed_mps: float) -> str:
        """How the greatest speed that the energy check alone lets pass is unsafe."""
        text = next(self._unsafe(speed_mps, self._atp.emergency_margin_mps, 0.0), "")
        return text and f"energy check alone at {speed_mps:.4f} m/s: {text}"

    def _unsafe(self, speed_mps: float, margin_mps: float, lead_s: float) -> Iterator[str]:
        """How the worst motion from this speed breaks a limit or the authority."""
        interval, end_m = self._attacked.front_m, self._attacked.authority_end_m
        width_m = interval.high - interval.low
        for front_m in dict.fromkeys(interval.low + ratio * width_m for ratio in FRONTS_RATIO):
            rear_m = front_m - self._attacked.length_m
            for start_m, to_m, limit_mps in self._limits:
                if start_m <= front_m and rear_m < to_m and speed_mps > limit_mps + margin_mps:
                    yield f"the limit under the train is {limit_mps:.4f} m/s"
            lower = sorted(
                (start_m, limit_mps + margin_mps)
                for start_m, _, limit_mps in self._limits
                if start_m > front_m and limit_mps + margin_mps < speed_mps
            )
            motion = follow(
                self._falls,
                self._declared,
                front_m,
                speed_mps,
                places_m=[at_m for at_m, _ in lower],
                lead_s=lead_s,
            )
            over_m = motion.stop_m - end_m
            if not over_m < TOLERANCE_M:
                yield f"from {front_m:.3f} m the train stops {over_m:.3f} m past the end"
            for (at_m, most_mps), mps in zip(lower, motion.arrivals_mps, strict=True):
                if mps is not None and mps > most_mps + TOLERANCE_MPS:
                    yield f"at {at_m:.3f} m the train has {mps:.4f} of {most_mps:.4f} m/s"


def _limits(attacked: AttackSituation) -> list[tuple[float, float, float]]:
    """Line limits and restrictions. The first and the last line limit hold beyond the line."""
    line = [(s.start_m, s.end_m, s.limit_mps) for s in attacked.line.speed_sections]
    line[0] = (-math.inf, *line[0][1:])
    line[-1] = (line[-1][0], math.inf, line[-1][2])
    return line + [(r.start_m, r.end_m, r.limit_mps) for r in attacked.restrictions]
