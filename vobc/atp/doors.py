"""Door enable: protection lets doors open only where and when nobody can fall out."""

from collections.abc import Sequence
from typing import NamedTuple

from firmware_py.trackdb import PlatformSide, Station
from vobc.vocabulary import Interval


class DoorEnable(NamedTuple):
    left: bool
    right: bool


SHUT = DoorEnable(False, False)


def enabled_doors(
    *,
    standstill: bool,
    platform: PlatformSide | None,
    holding_applied: bool,
    traction_cut: bool,
    emergency: bool,
) -> DoorEnable:
    """The side at the platform, and only while every term holds; losing one takes it away at once.

    Args:
        platform: side of the platform at which the whole position interval stands right.
        holding_applied: confirmed by the brake unit, freshly.
        traction_cut: confirmed by the traction unit, freshly.
        emergency: an emergency is latched and waits for its reset.
    """
    if not standstill or not holding_applied or not traction_cut or emergency:
        return SHUT
    return DoorEnable(
        left=platform is PlatformSide.LEFT,
        right=platform is PlatformSide.RIGHT,
    )


def platform_at(
    stations: Sequence[Station], front_m: Interval, *, window_m: float
) -> PlatformSide | None:
    """The platform side if the front surely stands within ±window_m of a stopping point."""
    for station in stations:
        if station.stop_m - window_m <= front_m.low and front_m.high <= station.stop_m + window_m:
            return station.side
    return None
