"""Door enable: protection enables doors only where and when no person can fall out."""

from collections.abc import Mapping
from typing import Final, NamedTuple

from can_dbc.vobc import Withheld
from firmware_py.trackdb import PlatformSide, Station
from vobc.vocabulary import Interval


class DoorEnable(NamedTuple):
    left: bool
    right: bool


SHUT: Final = DoorEnable(False, False)


class DoorTerms(NamedTuple):
    """Conditions for enabling a side (IEEE 1474). Each of them must be true."""

    standstill: bool
    """An odometer in communication proves zero speed."""
    localised: bool
    near_platform: bool
    """Some part of the train may be at a platform."""
    aligned: bool
    """The whole position interval is in the window around the stopping point."""
    holding_applied: bool
    """A fresh message of the brake unit confirms it."""
    traction_cut: bool
    """A fresh message of the traction unit confirms it."""
    no_emergency: bool
    """No emergency is latched and waiting for its reset."""
    authorised: bool
    """The centre permits doors on the side where the line map has the platform."""
    centre_heard: bool


WITHHELD_WITHOUT: Final[Mapping[str, Withheld]] = {
    "standstill": Withheld.MOVING,
    "localised": Withheld.NOT_LOCALISED,
    "near_platform": Withheld.NO_PLATFORM,
    "aligned": Withheld.MISALIGNED,
    "holding_applied": Withheld.NOT_HELD,
    "traction_cut": Withheld.TRACTION,
    "no_emergency": Withheld.EMERGENCY,
    "authorised": Withheld.NOT_AUTHORISED,
    "centre_heard": Withheld.CENTRE_SILENT,
}
"""Reason that is reported for each condition that is false."""

# Plain numbers: operators on an IntFlag cost a microsecond each, every cycle.
_WITHOUT: Final = tuple(int(WITHHELD_WITHOUT[term]) for term in DoorTerms._fields)
_FLAGS: Final = tuple(Withheld(number) for number in range(sum(_WITHOUT) + 1))


def withheld(terms: DoorTerms) -> Withheld:
    """Reasons against enabling doors. NONE only if every condition is true."""
    number = 0
    for term, flag in zip(terms, _WITHOUT, strict=True):
        if not term:
            number |= flag
    return _FLAGS[number]


def enabled_doors(reasons: Withheld, platform: PlatformSide | None) -> DoorEnable:
    """Enable the platform side while there is no reason against it.

    Args:
        platform: side of the platform at which the train is aligned. None: at no platform.
    """
    if reasons:
        return SHUT
    return DoorEnable(
        left=platform is PlatformSide.LEFT,
        right=platform is PlatformSide.RIGHT,
    )


def is_aligned(station: Station, front_m: Interval, *, window_m: float) -> bool:
    """The whole front interval is within ±window_m of the stopping point, edges included."""
    return station.stop_m - window_m <= front_m.low and front_m.high <= station.stop_m + window_m
