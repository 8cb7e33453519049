"""Deceleration by gradients as the operation believes its train feels them; positive uphill."""

from firmware_py.trackdb import LineMap
from vobc import kinematics
from vobc.ato.config import AtoConfig


def decel_on_mps2(config: AtoConfig, gradient_permille: float) -> float:
    return -kinematics.gradient_accel_mps2(
        gradient_permille, rotating_mass_ratio=config.rotating_mass_percent / 100.0
    )


def decel_at_mps2(config: AtoConfig, line: LineMap, front_m: float) -> float:
    """Mean under a train with its front there."""
    gradient_permille = line.mean_gradient_permille(front_m - config.train_length_m, front_m)
    return decel_on_mps2(config, gradient_permille)
