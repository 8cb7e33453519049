"""The safe braking model of IEEE 1474.1: the worst motion of a train until it stops.

After the speed is measured too high, three phases follow:

1. runaway: traction gives its maximum until it is cut (sensing, two cycles, the cut itself); 2.
build-up: neither traction nor brake; 3. braking at the guaranteed emergency brake rate (GEBR) until
the target.

The measurement of the speed comes before them: the caller passes its upper bound. In each phase a
downhill gradient adds its full acceleration, not reduced by rotating masses. An uphill gradient
counts as level. Here the gradient is constant; `profile` handles changing gradients.

Eight safe braking distances are published for 20, 40, 60 and 80 km/h, on level track and at -30 per
mille (41/58, 107/151, 204/288 and 333/468 m). This model gives them for a speed 8 km/h higher;
without the 8 km/h no reaction time fits all of them. With a runaway of 0.9 m/s2 for 0.3 s, a
build-up of 0.75 s and a GEBR of 1.0 m/s2 all eight agree within 2 m. The shipped parameters assume
more (1.0 m/s2 for 0.48 s, 1.05 s), so each of their distances is longer.
"""

import math
from dataclasses import dataclass
from typing import Final

from vobc.kinematics import gradient_accel_mps2

LEAST_DECEL_MPS2: Final = 0.05
"""Least deceleration that must remain on a downhill gradient. Otherwise no train may run there."""


@dataclass(frozen=True, slots=True)
class SafeBraking:
    """Worst-case assumptions about the train after an emergency brake command (IEEE 1474.1)."""

    guaranteed_decel_mps2: float
    runaway_mps2: float
    runaway_s: float
    """Time until traction is cut: sensing, deciding, commanding and switching together."""
    build_up_s: float
    """Time after that with neither traction nor brake."""

    def __post_init__(self) -> None:
        assert self.guaranteed_decel_mps2 > 0.0
        assert min(self.runaway_mps2, self.runaway_s, self.build_up_s) >= 0.0

    def on(self, gradient_permille: float) -> "BrakingCurve":
        """Curve for a constant gradient. Raises ValueError like `falling`."""
        return self.falling(fall_of_mps2(gradient_permille))

    def falling(self, fall_mps2: float) -> "BrakingCurve":
        """Curve for a constant downhill acceleration.

        Raises ValueError if the brake cannot hold the train.
        """
        if self.guaranteed_decel_mps2 - fall_mps2 < LEAST_DECEL_MPS2:
            raise ValueError(
                f"guaranteed_decel_mps2 {self.guaranteed_decel_mps2} does not hold a train where "
                f"the gradient takes {fall_mps2:.3f} m/s2 of it"
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
    """Acceleration by a downhill gradient. It is 0 on level track and uphill."""
    return max(0.0, gradient_accel_mps2(gradient_permille))


@dataclass(frozen=True, slots=True)
class BrakingCurve:
    """Speed over distance for the worst motion before braking.

    The train runs on at speed v for a lead. It then reacts for `reaction_s`, in which traction and
    gradient add `gain_mps`. Traction acts until it is cut, the gradient until the brake has built
    up. From then on the train decelerates by `decel_mps2`.
    """

    decel_mps2: float
    reaction_s: float
    gain_mps: float
    gain_m: float
    """Distance in the reaction time beyond v * reaction_s."""

    def speed_mps(self, distance_m: float, *, target_mps: float, lead_s: float = 0.0) -> float:
        """Highest speed v from which the train slows to `target_mps` within `distance_m`.

        With w = gain_mps, k = gain_m and T = lead_s + reaction_s the distance is

            d = v * T + k + ((v + w)**2 - v_target**2) / (2 * a)

        The result is the positive root. It is never less than the target, because a slower train
        needs no brake.
        """
        # In u = v + w: u**2 + 2*b*u = v_target**2 + 2*a*(d - k + w*T) with b = a*T.
        time_s = lead_s + self.reaction_s
        lost_mps = self.decel_mps2 * time_s
        reach_m = distance_m - self.gain_m + self.gain_mps * time_s
        square = lost_mps * lost_mps + target_mps * target_mps + 2.0 * self.decel_mps2 * reach_m
        return max(target_mps, math.sqrt(max(0.0, square)) - lost_mps - self.gain_mps)

    def stopping_m(self, speed_mps: float, *, lead_s: float = 0.0) -> float:
        """Distance to standstill: d of `speed_mps` without a target."""
        bites_mps = speed_mps + self.gain_mps
        braked_m = bites_mps * bites_mps / (2.0 * self.decel_mps2)
        return speed_mps * (lead_s + self.reaction_s) + self.gain_m + braked_m
