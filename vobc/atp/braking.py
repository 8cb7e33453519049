"""The safe braking model: how fast a train may run and still stop when everything goes wrong."""

from dataclasses import dataclass
from typing import Final

from vobc.kinematics import gradient_accel_mps2, worst_case_speed_mps

LEAST_DECEL_MPS2: Final = 0.05
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
        fall_mps2 = max(0.0, gradient_accel_mps2(gradient_permille))
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
