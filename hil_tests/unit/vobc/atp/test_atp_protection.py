"""Protection as a whole: sequences of modes, ceilings, jogs, bypass and orders."""

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import pytest

from can_dbc.alarms import TrainAlarms
from can_dbc.tags import TagReaderHealth
from can_dbc.vobc import Cause, Inhibit, Missing, OperatingMode, Supervision
from hil_tests.unit.vobc.atp.heard_rig import DESK
from hil_tests.unit.vobc.atp.protection_rig import (
    BETWEEN_M,
    CONFIG,
    CYCLE_S,
    FREE_BRAKE,
    KMH,
    LINE,
    MANUAL,
    ORDERS,
    STOP_M,
    UNLOCKED,
    WHOLE,
    Train,
)
from vobc.atp import ProtectionVerdict
from vobc.atp.energy_check import Replicas
from vobc.vocabulary import NEVER_S, Authority, Restriction


def assert_held(verdict: ProtectionVerdict) -> None:
    assert not verdict.emergency_released
    assert not verdict.traction_permitted
    assert not verdict.reverse_permitted
    assert verdict.service_brake


@pytest.mark.parametrize("high_m", [BETWEEN_M - 1.0, -math.inf, math.inf, math.nan])
def test_an_impossible_position_permits_no_movement(high_m: float) -> None:
    train = Train()
    train.step(2)
    good = train.motion()

    verdict = train.protection.step(
        train.image,
        replace(good, front_m=replace(good.front_m, high=high_m)),
        odometer_usable=True,
        not_finite=False,
    )

    assert verdict.ceiling is not None
    assert verdict.ceiling.emergency_mps == 0.0
    assert not verdict.traction_permitted


# Sleep.


def test_a_sleeping_train_is_held_without_doors_until_it_is_woken() -> None:
    train = Train(STOP_M)
    train.change(brake=replace(FREE_BRAKE, holding_applied=True))
    assert any(train.step(3).doors)

    train.change(orders=replace(ORDERS, awake=False))
    asleep = train.step(3)
    train.change(orders_age_s=99.0)
    forgotten = train.step(3)
    train.change(orders=ORDERS, orders_age_s=0.0)
    woken = train.step(3)

    for verdict in (asleep, forgotten):
        assert verdict.mode is OperatingMode.ASLEEP
        assert verdict.cause == "asleep"
        assert_held(verdict)
        assert verdict.hold
        assert not any(verdict.doors)
        assert Inhibit.ASLEEP in verdict.departure_inhibits
        assert not verdict.keep_doors_open
    assert woken.mode is OperatingMode.AUTHORISED
    assert woken.supervision is Supervision.NOMINAL


def test_a_moving_train_is_not_put_to_sleep() -> None:
    train = Train()
    train.runs(5.0)
    train.change(orders=replace(ORDERS, awake=False))

    assert train.step().mode is OperatingMode.AUTHORISED


def test_a_train_that_is_moved_in_its_sleep_brakes() -> None:
    train = Train()
    train.change(orders=replace(ORDERS, awake=False))
    train.step(3)
    train.speed_mps = 0.5

    verdict = train.step(20)

    assert verdict.emergency_cause is Cause.ASLEEP_MOVED
    assert verdict.mode is OperatingMode.ASLEEP


# On sight.


def on_sight(**desk: Any) -> Train:
    train = Train()
    train.lost()
    train.change(desk=replace(MANUAL, restricted_requested=True, **desk))
    return train


def test_without_position_and_authority_a_driver_may_run_at_25_km_per_hour() -> None:
    verdict = on_sight().runs(20.0 * KMH)

    assert verdict.mode is OperatingMode.RESTRICTED
    assert verdict.supervision is Supervision.NOMINAL
    assert verdict.traction_permitted
    assert verdict.ceiling is not None
    assert verdict.ceiling.permitted_mps == pytest.approx(25.0 * KMH)
    assert verdict.ceiling.emergency_mps <= 30.0 * KMH + 1e-9
    assert verdict.missing == Missing.AUTHORITY | Missing.LOCALISATION


def test_the_centre_may_permit_driving_on_sight_to_a_driver_only() -> None:
    allowed = replace(ORDERS, restricted=True)
    train = Train()
    train.lost()
    train.change(orders=allowed, desk=MANUAL)
    alone = Train()
    alone.lost()
    alone.change(orders=allowed)

    assert train.step(2).mode is OperatingMode.RESTRICTED
    assert alone.step(2).mode is OperatingMode.STANDBY


@pytest.mark.parametrize(
    ("over_mps", "state"),
    [
        (CONFIG.flat_service_margin_mps - 0.001, Supervision.NOMINAL),
        (CONFIG.flat_service_margin_mps + 0.001, Supervision.SERVICE),
        (CONFIG.flat_emergency_margin_mps - 0.001, Supervision.SERVICE),
        (CONFIG.flat_emergency_margin_mps + 0.001, Supervision.EMERGENCY),
    ],
)
def test_the_restricted_speed_has_small_margins_of_its_own(
    over_mps: float, state: Supervision
) -> None:
    train = on_sight()
    train.half_mps = 1.0

    verdict = train.runs(CONFIG.restricted_mps + over_mps - train.half_mps)

    assert verdict.supervision is state


def test_on_sight_radio_and_position_may_be_lost_but_not_the_desk() -> None:
    train = on_sight()
    train.runs(5.0)
    assert train.step(200).supervision is Supervision.NOMINAL

    train.change(desk_age_s=9.0)

    assert train.step().emergency_cause is Cause.VITAL_INPUT_LOST


def test_a_person_who_leaves_the_desk_mode_in_motion_is_braked_to_standstill() -> None:
    train = on_sight()
    train.runs(5.0)

    train.change(desk=DESK)
    braked = train.step()
    train.speed_mps = 0.0
    stands = train.step(60)

    assert braked.supervision is Supervision.SERVICE
    assert braked.cause == "driving on sight is no longer permitted"
    assert stands.mode is OperatingMode.STANDBY
    assert stands.supervision is Supervision.NO_AUTHORITY


def test_a_known_end_of_authority_is_kept_on_sight() -> None:
    train = Train()
    train.change(
        desk=replace(MANUAL, restricted_requested=True),
        tag_reader=TagReaderHealth(False, 0, 0.0),
        authority=Authority(BETWEEN_M + 20.0, 1, 1),
    )

    near = train.step(2)
    train.change(authority=Authority(BETWEEN_M + 1000.0, 1, 2))
    far = train.step()

    assert near.mode is far.mode is OperatingMode.RESTRICTED
    assert near.ceiling is not None
    assert far.ceiling is not None
    assert near.ceiling.emergency_mps < 20.0 * KMH
    assert far.ceiling.permitted_mps == pytest.approx(25.0 * KMH)


def test_on_sight_without_authority_civil_limits_and_restrictions_still_hold() -> None:
    train = Train()
    slow = Restriction(BETWEEN_M - 20.0, BETWEEN_M + 20.0, 3.0)
    train.change(
        desk=replace(MANUAL, restricted_requested=True),
        authority_age_s=9.0,
        orders=replace(ORDERS, restrictions=(slow,)),
    )

    verdict = train.step(2)

    assert verdict.mode is OperatingMode.RESTRICTED
    assert verdict.ceiling is not None
    assert verdict.ceiling.permitted_mps == 3.0
    assert verdict.ceiling.distance_to_authority_m == 0.0


def test_on_sight_without_any_orders_the_line_alone_counts() -> None:
    train = Train()
    train.change(desk=replace(MANUAL, restricted_requested=True), authority_age_s=9.0, orders=None)

    verdict = train.step(2)

    assert verdict.mode is OperatingMode.RESTRICTED
    assert verdict.ceiling is not None
    assert verdict.ceiling.permitted_mps == pytest.approx(25.0 * KMH)


def test_full_supervision_takes_over_a_running_train_only_with_every_input() -> None:
    train = on_sight()
    train.runs(5.0)

    train.change(authority=Authority(train.front_m + 1000.0, 1, 1), authority_age_s=0.1)
    only_authority = train.step()
    train.localised = True
    both = train.step()

    assert only_authority.mode is OperatingMode.RESTRICTED
    assert both.mode is OperatingMode.AUTHORISED
    assert both.ceiling is not None
    assert both.ceiling.permitted_mps > 10.0


def test_a_driverless_train_creeps_on_order_and_stops_when_the_order_expires() -> None:
    train = Train()
    train.lost()
    train.change(orders=replace(ORDERS, creep=True))

    creeps = train.runs(3.0)
    train.change(orders_age_s=CONFIG.orders_age_max_s)
    still = train.step()
    train.change(orders_age_s=CONFIG.orders_age_max_s + 1e-6)
    over = train.step()

    assert creeps.mode is OperatingMode.CREEP
    assert creeps.creep
    assert creeps.ceiling is not None
    assert creeps.ceiling.permitted_mps == pytest.approx(15.0 * KMH)
    assert still.supervision is Supervision.NOMINAL
    assert over.supervision is Supervision.SERVICE


# Restrictions and the end of the map belong to every permission.


@pytest.mark.parametrize(
    "orders", [{"orders": None, "orders_age_s": NEVER_S}, {"orders_age_s": 60.1}]
)
def test_without_recent_orders_no_train_begins_under_full_supervision(
    orders: dict[str, Any],
) -> None:
    train = Train()
    train.change(**orders)

    verdict = train.step(2)

    assert verdict.mode is OperatingMode.STANDBY
    assert Missing.AUTHORITY in verdict.missing
    assert "orders of the centre" in verdict.cause


@pytest.mark.parametrize(
    ("age_s", "supervision"),
    [
        (35.9, Supervision.NOMINAL),
        (36.0, Supervision.SERVICE),
        (59.9, Supervision.SERVICE),
        (60.0, Supervision.EMERGENCY),
        (math.nan, Supervision.EMERGENCY),
    ],
)
def test_old_restrictions_brake_a_train_as_an_old_authority_does(
    age_s: float, supervision: Supervision
) -> None:
    train = Train()
    train.runs(5.0)
    train.change(orders_age_s=age_s)

    verdict = train.step()

    assert verdict.supervision is supervision
    if supervision is Supervision.SERVICE:
        assert verdict.cause == "restrictions are getting old"
    if supervision is Supervision.EMERGENCY:
        assert verdict.emergency_cause is Cause.AUTHORITY_OLD


@pytest.mark.parametrize("age_s", [0.2, CONFIG.orders_age_max_s + 1.0, 40.0])
def test_the_last_restrictions_hold_while_the_centre_is_silent(age_s: float) -> None:
    """Both computations hold them: either of the two brakes a train that is too fast for them."""
    train = Train()
    slow = Restriction(BETWEEN_M - 50.0, BETWEEN_M + 500.0, 5.0)
    train.change(orders=replace(ORDERS, restrictions=(slow,)))
    train.runs(4.0)
    train.change(orders_age_s=age_s)

    ceiling = train.step().ceiling
    train.speed_mps = 9.0
    fast = train.step()

    assert ceiling is not None
    assert ceiling.permitted_mps == 5.0
    assert fast.emergency_cause is Cause.OVERSPEED


def test_full_supervision_does_not_take_over_a_train_that_has_no_orders() -> None:
    train = on_sight()
    train.runs(5.0)
    train.localised = True
    train.change(
        authority=Authority(train.front_m + 1000.0, 1, 1), authority_age_s=0.1, orders=None
    )

    assert train.step(3).mode is OperatingMode.RESTRICTED


@pytest.mark.parametrize("on_sight", [False, True])
def test_nothing_is_permitted_beyond_the_end_of_the_map(on_sight: bool) -> None:
    train = Train(front_m=LINE.end_m - 30.0)
    train.change(authority=Authority(LINE.end_m + 5000.0, 1, 1))
    if on_sight:
        train.change(desk=replace(MANUAL, restricted_requested=True), authority_age_s=9.0)

    near = train.step(2)
    train.front_m = LINE.end_m
    at_end = train.step()

    assert near.ceiling is not None
    assert 0.0 < near.ceiling.permitted_mps < 5.0
    assert at_end.ceiling is not None
    assert at_end.ceiling.permitted_mps == 0.0
    assert at_end.hold


def test_a_standing_train_without_traction_is_held() -> None:
    """A lever forward asks for no hold. The holding brake stays where nothing is permitted."""
    train = Train()
    held = train.step(3).hold
    train.change(authority=Authority(train.front_m + 0.5, 1, 1))
    near_end = train.step()

    assert not held
    assert near_end.supervision is Supervision.NOMINAL
    assert near_end.departure_inhibits == Inhibit.NONE
    assert not near_end.traction_permitted
    assert near_end.hold


# Emergencies from the centre, the brake unit, the clock and the second computation.


def test_an_order_to_brake_lasts_through_silence_until_the_centre_releases_it() -> None:
    train = Train()
    train.runs(5.0)
    train.change(orders=replace(ORDERS, emergency=True))
    assert train.step().emergency_cause is Cause.REMOTE
    train.speed_mps = 0.0
    train.change(orders_age_s=99.0)
    train.step(100)

    train.change(desk=replace(DESK, reset_requested=True))
    by_desk = train.step(2)
    train.change(desk=DESK, orders=ORDERS, orders_age_s=0.0)
    withdrawn = train.step(2)
    train.change(orders=replace(ORDERS, releases=1, released_emergency=1))
    released = train.step()

    assert by_desk.emergency_cause is Cause.REMOTE
    assert withdrawn.emergency_cause is Cause.REMOTE
    assert released.supervision is Supervision.NO_AUTHORITY
    assert released.emergency_cause is Cause.NONE
    assert train.step().supervision is Supervision.NOMINAL


def test_a_cause_that_comes_again_while_it_is_latched_has_a_new_number() -> None:
    """A reset that the centre gave between the two is for the first one."""
    train = Train()
    train.runs(5.0)
    train.speed_mps = 0.0
    numbers = []
    for touched in (True, True, False, False, True, False):
        train.change(alarms=TrainAlarms(no_obstacle=not touched, no_fire=True))
        numbers.append(train.step().emergency_number)

    assert numbers == [1, 1, 1, 1, 2, 2]


def test_each_latched_cause_has_a_number_of_its_own() -> None:
    train = Train()
    numbers = [train.runs(5.0).emergency_number]
    train.change(desk=replace(DESK, emergency_released=False))
    numbers += [train.step().emergency_number, train.step().emergency_number]
    train.change(orders=replace(ORDERS, emergency=True))
    numbers.append(train.step().emergency_number)

    assert numbers == [0, 1, 1, 2]


@pytest.mark.parametrize(("silent_s", "named", "releases"), [
    (0.0, 1, True), (0.0, 0, False), (0.0, 2, False), (6.0, 1, False),
])  # fmt: skip
def test_the_centre_releases_the_emergency_that_it_names_if_the_train_could_receive_it(
    silent_s: float, named: int, releases: bool
) -> None:
    train = Train()
    train.runs(5.0)
    train.change(alarms=TrainAlarms(no_obstacle=False, no_fire=True))
    assert train.step().emergency_cause is Cause.OBSTACLE
    train.speed_mps = 0.0
    train.change(alarms=TrainAlarms(no_obstacle=True, no_fire=True), orders_age_s=silent_s)
    train.step(100)

    train.change(orders=replace(ORDERS, releases=1, released_emergency=named), orders_age_s=0.0)

    assert (train.step().emergency_cause is Cause.NONE) is releases


def test_a_reset_of_the_centre_that_came_too_early_releases_nothing_later() -> None:
    train = Train()
    train.runs(5.0)
    train.change(desk=replace(DESK, emergency_released=False))
    train.step()
    train.change(desk=DESK, orders=replace(ORDERS, releases=1, released_emergency=1))
    train.step()
    train.speed_mps = 0.0

    assert train.step(100).emergency_cause is Cause.BUTTON


def test_a_brake_unit_that_brakes_by_itself_is_latched() -> None:
    train = Train()
    train.change(brake=replace(FREE_BRAKE, emergency_applied=True))
    train.step(2)
    train.speed_mps = 5.0
    early = train.step(20)
    train.change(brake=FREE_BRAKE)
    train.step(20)
    train.change(brake=replace(FREE_BRAKE, emergency_applied=True))
    late = train.step()
    train.change(brake=FREE_BRAKE)

    assert early.supervision is Supervision.NOMINAL
    assert late.emergency_cause is Cause.BRAKE_UNIT
    assert train.step(10).emergency_cause is Cause.BRAKE_UNIT


@pytest.mark.parametrize("dt_s", [0.0, -0.05, 0.5, math.nan])
def test_a_clock_that_steps_brings_the_emergency_brake_even_at_rest(dt_s: float) -> None:
    train = Train()
    train.step(2)
    train.change(dt_s=dt_s)

    assert train.step().emergency_cause is Cause.CLOCK_STEPPED


def test_two_computations_that_disagree_bring_the_emergency_brake(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    train = Train()
    train.runs(5.0)
    monkeypatch.setattr(Replicas, "agree", lambda *_args: False)

    verdict = train.step()

    assert verdict.emergency_cause is Cause.REPLICAS_DISAGREE
    assert not verdict.replicas_agree
    assert_held(verdict)


def test_a_silent_odometer_brings_the_emergency_brake() -> None:
    train = Train()
    train.runs(5.0)

    def blind() -> ProtectionVerdict:
        return train.protection.step(train.image, None, odometer_usable=False, not_finite=False)

    first, second = blind(), blind()

    for verdict in (first, second):
        assert verdict.emergency_cause is Cause.VITAL_INPUT_LOST
        assert verdict.cause == "vital input lost while moving"
        assert verdict.supervision is Supervision.EMERGENCY
        assert_held(verdict)
    assert train.step().emergency_cause is Cause.VITAL_INPUT_LOST


# Doors, departure, stations.


def test_with_doors_not_proven_locked_a_train_departs_only_bypassed_and_slowly() -> None:
    train = Train()
    train.change(doors=UNLOCKED)
    without = train.step(3)

    train.change(desk=replace(MANUAL, door_bypass_requested=True))
    bypassed = train.step(3)

    assert not without.traction_permitted
    assert Inhibit.DOORS in without.departure_inhibits
    assert bypassed.traction_permitted
    assert bypassed.door_bypass
    assert not bypassed.doors_locked
    assert bypassed.ceiling is not None
    assert bypassed.ceiling.permitted_mps == pytest.approx(25.0 * KMH)


def test_a_door_unit_that_is_silent_can_be_bypassed_as_well() -> None:
    train = Train()
    train.change(doors_age_s=9.0)
    assert train.step(3).supervision is Supervision.NO_AUTHORITY

    train.change(desk=replace(MANUAL, door_bypass_requested=True))

    assert train.step(3).traction_permitted


def test_a_bypass_that_is_pressed_in_motion_changes_nothing_before_the_train_stands() -> None:
    train = Train()
    train.runs(15.0)
    train.change(doors=UNLOCKED, desk=replace(DESK, door_bypass_requested=True))

    verdict = train.step()

    assert verdict.supervision is Supervision.NOMINAL
    assert not verdict.door_bypass
    assert not verdict.traction_permitted


def test_an_order_to_stay_holds_a_standing_train_against_any_lever() -> None:
    train = Train(STOP_M)
    train.change(orders=replace(ORDERS, hold=True), desk=replace(MANUAL, lever_percent=100.0))

    verdict = train.step(3)

    assert verdict.departure_inhibits == Inhibit.HOLD
    assert verdict.hold
    assert not verdict.traction_permitted
    assert verdict.emergency_released


def test_a_single_wheel_pulse_does_not_end_an_order_to_stay() -> None:
    train = Train(STOP_M)
    train.change(orders=replace(ORDERS, hold=True), desk=replace(MANUAL, lever_percent=100.0))
    train.step(3)

    train.speed_mps = 0.09 / CYCLE_S
    pulse = train.step()
    train.speed_mps = 0.02 / CYCLE_S
    moved = train.step()

    assert pulse.departure_inhibits == Inhibit.HOLD
    assert pulse.hold
    assert not pulse.traction_permitted
    assert not moved.departure_inhibits
    assert moved.traction_permitted


def test_a_train_without_obstacle_detection_goes_on_to_the_next_station_and_stays() -> None:
    train = Train()
    assert not train.runs(5.0).stop_next

    train.change(alarms_age_s=9.0)
    moving = train.step()
    train.speed_mps = 0.0
    stands = train.step(60)

    assert moving.supervision is Supervision.NOMINAL
    assert moving.stop_next
    assert stands.supervision is Supervision.NO_AUTHORITY


def test_a_train_that_ignores_an_order_to_stop_now_is_braked() -> None:
    """A passenger pulls the alarm just as the train begins to leave its stopping point."""
    train = Train(STOP_M)
    train.step(2)
    train.change(desk=replace(DESK, no_passenger_alarm=False))
    train.speed_mps = 1e-6
    train.travel_m = 0.2

    patient = train.step(round(CONFIG.stop_patience_s / CYCLE_S) - 1)
    braked = train.step(5)

    assert patient.stop_now
    assert patient.supervision is Supervision.NOMINAL
    assert braked.supervision is Supervision.SERVICE
    assert braked.cause == "operation does not stop as asked"


# Jogs.


def short_of_the_stop(off_m: float, rear_m: float | None = None) -> Train:
    train = Train(STOP_M + off_m)
    train.stopping_at_m = STOP_M
    train.change(authority=Authority(STOP_M + 500.0, 1, 1, rear_m))
    return train


def test_a_jog_forwards_is_slow_and_needs_no_protected_rear() -> None:
    verdict = short_of_the_stop(-1.0).step(4)

    assert verdict.mode is OperatingMode.JOG
    assert verdict.jog_permitted
    assert verdict.jog_back_m == 0.0
    assert not verdict.reverse_permitted
    assert verdict.traction_permitted
    assert verdict.ceiling is not None
    assert verdict.ceiling.permitted_mps == pytest.approx(5.0 * KMH)


def test_a_jog_back_needs_a_protected_rear() -> None:
    length_m = WHOLE.train.length_m
    covered = short_of_the_stop(0.8, STOP_M - length_m - 20.0).step(4)
    bare = short_of_the_stop(0.8, None).step(4)
    short = short_of_the_stop(0.8, STOP_M - length_m + 0.5).step(4)

    assert covered.jog_permitted
    assert covered.reverse_permitted
    assert 0.8 <= covered.jog_back_m <= 1.2
    for verdict in (bare, short):
        assert not verdict.reverse_permitted
        assert not verdict.jog_permitted


def test_a_jog_back_that_goes_too_far_is_stopped() -> None:
    train = short_of_the_stop(0.8, STOP_M - WHOLE.train.length_m - 20.0)
    train.step(4)
    train.speed_mps = -0.8
    verdict = train.step()
    while verdict.supervision is not Supervision.EMERGENCY and train.travel_m > -5.0:
        verdict = train.step()

    assert verdict.emergency_cause is Cause.WRONG_DIRECTION
    assert -1.8 < train.travel_m < -1.2


def test_a_jog_is_stopped_after_five_metres() -> None:
    train = short_of_the_stop(-4.0)
    assert train.step(4).mode is OperatingMode.JOG
    train.speed_mps = 1.0
    verdict = train.step()
    while verdict.supervision is not Supervision.EMERGENCY and train.travel_m < 9.0:
        verdict = train.step()

    assert verdict.supervision is Supervision.EMERGENCY
    assert train.travel_m <= 5.1


def test_after_a_jog_the_train_is_authorised_again() -> None:
    train = short_of_the_stop(-1.0)
    train.step(4)
    train.speed_mps = 0.5
    train.step(40)
    train.speed_mps = 0.0

    verdict = train.step(60)

    assert verdict.mode is OperatingMode.AUTHORISED
    assert not verdict.jog_permitted


def sequence(train: Train, changes: Sequence[dict[str, Any]]) -> list[ProtectionVerdict]:
    verdicts = []
    for change in changes:
        train.change(**change)
        verdicts.append(train.step())
    return verdicts


def test_protection_is_a_function_of_its_inputs() -> None:
    told: list[dict[str, Any]] = [
        {},
        {"desk": MANUAL},
        {"authority_age_s": 2.5},
        {"doors": UNLOCKED},
    ]

    assert sequence(Train(), told) == sequence(Train(), told)
