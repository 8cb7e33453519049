"""Fixed ceilings that need no position, and the lower of two ceilings in each speed."""

import pytest

from can_dbc.vobc import TargetKind
from vobc.atp.fixed_ceilings import FixedCeilings
from vobc.config import load_config
from vobc.vocabulary import Ceiling, SupervisedTarget

KMH = 1.0 / 3.6
FLAT = FixedCeilings(load_config("florence4").atp)


def kmh_of(ceiling: Ceiling) -> tuple[float, float, float, float]:
    return (
        ceiling.permitted_mps * 3.6,
        ceiling.warning_mps * 3.6,
        ceiling.service_mps * 3.6,
        ceiling.emergency_mps * 3.6,
    )


@pytest.mark.parametrize(
    ("ceiling", "speed_kmh"),
    [(FLAT.restricted, 25.0), (FLAT.creep, 15.0), (FLAT.jog, 5.0)],
    ids=["on sight", "creep", "jog"],
)
def test_the_fixed_limits_lie_one_two_and_five_kmh_above_the_fixed_speed(
    ceiling: Ceiling, speed_kmh: float
) -> None:
    assert kmh_of(ceiling) == pytest.approx(
        (speed_kmh, speed_kmh + 1.0, speed_kmh + 2.0, speed_kmh + 5.0)
    )
    assert ceiling.distance_to_authority_m == 0.0, "no place is known"


def test_each_speed_is_the_lower_of_the_known_and_the_fixed_one() -> None:
    known = Ceiling(1.0, 6.0, 3.0, 8.0, 120.0)
    flat = Ceiling(5.0, 2.0, 7.0, 4.0, 0.0)

    assert FixedCeilings.under(known, flat) == Ceiling(1.0, 2.0, 3.0, 4.0, 120.0)
    assert FixedCeilings.under(flat, known) == Ceiling(1.0, 2.0, 3.0, 4.0, 0.0)


@pytest.mark.parametrize(("permitted_mps", "shown"), [(4.9, True), (5.0, False), (5.1, False)])
def test_a_target_is_shown_while_it_is_lower_than_the_fixed_speed(
    permitted_mps: float, shown: bool
) -> None:
    target = SupervisedTarget(TargetKind.END, 0.0, 12.0)
    known = Ceiling(permitted_mps, 6.0, 7.0, 8.0, 120.0, target)
    flat = Ceiling(5.0, 6.0, 7.0, 8.0, 0.0)

    assert FixedCeilings.under(known, flat).target == (target if shown else None)
