"""Assumed deceleration by gradients, positive uphill, and by running resistance."""

from firmware_py.trackdb import LineMap
from vobc import kinematics
from vobc.ato.settings.ato import AtoConfig


def decel_on_mps2(config: AtoConfig, gradient_permille: float) -> float:
    return -kinematics.gradient_accel_mps2(
        gradient_permille, rotating_mass_ratio=config.rotating_mass_percent / 100.0
    )


def decel_at_mps2(config: AtoConfig, line: LineMap, front_m: float) -> float:
    """Mean over the length of a train with its front there."""
    gradient_permille = line.mean_gradient_permille(front_m - config.train_length_m, front_m)
    return decel_on_mps2(config, gradient_permille)


def resistance_mps2(config: AtoConfig, speed_mps: float, air_ratio: float = 1.0) -> float:
    """Deceleration by the running resistance. n N per kN act like a gradient of n ‰ uphill.

    Args:
        air_ratio: air drag, divided by that in the open.
    """
    if speed_mps <= 0.0:
        return 0.0
    return decel_on_mps2(config, config.resistance.n_per_kn(speed_mps, air_ratio))
