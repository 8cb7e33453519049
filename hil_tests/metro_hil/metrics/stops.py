"""How the train stopped at each station: the first standstill, jogs, doors and running time."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt

from can_dbc.doors import DoorState
from firmware_py.trackdb import Station
from metro_hil.model.log_columns import Columns, Numbers

NEAR_STOP_M: Final = 50.0
"""Greatest distance of a standstill from the stopping point that counts as a stop there, m."""
FOR_STOP_M: Final = 10.0
"""Distance within which the first standstill is the stop, m. A train that stands farther off waits
for its way; its last standstill near the point counts then."""
MOVED_M: Final = 0.01
"""Least movement between two standstills, m. The train settles in its couplers and brakes by less.
"""


@dataclass(frozen=True, slots=True)
class StationStop:
    """How the train stopped at one station."""

    station: str
    error_m: float | None = None
    """Stopping error at the first standstill, positive beyond the stopping point; None if the train
    never stood near it."""
    arrived_s: float | None = None
    run_time_s: float | None = None
    """Time from leaving the previous station to the first standstill."""
    jogs: int = 0
    """Number of movements after the first standstill, up to the opening of the doors."""
    doors_error_m: float | None = None
    """Stopping error when the doors opened; None if they never did."""
    doors_delay_s: float | None = None
    """Time from the first standstill to the opening of the doors."""


class _Standstill(NamedTuple):
    """First and last row of a standstill."""

    first: int
    last: int


def measure_stops(truth: Columns, stations: Sequence[Station]) -> list[StationStop]:
    """One entry for each station at which the mission stops, in running order."""
    time_s, front_m = truth.numbers("t_s"), truth.numbers("front_m")
    standstills = _standstills(truth.numbers("speed_mps") == 0.0, front_m)
    open_ = open_doors(truth)
    left_s = float(time_s[0]) if len(time_s) else 0.0
    if standstills and standstills[0].first == 0:
        left_s = float(time_s[standstills[0].last])
    stops = []
    for station in stations:
        near = _near(standstills, front_m, station)
        if not near:
            stops.append(StationStop(station.name))
            continue
        stop, left = _measured(station, near, truth, open_, left_s)
        stops.append(stop)
        left_s = float(time_s[left.last])
    return stops


def _near(
    standstills: Sequence[_Standstill], front_m: Numbers, station: Station
) -> list[_Standstill]:
    """The standstills near a station from the one that counts as the stop on."""
    far_m = [abs(float(front_m[one.first]) - station.stop_m) for one in standstills]
    near = [index for index, distance_m in enumerate(far_m) if distance_m <= NEAR_STOP_M]
    if not near:
        return []
    begin = next((index for index in near if far_m[index] <= FOR_STOP_M), near[-1])
    return [standstills[index] for index in near if index >= begin]


def _measured(
    station: Station,
    near: Sequence[_Standstill],
    truth: Columns,
    open_: npt.NDArray[np.bool_],
    left_s: float,
) -> tuple[StationStop, _Standstill]:
    """The stop, and the standstill from which the train left the station."""
    time_s, front_m = truth.numbers("t_s"), truth.numbers("front_m")
    arrived = near[0].first
    jogs, doors_at = len(near) - 1, None
    left = near[-1]
    for index, one in enumerate(near):
        opened = np.flatnonzero(open_[one.first : one.last + 1])
        if len(opened):
            jogs, doors_at, left = index, one.first + int(opened[0]), one
            break
    arrived_s = float(time_s[arrived])
    stop = StationStop(
        station=station.name,
        error_m=float(front_m[arrived]) - station.stop_m,
        arrived_s=arrived_s,
        run_time_s=arrived_s - left_s,
        jogs=jogs,
        doors_error_m=None if doors_at is None else float(front_m[doors_at]) - station.stop_m,
        doors_delay_s=None if doors_at is None else float(time_s[doors_at]) - arrived_s,
    )
    return stop, left


def _standstills(still: npt.NDArray[np.bool_], front_m: Numbers) -> list[_Standstill]:
    """Every standstill; two without a movement between them are one."""
    edges = np.diff(np.concatenate(([0], still.astype(np.int8), [0])))
    found: list[_Standstill] = []
    firsts, lasts = np.flatnonzero(edges == 1), np.flatnonzero(edges == -1) - 1
    for first, last in zip(firsts.tolist(), lasts.tolist(), strict=True):
        if found and np.ptp(front_m[found[-1].last : first + 1]) < MOVED_M:
            found[-1] = _Standstill(found[-1].first, last)
        else:
            found.append(_Standstill(first, last))
    return found


def open_doors(truth: Columns) -> npt.NDArray[np.bool_]:
    """Rows in which a door is not locked; none for a log without doors.

    In memory states are numbers; in logs of real time they are text.
    """
    locked = (str(DoorState.LOCKED), DoorState.LOCKED.name.lower())
    open_ = np.zeros(len(truth), dtype=np.bool_)
    for side in ("door_left", "door_right"):
        if truth.has(side):
            open_ |= np.array([state not in locked for state in truth.texts(side)], dtype=np.bool_)
    return open_
