"""Choice of a notch towards one reference, and how long the present one is kept ([Wu 2022])."""

from collections.abc import Sequence
from typing import NamedTuple

from vobc.ato.laws import catch_time
from vobc.ato.settings.chasing import ChasingScheme


class NotchTarget(NamedTuple):
    """One reference relative to the predicted train."""

    error_mps: float
    """Speed of the train minus that of the reference."""
    decel_mps2: float
    """Deceleration of the reference."""
    run_s: float
    """Time within which the train should reach the reference."""
    spare_m: float
    to_stop: bool = False


def picked(
    scheme: ChasingScheme,
    aim: NotchTarget,
    now_mps2: float,
    levels_mps2: Sequence[float],
    resistance_mps2: float,
    brake_ratio: float = 1.0,
) -> float:
    """Demand of the notch to take.

    Args:
        now_mps2: demand of the present notch.
        levels_mps2: demands to choose from, from the strongest traction to the strongest brake.
        resistance_mps2: deceleration by gradient and rolling.
        brake_ratio: deceleration by the brake, relative to the demand.
    """
    if keeps(scheme, aim, now_mps2, levels_mps2, resistance_mps2, brake_ratio):
        return now_mps2
    index = catch_time.gentlest(
        aim.error_mps,
        [decel_mps2(level_mps2, resistance_mps2, brake_ratio) for level_mps2 in levels_mps2],
        reference_mps2=aim.decel_mps2,
        within_s=aim.run_s,
        guard_mps2=scheme.guard_mps2,
    )
    if index is not None:
        return levels_mps2[index]
    return levels_mps2[-1] if aim.error_mps > 0.0 else levels_mps2[0]


def keeps(
    scheme: ChasingScheme,
    aim: NotchTarget,
    now_mps2: float,
    levels_mps2: Sequence[float],
    resistance_mps2: float,
    brake_ratio: float = 1.0,
) -> bool:
    """Whether the present notch still reaches the reference in time, and the error is small."""
    if now_mps2 not in levels_mps2 or abs(aim.error_mps) >= scheme.keep_band_mps:
        return False
    if abs(aim.error_mps) < quiet_mps(scheme, aim):
        # On a curve to a stop a released brake must be applied at once, or the gap grows.
        return now_mps2 < 0.0 or not aim.to_stop
    time_s = catch_time.catch_s(
        aim.error_mps,
        decel_mps2(now_mps2, resistance_mps2, brake_ratio),
        reference_mps2=aim.decel_mps2,
        guard_mps2=scheme.guard_mps2,
    )
    return time_s <= aim.run_s


def decel_mps2(level_mps2: float, resistance_mps2: float, brake_ratio: float) -> float:
    """Deceleration of the train with this demand."""
    return resistance_mps2 - level_mps2 * (brake_ratio if level_mps2 < 0.0 else 1.0)


def quiet_mps(scheme: ChasingScheme, aim: NotchTarget) -> float:
    """Error below which the notch is kept. It is wider while there is time to close the gap."""
    if not aim.to_stop:
        return scheme.quiet_band_mps
    return max(
        scheme.quiet_band_mps, min(scheme.keep_band_mps, scheme.quiet_growth_mps2 * aim.run_s)
    )
