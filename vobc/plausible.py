"""Judges line, train and parameters together: the relations that protection needs to hold.

The classes of the files check each value by itself.
"""

import itertools
from collections.abc import Iterator, Sequence
from typing import Final

from can_dbc.alarms import TrainAlarms
from can_dbc.binding import Frame, period_s
from can_dbc.brake import BrakeStatus
from can_dbc.cab import Desk
from can_dbc.doors import CARS_MAX, DoorStatus
from can_dbc.odometer import Tacho
from can_dbc.tags import TagReaderHealth
from can_dbc.traction import TractionStatus
from firmware_py.settings import SettingsError
from firmware_py.trackdb import LineMap, Station
from vobc.atp.braking import LEAST_DECEL_MPS2
from vobc.atp.doors import car_spans, cars_beside
from vobc.atp.rollback import RollbackWatch
from vobc.config import VobcConfig
from vobc.kinematics import GRAVITY_MPS2
from vobc.vocabulary import Interval
from vobc.zones import Coasting, coastings

EXACT_M: Final = 0.01
"""Difference that rounding explains between the train's length and the sum of its cars."""
PERIODS: Final[tuple[tuple[str, type[Frame]], ...]] = (
    ("tacho_s", Tacho),
    ("brake_s", BrakeStatus),
    ("traction_s", TractionStatus),
    ("doors_s", DoorStatus),
    ("desk_s", Desk),
    ("tag_reader_s", TagReaderHealth),
    ("alarms_s", TrainAlarms),
)
"""Each timeout with the frame that it watches."""


def check_plausible(config: VobcConfig, line: LineMap) -> None:
    """Raise SettingsError with one line for each relation that does not hold.

    Args:
        line: with the stopping points of this train, see `LineMap.for_train`.
    """
    if found := implausible(config, line):
        raise SettingsError("\n".join(found))


def implausible(config: VobcConfig, line: LineMap) -> list[str]:
    """Return a text for each relation that does not hold; it names file, key and value."""
    return [
        *(f"parameters {config.name}: {text}" for text in _of_train(config)),
        *(f"parameters {config.name}: {text}" for text in _of_times(config)),
        *(f"parameters {config.name}: {text}" for text in _of_odometry(config)),
        *(f"line {line.name}: {text}" for text in _of_line(config, line)),
    ]


def least_rollback_m(config: VobcConfig, line: LineMap) -> float:
    """Distance that the train rolls back on the line's steepest climb if protection brakes as soon
    as it can. A limit below that cannot be kept."""
    return RollbackWatch(
        config.atp,
        line,
        train_length_m=config.train.length_m,
        cycle_s=config.cycle_ms / 1000.0,
        true_per_counted=config.true_per_counted,
    ).least_m()


def _of_train(config: VobcConfig) -> Iterator[str]:
    train, atp = config.train, config.atp
    if train.antenna_offset_m > train.length_m:
        yield (
            f"train.antenna_offset_m: {train.antenna_offset_m:g} is more than "
            f"train.length_m {train.length_m:g}; the antenna must be under the train"
        )
    cars_m = sum(train.car_lengths_m)
    if train.car_lengths_m and abs(cars_m - train.length_m) > EXACT_M:
        yield (
            f"train.car_lengths_m: the cars are {cars_m:g} m long together, and train.length_m is "
            f"{train.length_m:g}; give each car from the front"
        )
    if len(train.car_lengths_m) > CARS_MAX:
        yield (
            f"train.car_lengths_m: {len(train.car_lengths_m)} cars; the door frame carries "
            f"{CARS_MAX}"
        )
    if atp.stop_decel_mps2 > train.service_decel_max_mps2:
        yield (
            f"atp.stop_decel_mps2: {atp.stop_decel_mps2:g} is more than "
            f"train.service_decel_max_mps2 {train.service_decel_max_mps2:g}; no service brake "
            "reaches it"
        )
    if not atp.jog_mps <= atp.creep_mps <= atp.restricted_mps:
        yield (
            f"atp.jog_mps {atp.jog_mps:g}, atp.creep_mps {atp.creep_mps:g} and "
            f"atp.restricted_mps {atp.restricted_mps:g} must not fall in this order"
        )


def _of_times(config: VobcConfig) -> Iterator[str]:
    atp = config.atp
    for name, kind in PERIODS:
        timeout_s, each_s = getattr(atp.timeouts, name), period_s(kind)
        if timeout_s <= each_s:
            yield (
                f"atp.timeouts.{name}: {timeout_s:g} is not more than the {each_s:g} s between two "
                "frames; the input would be lost at once"
            )
    usable_s = atp.authority_service_ratio * atp.authority_age_max_s
    if config.report_ms / 1000.0 >= usable_s:
        yield (
            f"report_ms: {config.report_ms:g} is not less than the {usable_s:g} s for which an "
            "authority is fresh (atp.authority_service_ratio × atp.authority_age_max_s)"
        )


def _of_odometry(config: VobcConfig) -> Iterator[str]:
    odometry, window_m = config.odometry, config.atp.door_window_m
    pulse_mps = config.train.nominal_m_per_pulse / odometry.window_s
    if odometry.zero_speed_mps <= pulse_mps:
        yield (
            f"odometry.zero_speed_mps: {odometry.zero_speed_mps:g} is not more than one pulse in "
            f"odometry.window_s, {pulse_mps:.3g} m/s; standstill could never be proven"
        )
    if odometry.tag_bound_m >= window_m:
        yield (
            f"odometry.tag_bound_m: {odometry.tag_bound_m:g} is not less than "
            f"atp.door_window_m {window_m:g}; no train could prove that it stands right"
        )
    if 2.0 * odometry.start_bound_m > odometry.localisation_limit_m:
        yield (
            f"odometry.start_bound_m: {odometry.start_bound_m:g} to both sides is wider than "
            f"odometry.localisation_limit_m {odometry.localisation_limit_m:g}; the train would "
            "start without a place"
        )


def _of_line(config: VobcConfig, line: LineMap) -> Iterator[str]:
    yield from _of_gradients(config, line)
    yield from _of_speeds(config, line)
    yield from _of_platforms(config, line.stations)
    for zone in line.no_stop_zones:
        for station in line.stations:
            if zone.covers(station.stop_m - config.train.length_m, station.stop_m):
                yield (
                    f"no_stop_zones: {zone.text}: a train of {config.train.length_m:g} m that "
                    f"stops at {station.name} stands in it; shorten the zone"
                )
    for stop in line.evacuation_stops:
        for zone in (*line.neutral_sections, *line.no_stop_zones):
            if zone.covers(stop.end_m - config.train.length_m, stop.end_m):
                yield (
                    f"evacuation_stops: {stop.text}: a train that stands there is in the zone "
                    f"{zone.text}; move the stop"
                )
    yield from _of_power_sections(line)
    for coasting in coastings(config, line):
        yield from _of_neutral_section(config, line.stations, coasting)
    least_m = config.atp.jog_m + config.atp.door_window_m
    for before, after in itertools.pairwise(line.stations):
        hop_m = after.stop_m - before.stop_m
        if hop_m <= least_m:
            yield (
                f"stations: {before.name} and {after.name} are {hop_m:g} m apart; a jog of "
                f"atp.jog_m and atp.door_window_m together reach {least_m:g} m"
            )


def _of_gradients(config: VobcConfig, line: LineMap) -> Iterator[str]:
    atp, odometry = config.atp, config.odometry
    climb_permille = line.steepest_climb_permille(line.start_m, line.end_m)
    fall_permille = -line.worst_gradient_permille(line.start_m, line.end_m)
    climb_mps2 = GRAVITY_MPS2 * climb_permille / 1000.0
    fall_mps2 = GRAVITY_MPS2 * fall_permille / 1000.0
    if atp.guaranteed_decel_mps2 - fall_mps2 < LEAST_DECEL_MPS2:
        yield (
            f"gradients: a fall of {fall_permille:g} ‰ takes {fall_mps2:.3f} m/s² of "
            f"atp.guaranteed_decel_mps2 {atp.guaranteed_decel_mps2:g}; at least "
            f"{LEAST_DECEL_MPS2:g} m/s² must remain"
        )
    for name, own_mps2, slope_mps2, slope in (
        ("guaranteed_decel_mps2", atp.guaranteed_decel_mps2, climb_mps2, "climb"),
        ("runaway_mps2", atp.runaway_mps2, fall_mps2, "fall"),
    ):
        if own_mps2 + slope_mps2 > odometry.max_accel_mps2:
            yield (
                f"gradients: atp.{name} {own_mps2:g} and {slope_mps2:.3f} m/s² of the steepest "
                f"{slope} exceed odometry.max_accel_mps2 {odometry.max_accel_mps2:g} together"
            )
    rolls_m = least_rollback_m(config, line)
    if not rolls_m <= line.rollback_m:
        yield (
            f"gradients: on the climb of {climb_permille:g} ‰ a train rolls back up to "
            f"{rolls_m:.2f} m before its emergency brake holds it, and rollback_m is "
            f"{line.rollback_m:g}; declare more if the wayside keeps it free, or a better brake"
        )


def _of_neutral_section(
    config: VobcConfig, stations: Sequence[Station], coasting: Coasting
) -> Iterator[str]:
    """Without traction the train must come through from the speed at which it enters."""
    section, length_m = coasting.section, config.train.length_m
    where = f"neutral_sections: {section.text}"
    if coasting.entry_mps > coasting.limit_mps:
        yield (
            f"{where}: a train coasts through from {coasting.entry_mps:.1f} m/s at "
            f"{coasting.from_m:.0f} m, and the limit there is {coasting.limit_mps:.1f} m/s; "
            "shorten the section, or move it off the climb"
        )
        return
    for station in stations:
        if section.covers(station.stop_m - length_m, station.stop_m):
            yield f"{where}: a train that stops at {station.name} has no power; move the section"
        elif section.start_m - station.stop_m >= 0.0 and (
            coasting.from_m - station.stop_m < coasting.run_up_m
        ):
            yield (
                f"{where}: a train that sets off at {station.name} may not reach the "
                f"{coasting.entry_mps:.1f} m/s at {coasting.from_m:.0f} m from which it coasts "
                "through; move the section away from the stop"
            )


def _of_power_sections(line: LineMap) -> Iterator[str]:
    """Where a line names its power sections, one of them or a neutral section is everywhere."""
    if not line.power_sections:
        return
    reached_m, before = line.start_m, "the start of the line"
    for section in sorted((*line.power_sections, *line.neutral_sections), key=lambda z: z.start_m):
        if section.start_m > reached_m:
            yield _gap_text(reached_m, section.start_m, before, section.text)
        if section.end_m > reached_m:
            reached_m, before = section.end_m, section.text
    if line.end_m > reached_m:
        yield _gap_text(reached_m, line.end_m, before, "the end of the line")


def _gap_text(from_m: float, to_m: float, before: str, after: str) -> str:
    return (
        f"power_sections: none from {from_m:g} m to {to_m:g} m, between {before} and {after}; "
        "lengthen one, or add a section or a neutral section"
    )


def _of_speeds(config: VobcConfig, line: LineMap) -> Iterator[str]:
    atp, most_mps = config.atp, config.odometry.max_speed_mps
    limit_mps = max(section.limit_mps for section in line.speed_sections)
    gained_mps = atp.runaway_mps2 * atp.runaway_s(config.cycle_ms / 1000.0)
    if limit_mps + atp.emergency_margin_mps + gained_mps > most_mps:
        yield (
            f"speed_sections: {limit_mps:g} m/s, atp.emergency_margin_mps and a runaway exceed "
            f"odometry.max_speed_mps {most_mps:g}"
        )


def _of_platforms(config: VobcConfig, stations: Sequence[Station]) -> Iterator[str]:
    """Wherever in its window the train stops, some doors must be beside the platform."""
    names = [station.name for station in stations if not cars_at(config, station)]
    if not names:
        return
    train = config.train
    whole = "" if train.car_lengths_m else ", or give train.car_lengths_m for doors by car"
    yield (
        f"stations: {', '.join(names)}: no door of the train of {train.length_m:g} m is surely "
        "beside the platform wherever it stops within stop_m ± atp.door_window_m "
        f"{config.atp.door_window_m:g}; move stop_m or the ends of the platform{whole}"
    )


def cars_at(config: VobcConfig, station: Station) -> int:
    """Cars that open wherever in its window the train stops, as a result of `cars_beside`."""
    window_m, train = config.atp.door_window_m, config.train
    return cars_beside(
        station,
        Interval(station.stop_m - window_m, station.stop_m, station.stop_m + window_m),
        train_length_m=train.length_m,
        spans=car_spans(train.car_lengths_m),
    )
