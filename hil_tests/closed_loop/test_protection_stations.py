"""Doors, departure and missed stops in the closed loop, judged by the true state of the train."""

from dataclasses import replace

import pytest

from can_dbc.cab import Desk
from can_dbc.vobc import Cause, Inhibit, OperatingMode, Supervision
from metro_hil.run.observed import ObservedRun, ride

KMH = 1.0 / 3.6
STOP_III_M = 3500.0
STOP_IV_M = 4500.0
WINDOW_M = 0.3
LATEST_S = 0.2
"""Time to the next frame of the desk plus a cycle, s."""


def opened(found: ObservedRun, stop_m: float) -> bool:
    """Whether doors were enabled at a stop, after checking that they never were outside its
    window."""
    enabled = [each for each in found.seen if each.output.open_left or each.output.open_right]
    assert all(each.speed_mps == 0.0 for each in enabled)
    assert all(abs(each.front_m - stop_m) <= WINDOW_M for each in enabled)
    return bool(enabled)


# Departure.


def test_a_train_stays_until_platform_doors_are_proven_locked() -> None:
    found = ride({"kind": "platform_doors_unlocked", "end_s": 12.0}, seconds=20.0)

    held = found.between(0.0, 12.0)
    assert max(each.speed_mps for each in held) == 0.0
    assert found.at(11.0).output.departure_inhibits == Inhibit.PLATFORM_DOORS
    assert found.seen[-1].speed_mps > 1.0
    assert found.causes == {Cause.NONE}


def test_with_the_sealed_switch_a_train_departs_slowly_with_an_unlocked_door() -> None:
    def hand(desk: Desk, t_s: float) -> Desk:
        return replace(desk, door_bypass_requested=t_s >= 8.0)

    found = ride({"kind": "door_lock_lost"}, seconds=35.0, hand=hand)

    assert max(each.speed_mps for each in found.between(0.0, 8.0)) == 0.0
    assert found.at(7.0).output.departure_inhibits == Inhibit.DOORS
    assert not found.at(7.0).output.door_bypass
    assert all(each.output.door_bypass for each in found.between(8.0 + LATEST_S, 35.0))
    assert 20.0 * KMH < max(each.speed_mps for each in found.seen) < 26.0 * KMH
    assert found.causes == {Cause.NONE}


# Stops.


@pytest.fixture(scope="module")
def overshoot() -> ObservedRun:
    """The brake fails from 12 m before the stop of III until 2 m past it, except for the emergency
    brake.

    A reset at the desk follows, then one by the centre.
    """
    return ride(
        {
            "kind": "brake_weak",
            "gain_ratio": 0.0,
            "when": "front_m > 3488",
            "until": "front_m > 3502",
        },
        {"kind": "desk_reset", "start_s": 70.0, "duration_s": 1.0},
        {"kind": "remote_release", "start_s": 80.0, "duration_s": 1.0},
        seconds=175.0,
        end="IV",
    )


def test_a_train_that_overshoots_by_more_than_five_metres_is_held_until_the_centre_releases_it(
    overshoot: ObservedRun,
) -> None:
    held = overshoot.between(66.0, 80.0)

    assert overshoot.causes == {Cause.NONE, Cause.OVERSHOT}
    assert 5.0 < held[0].front_m - STOP_III_M < 10.0
    assert {each.front_m for each in held} == {held[0].front_m}
    assert all(each.output.supervision is Supervision.EMERGENCY for each in held)
    assert held[-1].output.alarm_raised
    assert overshoot.at(81.0).output.emergency_released


def test_an_overshooting_train_never_goes_back_and_serves_the_next_station(
    overshoot: ObservedRun,
) -> None:
    assert min(each.speed_mps for each in overshoot.seen) > -0.01
    assert opened(overshoot, STOP_IV_M)


@pytest.mark.parametrize("tag_id", [301, 302, 303])
def test_any_one_of_the_three_tags_before_a_stop_may_be_missed(tag_id: int) -> None:
    found = ride({"kind": "tag_missed", "tag_id": tag_id}, seconds=80.0)

    motion = found.seen[-1].output.motion
    assert motion is not None
    assert motion.localised
    assert motion.front_m.low <= found.seen[-1].front_m <= motion.front_m.high
    # A train that stops a millimetre before the last tag may know its position too poorly for
    # doors.
    fits = (
        motion.front_m.low >= STOP_III_M - WINDOW_M and motion.front_m.high <= STOP_III_M + WINDOW_M
    )
    assert opened(found, STOP_III_M) is fits
    assert fits or tag_id == 303
    assert found.causes == {Cause.NONE}


# Creep.


def test_a_train_with_a_dead_antenna_creeps_on_order_until_it_is_localised_again() -> None:
    """The train brakes, stands without a position, creeps past a tag, and serves the station
    normally."""
    found = ride(
        {"kind": "antenna_dead", "when": "front_m > 3100", "until": "front_m > 3370"},
        {"kind": "remote_release", "start_s": 52.0, "duration_s": 1.0},
        {"kind": "creep_order", "start_s": 54.0},
        seconds=125.0,
    )

    waiting, creeping = found.between(50.0, 54.0), found.within(OperatingMode.CREEP)
    assert max(each.speed_mps for each in waiting) == 0.0
    assert 3100.0 < waiting[0].front_m < 3400.0
    assert 10.0 * KMH < max(each.speed_mps for each in creeping) < 16.0 * KMH
    assert opened(found, STOP_III_M)
    assert not found.seen[-1].output.alarm_raised
