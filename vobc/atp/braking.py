"""The safe braking model: how fast a train may run and still stop when everything goes wrong."""

import math
from dataclasses import dataclass

GRAVITY_MPS2 = 9.81
LEAST_DECEL_MPS2 = 0.05
"""On a track too steep for the guaranteed brake rate the curves become flat, not undefined."""


@dataclass(frozen=True, slots=True)
class SafeBraking:
    """What protection reckons with after it has commanded the emergency brake (IEEE 1474.1)."""

    guaranteed_decel_mps2: float
    runaway_mps2: float
    runaway_s: float
    """Until traction is cut: sensing, deciding, telling and switching together."""
    build_up_s: float
    """From there on neither traction nor brake."""

    def speed_mps(
        self,
        distance_m: float,
        *,
        target_mps: float,
        gradient_permille: float,
        margin_s: float = 0.0,
    ) -> float:
        """Highest speed from which the train is down to `target_mps` after `distance_m`.

        Args:
            gradient_permille: the lowest under the train on the way. Only its fall counts: a climb
                is no merit, and rotating masses, which dampen the fall, are not counted on either.
            margin_s: time for which the train runs on before anything happens.
        """
        fall_mps2 = max(0.0, -gradient_permille) * GRAVITY_MPS2 / 1000.0
        return worst_case_speed_mps(
            distance_m,
            decel_mps2=max(LEAST_DECEL_MPS2, self.guaranteed_decel_mps2 - fall_mps2),
            runaway_mps2=self.runaway_mps2 + fall_mps2,
            runaway_s=self.runaway_s,
            coasting_mps2=fall_mps2,
            coasting_s=self.build_up_s,
            target_mps=target_mps,
            margin_s=margin_s,
        )


def worst_case_speed_mps(
    distance_m: float,
    *,
    decel_mps2: float,
    runaway_mps2: float,
    runaway_s: float,
    coasting_mps2: float,
    coasting_s: float,
    target_mps: float = 0.0,
    margin_s: float = 0.0,
) -> float:
    """Highest speed v from which a train is down to `target_mps` after `distance_m`, when it

    1. runs on at v for `margin_s`,
    2. gains `runaway_mps2` for `runaway_s` (traction at full power until it is cut),
    3. gains `coasting_mps2` for `coasting_s` (downhill, until the brake has built up),
    4. loses `decel_mps2` from then on.

    With w the speed gained in 2 and 3, T = runaway_s + coasting_s and k the way that the gain alone
    adds in that time, it needs d = v * (margin_s + T) + k + ((v + w)**2 - v_target**2) / (2 * a).
    The positive root of that is the answer; the target is the least value returned, because a train
    that is slower needs no brake.
    """
    assert decel_mps2 > 0.0
    assert min(runaway_mps2, coasting_mps2, runaway_s, coasting_s, margin_s) >= 0.0
    assert target_mps >= 0.0
    runaway_gain_mps = runaway_mps2 * runaway_s
    gain_mps = runaway_gain_mps + coasting_mps2 * coasting_s
    gained_m = runaway_gain_mps * (0.5 * runaway_s + coasting_s)
    gained_m += 0.5 * coasting_mps2 * coasting_s * coasting_s
    # In u = v + w: u**2 + 2*b*u = v_target**2 + 2*a*(d - k + w*(margin + T)), b = a*(margin + T).
    run_on_s = margin_s + runaway_s + coasting_s
    lost_mps = decel_mps2 * run_on_s
    reach_m = distance_m - gained_m + gain_mps * run_on_s
    square = lost_mps * lost_mps + target_mps * target_mps + 2.0 * decel_mps2 * reach_m
    if square <= 0.0:
        return target_mps
    return max(target_mps, math.sqrt(square) - lost_mps - gain_mps)
