"""The safe braking model on changing gradients, exact from section to section.

Assumption: at each place the steepest downhill section under any part of the train acts. The
computation follows the foremost front of the front interval. The train extends back from it by its
length and by the width of the interval. Any other front of the interval therefore meets at most the
same gradient at its own place.

This is the worst motion. The acceleration never grows from phase to phase. A train that starts
slower or farther back reaches each place later, in the same phase or a later one. It meets no
steeper gradient and is never faster there.
"""

import itertools
import math
from bisect import bisect_right
from typing import Final

from firmware_py.trackdb import LineMap
from vobc.atp.braking import SafeBraking, fall_of_mps2

CLOSE_MPS: Final = 1e-6
"""Accuracy of a speed found by iteration. It is below the exact speed by at most this, and never
above."""
BEYOND_MPS: Final = 0.25 * CLOSE_MPS


class BrakingProfile:
    """Braking curves of one train on one line, for one distance back from the foremost front.

    Section i of the profile ends at its edge i and has the downhill acceleration `falls_mps2[i]`.
    The last edge is at infinity. A braking train loses of v**2 / 2 exactly the increase of
    `work_j_per_kg`. This increase is GEBR minus downhill acceleration per metre, so it is exact
    over any number of sections.
    """

    def __init__(self, braking: SafeBraking, line: LineMap, *, under_m: float) -> None:
        """Compute the sections. Raises ValueError if the line is too steep downhill.

        Args:
            under_m: distance back from the foremost front.
        """
        self._braking = braking
        self._edges_m, self._falls_mps2 = _worst_falls(line, under_m)
        self._curves = [braking.falling(fall_mps2) for fall_mps2 in self._falls_mps2]
        self._reaction_s = braking.runaway_s + braking.build_up_s
        works = [0.0]
        for (start_m, end_m), curve in zip(
            itertools.pairwise(self._edges_m[:-1]), self._curves[1:], strict=False
        ):
            works.append(works[-1] + (end_m - start_m) * curve.decel_mps2)
        self._work_at_edges = works

    def work_j_per_kg(self, at_m: float) -> float:
        """Energy per mass that the guaranteed brake has absorbed up to here, from a fixed place."""
        index = bisect_right(self._edges_m, at_m)
        edge = index - 1 if index else 0
        run_m = at_m - self._edges_m[edge]
        return self._work_at_edges[edge] + run_m * self._curves[index].decel_mps2

    def speed_mps(
        self,
        front_m: float,
        target_j_per_kg: float,
        *,
        target_mps: float,
        lead_s: float,
        below_mps: float,
    ) -> float:
        """Highest speed here from which the train slows to `target_mps` at the target.

        Args:
            front_m: the foremost front, before the target.
            target_j_per_kg: the work at the target.
            target_mps: also the least result, because a slower train needs no brake.
            lead_s: time at constant speed before the first phase.
            below_mps: the greatest result. Higher speeds are of no interest.
        """
        if target_mps >= below_mps:
            return below_mps
        index = bisect_right(self._edges_m, front_m)
        curve = self._curves[index]
        # Within one section the curve has a closed form. The rest is expressed as the distance that
        # takes the same work if the section went on.
        distance_m = (target_j_per_kg - self.work_j_per_kg(front_m)) / curve.decel_mps2
        speed_mps = curve.speed_mps(distance_m, target_mps=target_mps, lead_s=lead_s)
        begins_m = front_m + speed_mps * (lead_s + curve.reaction_s) + curve.gain_m
        if begins_m <= self._edges_m[index]:
            return min(speed_mps, below_mps)
        allowed = target_mps * target_mps + 2.0 * target_j_per_kg
        return self._across(
            front_m, allowed, lead_s, guess_mps=speed_mps, low_mps=target_mps, high_mps=below_mps
        )

    def _across(
        self,
        front_m: float,
        allowed: float,
        lead_s: float,
        *,
        guess_mps: float,
        low_mps: float,
        high_mps: float,
    ) -> float:
        """The same where the gradient changes before the brake acts, by iteration from both sides.

        When the brake begins to act, v**2 + 2 * work may be at most `allowed`. It grows with the
        present speed, so the root is unique.
        """
        if self._excess(front_m, high_mps, lead_s, allowed)[0] <= 0.0:
            return high_mps
        if self._excess(front_m, low_mps, lead_s, allowed)[0] >= 0.0:
            return low_mps
        speed_mps = guess_mps
        while high_mps - low_mps > CLOSE_MPS:
            if not low_mps < speed_mps < high_mps:
                speed_mps = 0.5 * (low_mps + high_mps)
            excess, slope = self._excess(front_m, speed_mps, lead_s, allowed)
            # Newton's step to the root, and a little beyond it, so that the other side closes in.
            if excess > 0.0:
                high_mps = speed_mps
                speed_mps -= excess / slope + BEYOND_MPS
            else:
                low_mps = speed_mps
                speed_mps -= excess / slope - BEYOND_MPS
        return low_mps

    def _excess(
        self, front_m: float, speed_mps: float, lead_s: float, allowed: float
    ) -> tuple[float, float]:
        """Excess over `allowed` when the brake begins to act, and its approximate slope."""
        braking = self._braking
        at_m, now_mps = front_m + speed_mps * lead_s, speed_mps
        at_m, now_mps = self._run_on(at_m, now_mps, braking.runaway_mps2, braking.runaway_s)
        at_m, now_mps = self._run_on(at_m, now_mps, 0.0, braking.build_up_s)
        excess = now_mps * now_mps + 2.0 * self.work_j_per_kg(at_m) - allowed
        decel_mps2 = self._curves[bisect_right(self._edges_m, at_m)].decel_mps2
        return excess, 2.0 * (now_mps + decel_mps2 * (lead_s + self._reaction_s))

    def _run_on(
        self, at_m: float, speed_mps: float, push_mps2: float, left_s: float
    ) -> tuple[float, float]:
        """Place and speed after a time in which only `push_mps2` and the gradient act."""
        index = bisect_right(self._edges_m, at_m)
        while True:
            accel_mps2 = push_mps2 + self._falls_mps2[index]
            way_m = (speed_mps + 0.5 * accel_mps2 * left_s) * left_s
            room_m = self._edges_m[index] - at_m
            if way_m <= room_m:
                return at_m + way_m, speed_mps + accel_mps2 * left_s
            at_edge_mps = math.sqrt(speed_mps * speed_mps + 2.0 * accel_mps2 * room_m)
            left_s -= 2.0 * room_m / (speed_mps + at_edge_mps)
            at_m, speed_mps = self._edges_m[index], at_edge_mps
            index += 1


def _worst_falls(line: LineMap, under_m: float) -> tuple[list[float], list[float]]:
    """Edges, the last at infinity, and the downhill acceleration before each.

    Before its start a line is level.
    """
    changes_m = {section.start_m for section in line.gradients}
    changes_m |= {section.end_m + under_m for section in line.gradients}
    edges_m = [line.start_m]
    falls_mps2 = [0.0, _worst_fall_mps2(line, line.start_m, under_m)]
    for at_m in sorted(changes_m):
        fall_mps2 = _worst_fall_mps2(line, at_m, under_m)
        if fall_mps2 != falls_mps2[-1]:
            edges_m.append(at_m)
            falls_mps2.append(fall_mps2)
    return [*edges_m, math.inf], falls_mps2


def _worst_fall_mps2(line: LineMap, at_m: float, under_m: float) -> float:
    """Steepest downhill acceleration under a train from its front here to `under_m` behind."""
    falls_mps2 = [
        fall_of_mps2(section.gradient_permille)
        for section in line.gradients
        if section.start_m <= at_m < section.end_m + under_m
    ]
    return max(falls_mps2, default=0.0)
