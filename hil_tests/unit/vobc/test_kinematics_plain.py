"""Plain braking against hand calculations, mostly from 20 m/s with 0.8 m/s²."""

import pytest

from vobc.kinematics import (
    EMERGENCY,
    SERVICE_FROM_COAST_OR_BRAKE,
    SERVICE_FROM_TRACTION,
    ReactionTimes,
    gradient_accel_mps2,
    permitted_speed_mps,
    stopping_distance_m,
    v_top_mps,
)


@pytest.mark.parametrize(
    ("gradient_permille", "rotating_mass_ratio", "accel_mps2"),
    [(-30.0, 0.0, 0.2943), (30.0, 0.0, -0.2943), (-30.0, 0.09, 0.27), (0.0, 0.09, 0.0)],
)
def test_gravity_accelerates_on_a_fall_and_less_with_more_rotating_mass(
    gradient_permille: float, rotating_mass_ratio: float, accel_mps2: float
) -> None:
    assert gradient_accel_mps2(
        gradient_permille, rotating_mass_ratio=rotating_mass_ratio
    ) == pytest.approx(accel_mps2, abs=1e-12)
    assert gradient_accel_mps2(-30.0) == pytest.approx(0.2943), "without a word nothing turns"


def test_from_20_to_12_metres_per_second_a_brake_of_0_8_needs_160_metres() -> None:
    """The train brakes for ten seconds at a mean of 16 m/s; from 20 m/s to standstill it needs
    250 m."""
    assert stopping_distance_m(20.0, decel_mps2=0.8, target_mps=12.0) == pytest.approx(160.0)
    assert stopping_distance_m(20.0, decel_mps2=0.8) == pytest.approx(250.0)
    assert permitted_speed_mps(
        160.0, decel_mps2=0.8, reaction_s=0.0, target_mps=12.0
    ) == pytest.approx(20.0)
    assert permitted_speed_mps(250.0, decel_mps2=0.8, reaction_s=0.0) == pytest.approx(20.0)


def test_a_reaction_of_one_and_a_half_seconds_adds_30_metres() -> None:
    assert stopping_distance_m(
        20.0, decel_mps2=0.8, reaction_s=1.5, target_mps=12.0
    ) == pytest.approx(190.0)
    assert permitted_speed_mps(
        190.0, decel_mps2=0.8, reaction_s=1.5, target_mps=12.0
    ) == pytest.approx(20.0)


def test_a_train_below_its_target_speed_needs_no_braking_distance() -> None:
    assert stopping_distance_m(10.0, decel_mps2=0.8, target_mps=12.0) == 0.0
    assert stopping_distance_m(10.0, decel_mps2=0.8, reaction_s=1.5, target_mps=12.0) == 15.0
    assert permitted_speed_mps(0.0, decel_mps2=0.8, reaction_s=1.5, target_mps=12.0) == 12.0
    assert permitted_speed_mps(-9.0, decel_mps2=0.8, reaction_s=1.5, target_mps=12.0) == 12.0
    assert permitted_speed_mps(0.0, decel_mps2=0.8, reaction_s=0.0) == 0.0
    assert permitted_speed_mps(-9.0, decel_mps2=0.8, reaction_s=0.0) == 0.0


@pytest.mark.parametrize(
    ("reaction", "before_cut_s", "build_up_s"),
    [
        (SERVICE_FROM_TRACTION, 0.95, 1.05),
        (SERVICE_FROM_COAST_OR_BRAKE, 0.2, 1.05),
        (EMERGENCY, 0.3, 1.05),
    ],
)
def test_a_train_in_traction_takes_longest_to_react_and_every_brake_builds_up_alike(
    reaction: ReactionTimes, before_cut_s: float, build_up_s: float
) -> None:
    assert (reaction.before_cut_s, reaction.build_up_s) == (before_cut_s, build_up_s)


def test_traction_in_the_reaction_adds_one_metre_per_second() -> None:
    """The train runs 35 m from 17 to 18 m/s, 18 m at 18 m/s, and brakes over 200 m to 2 m/s."""
    speed_mps = v_top_mps(
        253.0, decel_mps2=0.8, accel_mps2=0.5, reaction=ReactionTimes(2.0, 1.0), target_mps=2.0
    )

    assert speed_mps == pytest.approx(17.0)


def test_a_small_speed_limit_is_found_exactly() -> None:
    """The train runs on for an eighth of a second and then brakes: together a sixteenth of a
    metre."""
    speed_mps = v_top_mps(
        0.0625, decel_mps2=1.0, accel_mps2=0.0, reaction=ReactionTimes(0.125, 0.0)
    )

    assert speed_mps == pytest.approx(0.25)


def test_without_any_fitting_speed_the_limit_is_zero_even_while_braking() -> None:
    """The energy balance is zero only at 1 m/s backwards."""
    assert v_top_mps(1.5, decel_mps2=1.0, accel_mps2=-4.0, reaction=ReactionTimes(1.0, 0.0)) == 0.0
