"""Invariants of modes, jogs, authorities and platform doors, on both sides of each boundary."""

from typing import Any

import pytest

from can_dbc.brake import BrakeCommand
from can_dbc.cab import Desk
from can_dbc.nodes import Direction
from can_dbc.odometer import ColdMovement
from can_dbc.traction import TractionCommand
from can_dbc.vobc import (
    AtoPhase,
    Cause,
    EventKind,
    Inhibit,
    Missing,
    OperatingMode,
    Supervision,
    VobcEvent,
    VobcMode,
    VobcPosition,
    VobcStatus,
    Withheld,
)
from metro_hil.model.case import Verdict
from zenoh_config.codec import pack
from zenoh_config.messages import MovementAuthority, SpeedRestriction, TrainOrders

Rig = Any
"""Rig of conftest.py."""
KMH = 1.0 / 3.6
LEVEL_OVERSHOOT_MPS = 1.0 * (0.03 + 2 * 0.05 + 0.30)
NS_PER_S = 1_000_000_000


def say_mode(rig: Rig, mode: OperatingMode, cause: Cause = Cause.NONE) -> None:
    rig.said[VobcMode] = VobcMode(
        mode=mode,
        cause=cause,
        departure_inhibits=Inhibit.NONE,
        doors_withheld=Withheld.NONE,
        jog_attempts=0,
        replicas_agree=True,
        alarm_raised=False,
    )


def tell_event(rig: Rig, event: EventKind, number: int = 1, *, cause: int = 0) -> None:
    rig.tell(VobcEvent(event=event, cause=cause, number=number, frame_a=0, frame_b=0))


def jogging(rig: Rig) -> None:
    say_mode(rig, OperatingMode.JOG)
    rig.truth.authority_now_m = 4560.0
    rig.step(10)


# 5: the emergency brake is held.


@pytest.mark.parametrize(("off_steps", "held"), [(15, True), (30, False)])
def test_a_brake_unit_that_lets_go_of_its_own_emergency_is_taken_over_in_time(
    rig: Rig, off_steps: int, held: bool
) -> None:
    rig.step(20, speed_mps=10.0, emergency=1.0)
    rig.step(off_steps, emergency=0.0)
    rig.say(BrakeCommand, emergency_released=False)
    rig.step(20, emergency=1.0)
    rig.step(20, speed_mps=0.0)

    assert (rig.margin("inv-05-emergency-held") > 0.0) is held


@pytest.mark.parametrize(("since_release_steps", "held"), [(280, True), (320, False)])
def test_an_emergency_before_the_end_of_the_last_one_counts_as_the_same(
    rig: Rig, since_release_steps: int, held: bool
) -> None:
    """The unit has 3 s, and releases its own emergency brake at a speed at which no release is
    allowed."""
    rig.emergency(True)
    rig.step(100)
    rig.emergency(False)
    rig.step(20)
    rig.step(since_release_steps - 40, speed_mps=5.0)
    rig.step(20, emergency=1.0)
    rig.step(40, emergency=0.0)

    assert (rig.result("inv-05-emergency-held").verdict is not Verdict.FAIL) is held


@pytest.mark.parametrize(
    ("silent_steps", "missed", "held"), [(30, 0, True), (30, 6, False), (20, 0, False)]
)
def test_only_a_restarted_controller_may_lose_its_emergency(
    rig: Rig, silent_steps: int, missed: int, held: bool
) -> None:
    latched_to_standstill(rig, Cause.OVERSPEED)
    rig.silent |= {VobcStatus}
    rig.step(silent_steps)
    rig.silent -= {VobcStatus}
    rig.say(VobcStatus, supervision=Supervision.NO_AUTHORITY, cycle_slips=missed)
    rig.step(20)

    assert (rig.margin("inv-05-emergency-held") > 0.0) is held


def latched_to_standstill(rig: Rig, cause: Cause) -> None:
    say_mode(rig, OperatingMode.AUTHORISED, cause)
    rig.emergency(True)
    rig.say(VobcStatus, supervision=Supervision.EMERGENCY)
    rig.step(20, speed_mps=1.0)
    rig.step(50, speed_mps=0.0)


def let_go(rig: Rig) -> None:
    rig.emergency(False)
    rig.say(VobcStatus, supervision=Supervision.NOMINAL)
    rig.step(20)


@pytest.mark.parametrize(("cause", "held"), [(Cause.OVERSHOT, True), (Cause.OVERSPEED, False)])
def test_only_an_overshoot_releases_itself_at_standstill(
    rig: Rig, cause: Cause, held: bool
) -> None:
    latched_to_standstill(rig, cause)
    let_go(rig)

    assert (rig.margin("inv-05-emergency-held") > 0.0) is held


@pytest.mark.parametrize(("steps_before", "held"), [(400, True), (600, False)])
def test_a_release_by_the_centre_is_a_reset_for_five_seconds(
    rig: Rig, steps_before: int, held: bool
) -> None:
    latched_to_standstill(rig, Cause.OVERSPEED)
    rig.truth.order_releases = 1.0
    rig.step(steps_before)
    let_go(rig)

    assert (rig.margin("inv-05-emergency-held") > 0.0) is held


# 8, 9, 10: jogs.


def test_a_jog_back_is_neither_rollback_nor_against_the_direction(rig: Rig) -> None:
    jogging(rig)
    rig.say(TractionCommand, force_n=1000.0, direction=Direction.REVERSE)
    rig.step(400, speed_mps=-0.75)

    assert rig.margin("inv-09-direction") == 1.0
    assert rig.result("inv-08-rollback").margin is None


@pytest.mark.parametrize(("steps", "margin"), [(20, 1.0), (45, -1.0)])
def test_effort_backwards_must_be_announced_as_a_jog_in_time(
    rig: Rig, steps: int, margin: float
) -> None:
    rig.say(TractionCommand, force_n=1000.0, direction=Direction.REVERSE)
    rig.step(steps)
    say_mode(rig, OperatingMode.JOG)
    rig.step(20)

    assert rig.margin("inv-09-direction") == margin


@pytest.mark.parametrize(("steps", "verdict"), [(499, Verdict.PASS), (502, Verdict.FAIL)])
def test_a_jog_goes_five_metres(rig: Rig, steps: int, verdict: Verdict) -> None:
    jogging(rig)
    rig.step(steps, speed_mps=1.0)

    assert rig.result("inv-10-jog-distance").verdict is verdict


def test_a_jog_is_slow_but_for_margin_and_runaway(rig: Rig) -> None:
    jogging(rig)
    rig.step(5, speed_mps=-10.0 * KMH - LEVEL_OVERSHOOT_MPS)

    assert rig.margin("inv-10-jog-speed") == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize(("jogs", "verdict"), [(3, Verdict.PASS), (4, Verdict.FAIL)])
def test_there_are_three_jogs_at_a_stop(rig: Rig, jogs: int, verdict: Verdict) -> None:
    jogging(rig)
    for _ in range(jogs):
        rig.step(20, speed_mps=0.5)
        rig.step(20, speed_mps=0.0)

    assert rig.result("inv-10-jog-attempts").verdict is verdict
    assert rig.margin("inv-10-jog-attempts") == 3 - jogs


def test_jogs_at_another_stop_are_counted_again(rig: Rig) -> None:
    jogging(rig)
    for _ in range(4):
        rig.step(20, speed_mps=0.5)
        rig.step(20, speed_mps=0.0)
        rig.truth.front_m += 30.0

    assert rig.margin("inv-10-jog-attempts") == 2.0


@pytest.mark.parametrize(("beyond_m", "verdict"), [(-0.01, Verdict.PASS), (0.01, Verdict.FAIL)])
def test_a_jog_back_stays_before_the_rear_of_its_authority(
    rig: Rig, beyond_m: float, verdict: Verdict
) -> None:
    jogging(rig)
    rig.truth.authority_rear_m = rig.truth.rear_m - 1.0 + beyond_m
    rig.step(100, speed_mps=-1.0)

    assert rig.result("inv-10-jog-covered").verdict is verdict


# 1, 2, 11, 12: on sight.


def test_on_sight_there_is_no_end_of_authority(rig: Rig) -> None:
    say_mode(rig, OperatingMode.CREEP)
    rig.truth.order_creep = 1.0
    rig.step(10)
    rig.step(10, speed_mps=3.0, authority_end_m=900.0)

    assert rig.result("inv-01-stopping-distance").margin is None
    assert rig.result("inv-02-authority-end").margin is None


@pytest.mark.parametrize(
    ("missing", "localised", "end_m", "margin"),
    [
        (Missing.NOTHING, True, 1500.0, 1.0),
        (Missing.NOTHING, True, 999.0, -1.0),
        (Missing.AUTHORITY, True, 1500.0, -1.0),
        (Missing.NOTHING, False, 1500.0, -1.0),
    ],
)
def test_full_supervision_takes_place_and_authority(
    rig: Rig, missing: Missing, localised: bool, end_m: float, margin: float
) -> None:
    rig.truth.authority_now_m = end_m
    rig.say(VobcStatus, missing=missing, localised=localised)
    say_mode(rig, OperatingMode.AUTHORISED)
    rig.step(20)

    assert rig.margin("inv-11-mode-up") == margin


@pytest.mark.parametrize(("steps_after", "margin"), [(450, 1.0), (550, -1.0)])
def test_creep_takes_an_order_of_the_last_five_seconds(
    rig: Rig, steps_after: int, margin: float
) -> None:
    rig.step(20, order_creep=1.0)
    rig.step(steps_after, order_creep=0.0)
    say_mode(rig, OperatingMode.CREEP)
    rig.step(10)

    assert rig.margin("inv-11-mode-up") == margin


@pytest.mark.parametrize(("asked", "margin"), [(True, 1.0), (False, -1.0)])
def test_restricted_takes_a_person_who_asks(rig: Rig, asked: bool, margin: float) -> None:
    rig.say(Desk, restricted_requested=asked)
    rig.step(10)
    say_mode(rig, OperatingMode.RESTRICTED)
    rig.step(10)

    assert rig.margin("inv-11-mode-up") == margin


@pytest.mark.parametrize("mode", [OperatingMode.RESTRICTED, OperatingMode.CREEP])
def test_on_sight_the_train_keeps_to_25_and_margin(rig: Rig, mode: OperatingMode) -> None:
    say_mode(rig, mode)
    rig.step(10)
    rig.step(5, speed_mps=30.0 * KMH + LEVEL_OVERSHOOT_MPS + 0.01)

    assert rig.margin("inv-12-restricted-speed") == pytest.approx(-0.01)


# 15, 16, 18: tags and wake-up.


@pytest.mark.parametrize(("narrower_m", "margin"), [(0.19, 1.0), (0.25, -1.0)])
def test_a_refused_tag_narrows_nothing(rig: Rig, narrower_m: float, margin: float) -> None:
    rig.say(VobcPosition, front_m=1000.0, uncertainty_m=2.0)
    rig.step(20)
    tell_event(rig, EventKind.TAG_REJECTED)
    rig.say(VobcPosition, uncertainty_m=2.0 - narrower_m)
    rig.step(20)

    assert rig.margin("inv-15-refused-tag") == margin


def test_a_tag_that_is_accepted_beside_a_refused_one_may_narrow(rig: Rig) -> None:
    rig.say(VobcPosition, front_m=1000.0, uncertainty_m=2.0)
    rig.step(20)
    tell_event(rig, EventKind.TAG_REJECTED)
    tell_event(rig, EventKind.TAG_ACCEPTED, 2)
    rig.say(VobcPosition, uncertainty_m=0.2)
    rig.step(20)

    assert rig.result("inv-15-refused-tag").margin is None


@pytest.mark.parametrize(("localised", "margin"), [(False, 1.0), (True, -1.0)])
def test_two_missed_tags_in_a_row_take_the_place_away(
    rig: Rig, localised: bool, margin: float
) -> None:
    rig.step(10)
    tell_event(rig, EventKind.TAG_MISSED)
    tell_event(rig, EventKind.TAG_MISSED, 2)
    rig.say(VobcStatus, localised=localised)
    rig.step(50)

    assert rig.margin("inv-16-missed-tags") == margin


def test_a_tag_between_two_missed_ones_keeps_the_place(rig: Rig) -> None:
    rig.step(10)
    for number, event in enumerate(
        (EventKind.TAG_MISSED, EventKind.TAG_ACCEPTED, EventKind.TAG_MISSED)
    ):
        tell_event(rig, event, number)
    rig.step(50)

    assert rig.result("inv-16-missed-tags").margin is None


@pytest.mark.parametrize(
    ("moved_m", "monitored", "tags", "margin"),
    [
        (2.0, True, 0.0, 1.0),
        (2.01, True, 1.0, -1.0),
        (2.01, True, 2.0, 1.0),
        (0.0, False, 1.0, -1.0),
        (0.0, False, 2.0, 1.0),
    ],
)
def test_a_train_that_was_moved_asleep_knows_its_place_after_two_tags(
    rig: Rig, moved_m: float, monitored: bool, tags: float, margin: float
) -> None:
    rig.say(VobcStatus, localised=False)
    rig.tell(ColdMovement(moved_m=moved_m, monitored=monitored))
    rig.step(20)
    rig.truth.tags_read = tags
    rig.say(VobcStatus, localised=True)
    rig.step(20)

    assert rig.margin("inv-18-wake-up") == margin


# 23: switches on the path.


@pytest.mark.parametrize(("end_m", "margin_m"), [(480.0, 20.0), (500.5, -0.5)])
def test_an_authority_ends_before_a_switch_that_is_not_locked(
    rig: Rig, end_m: float, margin_m: float
) -> None:
    rig.step(30, unlocked_switch_m=500.0)
    hear_authority(rig, 0.2, end_m=end_m, sent_s=0.25)

    assert rig.margin("inv-23-switch-locked") == pytest.approx(margin_m)


def test_an_authority_that_was_sent_before_the_switch_failed_is_not_judged(rig: Rig) -> None:
    rig.step(30)
    rig.step(1, unlocked_switch_m=500.0)
    hear_authority(rig, 0.2, end_m=2000.0, sent_s=0.25)

    assert rig.result("inv-23-switch-locked").verdict is Verdict.VACUOUS


@pytest.mark.parametrize(("steps", "brakes"), [(42, True), (44, False)])
def test_a_train_beyond_its_authority_brakes_before_a_switch(
    rig: Rig, steps: int, brakes: bool
) -> None:
    """It may take 0.3 s, two cycles of 50 ms and 0.02 s."""
    say_mode(rig, OperatingMode.AUTHORISED)
    rig.step(30, unlocked_switch_m=1500.0, front_m=1000.0, speed_mps=10.0)
    hear_authority(rig, 0.2, end_m=900.0, sent_s=0.25)
    rig.step(steps, unlocked_switch_m=1500.0, front_m=1000.0, speed_mps=10.0)

    assert (rig.result("inv-23-switch-brake").verdict is Verdict.PASS) is brakes
    rig.emergency(True)
    rig.step(100)
    assert rig.margin("inv-23-switch-brake") == pytest.approx(0.43 - steps / 100.0)


# 41 to 43: zones.


@pytest.mark.parametrize(
    ("front_m", "force_n", "verdict"),
    [
        (1000.0, 5000.0, Verdict.VACUOUS),
        (1060.0, 0.0, Verdict.PASS),
        (1060.0, 5000.0, Verdict.FAIL),
        (1148.0, 5000.0, Verdict.FAIL),
        (1149.0, 5000.0, Verdict.VACUOUS),
    ],
)
def test_a_demand_for_traction_in_a_neutral_section_is_found(
    zone_rig: Rig, front_m: float, force_n: float, verdict: Verdict
) -> None:
    """The train is 68.59 m long."""
    rig = zone_rig
    rig.say(TractionCommand, force_n=force_n)
    rig.step(10, front_m=front_m, rear_m=front_m - 68.59)

    assert rig.result("inv-41-neutral-section").verdict is verdict


@pytest.mark.parametrize(
    ("end_m", "phase", "margin_m"),
    [
        (1150.0, AtoPhase.RUNNING, 1.41),
        (1148.0, AtoPhase.RUNNING, -0.59),
        (1.0, AtoPhase.OFF, None),
    ],
)
def test_a_train_enters_a_zone_only_with_an_authority_past_it(
    zone_rig: Rig, end_m: float, phase: AtoPhase, margin_m: float | None
) -> None:
    zone_rig.say(VobcStatus, ato_phase=phase)
    zone_rig.step(20, front_m=1049.0, speed_mps=10.0, authority_end_m=end_m)

    if margin_m is None:
        assert zone_rig.result("inv-42-no-stop-zone").verdict is Verdict.VACUOUS
    else:
        assert zone_rig.margin("inv-42-no-stop-zone") == pytest.approx(margin_m)


@pytest.mark.parametrize(
    ("front_m", "held_s", "margin_m"),
    [(1299.0, 48, 4.0), (1293.0, 48, -2.0), (1293.0, 46, None), (1420.0, 48, -115.0)],
)
def test_a_train_that_is_held_for_long_stands_at_an_evacuation_stop(
    exit_rig: Rig, front_m: float, held_s: int, margin_m: float | None
) -> None:
    exit_rig.say(VobcStatus, ato_phase=AtoPhase.RUNNING)
    exit_rig.step(held_s * 100, front_m=1000.0, speed_mps=0.001, authority_now_m=1440.0)
    exit_rig.step(1, front_m=front_m, speed_mps=5.0)
    exit_rig.step(2, speed_mps=0.0)

    if margin_m is None:
        assert exit_rig.result("inv-43-evacuation-stop").verdict is Verdict.VACUOUS
    else:
        assert exit_rig.margin("inv-43-evacuation-stop") == pytest.approx(margin_m, abs=0.1)


# 24: ageing authorities.


def hear_authority(rig: Rig, echo_s: float, *, end_m: float = 2000.0, sent_s: float = 0.0) -> None:
    rig.monitors.radio(
        pack(
            MovementAuthority(
                train=1, boot=1, term=1, sequence=1, stamp_ns=round(sent_s * NS_PER_S),
                echo_stamp_ns=round(echo_s * NS_PER_S), end_m=end_m,
            )
        )
    )  # fmt: skip


@pytest.mark.parametrize(("steps", "verdict"), [(311, Verdict.PASS), (314, Verdict.FAIL)])
def test_an_authority_lasts_three_seconds_and_two_cycles(
    rig: Rig, steps: int, verdict: Verdict
) -> None:
    say_mode(rig, OperatingMode.AUTHORISED)
    rig.truth.authority_now_m = 2000.0
    hear_authority(rig, 0.0)
    rig.step(steps, speed_mps=10.0)

    assert rig.result("inv-24-authority-age").verdict is verdict
    assert rig.margin("inv-24-authority-age") == pytest.approx(3.12 - steps / 100.0)


def test_under_the_emergency_brake_an_old_authority_is_answered(rig: Rig) -> None:
    say_mode(rig, OperatingMode.AUTHORISED)
    hear_authority(rig, 0.0)
    rig.step(300, speed_mps=10.0)
    rig.emergency(True)
    rig.step(200)

    assert rig.result("inv-24-authority-age").verdict is Verdict.PASS


# 32: traction with bypassed doors.


def pull_unlocked(rig: Rig, *, pressed: bool, given: bool) -> None:
    """Stand for a second with an unlocked door, then demand effort for half a second."""
    rig.say(Desk, door_bypass_requested=pressed)
    rig.step(10, doors_locked=0.0)
    if given:
        tell_event(rig, EventKind.DOOR_BYPASS, cause=1)
    rig.step(90)
    rig.step(50, drive_n=1000.0, speed_mps=0.5)


@pytest.mark.parametrize(
    ("pressed", "given", "verdict"),
    [
        (True, True, Verdict.PASS),
        (True, False, Verdict.FAIL),
        (False, True, Verdict.FAIL),
        (False, False, Verdict.FAIL),
    ],
)
def test_effort_with_an_unlocked_door_needs_a_requested_and_granted_bypass(
    rig: Rig, pressed: bool, given: bool, verdict: Verdict
) -> None:
    pull_unlocked(rig, pressed=pressed, given=given)

    assert rig.result("inv-32-door-traction").verdict is verdict


@pytest.mark.parametrize(("steps", "verdict"), [(30, Verdict.PASS), (37, Verdict.FAIL)])
@pytest.mark.parametrize("by_person", [True, False])
def test_a_bypass_that_ends_cuts_traction_within_300_ms(
    rig: Rig, by_person: bool, steps: int, verdict: Verdict
) -> None:
    """A release of the switch arrives with the next cycle, at most 50 ms later."""
    pull_unlocked(rig, pressed=True, given=True)
    if by_person:
        rig.say(Desk, door_bypass_requested=False)
    else:
        tell_event(rig, EventKind.DOOR_BYPASS, 2, cause=0)
    rig.step(steps)
    rig.step(20, drive_n=0.0)

    assert rig.result("inv-32-door-traction").verdict is verdict


# 33: platform doors.


@pytest.mark.parametrize(
    ("locked", "bypassed", "margin"), [(1.0, False, 1.0), (0.0, False, -1.0), (0.0, True, 1.0)]
)
def test_a_train_departs_from_platform_doors_that_are_locked_or_bypassed(
    rig_at_platform_doors: Rig, locked: float, bypassed: bool, margin: float
) -> None:
    rig = rig_at_platform_doors
    rig.step(20, platform_doors_locked=locked)
    if bypassed:
        tell_event(rig, EventKind.DOOR_BYPASS, cause=1)
    rig.step(20, speed_mps=0.5)

    assert rig.margin("inv-33-platform-doors") == margin


def test_an_ended_bypass_does_not_count_at_departure(rig_at_platform_doors: Rig) -> None:
    rig = rig_at_platform_doors
    rig.step(20, platform_doors_locked=0.0)
    tell_event(rig, EventKind.DOOR_BYPASS, 1, cause=1)
    tell_event(rig, EventKind.DOOR_BYPASS, 2, cause=0)
    rig.step(20, speed_mps=0.5)

    assert rig.margin("inv-33-platform-doors") == -1.0


def test_platform_doors_of_other_platforms_do_not_matter(rig: Rig) -> None:
    rig.truth.front_m = 1200.0
    rig.step(20, platform_doors_locked=0.0)
    rig.step(20, speed_mps=0.5)

    assert rig.result("inv-33-platform-doors").margin is None


# 4: restrictions that the train has received.

SLOW = SpeedRestriction(1400.0, 1500.0, 5.0)


def hear_orders(rig: Rig, sequence: int, *told: SpeedRestriction, age_s: float = 0.2) -> None:
    echo_ns = max(0, rig.now_ns - round(age_s * NS_PER_S))
    rig.monitors.radio(
        pack(
            TrainOrders(
                1, 1, sequence, echo_ns, True, False, False, False, False, 0, False, False,
                False, False, True, told,
            )
        )
    )  # fmt: skip


def passes(rig: Rig, speed_mps: float, front_m: float) -> float | None:
    """The margin after one step at this place."""
    rig.truth.front_m, rig.truth.rear_m = front_m, front_m - 68.59
    rig.step(1, speed_mps=speed_mps)
    margin: float | None = rig.result("inv-04-restriction").margin
    return margin


ALLOWED_MPS = 5.0 + 8.0 / 3.6 + 0.43
"""The limit, 8 km/h, and a runaway of 1.0 m/s² for 0.43 s on the level."""


def test_a_received_restriction_is_judged_from_the_braking_distance_on(rig: Rig) -> None:
    rig.truth.front_m = 1000.0
    hear_orders(rig, 1, SLOW)

    assert passes(rig, 15.0, 1010.0) is None
    assert passes(rig, 15.0, 1399.0) is None
    assert passes(rig, 7.0, 1400.5) == pytest.approx(ALLOWED_MPS - 7.0, abs=1e-6)
    assert passes(rig, 9.0, 1480.0) == pytest.approx(ALLOWED_MPS - 9.0, abs=1e-6)
    assert rig.result("inv-04-restriction").verdict is Verdict.FAIL


@pytest.mark.parametrize(("begins_m", "judged"), [(1100.0, True), (1020.0, False)])
def test_a_restriction_inside_of_the_braking_distance_is_not_judged_at_its_begin(
    rig: Rig, begins_m: float, judged: bool
) -> None:
    """From 10 m/s the worst motion takes less than 95 m to 5 m/s on this line."""
    rig.truth.front_m = 1000.0
    rig.step(1, speed_mps=10.0)
    hear_orders(rig, 1, SpeedRestriction(begins_m, 1500.0, 5.0))
    rig.step(1, speed_mps=10.0)

    assert (passes(rig, 10.0, begins_m + 1.0) is not None) is judged
    assert passes(rig, 5.0, 1400.0) is not None


def test_a_restriction_holds_for_the_whole_train_until_newer_orders_lift_it(rig: Rig) -> None:
    hear_orders(rig, 5, SLOW)
    passes(rig, 5.0, 1000.0)

    assert passes(rig, 8.0, 1500.0 + 68.0) is not None
    assert rig.margin("inv-04-restriction") < 0.0


@pytest.mark.parametrize(("sequence", "lifts"), [(6, True), (5, False), (4, False)])
def test_only_newer_orders_lift_a_restriction(rig: Rig, sequence: int, lifts: bool) -> None:
    hear_orders(rig, 5, SLOW)
    passes(rig, 5.0, 1000.0)
    hear_orders(rig, sequence)

    assert (passes(rig, 15.0, 1450.0) is None) is lifts


def test_orders_that_are_too_old_on_arrival_impose_nothing(rig: Rig) -> None:
    rig.step(600)
    hear_orders(rig, 5, SLOW, age_s=5.1)

    assert passes(rig, 15.0, 1450.0) is None


def test_without_the_guaranteed_rate_a_restriction_is_not_judged(rig: Rig) -> None:
    hear_orders(rig, 5, SLOW)
    passes(rig, 15.0, 1000.0)
    rig.truth.adhesion_ratio = 0.05
    passes(rig, 15.0, 1300.0)
    rig.truth.adhesion_ratio = 0.2

    assert passes(rig, 15.0, 1450.0) is None
