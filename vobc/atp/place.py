"""Place of a train relative to platforms, by the ends of its position interval."""

import enum
from collections.abc import Sequence
from typing import Final, NamedTuple

from firmware_py.trackdb import Station
from vobc.atp.doors import is_aligned
from vobc.vocabulary import Interval


class PlatformWhereabouts(enum.Enum):
    UNKNOWN = "not localised"
    BETWEEN = "no part of the train is at a platform"
    ARRIVING = "some part is at a platform, and the front short of its stopping point"
    NEAR = "the front may be in the window of the stopping point, but not surely"
    ALIGNED = "the front is surely in the window of the stopping point"
    PAST = "the front is surely past that window, and the rear not surely clear of the platform"


class PlatformPlace(NamedTuple):
    where: PlatformWhereabouts
    station: Station | None
    """Station of the platform. None: no platform."""


UNKNOWN = PlatformPlace(PlatformWhereabouts.UNKNOWN, None)
BETWEEN = PlatformPlace(PlatformWhereabouts.BETWEEN, None)
AT_STOP: Final = (PlatformWhereabouts.ALIGNED, PlatformWhereabouts.NEAR)


def place_of(
    stations: Sequence[Station], front_m: Interval, *, train_length_m: float, window_m: float
) -> PlatformPlace:
    """Platform that the train may touch.

    Of two platforms it is the one at whose stopping point the front may stand, as stops may be
    closer together than the train is long. Else it is the rear one, which the train has to clear.
    """
    rear_m = front_m.low - train_length_m
    rearmost = BETWEEN
    for station in stations:
        if front_m.high < station.platform_start_m or station.platform_end_m < rear_m:
            continue
        place = PlatformPlace(_whereabouts(station, front_m, window_m=window_m), station)
        if place.where in AT_STOP:
            return place
        if rearmost.station is None:
            rearmost = place
    return rearmost


def _whereabouts(station: Station, front_m: Interval, *, window_m: float) -> PlatformWhereabouts:
    if is_aligned(station, front_m, window_m=window_m):
        return PlatformWhereabouts.ALIGNED
    if front_m.low > station.stop_m + window_m:
        return PlatformWhereabouts.PAST
    if front_m.best < station.stop_m - window_m:
        return PlatformWhereabouts.ARRIVING
    return PlatformWhereabouts.NEAR
