"""The verdict of protection in each of its states, and the effect of every input on it."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pytest

from can_dbc.alarms import TrainAlarms
from can_dbc.tags import TagReaderHealth
from can_dbc.vobc import (
    Cause,
    Inhibit,
    Intervention,
    Missing,
    OperatingMode,
    ReasonCode,
    Supervision,
)
from hil_tests.unit.vobc.atp import protection_rig as rig
from hil_tests.unit.vobc.atp.heard_rig import DESK
from hil_tests.unit.vobc.atp.protection_rig import (
    BETWEEN_M,
    CONFIG,
    CYCLE_S,
    FREE_BRAKE,
    MANUAL,
    ORDERS,
    STOP_M,
    UNLOCKED,
    WHOLE,
    Train,
)
from vobc.atp import ProtectionVerdict
from vobc.atp.emergencies import in_cause_words
from vobc.atp.energy_check import EnergyCheck, Replicas
from vobc.atp.protection import INHIBITS
from vobc.vocabulary import NEVER_S, Authority, Restriction

LIMITED = Restriction(BETWEEN_M - 100.0, BETWEEN_M + 100.0, 10.0)
COVERED_M = STOP_M - WHOLE.train.length_m - 20.0
"""The rear of a train at the stop is protected back to this chainage, farther than any jog
needs."""
PRESSED = replace(DESK, emergency_released=False)


def limited() -> Train:
    """A train at a place where the limit is 10 m/s."""
    train = Train()
    train.change(orders=replace(ORDERS, restrictions=(LIMITED,)))
    return train


def held() -> ProtectionVerdict:
    train = Train()
    train.change(authority=None, authority_age_s=NEVER_S)
    return train.step()


def met_in_motion() -> ProtectionVerdict:
    """The verdict of a controller that starts while its train moves."""
    train = Train()
    train.speed_mps = 5.0
    train.stood_s = 0.0
    return train.step()


def may_set_off() -> ProtectionVerdict:
    return Train().step(2)


def nominal() -> ProtectionVerdict:
    return limited().runs(9.0)


def warned() -> ProtectionVerdict:
    return limited().runs(10.0 + CONFIG.warning_margin_mps + 0.05)


def braked() -> ProtectionVerdict:
    return limited().runs(10.0 + CONFIG.service_margin_mps + 0.05)


def braked_by_emergency() -> ProtectionVerdict:
    return limited().runs(10.0 + CONFIG.emergency_margin_mps + 0.05)


def stands_in_emergency() -> ProtectionVerdict:
    train = Train()
    train.step(2)
    train.change(desk=PRESSED)
    return train.step()


@pytest.mark.parametrize(
    ("happens", "state", "released", "service", "traction", "hold", "words"),
    [
        (held, Supervision.NO_AUTHORITY, False, True, False, True, "waits for movement authority"),
        (
            met_in_motion,
            Supervision.NO_AUTHORITY,
            False,
            True,
            False,
            True,
            "waits until standstill is proven",
        ),
        (may_set_off, Supervision.NOMINAL, True, False, True, False, ""),
        (nominal, Supervision.NOMINAL, True, False, True, False, ""),
        (warned, Supervision.WARNING, True, False, True, False, "speed over the warning limit"),
        (
            braked,
            Supervision.SERVICE,
            True,
            True,
            False,
            False,
            "speed over the service brake limit",
        ),
        (
            braked_by_emergency,
            Supervision.EMERGENCY,
            False,
            True,
            False,
            False,
            in_cause_words(Cause.OVERSPEED),
        ),
        (
            stands_in_emergency,
            Supervision.EMERGENCY,
            False,
            True,
            False,
            True,
            in_cause_words(Cause.BUTTON),
        ),
    ],
)
def test_each_state_sets_traction_and_brakes(
    happens: Callable[[], ProtectionVerdict],
    state: Supervision,
    released: bool,
    service: bool,
    traction: bool,
    hold: bool,
    words: str,
) -> None:
    verdict = happens()

    assert verdict.supervision is state
    assert verdict.emergency_released is released
    assert verdict.service_brake is service
    assert verdict.traction_permitted is traction
    assert verdict.hold is hold
    assert verdict.cause == words


def test_a_waiting_train_names_what_it_waits_for() -> None:
    train = Train()
    train.change(doors_age_s=9.0, authority=None)
    lacks = train.step()
    train.change(doors_age_s=0.0, authority=rig.WELL.authority)
    train.stood_s = 0.6
    unproven = train.step()
    train.change(authority_age_s=CONFIG.authority_age_max_s)
    aged = train.step()

    assert lacks.cause == "waits for door unit, movement authority"
    assert (lacks.intervention, lacks.reason) == (
        Intervention.HELD,
        ReasonCode.INPUT_MISSING,
    )
    assert unproven.supervision is Supervision.NO_AUTHORITY
    assert unproven.cause == "waits until standstill is proven"
    assert unproven.reason is ReasonCode.STANDSTILL_NOT_PROVEN
    assert aged.missing == Missing.NOTHING
    assert aged.supervision is Supervision.NO_AUTHORITY
    assert aged.cause == "waits for a fresh movement authority"
    assert aged.reason is ReasonCode.AUTHORITY_MISSING


def test_an_ageing_authority_brakes_with_a_reason_and_a_new_one_releases() -> None:
    train = Train()
    train.runs(5.0)
    aged_s = CONFIG.authority_service_ratio * CONFIG.authority_age_max_s

    train.change(authority_age_s=aged_s)
    ages = train.step()
    train.change(authority_age_s=0.1)
    fresh = train.step()
    train.change(authority_age_s=CONFIG.authority_age_max_s)
    old = train.step()

    assert ages.supervision is Supervision.SERVICE
    assert ages.cause == "movement authority is getting old"
    assert (ages.intervention, ages.reason) == (
        Intervention.SERVICE_BRAKE,
        ReasonCode.AUTHORITY_AGES,
    )
    assert fresh.supervision is Supervision.NOMINAL
    assert old.emergency_cause is Cause.AUTHORITY_OLD


def test_the_inhibit_table_holds_every_combination_at_its_index() -> None:
    assert len(INHIBITS) == 2 ** len(Inhibit)
    assert all(int(flags) == number for number, flags in enumerate(INHIBITS))


# Every input takes effect.


@pytest.mark.parametrize(
    ("change", "cause"),
    [
        ({"alarms": TrainAlarms(no_obstacle=False, no_fire=True)}, Cause.OBSTACLE),
        ({"desk": PRESSED}, Cause.BUTTON),
        ({"orders": replace(ORDERS, emergency=True)}, Cause.REMOTE),
        ({"brake_age_s": 9.0}, Cause.VITAL_INPUT_LOST),
        ({"dt_s": 0.2, "overruns": CONFIG.overruns_max + 1}, Cause.OVERRUN),
        ({"authority": Authority(BETWEEN_M - 1.0, 1, 1)}, Cause.PAST_AUTHORITY),
    ],
)
def test_every_fault_brakes_a_moving_train_in_the_same_cycle(
    change: dict[str, Any], cause: Cause
) -> None:
    train = Train()
    train.runs(5.0)
    train.change(**change)

    verdict = train.step()

    assert verdict.emergency_cause is cause
    assert not verdict.emergency_released


def test_the_tolerated_number_of_missed_cycles_does_not_brake() -> None:
    train = Train()
    train.runs(5.0)
    train.change(overruns=CONFIG.overruns_max, dt_s=(1 + CONFIG.overruns_max) * CYCLE_S)

    assert train.step().supervision is Supervision.NOMINAL


def test_a_number_that_was_not_finite_in_the_cycle_before_is_an_emergency() -> None:
    train = Train()
    train.step(2)

    verdict = train.protection.step(
        train.image, train.motion(), odometer_usable=True, not_finite=True
    )

    assert verdict.emergency_cause is Cause.NOT_FINITE


@pytest.mark.parametrize(("back_m", "brakes"), [(0.48, False), (0.52, True)])
def test_a_train_that_rolls_back_half_a_metre_is_stopped(back_m: float, brakes: bool) -> None:
    train = Train()
    train.runs(-back_m / CYCLE_S / 40.0)

    verdict = train.step(39)

    assert (verdict.emergency_cause is Cause.ROLLBACK) is brakes


def test_a_rollback_is_counted_across_whatever_else_brakes_the_train() -> None:
    train = Train()
    train.runs(-0.5)
    train.step(10)
    train.change(authority_age_s=2.0)
    assert train.step().supervision is Supervision.SERVICE

    assert train.step(9).emergency_cause is Cause.ROLLBACK


@pytest.mark.parametrize(("speed_mps", "brakes"), [(-0.5, False), (-1.1, True)])
def test_a_train_that_rolls_back_fast_is_stopped_before_half_a_metre(
    speed_mps: float, brakes: bool
) -> None:
    """After 0.2 m at 1.1 m/s the declared brake needs 1.68 m + 0.61 m on the level."""
    train = Train()
    train.runs(speed_mps)

    verdict = train.step(3)

    assert (verdict.emergency_cause is Cause.ROLLBACK) is brakes


# Either of two computations.


def test_the_second_computation_alone_brakes_under_full_supervision(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    train = Train()
    train.runs(5.0)
    monkeypatch.setattr(EnergyCheck, "exceeded", lambda *_args: True)

    verdict = train.step()

    assert verdict.emergency_cause is Cause.OVERSPEED
    assert verdict.replicas_agree


def test_on_sight_the_second_computation_alone_brakes_nothing(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The check assumes an end of authority that protection does not supervise on sight."""
    train = Train()
    train.change(
        desk=replace(MANUAL, restricted_requested=True), tag_reader=TagReaderHealth(False, 0, 0.0)
    )
    train.runs(5.0)
    monkeypatch.setattr(EnergyCheck, "exceeded", lambda *_args: True)

    verdict = train.step(CONFIG.replica_cycles_max)

    assert verdict.mode is OperatingMode.RESTRICTED
    assert verdict.supervision is Supervision.NOMINAL


def test_both_computations_use_the_same_inputs_and_the_highest_speed(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    told: list[tuple[Any, ...]] = []
    train = limited()
    train.runs(5.0)

    def agree(_: Replicas, *args: Any) -> bool:
        told.append(args)
        return True

    monkeypatch.setattr(Replicas, "agree", agree)

    verdict = train.step()

    motion, authority = train.motion(), rig.WELL.authority
    assert verdict.ceiling is not None
    assert authority is not None
    assert told == [
        (
            verdict.ceiling.emergency_mps,
            motion.front_m,
            motion.speed_mps.high,
            authority.end_m,
            (LIMITED,),
        )
    ]


def test_without_position_the_computations_cannot_disagree(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    train = Train()
    train.change(desk=replace(MANUAL, restricted_requested=True), authority=None)
    train.runs(5.0)
    monkeypatch.setattr(Replicas, "agree", lambda *_args: False)
    assert not train.step().replicas_agree

    train.localised = False

    assert train.step().replicas_agree


def test_without_an_authority_its_end_lies_behind_the_rearmost_place_of_the_front() -> None:
    ceiling = held().ceiling

    assert ceiling is not None
    assert ceiling.distance_to_authority_m == pytest.approx(-0.2)
    assert ceiling.permitted_mps == 0.0


# The request for driving on sight.


@pytest.mark.parametrize(
    ("change", "mode"),
    [
        ({"desk": replace(MANUAL, restricted_requested=True)}, OperatingMode.RESTRICTED),
        (
            {"desk": replace(MANUAL, restricted_requested=True), "orders_age_s": 9.0},
            OperatingMode.RESTRICTED,
        ),
        (
            {"desk": replace(MANUAL, restricted_requested=True), "orders": None},
            OperatingMode.RESTRICTED,
        ),
        ({"desk": MANUAL, "orders": replace(ORDERS, restricted=True)}, OperatingMode.RESTRICTED),
        (
            {"desk": MANUAL, "orders": replace(ORDERS, restricted=True), "orders_age_s": 9.0},
            OperatingMode.STANDBY,
        ),
        ({"desk": MANUAL}, OperatingMode.STANDBY),
        ({"desk": DESK, "orders": replace(ORDERS, restricted=True)}, OperatingMode.STANDBY),
        ({"desk": replace(DESK, restricted_requested=True)}, OperatingMode.STANDBY),
        ({"desk": DESK, "orders": replace(ORDERS, creep=True)}, OperatingMode.CREEP),
        ({"desk": MANUAL, "orders": replace(ORDERS, creep=True)}, OperatingMode.STANDBY),
        (
            {"desk": DESK, "orders": replace(ORDERS, creep=True), "orders_age_s": 9.0},
            OperatingMode.STANDBY,
        ),
        ({"desk": DESK, "orders": None}, OperatingMode.STANDBY),
        (
            {"desk": replace(MANUAL, restricted_requested=True), "desk_age_s": 9.0},
            OperatingMode.STANDBY,
        ),
        ({"desk": None, "desk_age_s": NEVER_S}, OperatingMode.STANDBY),
    ],
)
def test_only_a_person_at_the_desk_or_an_order_to_an_empty_one_lets_a_lost_train_move(
    change: dict[str, Any], mode: OperatingMode
) -> None:
    train = Train()
    train.lost()
    train.change(**change)

    assert train.step(3).mode is mode


# Doors and stations.


def at_platform(**change: Any) -> Train:
    train = Train(STOP_M)
    train.change(brake=replace(FREE_BRAKE, holding_applied=True), **change)
    return train


def test_an_emergency_disables_the_doors_in_the_same_cycle() -> None:
    train = at_platform()
    assert any(train.step(3).doors)

    train.change(desk=PRESSED)

    assert not any(train.step().doors)


def test_an_order_for_the_next_station_is_passed_on() -> None:
    train = Train()
    assert not train.step(2).stop_next

    train.change(orders=replace(ORDERS, stop_next=True))

    assert train.step().stop_next


def test_doors_stay_open_for_an_alarm_but_not_in_sleep() -> None:
    alarmed = at_platform(desk=replace(DESK, no_passenger_alarm=False))

    assert not at_platform().step(3).keep_doors_open
    assert alarmed.step(3).keep_doors_open
    alarmed.change(orders=replace(ORDERS, awake=False))
    asleep = alarmed.step(2)
    assert asleep.mode is OperatingMode.ASLEEP
    assert not asleep.keep_doors_open


def test_the_last_report_of_a_silent_door_unit_permits_no_traction() -> None:
    train = Train()
    assert train.runs(5.0).doors_locked
    train.change(doors_age_s=9.0)

    verdict = train.step()

    assert not verdict.doors_locked
    assert not verdict.traction_permitted


def test_a_bypass_that_began_at_rest_lasts_in_motion() -> None:
    train = Train()
    train.change(doors=UNLOCKED, desk=replace(MANUAL, door_bypass_requested=True))

    verdict = train.runs(5.0)

    assert verdict.door_bypass
    assert verdict.traction_permitted


def test_bypassed_doors_are_not_why_a_train_at_the_end_of_its_authority_has_no_traction() -> None:
    train = Train()
    train.change(doors=UNLOCKED, authority=Authority(BETWEEN_M + 0.5, 1, 1))
    train.change(desk=replace(MANUAL, door_bypass_requested=True))

    verdict = train.step(3)

    assert verdict.door_bypass
    assert verdict.reason is ReasonCode.NO_SPEED_PERMITTED


def test_a_bypass_pressed_before_the_first_step_does_not_count_in_motion() -> None:
    train = Train()
    train.change(doors=UNLOCKED, desk=replace(MANUAL, door_bypass_requested=True))
    train.speed_mps = 5.0

    assert not train.step().door_bypass


@pytest.mark.parametrize(("limit_mps", "pulls"), [(0.5, True), (0.0, False)])
def test_traction_is_permitted_for_the_lowest_permitted_speed(
    limit_mps: float, pulls: bool
) -> None:
    train = Train()
    train.change(orders=replace(ORDERS, restrictions=(replace(LIMITED, limit_mps=limit_mps),)))

    verdict = train.step(2)

    assert verdict.ceiling is not None
    assert verdict.ceiling.permitted_mps == limit_mps
    assert verdict.traction_permitted is pulls


# Jogs and overshoots.


def off_the_stop(off_m: float, rear_m: float | None = COVERED_M) -> Train:
    train = Train(STOP_M + off_m)
    train.stopping_at_m = STOP_M
    train.change(authority=Authority(STOP_M + 500.0, 1, 1, rear_m))
    return train


def test_a_jog_ends_in_the_cycle_of_an_emergency() -> None:
    train = off_the_stop(0.8)
    assert train.step(4).jog_permitted
    train.change(desk=PRESSED)

    verdict = train.step()

    assert not verdict.jog_permitted
    assert not verdict.reverse_permitted
    assert verdict.jog_back_m == 0.0


def test_a_jog_back_ends_when_its_rear_is_no_longer_protected() -> None:
    train = off_the_stop(0.8)
    train.step(4)
    train.speed_mps = -0.3
    assert train.step(2).reverse_permitted
    train.change(authority=Authority(STOP_M + 500.0, 1, 2, None))

    verdict = train.step()

    assert verdict.mode is OperatingMode.JOG
    assert not verdict.jog_permitted
    assert not verdict.reverse_permitted


def test_a_jog_back_is_permitted_with_little_room_behind() -> None:
    """The train stands just past its stop; half a metre back reaches the window."""
    verdict = off_the_stop(0.35).step(4)

    assert verdict.reverse_permitted
    assert 0.35 < verdict.jog_back_m < 1.0


def test_on_sight_no_train_jogs() -> None:
    train = off_the_stop(0.8)
    train.change(
        desk=replace(MANUAL, restricted_requested=True), tag_reader=TagReaderHealth(False, 0, 0.0)
    )

    verdict = train.step(4)

    assert verdict.mode is OperatingMode.RESTRICTED
    assert not verdict.jog_permitted
    assert not verdict.reverse_permitted
    assert verdict.jog_back_m == 0.0


def test_a_jog_ends_five_metres_from_where_it_was_granted() -> None:
    """The train stands once on its way, so no single attempt is too long."""
    train = off_the_stop(-4.9)
    train.step(4)
    train.speed_mps = 1.0
    train.step(58)
    train.speed_mps = 0.0
    assert train.step(60).mode is OperatingMode.JOG
    train.speed_mps = 1.0

    just_short = train.step(41)
    over = train.step(2)

    assert just_short.supervision is not Supervision.EMERGENCY
    assert over.emergency_cause is Cause.JOG_EXCEEDED
    assert train.travel_m == pytest.approx(5.05)


def test_after_a_jog_the_train_leaves_without_remembering_it() -> None:
    train = off_the_stop(-1.0)
    train.step(4)
    train.speed_mps = 0.5
    train.step(40)
    train.speed_mps = 0.0
    assert train.step(60).mode is OperatingMode.AUTHORISED
    train.stopping_at_m = STOP_M + 500.0
    train.speed_mps = 5.0

    verdict = train.step(40)

    assert verdict.supervision is Supervision.NOMINAL
    assert verdict.mode is OperatingMode.AUTHORISED


@pytest.mark.parametrize(("past_m", "releases_itself"), [(1.5, True), (6.0, False)])
def test_an_overshoot_brakes_and_releases_itself_only_where_a_jog_corrects_it(
    past_m: float, releases_itself: bool
) -> None:
    train = off_the_stop(-10.0)
    train.runs(3.0)
    while train.front_m < STOP_M + past_m:
        moving = train.step()
    train.speed_mps = 0.0
    verdict = train.step(60)

    assert moving.emergency_cause is Cause.OVERSHOT
    assert (verdict.emergency_cause is Cause.NONE) is releases_itself
    assert verdict.jog_permitted is releases_itself


def test_a_train_that_moves_without_attempts_left_is_braked_at_once() -> None:
    """The order to stay still applies when operation would no longer wait."""
    train = off_the_stop(-4.0)
    train.step(4)
    for _ in range(CONFIG.jog_attempts):
        train.speed_mps = 0.5
        train.step(10)
        train.speed_mps = 0.0
        used_up = train.step(120)
    assert used_up.stop_now
    train.speed_mps = 0.5

    assert train.step().supervision is Supervision.SERVICE
