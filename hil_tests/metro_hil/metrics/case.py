"""Measures of one case by name; the unit is the last part of the name."""

import itertools
import math
from bisect import bisect_right
from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np

from firmware_py.trackdb import Station
from metro_hil.metrics.comfort import felt_worst
from metro_hil.metrics.run import measure_ride
from metro_hil.metrics.stops import StationStop, measure_stops, open_doors
from metro_hil.model.log_columns import Columns
from plant_emulator.process import TRUTH_COLUMNS

NAMES: Final[Mapping[str, str]] = {
    "stop_error_worst_m": "greatest distance from the stopping point at a first standstill",
    "stop_error_mean_m": "mean distance from the stopping point at first standstills",
    "stop_bound_worst_m": "greatest bound of the position error that the controller has at a stop",
    "doors_error_worst_m": "greatest distance from the stopping point when doors opened",
    "doors_delay_worst_s": "greatest time from the first standstill to the opening of the doors",
    "jogs_count": "movements between the first standstill at a stop and the opening of the doors",
    "stops_made_count": "stations near whose stopping point the train stood",
    "stops_missed_count": "stations of its timetable near which the train never stood",
    "doors_shut_count": "stops with a dwell time at which no door opened",
    "stranded_count": "1 if the train stood for the last minute short of its last stop, else 0",
    "arrived_count": "1 if the train stood with open doors at its last station, else 0",
    "accel_max_mps2": "greatest acceleration of the whole train either way, low-passed at 2 Hz",
    "jerk_max_mps3": "greatest slope of the whole train's low-passed acceleration",
    "felt_accel_max_mps2": "greatest acceleration of any car, low-passed at 2 Hz, no emergencies",
    "felt_jerk_1s_mps3": "greatest change of a car's low-passed acceleration over 1 s",
    "felt_jerk_2hz_mps3": "greatest slope of a car's low-passed acceleration, jolts included",
    "en12299_index_ratio": "mean comfort index of EN 12299, longitudinal, of the worst car",
    "commanded_accel_max_mps2": "greatest acceleration that ATO commanded, in either direction",
    "commanded_jerk_max_mps3": "greatest change of the command between two control cycles",
    "speed_max_mps": "greatest speed",
    "distance_m": "distance from the first to the last place of the front",
    "run_time_s": "duration of the run",
    "punctuality_worst_s": "greatest difference from the planned running time to a station",
    "over_fastest_worst_ratio": "greatest excess of a running time over the shortest possible one",
    "over_fastest_total_ratio": "excess of all running times over the shortest possible ones",
    "front_end_m": "chainage of the front at the end",
    "notch_changes_max_count": "most changes of the brake command's level before one stop",
    "notch_changes_mean_count": "mean number of changes of that level before a stop",
    "notch_reversals_count": "reversals of the brake command's level between 8 and 4 km/h",
    "emergency_count": "number of emergency brake applications",
    "emergency_speed_mps": "greatest speed at which the emergency brake came on",
    "emergency_distance_m": "longest distance from an emergency brake application to standstill",
    "rollback_m": "greatest distance back from the foremost place",
    "door_open_speed_max_mps": "greatest magnitude of speed while a door was unlocked",
    "energy_drawn_kwh": "energy drawn at the collector",
    "energy_returned_kwh": "energy returned at the collector",
    "brake_reports_count": "reports of a late or weak brake by the controller",
    "controller_slips_count": "control cycles missed",
    "rejected_frames_count": "frames that the train's nodes rejected",
    "switches_moved_count": "movements of switches",
    "routes_refused_count": "routes that had to wait because something conflicted",
    "ends_changed_count": "changes of ends of the train between trips",
    "command_changes_count": "trains that began to command an area under masters",
    "takeover_worst_s": "longest time until another train commanded, after a master was struck",
    "authority_oldest_s": "age of the oldest authority of another train in the 2 s after that",
    "bus_load_ratio": "share of time that the bus was occupied",
}
"""Measures of every case with their meaning. Each station of the timetable adds four:
`stop_<name>_error_m` at the first standstill and `doors_<name>_error_m` when the doors opened, both
positive beyond the stopping point; `stop_<name>_bound_m`, half of the controller's position
interval at that standstill; and `stop_<name>_run_s`, from leaving the previous stop to the first
standstill."""


STRANDED_S: Final = 60.0
"""Standing time at the end of a run after which a train counts as stranded. It exceeds every dwell
time, and the 30 s after which a train calls for help."""
NO_PLAN: Final[Mapping[str, float]] = {}
Bounds = Sequence[tuple[float, float]]
"""Instants in s, rising, each with half the width of the controller's position interval in m."""


class MemoryLog:
    """The truth log of a run in memory."""

    def __init__(self) -> None:
        self._rows: list[tuple[object, ...]] = []

    def row(self, *values: object) -> None:
        self._rows.append(values)

    def columns(self) -> Columns:
        return Columns.of_rows("truth", TRUTH_COLUMNS, self._rows)


def measure_names(stations: Sequence[Station]) -> tuple[str, ...]:
    """Names of all measures of a case with these stops."""
    each = [
        name
        for station in stations
        for name in (
            f"stop_{station.name}_error_m",
            f"stop_{station.name}_bound_m",
            f"stop_{station.name}_run_s",
            f"doors_{station.name}_error_m",
        )
    ]
    return (*NAMES, *each)


def motion_measures(
    truth: Columns,
    stops: Sequence[Station],
    planned_run_s: Mapping[str, float] = NO_PLAN,
    fastest_run_s: Mapping[str, float] = NO_PLAN,
    bounds: Bounds = (),
) -> dict[str, float | None]:
    """Measures from the truth log alone: stops, motion, emergencies, punctuality.

    Args:
        planned_run_s, fastest_run_s: running time to each station by timetable, and the shortest
            possible one.
        bounds: the controller's bound of its position over time.
    """
    measured = measure_stops(truth, stops)
    ride = measure_ride(truth)
    front_m = truth.numbers("front_m")
    emergency = truth.flags("emergency")
    errors_m = [abs(stop.error_m) for stop in measured if stop.error_m is not None]
    bounds_m = [_bound_m(bounds, stop) for stop in measured]
    doors_m = [abs(stop.doors_error_m) for stop in measured if stop.doors_error_m is not None]
    measures: dict[str, float | None] = {
        "stop_error_worst_m": max(errors_m, default=None),
        "stop_error_mean_m": math.fsum(errors_m) / len(errors_m) if errors_m else None,
        "stop_bound_worst_m": max((m for m in bounds_m if m is not None), default=None),
        "doors_error_worst_m": max(doors_m, default=None),
        "doors_delay_worst_s": max(
            (stop.doors_delay_s for stop in measured if stop.doors_delay_s is not None),
            default=None,
        ),
        "jogs_count": float(sum(stop.jogs for stop in measured)),
        "stops_made_count": float(len(errors_m)),
        "stops_missed_count": float(len(measured) - len(errors_m)),
        "doors_shut_count": float(
            sum(_stays_shut(*pair) for pair in zip(stops, measured, strict=True))
        ),
        "stranded_count": float(_stranded(truth, stops, measured)),
        "accel_max_mps2": ride.max_accel_mps2,
        "jerk_max_mps3": ride.max_jerk_mps3,
        **felt_worst(truth),
        "speed_max_mps": ride.top_speed_mps,
        "distance_m": ride.distance_m,
        "run_time_s": ride.duration_s,
        "punctuality_worst_s": max(
            (abs(run_s - plan_s) for run_s, plan_s in _against(measured, planned_run_s)),
            default=None,
        ),
        "over_fastest_worst_ratio": max(
            (run_s / least_s - 1.0 for run_s, least_s in _against(measured, fastest_run_s)),
            default=None,
        ),
        "over_fastest_total_ratio": _total_ratio(_against(measured, fastest_run_s)),
        "front_end_m": float(front_m[-1]) if len(front_m) else None,
        "emergency_count": float(_risings(emergency)),
        **_emergency_measures(truth),
        "rollback_m": float(np.max(np.maximum.accumulate(front_m) - front_m, initial=0.0)),
        "door_open_speed_max_mps": _door_open_speed_mps(truth),
    }
    for stop, bound_m in zip(measured, bounds_m, strict=True):
        measures[f"stop_{stop.station}_error_m"] = stop.error_m
        measures[f"stop_{stop.station}_bound_m"] = bound_m
        measures[f"stop_{stop.station}_run_s"] = stop.run_time_s
        measures[f"doors_{stop.station}_error_m"] = stop.doors_error_m
    return measures


def _bound_m(bounds: Bounds, stop: StationStop) -> float | None:
    """The last bound up to the first standstill; None without any."""
    if stop.arrived_s is None:
        return None
    index = bisect_right(bounds, (stop.arrived_s, math.inf))
    return bounds[index - 1][1] if index else None


def _stays_shut(station: Station, stop: StationStop) -> bool:
    """The train stood at a station with a dwell time, and no door opened."""
    return station.dwell_s > 0.0 and stop.error_m is not None and stop.doors_delay_s is None


def _stranded(truth: Columns, stations: Sequence[Station], stops: Sequence[StationStop]) -> bool:
    """The train stands for good before it has made its last stop and opened the doors there."""
    if not stops:
        return False
    last = stops[-1]
    if last.error_m is not None and not _stays_shut(stations[-1], last):
        return False
    time_s = truth.numbers("t_s")
    moves = np.flatnonzero(truth.numbers("speed_mps") != 0.0)
    stood_s = float(time_s[-1] - time_s[moves[-1] if len(moves) else 0]) if len(time_s) else 0.0
    return stood_s >= STRANDED_S


def _against(
    stops: Sequence[StationStop], reference_s: Mapping[str, float]
) -> list[tuple[float, float]]:
    """Running time and its reference of each stop that has both."""
    return [
        (stop.run_time_s, reference_s[stop.station])
        for stop in stops
        if stop.run_time_s is not None and stop.station in reference_s
    ]


def _total_ratio(pairs: Sequence[tuple[float, float]]) -> float | None:
    """Excess of the sum of running times over the sum of their references; None without any."""
    if not pairs:
        return None
    return math.fsum(run_s for run_s, _ in pairs) / math.fsum(least_s for _, least_s in pairs) - 1.0


def _emergency_measures(truth: Columns) -> dict[str, float | None]:
    """Measures of emergency brakes on a moving train; without standstill there is no distance.

    The brake came on between two rows. The distance counts from the earlier row, so it may be too
    long by one row, but never too short.
    """
    front_m, speed_mps = truth.numbers("front_m"), truth.numbers("speed_mps")
    emergency = np.array(truth.flags("emergency"), dtype=np.bool_)
    came = np.flatnonzero(~emergency[:-1] & emergency[1:] & (speed_mps[1:] != 0.0))
    rests = np.flatnonzero(speed_mps == 0.0)
    ends = [rests[rests > first] for first in came]
    ways_m = [
        abs(float(front_m[after[0]] - front_m[first]))
        for first, after in zip(came, ends, strict=True)
        if len(after)
    ]
    speeds_mps = np.abs(speed_mps[came + 1])
    return {
        "emergency_speed_mps": float(np.max(speeds_mps)) if len(came) else None,
        "emergency_distance_m": max(ways_m) if ways_m and len(ways_m) == len(came) else None,
    }


def _door_open_speed_mps(truth: Columns) -> float | None:
    open_ = open_doors(truth)
    if not np.any(open_):
        return None
    return float(np.max(np.abs(truth.numbers("speed_mps")[open_])))


def _risings(flags: Sequence[bool]) -> int:
    """Number of changes to true; a train braked from the start has no emergency of the run."""
    return sum(1 for before, now in itertools.pairwise(flags) if now and not before)
