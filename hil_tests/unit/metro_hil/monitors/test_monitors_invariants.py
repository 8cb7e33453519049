"""Each invariant: held at its boundary, violated just beyond, vacuous without its premise."""

from pathlib import Path
from typing import Any

import pytest

from can_dbc.brake import BrakeCommand, BrakeStatus
from can_dbc.cab import Desk
from can_dbc.doors import DoorCommand
from can_dbc.nodes import Direction
from can_dbc.odometer import Tacho
from can_dbc.traction import TractionCommand
from can_dbc.vobc import (
    Cause,
    Inhibit,
    OperatingMode,
    Supervision,
    VobcMode,
    VobcMotion,
    VobcPosition,
    VobcStatus,
    Withheld,
)
from metro_hil.model.case import Verdict
from metro_hil.monitors.catalogue import WATCHED

Rig = Any
"""Rig of conftest.py."""
KMH = 1.0 / 3.6


def test_a_train_in_order_that_never_moves_exercises_next_to_nothing(rig: Rig) -> None:
    rig.step(100)

    rig.monitors.finish()
    results = rig.monitors.results({})
    assert {each.verdict for each in results} == {Verdict.PASS, Verdict.VACUOUS}
    shown = {each.name for each in results if each.verdict is not Verdict.VACUOUS}
    assert shown == {
        "inv-13-position-interval", "inv-16-localisation-limit", "inv-34-brake-silence",
        "inv-39-accel", "inv-39-jerk",
    }  # fmt: skip


# Invariants 1 and 2: the end of authority.


def test_the_way_to_stop_is_that_of_the_declared_emergency_brake(rig: Rig) -> None:
    """On the level the train runs on at 10 m/s for 0.3 s and 0.4 s and then needs 10²/2 at 1
    m/s²."""
    rig.step(1, speed_mps=10.0, authority_end_m=1000.1 + 7.0 + 50.0)

    assert rig.margin("inv-01-stopping-distance") == pytest.approx(0.0, abs=0.01)
    rig.step(1)
    assert rig.result("inv-01-stopping-distance").verdict is Verdict.FAIL


def test_traction_makes_the_way_to_stop_longer_until_it_is_cut(rig: Rig) -> None:
    """By the equations of motion: 0.8 m/s² for 0.30 s, coasting for 0.4 s, then braking."""
    reached_mps = 10.0 + 0.8 * 0.3
    way_m = 10.0 * 0.3 + 0.5 * 0.8 * 0.09 + reached_mps * 0.4 + reached_mps**2 / 2.0

    rig.step(1, speed_mps=10.0, accel_mps2=0.8, drive_n=1.0e5, authority_end_m=1100.1)

    assert rig.margin("inv-01-stopping-distance") == pytest.approx(100.0 - way_m, abs=0.01)


def test_a_fall_makes_the_way_to_stop_longer_by_its_energy(rig: Rig) -> None:
    """The whole distance is on -30 ‰: with 8 % rotating mass the train gains 9.81 · 0.03 / 1.08."""
    rig.truth.front_m, rig.truth.gradient_permille = 1875.0, -30.0
    fall_mps2 = 9.81 * 0.03 / 1.08
    reached_mps = 4.0 + fall_mps2 * 0.7
    way_m = 4.0 * 0.7 + 0.5 * fall_mps2 * 0.49 + reached_mps**2 / (2.0 * (1.0 - fall_mps2))

    rig.step(1, speed_mps=4.0, authority_end_m=1900.04)

    assert rig.margin("inv-01-stopping-distance") == pytest.approx(25.0 - way_m, abs=0.05)


def test_of_a_brake_that_is_on_already_only_the_rest_of_its_delay_counts(rig: Rig) -> None:
    rig.step(1, speed_mps=10.0, emergency=1.0)
    rig.step(200, emergency_mps2=1.2)

    # Two seconds later the speed is still 10 m/s: now no more than 10²/2 from here.
    rig.truth.authority_end_m = rig.truth.front_m + 0.1 + 50.0
    rig.step(1)

    assert rig.margin("inv-01-stopping-distance") == pytest.approx(0.0, abs=0.01)


@pytest.mark.parametrize("broken", [{"adhesion_ratio": 0.1}, {"emergency_mps2": 0.9}])
def test_without_the_guaranteed_rate_the_stopping_distance_is_not_judged(
    rig: Rig, broken: dict[str, float]
) -> None:
    rig.step(300, emergency=1.0, emergency_mps2=1.2)
    rig.step(1, speed_mps=20.0, authority_end_m=1010.0, **broken)

    result = rig.result("inv-01-stopping-distance")
    assert result.margin is None
    assert result.verdict is Verdict.VACUOUS
    assert "guaranteed 1 m/s²" in result.detail


def test_no_authority_reaches_beyond_the_map(rig: Rig) -> None:
    end_m = rig.context.line.end_m
    rig.truth.front_m = end_m - 50.0

    rig.step(1, speed_mps=10.0, authority_end_m=end_m + 5000.0)

    assert rig.margin("inv-02-authority-end") == pytest.approx(50.0 - 0.1)
    assert rig.result("inv-01-stopping-distance").verdict is Verdict.FAIL


def test_the_front_at_the_end_of_authority_is_the_last_that_is_allowed(rig: Rig) -> None:
    rig.step(1, speed_mps=1.0, authority_end_m=1000.01)
    assert rig.margin("inv-02-authority-end") == pytest.approx(0.0, abs=1e-9)

    rig.step(1)
    assert rig.margin("inv-02-authority-end") == pytest.approx(-0.01)


# 3, 4: speed.


def over_its_curve(rig: Rig, steps: int) -> None:
    """The controller reports 0.5 m/s above its emergency limit and does not react for a while."""
    rig.step(5, speed_mps=20.5)
    rig.send_now(VobcMotion, speed_mps=20.5, emergency_mps=20.0)
    rig.step(steps)


def test_the_emergency_brake_one_cycle_after_the_curve_is_in_time(rig: Rig) -> None:
    over_its_curve(rig, 5)
    rig.say(BrakeCommand, emergency_released=False)
    rig.step(20)

    assert rig.margin("inv-03-emergency-at-curve") == pytest.approx(0.02, abs=0.003)


def test_no_emergency_brake_at_the_curve_is_a_violation(rig: Rig) -> None:
    over_its_curve(rig, 20)

    result = rig.result("inv-03-emergency-at-curve")
    assert result.verdict is Verdict.FAIL
    assert rig.monitors.violated.name == "inv-03-emergency-at-curve"


def bound_at_curve(rig: Rig, *, reach_mps: float, later_s: float = 0.0) -> None:
    """The best estimate is 0.5 m/s below the emergency limit; `reach_mps` sets the upper bound
    above it."""
    rig.step(6, speed_mps=20.0)
    rig.send_now(VobcMotion, speed_mps=20.0, emergency_mps=20.5)
    rig.step(round(later_s / 0.01))
    rig.tell(mode_told(speed_reach_mps=reach_mps))


def mode_told(**changes: Any) -> VobcMode:
    """The mode frame of a train under full supervision without findings."""
    nothing: dict[str, Any] = {
        "mode": OperatingMode.AUTHORISED,
        "cause": Cause.NONE,
        "departure_inhibits": Inhibit.NONE,
        "doors_withheld": Withheld.NONE,
        "jog_attempts": 0,
        "replicas_agree": True,
        "alarm_raised": False,
    }
    return VobcMode(**(nothing | changes))


def test_a_speed_bound_above_the_curve_without_emergency_brake_is_a_violation(
    rig: Rig,
) -> None:
    bound_at_curve(rig, reach_mps=0.6)
    rig.step(20)

    assert rig.result("inv-03-emergency-at-curve").verdict is Verdict.FAIL


def test_a_speed_bound_above_the_curve_with_emergency_brake_is_no_violation(rig: Rig) -> None:
    bound_at_curve(rig, reach_mps=0.6)
    rig.say(BrakeCommand, emergency_released=False)
    rig.step(20)

    assert rig.margin("inv-03-emergency-at-curve") > 0.0


def test_a_bound_that_rounding_may_lift_to_the_curve_is_not_above_it(rig: Rig) -> None:
    bound_at_curve(rig, reach_mps=0.55)
    rig.step(20)

    assert rig.result("inv-03-emergency-at-curve").margin is None


def test_a_brake_at_a_bound_that_rounding_may_lift_to_the_curve_is_in_time(rig: Rig) -> None:
    rig.step(6, speed_mps=20.0)
    rig.send_now(BrakeCommand, emergency_released=False)
    rig.send_now(VobcMotion, speed_mps=20.0, emergency_mps=20.5)
    rig.tell(mode_told(speed_reach_mps=0.55))
    rig.step(20)

    assert rig.margin("inv-03-emergency-at-curve") == pytest.approx(0.07, abs=0.003)


def test_a_bound_of_another_cycle_does_not_count(rig: Rig) -> None:
    bound_at_curve(rig, reach_mps=0.6, later_s=0.03)
    rig.step(20)

    assert rig.result("inv-03-emergency-at-curve").margin is None


def test_a_speed_that_may_be_rounded_up_to_the_curve_is_not_over_it(rig: Rig) -> None:
    rig.step(5, speed_mps=20.0)
    rig.send_now(VobcMotion, speed_mps=20.0, emergency_mps=20.0)
    rig.step(50)

    assert rig.result("inv-03-emergency-at-curve").margin is None


LEVEL_OVERSHOOT_MPS = 1.0 * (0.03 + 2 * 0.05 + 0.30)


def test_the_civil_limit_allows_margin_and_overshoot_and_no_more(rig: Rig) -> None:
    allowed_mps = 70.0 * KMH + 8.0 * KMH + LEVEL_OVERSHOOT_MPS

    rig.step(1, speed_mps=allowed_mps - 1e-6)
    assert rig.margin("inv-04-civil-limit") == pytest.approx(1e-6, abs=1e-8)
    rig.step(1, speed_mps=allowed_mps + 1e-6)
    assert rig.result("inv-04-civil-limit").verdict is Verdict.FAIL


def test_the_slowest_metre_under_the_train_counts(rig: Rig) -> None:
    """The 40 km/h section ends at 1900 m; a train of 68.59 m is clear of it at 1968.59 m."""
    rig.truth.front_m = 1968.4
    rig.step(1, speed_mps=10.0)
    fall_mps2 = 9.81 * 0.03 / 1.08
    overshoot_mps = (1.0 + fall_mps2) * 0.43 + fall_mps2 * 1.05
    slow_mps = 48.0 * KMH + overshoot_mps - 10.0
    assert rig.margin("inv-04-civil-limit") == pytest.approx(slow_mps, abs=1e-6)

    rig.truth.front_m = 1968.7
    rig.step(1, speed_mps=78.0 * KMH)
    assert rig.margin("inv-04-civil-limit") == pytest.approx(LEVEL_OVERSHOOT_MPS, abs=1e-6)


# 5, 6, 7: the emergency brake.


def test_an_emergency_brake_released_in_motion_is_a_violation(rig: Rig) -> None:
    rig.step(20, speed_mps=5.0)
    rig.emergency(True)
    rig.step(50)
    rig.emergency(False)
    rig.step(10)

    assert rig.margin("inv-05-emergency-held") == -1.0


def latched_to_standstill(rig: Rig) -> None:
    rig.step(20, speed_mps=5.0)
    rig.say(VobcStatus, supervision=Supervision.EMERGENCY)
    rig.emergency(True)
    rig.step(50)
    rig.step(50, speed_mps=0.0)


def test_an_emergency_brake_held_to_standstill_and_reset_is_right(rig: Rig) -> None:
    latched_to_standstill(rig)
    rig.send_now(Desk, reset_requested=True)
    rig.step(10)
    rig.say(VobcStatus, supervision=Supervision.NO_AUTHORITY)
    rig.step(1000)
    assert rig.margin("inv-05-emergency-held") == 1.0

    rig.say(VobcStatus, supervision=Supervision.NOMINAL)
    rig.emergency(False)
    rig.step(10)
    assert rig.margin("inv-05-emergency-held") == 1.0


@pytest.mark.parametrize("pressed", ["never", "in motion"])
def test_a_latched_emergency_without_a_reset_at_standstill_must_stay(
    rig: Rig, pressed: str
) -> None:
    if pressed == "in motion":
        rig.step(20, speed_mps=5.0)
        rig.send_now(Desk, reset_requested=True)
    latched_to_standstill(rig)
    rig.say(VobcStatus, supervision=Supervision.NOMINAL)
    rig.emergency(False)
    rig.step(10)

    assert rig.margin("inv-05-emergency-held") == -1.0


@pytest.mark.parametrize(("steps", "verdict"), [(30, Verdict.PASS), (31, Verdict.FAIL)])
def test_traction_has_300_ms_to_go(rig: Rig, steps: int, verdict: Verdict) -> None:
    """Traction acts for `steps` of 10 ms from the step in which the brake is requested."""
    rig.step(10, speed_mps=5.0, drive_n=1.0e5)
    rig.emergency(True)
    rig.step(steps)
    rig.step(10, drive_n=0.0)

    assert rig.result("inv-06-traction-off").verdict is verdict


def test_an_emergency_without_traction_shows_nothing_of_it(rig: Rig) -> None:
    rig.step(10, speed_mps=5.0)
    rig.emergency(True)
    rig.step(100)

    assert rig.result("inv-06-traction-off").margin is None


@pytest.mark.parametrize(("drive_n", "margin"), [(0.0, 1.0), (500.0, -1.0)])
def test_what_is_asked_of_traction_is_ignored_under_the_emergency_brake(
    rig: Rig, drive_n: float, margin: float
) -> None:
    rig.step(10, speed_mps=5.0)
    rig.emergency(True)
    rig.say(TractionCommand, force_n=1.0e5)
    rig.step(50)
    rig.step(50, drive_n=drive_n)

    assert rig.margin("inv-07-demand-ignored") == margin


# 8, 9: direction.


def test_a_train_may_roll_back_two_metres_from_its_foremost_place(rig: Rig) -> None:
    rig.step(100, speed_mps=1.0)
    rig.step(200, speed_mps=-1.0)
    assert rig.margin("inv-08-rollback") == pytest.approx(0.0, abs=1e-6)

    rig.step(1, speed_mps=-1.0)
    assert rig.margin("inv-08-rollback") == pytest.approx(-0.01)


def test_a_coupler_that_eases_is_no_rollback(rig: Rig) -> None:
    rig.step(10, speed_mps=1.0)
    rig.step(1, speed_mps=-1.0)

    assert rig.result("inv-08-rollback").margin is None


@pytest.mark.parametrize(
    ("direction", "margin"),
    [(Direction.FORWARD, 1.0), (Direction.REVERSE, -1.0), (Direction.NEUTRAL, -1.0)],
)
def test_traction_is_asked_for_forwards_only(rig: Rig, direction: Direction, margin: float) -> None:
    rig.say(TractionCommand, force_n=1000.0, direction=direction)
    rig.step(45)

    assert rig.margin("inv-09-direction") == margin


# 13 to 17: the train's position estimate.


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_the_true_front_lies_within_the_uncertainty(rig: Rig, side: float) -> None:
    rig.say(VobcPosition, front_m=1000.0 + side * 0.99)
    rig.step(10)
    assert rig.margin("inv-13-position-interval") == pytest.approx(0.01, abs=1e-6)

    rig.say(VobcPosition, front_m=1000.0 + side * 1.01)
    rig.step(10)
    assert rig.result("inv-13-position-interval").verdict is Verdict.FAIL


@pytest.mark.parametrize(
    ("slips", "behind_m", "verdict"),
    [
        (0, 1.4 + 0.09, Verdict.PASS),
        (0, 1.4 + 0.13, Verdict.FAIL),
        (1, 2.4 + 0.09, Verdict.PASS),
        (1, 2.4 + 0.13, Verdict.FAIL),
    ],
)
def test_a_claim_may_be_as_old_as_its_cycle(
    rig: Rig, slips: int, behind_m: float, verdict: Verdict
) -> None:
    """At 20 m/s a train moves 1.4 m in 50 ms and 20 ms, and 1 m more in a missed cycle."""
    rig.step(1, speed_mps=20.0)
    rig.silent.add(VobcPosition)
    rig.step(9)
    rig.send_now(VobcStatus, cycle_slips=slips)
    # The frame comes half a millisecond after the status, a millisecond or two into the step.
    rig.send_now(VobcPosition, front_m=rig.truth.front_m - behind_m + 0.02, uncertainty_m=0.1)
    rig.step(1)

    assert rig.result("inv-13-position-interval").verdict is verdict


def test_a_width_from_silent_wheels_may_shrink_again(rig: Rig) -> None:
    rig.step(10)
    rig.silent.add(Tacho)
    rig.step(20)
    rig.say(VobcPosition, front_m=1000.0, uncertainty_m=9.0)
    rig.step(10)
    rig.silent.clear()
    rig.say(VobcPosition, front_m=1000.0, uncertainty_m=1.0)
    rig.step(10)

    assert rig.result("inv-14-narrowed-by-tag").margin is None


def test_a_claim_that_waited_for_the_bus_is_not_judged(rig: Rig) -> None:
    """The frame is half a second late and 10 m behind the train."""
    rig.step(50, speed_mps=20.0)
    rig.silent.add(VobcPosition)
    rig.step(50)
    rig.send_now(VobcPosition, front_m=rig.truth.front_m - 10.0)
    rig.step(1)

    assert rig.result("inv-13-position-interval").verdict is Verdict.PASS


def test_an_unknown_position_is_not_judged(rig: Rig) -> None:
    rig.say(VobcPosition, front_m=0.0, uncertainty_m=655.35)
    rig.step(20)

    assert rig.result("inv-13-position-interval").margin is None


def test_a_width_that_falls_takes_a_tag(rig: Rig) -> None:
    rig.step(10)
    rig.say(VobcPosition, front_m=1000.0, uncertainty_m=0.5)
    rig.step(10, tags_read=1.0)
    assert rig.margin("inv-14-narrowed-by-tag") == 1.0

    rig.step(250)
    rig.say(VobcPosition, front_m=1000.0, uncertainty_m=0.4)
    rig.step(10)
    assert rig.margin("inv-14-narrowed-by-tag") == 1.0
    rig.say(VobcPosition, front_m=1000.0, uncertainty_m=0.1)
    rig.step(10)
    assert rig.margin("inv-14-narrowed-by-tag") == -1.0


@pytest.mark.parametrize(("tags", "margin"), [(1.0, 1.0), (0.0, -1.0)])
def test_a_tag_that_was_read_while_claims_were_passed_over_narrows_what_comes_after_them(
    rig: Rig, tags: float, margin: float
) -> None:
    """A position frame is out of its rhythm; the train reads the tag in the 2 s that are skipped
    for it."""
    rig.step(20)
    rig.silent.add(VobcPosition)
    rig.step(40)
    rig.silent.clear()
    rig.step(10, tags_read=tags)
    rig.say(VobcPosition, front_m=1000.0, uncertainty_m=0.5)
    rig.step(300)

    assert rig.margin("inv-14-narrowed-by-tag") == margin


def test_positions_are_judged_only_after_the_settling_time(
    settling_rig: Rig,
) -> None:
    rig = settling_rig
    rig.say(VobcPosition, front_m=1500.0, uncertainty_m=1.0)
    rig.step(190)
    assert rig.result("inv-13-position-interval").margin is None

    rig.step(30)
    assert rig.margin("inv-13-position-interval") == pytest.approx(-499.0)


def test_a_localised_train_knows_its_place_within_thirty_metres(rig: Rig) -> None:
    rig.say(VobcPosition, front_m=1000.0, uncertainty_m=30.0)
    rig.step(10)
    assert rig.margin("inv-16-localisation-limit") == pytest.approx(0.0, abs=1e-9)

    rig.say(VobcStatus, localised=False)
    rig.say(VobcPosition, front_m=1000.0, uncertainty_m=32.0)
    rig.step(10)
    assert rig.result("inv-16-localisation-limit").verdict is Verdict.PASS

    rig.say(VobcStatus, localised=True)
    rig.step(10)
    assert rig.margin("inv-16-localisation-limit") == pytest.approx(-2.0)


def test_doors_are_enabled_under_three_kilometres_an_hour(rig: Rig) -> None:
    rig.say(DoorCommand, enable_right=True)
    rig.step(10, speed_mps=3.0 * KMH)
    assert rig.margin("inv-17-zero-speed") == pytest.approx(0.0, abs=1e-12)

    rig.step(1, speed_mps=3.01 * KMH)
    assert rig.result("inv-17-zero-speed").verdict is Verdict.FAIL


# 30 to 33: doors.


def open_doors(rig: Rig, at_m: float, **changes: float) -> None:
    """All platforms are on the right."""
    rig.say(DoorCommand, enable_right=True, enable_left=True, open_right=True)
    rig.truth.front_m = at_m
    rig.step(10)
    rig.step(20, doors_locked=0.0, **{"right_open": 1.0, **changes})


def test_doors_that_open_where_they_should_violate_nothing(rig: Rig) -> None:
    open_doors(rig, 1500.0)

    assert rig.monitors.violated is None
    for name in ("door-speed", "door-place", "door-platform", "door-side"):
        assert rig.result(f"inv-30-{name}").margin is not None
    assert rig.margin("inv-31-door-enable") == 1.0
    assert rig.margin("inv-32-door-holding") == 1.0
    assert rig.margin("inv-32-door-traction") == pytest.approx(0.3)


def test_doors_open_within_thirty_centimetres_of_the_stopping_point(rig: Rig) -> None:
    open_doors(rig, 1499.7)
    assert rig.margin("inv-30-door-place") == pytest.approx(0.0, abs=1e-9)

    rig.step(1, front_m=1499.69)
    assert rig.margin("inv-30-door-place") == pytest.approx(-0.01)


@pytest.mark.parametrize(
    ("cars", "margin_m"),
    [
        # The platform reaches from 1420 m to 1505 m; the cars are 17.455, 16.84, 16.84 and
        # 17.455 m long.
        (0b1111, 5.0),
        (0b0110, 22.455),
        (0b1000, 11.41),
    ],
)
def test_each_car_with_an_open_door_is_beside_the_platform(
    rig: Rig, cars: int, margin_m: float
) -> None:
    open_doors(rig, 1500.0, right_cars=float(cars))
    assert rig.margin("inv-30-door-platform") == pytest.approx(margin_m)

    # A front right at its stop does not help a car that is still in the tunnel.
    rig.step(1, front_m=1505.01)
    first_m = {0b1111: 0.0, 0b0110: 17.455, 0b1000: 51.135}[cars]
    assert rig.margin("inv-30-door-platform") == pytest.approx(min(margin_m, first_m - 0.01))


def test_a_car_behind_the_platform_is_found_although_the_front_is_at_its_stop(rig: Rig) -> None:
    """The shipped train of 68.59 m at a stopping point 60 m from the rear end of a platform."""
    open_doors(rig, 1480.0, right_cars=float(0b0111))
    assert rig.margin("inv-30-door-platform") == pytest.approx(8.865)

    rig.step(1, right_cars=float(0b1111))
    assert rig.margin("inv-30-door-platform") == pytest.approx(-8.59)


@pytest.mark.parametrize(
    ("name", "changes"),
    [
        ("inv-30-door-speed", {"speed_mps": 3.01 * KMH}),
        ("inv-30-door-side", {"left_open": 1.0}),
        ("inv-32-door-holding", {"holding": 0.0}),
    ],
)
def test_an_open_door_forbids_motion_and_traction(
    rig: Rig, name: str, changes: dict[str, float]
) -> None:
    open_doors(rig, 1500.0)
    assert rig.result(name).verdict is Verdict.PASS

    rig.step(1, **changes)
    assert rig.result(name).verdict is Verdict.FAIL


def test_a_side_opens_by_its_own_enable_only(rig: Rig) -> None:
    rig.say(DoorCommand, enable_left=True, open_left=True, open_right=True)
    rig.truth.front_m = 1500.0
    rig.step(10)
    rig.step(10, doors_locked=0.0, right_open=1.0)

    assert rig.margin("inv-31-door-enable") == -1.0


@pytest.mark.parametrize(("steps", "verdict"), [(31, Verdict.PASS), (32, Verdict.FAIL)])
def test_a_door_that_unlocks_cuts_traction_within_300_ms(
    rig: Rig, steps: int, verdict: Verdict
) -> None:
    """The first step is the one in which the door unlocks; 30 more end 300 ms later."""
    rig.step(10, speed_mps=0.5, drive_n=1000.0)
    rig.step(steps, doors_locked=0.0)
    rig.step(5, drive_n=0.0)

    assert rig.result("inv-32-door-traction").verdict is verdict


@pytest.mark.parametrize(("locked", "margin"), [(1.0, 1.0), (0.0, -1.0)])
def test_a_train_departs_with_its_doors_locked(rig: Rig, locked: float, margin: float) -> None:
    rig.step(10, doors_locked=locked)
    rig.step(10, speed_mps=0.09)
    assert rig.result("inv-33-departure-locked").margin is None

    rig.step(10, speed_mps=0.5)
    assert rig.margin("inv-33-departure-locked") == margin


@pytest.mark.parametrize(("first", "then", "margin"), [(1.0, 0.0, 1.0), (0.0, 1.0, -1.0)])
def test_the_state_of_the_doors_at_the_start_of_motion_counts(
    rig: Rig, first: float, then: float, margin: float
) -> None:
    rig.step(10, doors_locked=first)
    rig.step(10, speed_mps=0.05)
    rig.step(10, speed_mps=0.5, doors_locked=then)

    assert rig.margin("inv-33-departure-locked") == margin


# 34, 36: silence.


@pytest.mark.parametrize(("steps", "verdict"), [(12, Verdict.PASS), (13, Verdict.FAIL)])
def test_a_silent_brake_command_brings_the_emergency_brake(
    rig: Rig, steps: int, verdict: Verdict
) -> None:
    rig.step(50, speed_mps=5.0)
    rig.silent.add(BrakeCommand)
    rig.step(steps)
    rig.step(50, emergency=1.0)

    assert rig.result("inv-34-brake-silence").verdict is verdict


@pytest.mark.parametrize(("steps", "verdict"), [(42, Verdict.PASS), (43, Verdict.FAIL)])
def test_a_silent_traction_command_takes_traction_away(
    rig: Rig, steps: int, verdict: Verdict
) -> None:
    rig.step(50, speed_mps=5.0, drive_n=1000.0)
    rig.silent.add(TractionCommand)
    rig.step(steps)
    rig.step(50, drive_n=0.0)

    assert rig.result("inv-34-traction-silence").verdict is verdict


@pytest.mark.parametrize(("steps", "verdict"), [(277, Verdict.PASS), (278, Verdict.FAIL)])
def test_a_silent_door_command_closes_the_doors(rig: Rig, steps: int, verdict: Verdict) -> None:
    """The unit needs 0.3 s to detect the silence and 2.5 s to close the doors."""
    open_doors(rig, 1500.0)
    rig.silent.add(DoorCommand)
    rig.step(steps)
    rig.step(50, doors_locked=1.0, right_open=0.0)

    assert rig.result("inv-34-door-silence").verdict is verdict


@pytest.mark.parametrize("kind", [Tacho, BrakeStatus, Desk])
def test_a_moving_train_with_missing_inputs_brakes(rig: Rig, kind: type) -> None:
    rig.step(50, speed_mps=5.0)
    rig.silent.add(kind)
    rig.step(37)
    assert rig.result("inv-34-input-silence").verdict is Verdict.PASS

    rig.step(1)
    assert rig.result("inv-34-input-silence").verdict is Verdict.FAIL


def test_a_corrupted_frame_does_not_count(rig: Rig) -> None:
    """A frame with a wrong CRC does not end a silence."""
    rig.step(50, speed_mps=5.0)
    rig.silent.add(Tacho)
    for _ in range(50):
        rig.step(1)
        rig.monitors.frame(rig.now_ns, 389, bytes(8))

    assert rig.result("inv-34-input-silence").verdict is Verdict.FAIL


@pytest.mark.parametrize(("missed", "margin"), [(2, None), (3, -1.0)])
def test_more_than_two_missed_cycles_bring_the_emergency_brake(
    rig: Rig, missed: int, margin: float | None
) -> None:
    rig.say(VobcStatus, cycle_slips=63)
    rig.step(50, speed_mps=5.0)
    rig.say(VobcStatus, cycle_slips=(63 + missed) % 64)
    rig.step(20)

    assert rig.result("inv-36-overrun").margin == margin


def test_missed_cycles_that_brought_the_emergency_brake_are_in_order(rig: Rig) -> None:
    rig.step(50, speed_mps=5.0)
    rig.say(VobcStatus, cycle_slips=3)
    rig.emergency(True)
    rig.step(20)

    assert rig.margin("inv-36-overrun") == 1.0


# 39: comfort.


def test_the_demand_changes_no_faster_than_the_jerk_allows(rig: Rig) -> None:
    for decel_mps2 in (0.0, 0.030, 0.060):
        rig.say(BrakeCommand, service_decel_mps2=decel_mps2)
        rig.step(5)
    assert rig.margin("inv-39-jerk") == pytest.approx(0.65 - 0.6, abs=1e-6)

    rig.say(BrakeCommand, service_decel_mps2=0.096)
    rig.step(5)
    assert rig.margin("inv-39-jerk") == pytest.approx(0.65 - 0.72, abs=1e-6)


def test_a_cycle_that_was_late_may_change_the_demand_by_as_much_more(late_rig: Rig) -> None:
    """The first cycle is 20 ms late and changes the demand at 0.6 m/s³ for 70 ms: 0.84 of a
    cycle's change."""
    rig = late_rig
    rig.step(5)
    rig.silent.update((BrakeCommand, TractionCommand))
    rig.step(7)
    rig.send_now(BrakeCommand, service_decel_mps2=0.042)
    rig.send_now(TractionCommand)
    rig.step(1)

    margin_mps3 = rig.margin("inv-39-jerk")
    assert margin_mps3 > 0.65 - 0.6


def test_a_demand_that_changes_too_fast_for_long_is_seen_through_what_lateness_explains(
    late_rig: Rig,
) -> None:
    """At 0.8 m/s³ each step alone may come from a late cycle, but ten in a row may not."""
    rig = late_rig
    for number in range(12):
        rig.say(BrakeCommand, service_decel_mps2=round(0.04 * number, 3))
        rig.step(5)

    assert rig.margin("inv-39-jerk") == pytest.approx(0.65 - 0.4 / 0.55, abs=1e-6)


def test_the_demand_stays_within_the_comfort_limit(rig: Rig) -> None:
    rig.truth.accel_mps2 = -1.0
    rig.say(BrakeCommand, service_decel_mps2=0.85)
    rig.step(10)
    assert rig.margin("inv-39-accel") == pytest.approx(0.0, abs=1e-6)

    rig.say(BrakeCommand, service_decel_mps2=0.852)
    rig.step(10)
    assert rig.margin("inv-39-accel") == pytest.approx(-0.002, abs=1e-6)


@pytest.mark.parametrize(
    ("gradient_permille", "margin_mps2"),
    [(30.0, -0.1), (0.0, -0.1), (-30.0, 0.85 - 0.95 + 0.03 * 9.81 / 1.08)],
)
def test_on_falling_track_the_brake_may_also_hold_the_gradient(
    rig: Rig, gradient_permille: float, margin_mps2: float
) -> None:
    rig.truth.gradient_permille, rig.truth.accel_mps2 = gradient_permille, -1.0

    rig.say(BrakeCommand, service_decel_mps2=0.95)
    rig.step(10)

    assert rig.margin("inv-39-accel") == pytest.approx(min(0.85, margin_mps2), abs=1e-6)


@pytest.mark.parametrize("decel_mps2", [0.0, 0.7, 0.86])
def test_more_brake_is_in_order_while_the_train_keeps_the_comfort_limit(
    rig: Rig, decel_mps2: float
) -> None:
    """On falling track, and with a weak brake, the train decelerates by less than the demand."""
    rig.truth.accel_mps2 = -decel_mps2

    rig.say(BrakeCommand, service_decel_mps2=0.95)
    rig.step(10)

    assert rig.margin("inv-39-accel") == pytest.approx(0.85 - decel_mps2, abs=1e-6)


@pytest.mark.parametrize(
    ("kind", "changes"),
    [
        (VobcStatus, {"supervision": Supervision.SERVICE}),
        (BrakeCommand, {"emergency_released": False}),
        (BrakeCommand, {"holding_released": False}),
        (TractionCommand, {"traction_permitted": False}),
    ],
)
def test_the_comfort_limit_does_not_apply_to_protection(
    rig: Rig, kind: type, changes: dict[str, object]
) -> None:
    rig.say(kind, **changes)
    rig.say(BrakeCommand, service_decel_mps2=1.0)
    rig.step(20)

    assert rig.result("inv-39-accel").margin is None


def test_every_watched_invariant_has_a_test_here() -> None:
    tests = Path(__file__).parent.glob("test_monitors_*.py")
    text = "".join(each.read_text(encoding="utf-8") for each in tests)

    assert [each.name for each in WATCHED if each.name not in text] == []
