"""The safe braking model of IEEE 1474.1: what a train may do before it stops if all goes wrong.

Four phases follow each other from the moment at which the speed is measured too high:

1. runaway: traction gives the most it can until it is cut (sensing, two cycles, the cut itself);
2. build-up: neither traction nor brake;
3. braking at the guaranteed emergency brake rate (GEBR), which lasts until the target.

The measurement of the speed is the phase before them: the caller hands in its upper bound. In each
phase the fall of the track comes on top, unreduced by rotating masses; a climb is no merit. Which
fall that is on a changing track says `profile`; here it is one and the same.

The eight safe braking distances that are published for 20, 40, 60 and 80 km/h, level and -30 per
mille (41/58, 107/151, 204/288 and 333/468 m), are this model from a speed that is 8 km/h higher:
without those 8 km/h no reaction fits all of them. With a runaway of 0.9 m/s2 for 0.3 s, a build-up
of 0.75 s and a GEBR of 1.0 m/s2 all eight come out within 2 m. The shipped parameters reckon with
more (1.0 m/s2 for 0.48 s, 1.05 s), so each of their distances is longer.
"""

import math
from dataclasses import dataclass
from typing import Final

from vobc.kinematics import gradient_accel_mps2

LEAST_DECEL_MPS2: Final = 0.05
"""Where a fall leaves less of the guaranteed brake rate no train may run."""


@dataclass(frozen=True, slots=True)
class SafeBraking:
    """What protection reckons with after it has commanded the emergency brake (IEEE 1474.1)."""

    guaranteed_decel_mps2: float
    runaway_mps2: float
    runaway_s: float
    """Until traction is cut: sensing, deciding, telling and switching together."""
    build_up_s: float
    """From there on neither traction nor brake."""

    def __post_init__(self) -> None:
        assert self.guaranteed_decel_mps2 > 0.0
        assert min(self.runaway_mps2, self.runaway_s, self.build_up_s) >= 0.0

    def on(self, gradient_permille: float) -> "BrakingCurve":
        """The curve for a stretch of one gradient; raises ValueError as `falling` does."""
        return self.falling(fall_of_mps2(gradient_permille))

    def falling(self, fall_mps2: float) -> "BrakingCurve":
        """The curve for a stretch of one fall. Raises ValueError where the brake cannot hold."""
        if self.guaranteed_decel_mps2 - fall_mps2 < LEAST_DECEL_MPS2:
            raise ValueError(
                f"guaranteed_decel_mps2 {self.guaranteed_decel_mps2} does not hold a train where "
                f"the fall takes {fall_mps2:.3f} m/s2 of it"
            )
        runaway_gain_mps = (self.runaway_mps2 + fall_mps2) * self.runaway_s
        coasting_gain_mps = fall_mps2 * self.build_up_s
        return BrakingCurve(
            decel_mps2=self.guaranteed_decel_mps2 - fall_mps2,
            reaction_s=self.runaway_s + self.build_up_s,
            gain_mps=runaway_gain_mps + coasting_gain_mps,
            gain_m=runaway_gain_mps * (0.5 * self.runaway_s + self.build_up_s)
            + 0.5 * coasting_gain_mps * self.build_up_s,
        )


def fall_of_mps2(gradient_permille: float) -> float:
    """What a falling track adds to the acceleration; 0 on the level and on a climb."""
    return max(0.0, gradient_accel_mps2(gradient_permille))


@dataclass(frozen=True, slots=True)
class BrakingCurve:
    """Speed over distance of a train that does the worst before it brakes.

    From the speed v it runs on at v for a lead, then reacts for `reaction_s`, in which traction and
    gradient make it faster by `gain_mps` (traction until it is cut, gradient until the brake has
    built up), and loses `decel_mps2` from then on.
    """

    decel_mps2: float
    reaction_s: float
    gain_mps: float
    gain_m: float
    """Way in the reaction time beyond v * reaction_s."""

    def speed_mps(self, distance_m: float, *, target_mps: float, lead_s: float = 0.0) -> float:
        """Highest speed v from which the train is down to `target_mps` after `distance_m`.

        With w = gain_mps, k = gain_m and T = lead_s + reaction_s it needs

            d = v * T + k + ((v + w)**2 - v_target**2) / (2 * a)

        and the positive root of that is the answer. The target is the least value returned: a train
        that is slower needs no brake.
        """
        # In u = v + w: u**2 + 2*b*u = v_target**2 + 2*a*(d - k + w*T) with b = a*T.
        time_s = lead_s + self.reaction_s
        lost_mps = self.decel_mps2 * time_s
        reach_m = distance_m - self.gain_m + self.gain_mps * time_s
        square = lost_mps * lost_mps + target_mps * target_mps + 2.0 * self.decel_mps2 * reach_m
        return max(target_mps, math.sqrt(max(0.0, square)) - lost_mps - self.gain_mps)

    def stopping_m(self, speed_mps: float, *, lead_s: float = 0.0) -> float:
        """Way to standstill: d as above, without a target."""
        bites_mps = speed_mps + self.gain_mps
        braked_m = bites_mps * bites_mps / (2.0 * self.decel_mps2)
        return speed_mps * (lead_s + self.reaction_s) + self.gain_m + braked_m
