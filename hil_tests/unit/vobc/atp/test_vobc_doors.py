"""Door enabling: the whole truth table, and where a train counts as correctly stopped."""

import itertools
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from can_dbc.doors import ALL_CARS
from can_dbc.vobc import Withheld
from firmware_py.trackdb import PlatformSide, Station
from vobc.atp.doors import (
    WITHHELD_WITHOUT,
    DoorEnable,
    DoorTerms,
    car_spans,
    cars_beside,
    enabled_doors,
    is_aligned,
    withheld,
)
from vobc.vocabulary import Interval

STATION = Station("A", 100.0, 20.0, 105.0, PlatformSide.LEFT)
SIDES = (None, *PlatformSide)
BOTH_PERMITTED = DoorEnable(left=True, right=True)


def test_every_combination_of_the_terms() -> None:
    """Of all 2^10 combinations times four sides, only the three with every term enable doors, on
    the right sides."""
    enabled = {}
    for values in itertools.product((False, True), repeat=len(DoorTerms._fields)):
        for side in SIDES:
            doors = enabled_doors(withheld(DoorTerms(*values)), side, BOTH_PERMITTED)
            if any(doors):
                enabled[values, side] = doors

    everything = (True,) * 10
    assert enabled == {
        (everything, PlatformSide.LEFT): DoorEnable(left=True, right=False),
        (everything, PlatformSide.RIGHT): DoorEnable(left=False, right=True),
        (everything, PlatformSide.BOTH): DoorEnable(left=True, right=True),
    }


@pytest.mark.parametrize(
    "permitted", list(map(DoorEnable._make, itertools.product((False, True), repeat=2)))
)
@pytest.mark.parametrize("side", list(PlatformSide))
def test_a_side_opens_only_with_platform_and_permission(
    side: PlatformSide, permitted: DoorEnable
) -> None:
    doors = enabled_doors(Withheld.NONE, side, permitted)

    assert doors.left is (permitted.left and side in (PlatformSide.LEFT, PlatformSide.BOTH))
    assert doors.right is (permitted.right and side in (PlatformSide.RIGHT, PlatformSide.BOTH))


def test_each_missing_term_is_named_by_a_flag_of_its_own() -> None:
    expected = {
        "standstill": Withheld.MOVING,
        "localised": Withheld.NOT_LOCALISED,
        "near_platform": Withheld.NO_PLATFORM,
        "aligned": Withheld.MISALIGNED,
        "beside_platform": Withheld.OFF_PLATFORM,
        "holding_applied": Withheld.NOT_HELD,
        "traction_cut": Withheld.TRACTION,
        "no_emergency": Withheld.EMERGENCY,
        "authorised": Withheld.NOT_AUTHORISED,
        "centre_heard": Withheld.CENTRE_SILENT,
    }
    for term, flag in expected.items():
        terms = DoorTerms(*(True,) * 10)._replace(**{term: False})
        assert withheld(terms) is flag
    assert set(WITHHELD_WITHOUT) == set(DoorTerms._fields)


@given(st.lists(st.booleans(), min_size=10, max_size=10))
def test_exactly_the_missing_terms_are_named(values: list[bool]) -> None:
    said = withheld(DoorTerms(*values))

    for term, value in zip(DoorTerms._fields, values, strict=True):
        assert (WITHHELD_WITHOUT[term] in said) is not value


@given(st.floats(0.0, 700.0), st.floats(0.0, 2.0))
def test_no_place_outside_the_window_is_a_platform(best_m: float, half_m: float) -> None:
    front_m = Interval(best_m - half_m, best_m, best_m + half_m)

    aligned = is_aligned(STATION, front_m, window_m=0.3)

    reach_m = abs(best_m - STATION.stop_m) + half_m
    assert aligned == (reach_m <= 0.3) or abs(reach_m - 0.3) < 1e-9


def test_an_unset_term_is_an_error_and_no_permission_to_open() -> None:
    too_few = (True,) * (len(DoorTerms._fields) - 1)

    with pytest.raises(ValueError, match="longer"):
        withheld(too_few)  # type: ignore[arg-type]


# The platform of STATION reaches from 20 m to 105 m.


@pytest.mark.parametrize(
    ("low_m", "high_m", "length_m", "cars"),
    [
        (100.0, 100.0, 80.0, ALL_CARS),
        (99.75, 100.0, 80.0, 0),
        (100.0, 100.0, 80.25, 0),
        (105.0, 105.0, 80.0, ALL_CARS),
        (105.0, 105.25, 80.0, 0),
        (104.0, 106.0, 10.0, 0),
    ],
)
def test_a_train_whose_door_unit_knows_no_cars_opens_all_its_doors_or_none(
    low_m: float, high_m: float, length_m: float, cars: int
) -> None:
    front_m = Interval(low_m, low_m, high_m)

    assert cars_beside(STATION, front_m, train_length_m=length_m, spans=()) == cars


@pytest.mark.parametrize(
    ("low_m", "high_m", "cars"),
    [
        # Four of six cars of 20 m reach from 100 m back to 20 m.
        (100.0, 100.0, 0b001111),
        (99.75, 100.0, 0b000111),
        (100.0, 105.0, 0b001111),
        # The first car may be in front of the platform.
        (105.0, 105.25, 0b001110),
        (125.0, 125.0, 0b011110),
        (125.25, 125.25, 0b011100),
        # No car is surely beside the platform.
        (300.0, 300.0, 0),
        (20.0, 120.0, 0),
    ],
)
def test_each_car_opens_only_with_both_its_ends_beside_the_platform(
    low_m: float, high_m: float, cars: int
) -> None:
    front_m, spans = Interval(low_m, low_m, high_m), car_spans((20.0,) * 6)

    assert cars_beside(STATION, front_m, train_length_m=120.0, spans=spans) == cars


@given(
    st.lists(st.floats(5.0, 30.0), min_size=1, max_size=8),
    st.floats(-20.0, 400.0),
    st.floats(0.0, 3.0),
    st.floats(0.0, 1.0),
)
def test_no_door_opens_beyond_the_platform_wherever_the_front_is(
    lengths_m: list[float], low_m: float, width_m: float, share: float
) -> None:
    """Each point of an open car is beside the platform, for each front in the interval."""
    front_m = Interval(low_m, low_m, low_m + width_m)
    length_m, true_front_m = sum(lengths_m), low_m + share * width_m

    cars = cars_beside(STATION, front_m, train_length_m=length_m, spans=car_spans(lengths_m))

    reached_m = true_front_m
    for index, car_m in enumerate(lengths_m):
        if cars >> index & 1:
            assert reached_m <= STATION.platform_end_m + 1e-9
            assert reached_m - car_m >= STATION.platform_start_m - 1e-9
        reached_m -= car_m
    if cars == ALL_CARS:
        assert STATION.platform_start_m <= true_front_m - length_m + 1e-9


def test_an_unknown_front_opens_no_car() -> None:
    nowhere = Interval(math.nan, math.nan, math.nan)

    assert cars_beside(STATION, nowhere, train_length_m=60.0, spans=car_spans((20.0,) * 3)) == 0
