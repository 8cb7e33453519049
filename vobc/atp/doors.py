"""Door enable: protection enables doors only where and when no person can fall out."""

import itertools
from collections.abc import Mapping, Sequence
from typing import Final, NamedTuple

from can_dbc.doors import ALL_CARS
from can_dbc.vobc import Withheld
from firmware_py.trackdb import PlatformSide, Station
from vobc.vocabulary import Interval


class DoorEnable(NamedTuple):
    left: bool
    right: bool


SHUT: Final = DoorEnable(False, False)


class CarSpan(NamedTuple):
    """Distances from the front coupler of the train back to both ends of one car."""

    front_m: float
    rear_m: float


class DoorTerms(NamedTuple):
    """Conditions for enabling a side (IEEE 1474). Each of them must be true."""

    standstill: bool
    """An odometer in communication proves zero speed."""
    localised: bool
    near_platform: bool
    """Some part of the train may be at a platform."""
    aligned: bool
    """The whole position interval is in the window around the stopping point."""
    beside_platform: bool
    """At the stopping point, the platform is surely beside the whole train or beside one of its
    cars."""
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
    "beside_platform": Withheld.OFF_PLATFORM,
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


def enabled_doors(
    reasons: Withheld, platform: PlatformSide | None, permitted: DoorEnable
) -> DoorEnable:
    """Enable each side that has a platform and the centre's permission, while there is no reason
    against it.

    Args:
        platform: side of the platform at which the train is aligned. None: at no platform.
        permitted: sides that the centre permits.
    """
    if reasons or platform is None:
        return SHUT
    return DoorEnable(
        left=platform.left and permitted.left,
        right=platform.right and permitted.right,
    )


def car_spans(car_lengths_m: Sequence[float]) -> tuple[CarSpan, ...]:
    """Spans of the cars, from the front."""
    ends_m = list(itertools.accumulate(car_lengths_m, initial=0.0))
    return tuple(CarSpan(front_m, rear_m) for front_m, rear_m in itertools.pairwise(ends_m))


def cars_beside(
    station: Station, front_m: Interval, *, train_length_m: float, spans: Sequence[CarSpan]
) -> int:
    """Cars that are surely beside the platform, wherever in its interval the front is.

    Without spans the door unit cannot open single cars. Then it is the whole train or none.
    """
    start_m, end_m = station.platform_start_m, station.platform_end_m
    if start_m <= front_m.low - train_length_m and front_m.high <= end_m:
        return ALL_CARS
    cars = 0
    for index, span in enumerate(spans):
        if start_m <= front_m.low - span.rear_m and front_m.high - span.front_m <= end_m:
            cars |= 1 << index
    return cars


def is_aligned(station: Station, front_m: Interval, *, window_m: float) -> bool:
    """The whole front interval is within ±window_m of the stopping point, edges included."""
    return station.stop_m - window_m <= front_m.low and front_m.high <= station.stop_m + window_m
