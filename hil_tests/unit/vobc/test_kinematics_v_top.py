"""The maximum speed of [Lin] against the energy balance that defines it."""

import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from vobc.kinematics import (
    EMERGENCY,
    SERVICE_FROM_COAST_OR_BRAKE,
    SERVICE_FROM_TRACTION,
    ReactionTimes,
    v_top_mps,
)

MASS_KG = 190_000.0
STATES = [
    (SERVICE_FROM_TRACTION, 0.8),
    (SERVICE_FROM_COAST_OR_BRAKE, 0.0),
    (SERVICE_FROM_COAST_OR_BRAKE, -0.4),
    (EMERGENCY, 1.0),
]


def surplus_j(
    speed_mps: float,
    distance_m: float,
    *,
    brake_mps2: float,
    climb_mps2: float,
    accel_mps2: float,
    reaction: ReactionTimes,
    target_mps: float,
) -> float:
    """Energy W of equation (2) of [Lin], term by term, from forces and distances.

    The acceleration in t1 includes the gradient, so potential energy counts from the end of t1. In
    t2 the equation holds the speed, so that distance takes no work.
    """
    after_mps = speed_mps + accel_mps2 * reaction.before_cut_s
    first_m = 0.5 * (speed_mps + after_mps) * reaction.before_cut_s
    braked_m = distance_m - first_m - after_mps * reaction.build_up_s
    kinetic_j = 0.5 * MASS_KG * speed_mps**2
    traction_j = MASS_KG * accel_mps2 * first_m
    left_j = 0.5 * MASS_KG * target_mps**2
    climb_j = MASS_KG * climb_mps2 * braked_m
    brake_j = MASS_KG * brake_mps2 * braked_m
    return kinetic_j + traction_j - left_j - climb_j - brake_j


@pytest.mark.parametrize(("reaction", "accel_mps2"), STATES)
@given(
    distance_m=st.floats(5.0, 900.0),
    brake_mps2=st.floats(0.5, 1.3),
    climb_mps2=st.floats(-0.3, 0.3),
    target_mps=st.floats(0.0, 20.0),
)
def test_at_the_maximum_speed_the_energy_balance_is_zero(
    reaction: ReactionTimes,
    accel_mps2: float,
    distance_m: float,
    brake_mps2: float,
    climb_mps2: float,
    target_mps: float,
) -> None:
    speed_mps = v_top_mps(
        distance_m,
        decel_mps2=brake_mps2 + climb_mps2,
        accel_mps2=accel_mps2,
        reaction=reaction,
        target_mps=target_mps,
    )
    assume(speed_mps > 0.0)

    def over_j(at_mps: float) -> float:
        return surplus_j(
            at_mps,
            distance_m,
            brake_mps2=brake_mps2,
            climb_mps2=climb_mps2,
            accel_mps2=accel_mps2,
            reaction=reaction,
            target_mps=target_mps,
        )

    assert over_j(speed_mps) == pytest.approx(0.0, abs=1e-9 * MASS_KG * 900.0)
    assert over_j(speed_mps + 0.01) > 0.0 > over_j(speed_mps - 0.01)


def test_traction_gives_a_lower_maximum_speed_than_coasting() -> None:
    from_traction_mps = v_top_mps(
        300.0, decel_mps2=0.9, accel_mps2=0.8, reaction=SERVICE_FROM_TRACTION
    )
    from_coast_mps = v_top_mps(
        300.0, decel_mps2=0.9, accel_mps2=0.0, reaction=SERVICE_FROM_COAST_OR_BRAKE
    )

    assert from_traction_mps < from_coast_mps - 1.0


@pytest.mark.parametrize("distance_m", [-500.0, -3.0, 0.0, 0.1])
def test_without_room_for_the_reaction_the_maximum_speed_is_zero(distance_m: float) -> None:
    assert v_top_mps(distance_m, decel_mps2=1.0, accel_mps2=1.0, reaction=EMERGENCY) == 0.0
