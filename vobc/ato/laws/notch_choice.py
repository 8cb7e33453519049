"""Which notch is taken towards one reference, and how long the one at work is kept (Wu 2022)."""

from collections.abc import Sequence
from typing import NamedTuple

from vobc.ato.laws import catch_time
from vobc.ato.settings.chasing import ChasingScheme


class NotchTarget(NamedTuple):
    """One reference as the predicted train sees it."""

    error_mps: float
    """Its speed less the reference's."""
    decel_mps2: float
    """Of the reference."""
    run_s: float
    """Time within which the reference is to be caught."""
    spare_m: float
    to_stop: bool = False


def picked(
    scheme: ChasingScheme,
    aim: NotchTarget,
    now_mps2: float,
    levels_mps2: Sequence[float],
    resistance_mps2: float,
) -> float:
    """The demand of the notch to take.

    Args:
        now_mps2: the demand of the notch at work.
        levels_mps2: demands to choose from, from the strongest pull to the strongest brake.
        resistance_mps2: deceleration by gradient and rolling.
    """
    if keeps(scheme, aim, now_mps2, levels_mps2, resistance_mps2):
        return now_mps2
    index = catch_time.gentlest(
        aim.error_mps,
        [resistance_mps2 - level_mps2 for level_mps2 in levels_mps2],
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
) -> bool:
    """Whether the notch at work still catches the reference in time, near enough to it."""
    if now_mps2 not in levels_mps2 or abs(aim.error_mps) >= scheme.keep_band_mps:
        return False
    if abs(aim.error_mps) < quiet_mps(scheme, aim):
        # On a curve to a stop a released brake waits for no gap: it would only open.
        return now_mps2 < 0.0 or not aim.to_stop
    time_s = catch_time.catch_s(
        aim.error_mps,
        resistance_mps2 - now_mps2,
        reference_mps2=aim.decel_mps2,
        guard_mps2=scheme.guard_mps2,
    )
    return time_s <= aim.run_s


def quiet_mps(scheme: ChasingScheme, aim: NotchTarget) -> float:
    """The gap in which no other notch is looked for; wider while there is time to close it."""
    if not aim.to_stop:
        return scheme.quiet_band_mps
    return max(
        scheme.quiet_band_mps, min(scheme.keep_band_mps, scheme.quiet_growth_mps2 * aim.run_s)
    )
