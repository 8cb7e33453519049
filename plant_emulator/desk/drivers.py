"""Driver models. They use only what the display shows."""

import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Final, Protocol

from can_dbc.cab import CabMode, Desk
from can_dbc.vobc import Supervision, VobcMotion, VobcStatus, VobcTarget
from plant_emulator.desk.display import DeskDisplay
from plant_emulator.desk.hands import unattended

FULL_PERCENT: Final = 100.0
PERCENT_PER_MPS: Final = 60.0
"""Lever gain of an obedient driver per speed error."""
KEPT_MPS: Final = 1.0
"""Margin that an obedient driver keeps below the permitted speed, m/s."""
SEEN_AHEAD_S: Final = 3.0
"""Time for which an obedient driver extrapolates a falling limit, s."""
EASY_MPS2: Final = 0.5
"""Deceleration of an obedient driver towards the end of the authority."""
EASY_GAP_M: Final = 20.0
"""Distance before the end of the authority at which an obedient driver intends to stop."""
LATE_AHEAD_S: Final = 1.5
"""Time for which a late driver extrapolates a falling limit; it equals the build-up of the
brake."""
LATE_KEPT_MPS: Final = 0.5
LATE_RELEASE_MPS: Final = 1.5
"""Margin below the emergency limit at which a late driver releases the brake again."""
FALL_MAX_MPS2: Final = 2.0
"""Largest fall of a limit that counts as approaching it. A faster fall means that the limit was
changed."""
STANDING_MPS: Final = 0.1
RESET_EVERY_NS: Final = 3_000_000_000
RESET_FOR_NS: Final = 1_000_000_000
NS_PER_S: Final = 1_000_000_000


class Driver(Protocol):
    """Returns the desk frame to send, whenever the desk sends one."""

    def drive(self, display: DeskDisplay, now_ns: int) -> Desk: ...


class Trend:
    """Estimates how fast a shown limit falls; never negative."""

    def __init__(self) -> None:
        self._limit_mps = 0.0
        self._since_ns: int | None = None
        self._fall_mps2 = 0.0

    def fall_mps2(self, limit_mps: float, now_ns: int) -> float:
        since_ns = self._since_ns
        if since_ns is not None and limit_mps != self._limit_mps and now_ns > since_ns:
            fall_mps2 = (self._limit_mps - limit_mps) / ((now_ns - since_ns) / NS_PER_S)
            self._fall_mps2 = max(0.0, fall_mps2) if fall_mps2 <= FALL_MAX_MPS2 else 0.0
        elif since_ns is not None and now_ns - since_ns > NS_PER_S:
            self._fall_mps2 = 0.0
        if since_ns is None or limit_mps != self._limit_mps:
            self._limit_mps, self._since_ns = limit_mps, now_ns
        return self._fall_mps2


class Obedient:
    """Keeps below the permitted speed, and resets an emergency when the train stands."""

    def __init__(self) -> None:
        # Both trends matter: the emergency limit begins to fall before the permitted speed does.
        self._trends = (Trend(), Trend())

    def drive(self, display: DeskDisplay, now_ns: int) -> Desk:
        seen = display.speeds(now_ns)
        if seen is None:
            return _desk(-FULL_PERCENT)
        status = display.latest(VobcStatus, now_ns)
        emergency = status is not None and status.supervision is Supervision.EMERGENCY
        if emergency:
            standing = abs(seen.speed_mps) < STANDING_MPS
            pressed = standing and now_ns % RESET_EVERY_NS < RESET_FOR_NS
            return replace(_desk(-FULL_PERCENT), reset_requested=pressed)
        wanted_mps = min(
            self._under_limits_mps(seen, now_ns), _easy_mps(display.latest(VobcTarget, now_ns))
        )
        if wanted_mps <= 0.0:
            return _desk(-FULL_PERCENT)
        return _desk(PERCENT_PER_MPS * (wanted_mps - seen.speed_mps))

    def _under_limits_mps(self, seen: VobcMotion, now_ns: int) -> float:
        permitted, emergency = self._trends
        fall_mps2 = max(
            permitted.fall_mps2(seen.ceiling_mps, now_ns),
            emergency.fall_mps2(seen.emergency_mps, now_ns),
        )
        return seen.ceiling_mps - KEPT_MPS - SEEN_AHEAD_S * fall_mps2


class Reckless:
    """Drives with full power, whatever the display shows."""

    def drive(self, display: DeskDisplay, now_ns: int) -> Desk:
        return _desk(FULL_PERCENT)


class LateDriver:
    """Drives with full power until just below the emergency limit, then brakes fully."""

    def __init__(self) -> None:
        self._trend = Trend()
        self._braking = False

    def drive(self, display: DeskDisplay, now_ns: int) -> Desk:
        seen = display.speeds(now_ns)
        if seen is None:
            return _desk(-FULL_PERCENT)
        self._braking = self._has_to_brake(seen, now_ns)
        return _desk(-FULL_PERCENT if self._braking else FULL_PERCENT)

    def _has_to_brake(self, seen: VobcMotion, now_ns: int) -> bool:
        fall_mps2 = self._trend.fall_mps2(seen.emergency_mps, now_ns)
        left_mps = seen.emergency_mps - LATE_AHEAD_S * fall_mps2 - seen.speed_mps
        return left_mps < (LATE_RELEASE_MPS if self._braking else LATE_KEPT_MPS)


DRIVERS: Final[Mapping[str, Callable[[], Driver]]] = {
    "obedient": Obedient,
    "reckless": Reckless,
    "late": LateDriver,
}


def _easy_mps(target: VobcTarget | None) -> float:
    """Speed from which gentle braking stops the train before the end of the authority."""
    if target is None:
        return math.inf
    left_m = target.distance_to_authority_m - EASY_GAP_M
    return math.sqrt(2.0 * EASY_MPS2 * max(0.0, left_m))


def _desk(lever_percent: float) -> Desk:
    limited_percent = max(-FULL_PERCENT, min(FULL_PERCENT, lever_percent))
    return replace(unattended(CabMode.MANUAL), lever_percent=limited_percent)
