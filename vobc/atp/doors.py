"""Door enable: protection lets doors open only where and when nobody can fall out."""

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
    """All that has to be true before a side is enabled (IEEE 1474), each by itself."""

    standstill: bool
    """Zero speed is proven by an odometer that is heard."""
    localised: bool
    near_platform: bool
    """Some part of the train may stand at a platform."""
    aligned: bool
    """The whole position interval lies in the window around the stopping point."""
    holding_applied: bool
    """Confirmed by the brake unit, freshly."""
    traction_cut: bool
    """Confirmed by the traction unit, freshly."""
    no_emergency: bool
    """No emergency is latched and waits for its reset."""
    authorised: bool
    """The centre lets doors open on the side where the map has the platform."""
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
"""What is said of a term that is not true."""

# Plain numbers: operators on an IntFlag cost a microsecond each, every cycle.
_WITHOUT: Final = tuple(int(WITHHELD_WITHOUT[term]) for term in DoorTerms._fields)
_FLAGS: Final = tuple(Withheld(number) for number in range(sum(_WITHOUT) + 1))


def withheld(terms: DoorTerms) -> Withheld:
    """What stands against enabling doors; NONE only if every single term is true."""
    number = 0
    for term, flag in zip(terms, _WITHOUT, strict=True):
        if not term:
            number |= flag
    return _FLAGS[number]


def enabled_doors(reasons: Withheld, platform: PlatformSide | None) -> DoorEnable:
    """The side at the platform while nothing stands against it; it goes as soon as anything does.

    Args:
        platform: side of the platform at which the train stands right; None at none.
    """
    if reasons:
        return SHUT
    return DoorEnable(
        left=platform is PlatformSide.LEFT,
        right=platform is PlatformSide.RIGHT,
    )


def is_aligned(station: Station, front_m: Interval, *, window_m: float) -> bool:
    """The front surely stands within ±window_m of the stopping point; the edges belong to it."""
    return station.stop_m - window_m <= front_m.low and front_m.high <= station.stop_m + window_m
