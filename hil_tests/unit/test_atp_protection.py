"""Protection as a whole: modes, ceilings, jogs, bypass, orders; then random lives of a train."""

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import pytest
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, precondition, rule

from can_dbc.alarms import TrainAlarms
from can_dbc.brake import BrakeStatus
from can_dbc.cab import CabMode, Desk
from can_dbc.doors import DoorState, DoorStatus
from can_dbc.tags import TagReaderHealth
from can_dbc.traction import TractionStatus
from can_dbc.vobc import AtoPhase, Cause, Inhibit, Missing, OperatingMode, Supervision
from firmware_py.trackdb import load_line
from vobc.arbitration import arbitrate
from vobc.atp import Protection, Verdict
from vobc.atp.energy_check import Replicas
from vobc.config import load_config
from vobc.vocabulary import (
    NEVER_S,
    AtoDemand,
    Authority,
    CycleInput,
    CycleOutput,
    Interval,
    Motion,
    Orders,
    Restriction,
)

LINE = load_line("florence")
WHOLE = load_config("florence4")
CONFIG = WHOLE.atp
CYCLE_S = 0.05
BETWEEN_M = 3250.0
"""Between stations II and III."""
STOP_M = LINE.station("II").stop_m
KMH = 1.0 / 3.6

DESK = Desk(CabMode.AUTO, 0.0, True, True, False, False, False, False)
MANUAL = replace(DESK, mode=CabMode.MANUAL)
ORDERS = Orders(True, False, False, False, False, 0, False, False, True, True, True)
LOCKED = DoorStatus(True, DoorState.LOCKED, DoorState.LOCKED, True)
UNLOCKED = DoorStatus(False, DoorState.LOCKED, DoorState.UNKNOWN, True)
FREE_BRAKE = BrakeStatus(0.0, 0.0, False, False, True, True)
CUT = TractionStatus(0.0, 1.0, True, True)
WELL = CycleInput(
    0, CYCLE_S, 0, None, 0.0, (), None, NEVER_S, None, NEVER_S, CUT, 0.0,
    FREE_BRAKE, 0.0, LOCKED, 0.0, DESK, 0.0, TagReaderHealth(True, 0, 0.0), 0.0, None, NEVER_S,
    None, NEVER_S, (), Authority(BETWEEN_M + 1200.0, 1, 1), 0.2, TrainAlarms(True, True), 0.0,
    None, NEVER_S, ORDERS, 0.2,
)  # fmt: skip


class Train:
    """A train that moves as it is told and hears what it is told."""

    def __init__(self, front_m: float = BETWEEN_M) -> None:
        self.protection = Protection(
            CONFIG, LINE, train_length_m=WHOLE.train.length_m, cycle_s=CYCLE_S
        )
        self.image = WELL
        self.front_m = front_m
        self.travel_m = 0.0
        self.speed_mps = 0.0
        self.half_mps = 0.1
        self.stood_s = 10.0
        self.localised = True
        self.stopping_at_m: float | None = None

    def change(self, **changes: Any) -> None:
        self.image = replace(self.image, **changes)

    def motion(self) -> Motion:
        speed = self.speed_mps
        half = self.half_mps if speed else 0.05
        return Motion(
            Interval(self.front_m - 0.1, self.front_m, self.front_m + 0.1),
            Interval(speed - half, speed, speed + half),
            0.0,
            self.travel_m,
            self.stood_s >= 0.5,
            self.stood_s >= 2.0,
            self.localised,
            False,
            (),
        )

    def step(self, cycles: int = 1) -> Verdict:
        for _ in range(cycles):
            moved_m = self.speed_mps * CYCLE_S
            self.front_m += moved_m
            self.travel_m += moved_m
            self.stood_s = 0.0 if self.speed_mps else self.stood_s + CYCLE_S
            verdict = self.protection.step(
                self.image,
                self.motion(),
                odometer_usable=True,
                not_finite=False,
                stopping_at_m=self.stopping_at_m,
            )
        return verdict

    def runs(self, speed_mps: float) -> Verdict:
        verdict = self.step(2)
        assert verdict.supervision is Supervision.NOMINAL, verdict.cause
        self.speed_mps = speed_mps
        return self.step()

    def lost(self) -> None:
        """Neither place nor authority."""
        self.localised = False
        self.change(authority=None, authority_age_s=NEVER_S)


def assert_held(verdict: Verdict) -> None:
    assert not verdict.emergency_released
    assert not verdict.traction_permitted
    assert not verdict.reverse_permitted
    assert verdict.service_brake


@pytest.mark.parametrize("high_m", [BETWEEN_M - 1.0, -math.inf, math.inf, math.nan])
def test_a_place_that_cannot_be_permits_nothing(high_m: float) -> None:
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


def test_a_train_that_is_told_to_sleep_is_held_without_doors_until_it_is_woken() -> None:
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


def test_without_place_and_authority_a_person_may_drive_at_25_km_per_hour() -> None:
    verdict = on_sight().runs(20.0 * KMH)

    assert verdict.mode is OperatingMode.RESTRICTED
    assert verdict.supervision is Supervision.NOMINAL
    assert verdict.traction_permitted
    assert verdict.ceiling is not None
    assert verdict.ceiling.permitted_mps == pytest.approx(25.0 * KMH)
    assert verdict.ceiling.emergency_mps <= 30.0 * KMH + 1e-9
    assert verdict.missing == Missing.AUTHORITY | Missing.LOCALISATION


def test_the_centre_may_let_a_person_drive_on_sight_but_nobody_else() -> None:
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


def test_on_sight_a_silent_radio_and_a_lost_place_mean_nothing_but_a_silent_desk_does() -> None:
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
    assert braked.cause == "nobody answers for driving on sight any more"
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


def test_without_an_authority_what_the_line_and_the_centre_restrict_is_kept_on_sight() -> None:
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


def test_full_supervision_takes_over_a_running_train_without_a_step_up_for_what_is_missing() -> (
    None
):
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


def test_a_driverless_train_creeps_when_it_is_ordered_and_stops_when_the_order_fades() -> None:
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


# Emergencies by the centre, the brake unit, the clock, the second computation.


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
    train.change(orders=replace(ORDERS, releases=1))
    released = train.step()

    assert by_desk.emergency_cause is Cause.REMOTE
    assert withdrawn.emergency_cause is Cause.REMOTE
    assert released.supervision is Supervision.NO_AUTHORITY
    assert released.emergency_cause is Cause.NONE
    assert train.step().supervision is Supervision.NOMINAL


def test_a_step_of_the_centre_that_came_too_early_releases_nothing_later() -> None:
    train = Train()
    train.runs(5.0)
    train.change(desk=replace(DESK, emergency_released=False))
    train.step()
    train.change(desk=DESK, orders=replace(ORDERS, releases=1))
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


def test_wheels_that_are_not_heard_of_at_all_any_more_bring_the_emergency_brake() -> None:
    train = Train()
    train.runs(5.0)

    def blind() -> Verdict:
        return train.protection.step(train.image, None, odometer_usable=False, not_finite=False)

    first, second = blind(), blind()

    for verdict in (first, second):
        assert verdict.emergency_cause is Cause.VITAL_INPUT_LOST
        assert verdict.cause == "vital input lost while moving"
        assert_held(verdict)
    assert train.step().emergency_cause is Cause.VITAL_INPUT_LOST


# Doors, departure, stations.


def test_doors_that_are_not_proven_locked_let_a_train_depart_only_bypassed_and_slowly() -> None:
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


def test_a_train_that_is_to_stop_now_and_does_not_is_braked() -> None:
    """Somebody pulls the alarm as the train just begins to leave its stopping point."""
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


def test_a_jog_forwards_is_slow_and_needs_nothing_behind() -> None:
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


def test_a_jog_that_goes_on_and_on_is_stopped_at_five_metres() -> None:
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


# Random lives.


MOVING_STATES = (Supervision.NOMINAL, Supervision.WARNING, Supervision.SERVICE)
FULL_LEVER = AtoDemand(5.0, False, True, AtoPhase.RUNNING, 20.0, 100.0)
BAD = st.sampled_from([math.nan, math.inf, -math.inf])
AGED_S = CONFIG.authority_service_ratio * CONFIG.authority_age_max_s


class Life(RuleBasedStateMachine):
    """Somebody presses everything there is, and operation always asks for all it can."""

    def __init__(self) -> None:
        super().__init__()
        self.train = Train()
        self.releases = 0
        self.verdict = self.train.step()
        self.output = self.arbitrated(self.train.motion())
        self.before = self.verdict
        self.reset_now = False

    def arbitrated(self, motion: Motion) -> CycleOutput:
        return arbitrate(
            self.verdict,
            FULL_LEVER,
            motion,
            self.train.image.desk,
            train=WHOLE.train,
            load_kg=10_000.0,
        )

    def go(self, cycles: int = 1) -> None:
        for _ in range(cycles):
            self.before = self.verdict
            self.verdict = self.train.step()
            self.output = self.arbitrated(self.train.motion())
            self.check()

    def check(self) -> None:
        verdict, before, output, train = self.verdict, self.before, self.output, self.train
        if verdict.supervision not in MOVING_STATES:
            assert output.force_n == 0.0
            assert not output.traction_permitted
            assert not output.emergency_released
            assert output.service_decel_mps2 > 0.0
        if verdict.mode in (OperatingMode.ASLEEP, OperatingMode.STANDBY):
            assert verdict.supervision not in MOVING_STATES
        if before.supervision is Supervision.EMERGENCY is not verdict.supervision:
            assert train.stood_s >= 2.0
            assert self.reset_now
            assert verdict.supervision is Supervision.NO_AUTHORITY
            assert verdict.emergency_cause is Cause.NONE
        assert (verdict.supervision is Supervision.EMERGENCY) is (
            verdict.emergency_cause is not Cause.NONE
        )
        if verdict.reverse_permitted:
            assert verdict.mode is OperatingMode.JOG
            assert train.image.authority is not None
            assert train.image.authority.rear_m is not None
        self.check_mode()

    def check_mode(self) -> None:
        verdict, before, train = self.verdict, self.before, self.train
        assert verdict.ceiling is not None
        assert before.ceiling is not None
        flat = {
            OperatingMode.RESTRICTED: 25.0 * KMH,
            OperatingMode.CREEP: 15.0 * KMH,
            OperatingMode.JOG: 5.0 * KMH,
        }.get(verdict.mode, math.inf)
        assert verdict.ceiling.permitted_mps <= flat + 1e-9
        raised = verdict.ceiling.permitted_mps > before.ceiling.permitted_mps
        if verdict.mode is not before.mode and raised and train.speed_mps != 0.0:
            assert train.localised
            assert train.image.authority is not None
            assert train.image.authority_age_s < AGED_S

    @rule(speed_mps=st.floats(-1.0, 25.0), cycles=st.integers(1, 30))
    def drive(self, speed_mps: float, cycles: int) -> None:
        self.train.speed_mps = speed_mps
        self.go(cycles)

    @rule(cycles=st.integers(1, 60))
    def stand(self, cycles: int) -> None:
        self.train.speed_mps = 0.0
        self.go(cycles)

    @rule(age_s=st.floats(0.0, 6.0), ahead_m=st.one_of(st.none(), st.floats(-50.0, 1500.0)))
    def authority(self, age_s: float, ahead_m: float | None) -> None:
        train = self.train
        end_m = None if ahead_m is None else train.front_m + ahead_m
        rear_m = train.front_m - 100.0
        train.change(
            authority=None if end_m is None else Authority(end_m, 1, 1, rear_m),
            authority_age_s=age_s,
        )
        self.go()

    @rule(name=st.sampled_from(["awake", "hold", "emergency", "creep", "restricted"]))
    def order(self, name: str) -> None:
        orders = self.train.image.orders
        assert orders is not None
        changed = {name: not getattr(orders, name)}
        self.train.change(orders=replace(orders, **changed))  # type: ignore[arg-type]
        self.go()

    @rule(age_s=st.floats(0.0, 8.0))
    def silent_centre(self, age_s: float) -> None:
        self.train.change(orders_age_s=age_s)
        self.go()

    @rule(
        mode=st.sampled_from(list(CabMode)),
        button=st.booleans(),
        alarm=st.booleans(),
        restricted=st.booleans(),
        bypass=st.booleans(),
    )
    def desk(
        self, mode: CabMode, button: bool, alarm: bool, restricted: bool, bypass: bool
    ) -> None:
        self.train.change(
            desk=replace(
                DESK,
                mode=mode,
                emergency_released=not button,
                no_passenger_alarm=not alarm,
                restricted_requested=restricted,
                door_bypass_requested=bypass,
            )
        )
        self.go()

    @rule(name=st.sampled_from(["brake", "traction", "doors", "desk", "tag_reader", "alarms"]))
    def silence(self, name: str) -> None:
        age = f"{name}_age_s"
        self.train.change(**{age: 9.0 if getattr(self.train.image, age) == 0.0 else 0.0})
        self.go()

    @rule()
    def place(self) -> None:
        self.train.localised = not self.train.localised
        self.go()

    @rule(doors=st.sampled_from([LOCKED, UNLOCKED]))
    def lock(self, doors: DoorStatus) -> None:
        self.train.change(doors=doors)
        self.go()

    @rule()
    def obstacle(self) -> None:
        self.train.change(alarms=TrainAlarms(False, True))
        self.go()
        self.train.change(alarms=TrainAlarms(True, True))
        self.go()

    @rule()
    def at_a_stop(self) -> None:
        """The front stands a little off a stopping point that operation heads for."""
        self.train.front_m, self.train.stopping_at_m = STOP_M + 0.7, STOP_M
        self.train.speed_mps = 0.0
        self.go(3)

    @rule(desk=st.booleans(), centre=st.booleans())
    def reset(self, desk: bool, centre: bool) -> None:
        train = self.train
        assert train.image.orders is not None
        assert train.image.desk is not None
        self.releases += centre
        self.reset_now = True
        train.change(
            desk=replace(train.image.desk, reset_requested=desk),
            orders=replace(train.image.orders, releases=self.releases),
        )
        self.go()
        train.change(desk=replace(train.image.desk, reset_requested=False))
        self.go()
        self.reset_now = False

    @rule(bad=BAD, part=st.sampled_from(["front", "speed", "travel", "accel"]))
    def no_number(self, bad: float, part: str) -> None:
        good = self.train.motion()
        motion = {
            "front": replace(good, front_m=replace(good.front_m, high=bad)),
            "speed": replace(good, speed_mps=replace(good.speed_mps, low=bad)),
            "travel": replace(good, travel_m=bad),
            "accel": replace(good, accel_mps2=bad),
        }[part]
        self.verdict = self.train.protection.step(
            self.train.image, motion, odometer_usable=True, not_finite=False
        )
        output = self.arbitrated(motion)
        assert not output.emergency_released
        assert not output.traction_permitted
        assert output.force_n == 0.0
        assert output.motion is None
        self.verdict = self.train.protection.step(
            self.train.image, good, odometer_usable=True, not_finite=True
        )
        assert self.verdict.supervision is Supervision.EMERGENCY

    @precondition(lambda self: self.verdict.supervision is Supervision.EMERGENCY)
    @rule(cycles=st.integers(1, 100))
    def waiting_alone_releases_nothing(self, cycles: int) -> None:
        self.train.speed_mps = 0.0
        self.go(cycles)
        assert self.verdict.supervision is Supervision.EMERGENCY

    @invariant()
    def doors_stay_shut_in_an_emergency(self) -> None:
        if self.verdict.supervision is Supervision.EMERGENCY:
            assert not any(self.verdict.doors)


TestLife = Life.TestCase
TestLife.settings = settings(max_examples=40, stateful_step_count=30, deadline=None)


def sequence(train: Train, changes: Sequence[dict[str, Any]]) -> list[Verdict]:
    verdicts = []
    for change in changes:
        train.change(**change)
        verdicts.append(train.step())
    return verdicts


def test_protection_is_a_function_of_what_it_was_told() -> None:
    told: list[dict[str, Any]] = [
        {},
        {"desk": MANUAL},
        {"authority_age_s": 2.5},
        {"doors": UNLOCKED},
    ]

    assert sequence(Train(), told) == sequence(Train(), told)
