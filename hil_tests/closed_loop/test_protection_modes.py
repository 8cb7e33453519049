"""Drivers and centre against protection in the closed loop: no train exceeds a limit."""

from dataclasses import replace

import pytest

from can_dbc.cab import CabMode, Desk
from can_dbc.vobc import Cause, OperatingMode, Supervision
from metro_hil.run.observed import ObservedRun, ride

KMH = 1.0 / 3.6


@pytest.fixture(scope="module")
def reckless() -> ObservedRun:
    """The lever is at full power from II on, past III, up to the end of authority behind IV."""
    return ride(
        {"kind": "desk_mode", "mode": "manual"},
        {"kind": "desk_lever", "lever_percent": 100.0, "start_s": 3.0},
        seconds=110.0,
        end="IV",
    )


def test_full_power_all_the_way_stays_inside_the_emergency_margin(
    reckless: ObservedRun,
) -> None:
    fastest_mps = max(each.speed_mps for each in reckless.seen)

    assert 70.0 * KMH < fastest_mps < 78.0 * KMH
    assert any(each.output.supervision is Supervision.SERVICE for each in reckless.seen)


def test_a_train_whose_driver_never_brakes_stops_before_the_end_of_authority(
    reckless: ObservedRun,
) -> None:
    last = reckless.seen[-1]

    assert last.speed_mps == 0.0
    assert last.output.ceiling is not None
    assert last.output.ceiling.distance_to_authority_m > 0.0


def test_on_sight_the_brake_of_protection_holds_full_power_at_restricted_speed() -> None:
    """The radio falls silent, the train stops, the driver resets the emergency and goes on."""

    def hand(desk: Desk, t_s: float) -> Desk:
        if t_s < 45.0:
            return replace(desk, reset_requested=40.0 < t_s < 41.0)
        return replace(desk, mode=CabMode.MANUAL, restricted_requested=True, lever_percent=100.0)

    found = ride({"kind": "radio_partition", "start_s": 20.0}, seconds=80.0, end="IV", hand=hand)

    on_sight = found.within(OperatingMode.RESTRICTED)
    assert found.causes == {Cause.NONE, Cause.AUTHORITY_OLD}
    assert 25.0 * KMH < max(each.speed_mps for each in on_sight) < 28.0 * KMH
    assert all(each.output.supervision is not Supervision.EMERGENCY for each in on_sight)


def test_the_centre_stops_a_driverless_train_and_releases_it_again() -> None:
    found = ride(
        {"kind": "remote_emergency", "start_s": 20.0, "end_s": 25.0},
        {"kind": "remote_release", "start_s": 50.0, "end_s": 51.0},
        seconds=70.0,
    )

    before, after = found.at(49.0), found.at(51.0)
    assert found.causes == {Cause.NONE, Cause.REMOTE}
    assert before.speed_mps == 0.0
    assert before.output.supervision is Supervision.EMERGENCY
    assert after.output.supervision is Supervision.NOMINAL
    assert found.seen[-1].speed_mps > 5.0


def test_brake_commands_that_fail_for_a_fifth_of_a_second_stop_the_train_for_good() -> None:
    found = ride(
        {
            "kind": "frame_drop",
            "frames": "BRAKE_CMD*",
            "way": "to_train",
            "start_s": 20.0,
            "end_s": 20.2,
        },
        seconds=60.0,
    )

    assert found.causes == {Cause.NONE, Cause.BRAKE_UNIT}
    assert found.seen[-1].speed_mps == 0.0
    assert found.seen[-1].output.supervision is Supervision.EMERGENCY


def test_a_train_that_is_put_to_sleep_at_its_platform_leaves_when_it_is_woken() -> None:
    found = ride({"kind": "sleep", "start_s": 1.0, "end_s": 20.0}, seconds=70.0)

    asleep, awake = found.at(15.0), found.at(22.0)
    assert asleep.output.mode is OperatingMode.ASLEEP
    assert not asleep.output.emergency_released
    assert awake.output.mode is OperatingMode.AUTHORISED
    assert max(each.speed_mps for each in found.seen) > 5.0
    assert found.causes == {Cause.NONE}
