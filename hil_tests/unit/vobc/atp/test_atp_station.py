"""The station guard: doors, departure and alarms, on both sides of every threshold."""

import itertools
import math
from dataclasses import replace
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from can_dbc.alarms import TrainAlarms
from can_dbc.brake import BrakeStatus
from can_dbc.doors import ALL_CARS, DoorState, DoorStatus
from can_dbc.traction import TractionStatus
from can_dbc.vobc import Cause, Inhibit, Missing, Withheld
from firmware_py.trackdb import LineMap, PlatformSide, load_line
from hil_tests.unit.vobc.atp.heard_rig import DESK, NO_ORDERS, SILENCE
from vobc.atp import alarms
from vobc.atp.departure import INHIBIT_WITHOUT, DepartureTerms, inhibits
from vobc.atp.place import PlatformWhereabouts, place_of
from vobc.atp.station import StationGuard, StationVerdict
from vobc.config import load_config
from vobc.vocabulary import Authority, CycleInput, Interval, Motion

LINE = load_line("florence")
CONFIG = load_config("florence4").atp
LENGTH_M = 68.59
STOP_M = 1500.0
"""Stopping point of station I, m. Its platform is on the right and reaches from 1420 m to 1505
m."""
ORDERS = replace(NO_ORDERS, awake=True, doors_right=True, platform_doors_locked=True)


def made(cls: type, **known: Any) -> Any:
    """A frame of the given class; every field that the test does not name is zero."""
    fields = {name: known.get(name, 0) for name in cls.__dataclass_fields__}  # type: ignore[attr-defined]
    return cls(**fields)


SEEN = replace(
    SILENCE,
    brake=made(BrakeStatus, holding_applied=True),
    brake_age_s=0.0,
    traction=made(TractionStatus, traction_cut=True),
    traction_age_s=0.0,
    doors=DoorStatus(True, DoorState.LOCKED, DoorState.LOCKED, True),
    doors_age_s=0.0,
    desk=DESK,
    desk_age_s=0.0,
    authority=Authority(1560.0, 1, 1, rear_m=1400.0),
    authority_age_s=0.0,
    alarms=TrainAlarms(True, True),
    alarms_age_s=0.0,
    orders=ORDERS,
    orders_age_s=0.0,
)
UNLOCKED = replace(SEEN, doors=DoorStatus(False, DoorState.LOCKED, DoorState.FAULT, True))
ALARM = replace(SEEN, desk=replace(DESK, no_passenger_alarm=False))
FIRE = replace(SEEN, alarms=TrainAlarms(True, False))


def standing(front_m: float, half_m: float = 0.0, **changes: Any) -> Motion:
    given_: dict[str, Any] = {
        "front_m": Interval(front_m - half_m, front_m, front_m + half_m),
        "speed_mps": Interval(0.0, 0.0, 0.0),
        "accel_mps2": 0.0,
        "travel_m": front_m,
        "standing": True,
        "standstill": True,
        "localised": True,
        "slip": False,
        "accepted_tag_ids": (),
    }
    return Motion(**{**given_, **changes})


def moving(front_m: float, speed_mps: float = 1.0, half_m: float = 0.0, **changes: Any) -> Motion:
    speed = Interval(speed_mps, speed_mps, speed_mps)
    return standing(
        front_m, half_m, **{"standing": False, "standstill": False, "speed_mps": speed, **changes}
    )


class GuardRig:
    """One station guard with a method that steps it."""

    def __init__(self, line: LineMap = LINE) -> None:
        self.guard = StationGuard(CONFIG, line, train_length_m=LENGTH_M)

    def step(
        self,
        motion: Motion,
        seen: CycleInput = SEEN,
        *,
        gone: int = 0,
        emergency: bool = False,
        may_move: bool = True,
        stop_m: float | None = STOP_M,
    ) -> StationVerdict:
        return self.guard.step(
            seen,
            motion,
            gone=gone,
            emergency=emergency,
            may_move=may_move,
            stopping_at_m=stop_m,
        )


def at_platform(seen: CycleInput = SEEN, **options: Any) -> StationVerdict:
    return GuardRig().step(standing(STOP_M), seen, **options)


def ordered(**orders: Any) -> CycleInput:
    return replace(SEEN, orders=replace(ORDERS, **orders))


# Doors.


def test_a_train_at_its_stopping_point_has_the_doors_of_the_platform_side_enabled() -> None:
    verdict = at_platform()

    assert verdict.doors == (False, True)
    assert verdict.withheld is Withheld.NONE


@pytest.mark.parametrize(
    ("seen", "options", "reason"),
    [
        (ordered(doors_right=False), {}, Withheld.NOT_AUTHORISED),
        (ordered(doors_right=False, doors_left=True), {}, Withheld.NOT_AUTHORISED),
        (replace(SEEN, orders=None), {}, Withheld.NOT_AUTHORISED | Withheld.CENTRE_SILENT),
        (
            replace(SEEN, orders_age_s=CONFIG.orders_age_max_s + 1e-9),
            {},
            Withheld.NOT_AUTHORISED | Withheld.CENTRE_SILENT,
        ),
        (SEEN, {"emergency": True}, Withheld.EMERGENCY),
        (SEEN, {"gone": int(Missing.ODOMETER)}, Withheld.MOVING),
        (SEEN, {"gone": int(Missing.BRAKE)}, Withheld.NOT_HELD),
        (SEEN, {"gone": int(Missing.TRACTION)}, Withheld.TRACTION),
        (replace(SEEN, brake=made(BrakeStatus)), {}, Withheld.NOT_HELD),
        (replace(SEEN, traction=made(TractionStatus)), {}, Withheld.TRACTION),
    ],
)
def test_any_missing_term_disables_the_doors_and_is_named(
    seen: CycleInput, options: dict[str, Any], reason: Withheld
) -> None:
    verdict = at_platform(seen, **options)

    assert verdict.doors == (False, False)
    assert verdict.withheld == reason


def test_orders_of_exactly_the_maximum_age_still_count() -> None:
    assert any(at_platform(replace(SEEN, orders_age_s=CONFIG.orders_age_max_s)).doors)


@pytest.mark.parametrize("side", [-1.0, 1.0])
@pytest.mark.parametrize(("off_m", "enabled"), [(0.29, True), (0.31, False)])
@pytest.mark.parametrize("half_m", [0.0, 0.1, 0.25])
def test_doors_open_within_thirty_centimetres_and_not_beyond(
    off_m: float, side: float, half_m: float, enabled: bool
) -> None:
    """The far end of the interval counts, whatever its width."""
    front_m = STOP_M + side * (off_m - half_m)

    assert any(GuardRig().step(standing(front_m, half_m)).doors) is enabled


def test_a_moving_train_reports_no_withheld_doors_and_enables_none() -> None:
    verdict = GuardRig().step(moving(STOP_M))

    assert verdict.doors == (False, False)
    assert verdict.withheld is Withheld.NONE


def test_a_train_between_stations_reports_no_withheld_doors() -> None:
    assert GuardRig().step(standing(1000.0)).withheld is Withheld.NONE


@pytest.mark.parametrize(
    ("side", "left", "right", "doors"),
    [
        (PlatformSide.LEFT, True, False, (True, False)),
        (PlatformSide.LEFT, False, True, (False, False)),
        (PlatformSide.RIGHT, True, False, (False, False)),
        (PlatformSide.RIGHT, False, True, (False, True)),
        (PlatformSide.BOTH, True, False, (True, False)),
        (PlatformSide.BOTH, False, True, (False, True)),
        (PlatformSide.BOTH, True, True, (True, True)),
        (PlatformSide.BOTH, False, False, (False, False)),
    ],
)
def test_doors_open_on_the_side_that_map_and_centre_both_name(
    side: PlatformSide, left: bool, right: bool, doors: tuple[bool, bool]
) -> None:
    line = replace(LINE, stations=tuple(replace(station, side=side) for station in LINE.stations))

    verdict = GuardRig(line).step(
        standing(STOP_M), ordered(doors_left=left, doors_right=right), stop_m=STOP_M
    )

    assert verdict.doors == doors
    assert (verdict.withheld is Withheld.NONE) is any(doors)


def at_platform_of(
    length_m: float, car_lengths_m: tuple[float, ...] = (), front_m: float = STOP_M
) -> StationVerdict:
    """A train of another length at the stopping point, 80 m from the rear end of the platform."""
    guard = StationGuard(CONFIG, LINE, train_length_m=length_m, car_lengths_m=car_lengths_m)
    return guard.step(
        SEEN, standing(front_m), gone=0, emergency=False, may_move=True, stopping_at_m=STOP_M
    )


def test_a_train_longer_than_the_platform_opens_no_door_and_says_why() -> None:
    verdict = at_platform_of(80.01)

    assert not any(verdict.doors)
    assert verdict.withheld is Withheld.OFF_PLATFORM
    assert any(at_platform_of(80.0).doors)


def test_a_longer_train_opens_the_cars_beside_the_platform_alone() -> None:
    verdict = at_platform_of(117.12, (19.52,) * 6)

    assert verdict.doors == (False, True)
    assert verdict.door_cars == 0b001111
    assert verdict.withheld is Withheld.NONE


def test_off_its_stopping_point_no_car_is_compared_with_the_platform() -> None:
    verdict = at_platform_of(117.12, (19.52,) * 6, front_m=STOP_M - 1.0)

    assert not any(verdict.doors)
    assert verdict.door_cars == ALL_CARS


def test_a_train_beside_its_platform_opens_all_doors() -> None:
    assert at_platform().door_cars == ALL_CARS
    assert at_platform_of(78.08, (19.52,) * 4).door_cars == ALL_CARS


def test_a_train_without_position_opens_no_doors() -> None:
    assert not any(GuardRig().step(standing(STOP_M, localised=False)).doors)


# Departure.


def test_every_combination_of_the_terms_of_departure() -> None:
    """Only one of the 1024 combinations lets a train depart, and the guard names exactly the
    missing terms."""
    free = 0
    for values in itertools.product((False, True), repeat=len(DepartureTerms._fields)):
        terms = DepartureTerms(*values)
        said = inhibits(terms)
        free += said is Inhibit.NONE
        for name, value in terms._asdict().items():
            assert (INHIBIT_WITHOUT[name] in said) is not value
    assert free == 1


@pytest.mark.parametrize(
    ("seen", "options", "flags"),
    [
        (SEEN, {}, Inhibit.NONE),
        (UNLOCKED, {}, Inhibit.DOORS),
        (SEEN, {"gone": int(Missing.DOORS)}, Inhibit.DOORS),
        (ordered(platform_doors_locked=False), {}, Inhibit.PLATFORM_DOORS),
        (ordered(hold=True), {}, Inhibit.HOLD),
        (ordered(awake=False), {}, Inhibit.ASLEEP),
        (ordered(emergency=True), {}, Inhibit.EMERGENCY),
        (SEEN, {"emergency": True}, Inhibit.EMERGENCY),
        (replace(SEEN, orders=None), {}, Inhibit.CENTRE_SILENT | Inhibit.PLATFORM_DOORS),
        (SEEN, {"gone": int(Missing.AUTHORITY)}, Inhibit.AUTHORITY),
        (replace(SEEN, authority=Authority(STOP_M, 1, 1)), {}, Inhibit.AUTHORITY),
        (replace(SEEN, authority=Authority(STOP_M + 0.01, 1, 1)), {}, Inhibit.NONE),
        (ALARM, {}, Inhibit.PASSENGER_ALARM),
        (FIRE, {}, Inhibit.FIRE),
        (replace(SEEN, alarms=TrainAlarms(False, True)), {}, Inhibit.OBSTACLE),
        (
            replace(SEEN, alarms_age_s=CONFIG.timeouts.alarms_s + 1e-9),
            {},
            Inhibit.OBSTACLE,
        ),
    ],
)
def test_every_departure_inhibit_is_named(
    seen: CycleInput, options: dict[str, Any], flags: Inhibit
) -> None:
    assert at_platform(seen, **options).inhibits == flags


@pytest.mark.parametrize(
    "seen", [UNLOCKED, ordered(platform_doors_locked=False), replace(SEEN, orders=None)]
)
def test_the_sealed_switch_stands_in_for_locked_doors_and_is_logged(seen: CycleInput) -> None:
    verdict = at_platform(replace(seen, desk=replace(DESK, door_bypass_requested=True)))

    assert not verdict.inhibits & (Inhibit.DOORS | Inhibit.PLATFORM_DOORS)
    assert verdict.door_bypass


def test_a_bypass_without_a_missing_term_does_not_count() -> None:
    bypassed = replace(SEEN, desk=replace(DESK, door_bypass_requested=True))

    assert not at_platform(bypassed).door_bypass


def test_a_bypass_from_a_silent_desk_does_not_count() -> None:
    seen = replace(UNLOCKED, desk=replace(DESK, door_bypass_requested=True))

    verdict = at_platform(seen, gone=int(Missing.DESK))

    assert not verdict.door_bypass
    assert verdict.inhibits & Inhibit.DOORS


@pytest.mark.parametrize("front_m", [1000.0, STOP_M - 30.0])
def test_a_hold_applies_at_a_platform_and_not_on_the_way_to_it(front_m: float) -> None:
    assert GuardRig().step(standing(front_m), ordered(hold=True)).inhibits is Inhibit.NONE


def test_between_stations_a_silent_centre_has_no_platform_doors() -> None:
    verdict = GuardRig().step(standing(1000.0), replace(SEEN, orders=None))

    assert verdict.inhibits == Inhibit.CENTRE_SILENT


def test_between_stations_platform_doors_that_the_centre_reports_still_count() -> None:
    verdict = GuardRig().step(standing(1000.0), ordered(platform_doors_locked=False))

    assert verdict.inhibits == Inhibit.PLATFORM_DOORS


def test_room_to_the_end_of_authority_begins_at_the_foremost_front() -> None:
    ends = replace(SEEN, authority=Authority(STOP_M + 0.05, 1, 1))

    assert GuardRig().step(standing(STOP_M, half_m=0.1), ends).inhibits == Inhibit.AUTHORITY
    assert GuardRig().step(standing(STOP_M, half_m=0.01), ends).inhibits is Inhibit.NONE


def test_a_train_that_has_just_come_to_rest_has_not_departed() -> None:
    """Standstill is not proven yet but the wheels are still, so the guard treats the train as
    standing."""
    bench = GuardRig()
    bench.step(standing(STOP_M))

    verdict = bench.step(standing(1000.0, standstill=False), UNLOCKED)

    assert verdict.emergency is Cause.NONE
    assert verdict.inhibits == Inhibit.DOORS


# Where the train is.


@pytest.mark.parametrize(
    ("front_m", "where"),
    [
        (1419.9, PlatformWhereabouts.BETWEEN),
        (1420.0, PlatformWhereabouts.ARRIVING),
        (1499.69, PlatformWhereabouts.ARRIVING),
        (1499.71, PlatformWhereabouts.ALIGNED),
        (1500.29, PlatformWhereabouts.ALIGNED),
        (1500.31, PlatformWhereabouts.PAST),
        (1500.4, PlatformWhereabouts.PAST),
        (1505.0 + LENGTH_M, PlatformWhereabouts.PAST),
        (1505.1 + LENGTH_M, PlatformWhereabouts.BETWEEN),
    ],
)
def test_a_platform_is_left_when_the_rear_is_clear(
    front_m: float, where: PlatformWhereabouts
) -> None:
    place = place_of(
        LINE.stations,
        Interval(front_m, front_m, front_m),
        train_length_m=LENGTH_M,
        window_m=0.3,
    )

    assert place.where is where


def test_a_wide_interval_about_the_stopping_point_is_near_it() -> None:
    place = place_of(
        LINE.stations, Interval(1499.6, 1499.9, 1500.2), train_length_m=LENGTH_M, window_m=0.3
    )

    assert place.where is PlatformWhereabouts.NEAR


def test_an_unlocked_train_that_stops_at_the_end_of_the_window_needs_no_emergency_brake() -> None:
    bench = GuardRig()
    bench.step(standing(1000.0))

    assert bench.step(moving(1500.24, 0.3, 0.08), UNLOCKED).emergency is Cause.NONE


@given(st.floats(-100.0, 4700.0), st.floats(0.0, 5.0), st.floats(0.0, 5.0))
def test_the_tables_cover_every_place(best_m: float, behind_m: float, ahead_m: float) -> None:
    front_m = Interval(best_m - behind_m, best_m, best_m + ahead_m)
    where, station = place_of(
        LINE.stations, front_m, train_length_m=LENGTH_M, window_m=CONFIG.door_window_m
    )

    for table in (alarms.PASSENGER_ALARM, alarms.FIRE, alarms.DOOR_UNLOCKED):
        assert alarms.AlarmGuardInputs(where, False) in table
        if station is not None:
            assert alarms.AlarmGuardInputs(where, True) in table


# Doors that lose their lock in motion.


def departed(moved_m: float, seen: CycleInput) -> StationVerdict:
    bench = GuardRig()
    bench.step(standing(STOP_M))
    return bench.step(moving(STOP_M + moved_m), seen, stop_m=3000.0)


@pytest.mark.parametrize("moved_m", [-0.2, 0.2, 1.0, 5.0, 40.0, 5.0 + LENGTH_M])
def test_a_door_that_unlocks_before_the_rear_is_clear_stops_the_train(moved_m: float) -> None:
    assert departed(moved_m, UNLOCKED).emergency is Cause.DOOR_UNLOCKED


@pytest.mark.parametrize("moved_m", [5.1 + LENGTH_M, 500.0])
def test_clear_of_the_platform_the_train_goes_on_to_the_next_station(moved_m: float) -> None:
    verdict = departed(moved_m, UNLOCKED)

    assert verdict.emergency is Cause.NONE
    assert verdict.stop_next


def test_a_train_that_arrives_with_an_unlocked_door_stops_normally() -> None:
    bench = GuardRig()
    bench.step(standing(1000.0))
    for front_m in (1300.0, 1450.0, 1499.0, 1500.2):
        assert bench.step(moving(front_m), UNLOCKED).emergency is Cause.NONE
    assert bench.step(moving(1500.4), UNLOCKED).emergency is Cause.DOOR_UNLOCKED


def test_a_held_train_that_moves_a_little_with_open_doors_needs_no_emergency_brake() -> None:
    assert departed(0.09, UNLOCKED).emergency is Cause.NONE


@pytest.mark.parametrize(
    ("travel_m", "cause"),
    [(0.1, Cause.NONE), (math.nextafter(0.1, 1.0), Cause.DOOR_UNLOCKED)],
)
def test_a_held_train_may_move_ten_centimetres_by_the_pulses(travel_m: float, cause: Cause) -> None:
    bench = GuardRig()
    bench.step(standing(STOP_M, travel_m=0.0))

    assert bench.step(moving(STOP_M, travel_m=travel_m), UNLOCKED).emergency is cause


def test_a_momentary_pause_of_the_wheels_is_no_stop() -> None:
    """A movement counts from the place of the last proven standstill."""
    bench = GuardRig()
    bench.step(standing(STOP_M))
    bench.step(standing(STOP_M + 0.2, standstill=False))

    assert bench.step(moving(STOP_M + 0.25), UNLOCKED).emergency is Cause.DOOR_UNLOCKED


@pytest.mark.parametrize("localised", [True, False])
def test_open_doors_of_a_standing_train_request_no_brake_and_no_stop(localised: bool) -> None:
    verdict = GuardRig().step(standing(STOP_M, localised=localised), UNLOCKED)

    assert verdict.emergency is Cause.NONE
    assert not verdict.stop_next
    assert not verdict.stop_now


def test_with_the_sealed_switch_a_train_departs_with_a_door_that_is_not_locked() -> None:
    bypassed = replace(UNLOCKED, desk=replace(DESK, door_bypass_requested=True))

    verdict = departed(40.0, bypassed)

    assert verdict.emergency is Cause.NONE
    assert not verdict.stop_next
    assert verdict.door_bypass


def test_without_a_place_an_unlocked_door_stops_the_train() -> None:
    bench = GuardRig()
    bench.step(standing(1000.0))

    verdict = bench.step(moving(1100.0, localised=False), UNLOCKED)

    assert verdict.emergency is Cause.DOOR_UNLOCKED


# Alarms.


@pytest.mark.parametrize("seen", [ALARM, FIRE])
def test_an_alarm_at_a_platform_opens_doors_and_keeps_the_train(seen: CycleInput) -> None:
    verdict = at_platform(seen)

    assert any(verdict.doors)
    assert verdict.keep_doors_open
    assert verdict.alarm_raised
    assert verdict.emergency is Cause.NONE


@pytest.mark.parametrize(
    ("moved_m", "seen", "emergency", "stop_now", "stop_next"),
    [
        (0.29, ALARM, Cause.NONE, True, False),
        (0.31, ALARM, Cause.PASSENGER_ALARM, False, False),
        (5.0 + LENGTH_M, ALARM, Cause.PASSENGER_ALARM, False, False),
        (5.1 + LENGTH_M, ALARM, Cause.NONE, False, True),
        (0.29, FIRE, Cause.NONE, True, False),
        (0.31, FIRE, Cause.NONE, False, True),
        (500.0, FIRE, Cause.NONE, False, True),
    ],
)
def test_what_a_departing_train_does_about_an_alarm(
    moved_m: float, seen: CycleInput, emergency: Cause, stop_now: bool, stop_next: bool
) -> None:
    verdict = departed(moved_m, seen)

    assert (verdict.emergency, verdict.stop_now, verdict.stop_next) == (
        emergency,
        stop_now,
        stop_next,
    )


def test_an_alarm_in_a_train_that_runs_past_its_stop_brings_the_emergency_brake() -> None:
    """The train did not stand here, but people on the platform may have caught hold of it."""
    bench = GuardRig()
    bench.step(standing(1000.0))

    assert bench.step(moving(1520.0), ALARM).emergency is Cause.PASSENGER_ALARM


def test_an_arriving_train_takes_an_alarm_to_its_stopping_point() -> None:
    bench = GuardRig()
    bench.step(standing(1000.0))

    verdict = bench.step(moving(1460.0, 12.0), ALARM)

    assert verdict.emergency is Cause.NONE
    assert verdict.stop_next


@pytest.mark.parametrize("seen", [ALARM, FIRE])
def test_the_stop_counts_as_ordered_until_the_train_stands_there(seen: CycleInput) -> None:
    bench = GuardRig()
    bench.step(standing(1000.0))
    assert bench.step(moving(1499.9, 0.3), seen).stop_next
    assert not bench.step(standing(1500.0), seen).stop_next


@pytest.mark.parametrize("alarm", [ALARM, FIRE])
def test_a_short_alarm_on_the_way_is_kept_until_the_train_stood_at_a_platform(
    alarm: CycleInput,
) -> None:
    bench = GuardRig()
    bench.step(standing(1000.0))
    bench.step(moving(1100.0), alarm)
    assert bench.step(moving(1300.0)).stop_next
    assert bench.step(moving(1460.0)).stop_next
    assert bench.step(moving(1490.0)).alarm_raised
    assert bench.step(standing(1350.0)).stop_next
    assert bench.step(standing(1350.0)).inhibits is Inhibit.NONE

    assert not bench.step(standing(STOP_M)).stop_next
    assert not bench.step(moving(1700.0)).stop_next


@pytest.mark.parametrize("speed_mps", [0.0, 1.0, 15.0])
@pytest.mark.parametrize("front_m", [1000.0, STOP_M, 1540.0])
def test_an_obstacle_stops_the_train_wherever_it_is(front_m: float, speed_mps: float) -> None:
    verdict = GuardRig().step(
        moving(front_m, speed_mps), replace(SEEN, alarms=TrainAlarms(False, True))
    )

    assert verdict.emergency is Cause.OBSTACLE
    assert verdict.alarm_raised


def test_silent_detectors_are_no_alarm_but_inhibit_departure() -> None:
    verdict = at_platform(replace(SEEN, alarms=None, alarms_age_s=math.inf))

    assert verdict.emergency is Cause.NONE
    assert not verdict.alarm_raised
    assert verdict.inhibits == Inhibit.OBSTACLE


# Orders.


def test_an_order_to_stop_at_the_next_station_is_passed_on() -> None:
    assert GuardRig().step(moving(1000.0), ordered(stop_next=True)).stop_next
    assert not GuardRig().step(moving(1000.0)).stop_next
