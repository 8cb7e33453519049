"""Door enabling: the whole truth table, and where a train counts as correctly stopped."""

import itertools

import pytest
from hypothesis import given
from hypothesis import strategies as st

from can_dbc.vobc import Withheld
from firmware_py.trackdb import PlatformSide, Station
from vobc.atp.doors import (
    WITHHELD_WITHOUT,
    DoorEnable,
    DoorTerms,
    enabled_doors,
    is_aligned,
    withheld,
)
from vobc.vocabulary import Interval

STATION = Station("A", 100.0, 20.0, 105.0, PlatformSide.LEFT)
SIDES = (None, PlatformSide.LEFT, PlatformSide.RIGHT)


def test_every_combination_of_the_terms() -> None:
    """Of all 2^9 combinations times three sides, only the two with every term enable doors, on
    the right side."""
    enabled = {}
    for values in itertools.product((False, True), repeat=len(DoorTerms._fields)):
        for side in SIDES:
            doors = enabled_doors(withheld(DoorTerms(*values)), side)
            if any(doors):
                enabled[values, side] = doors

    everything = (True,) * 9
    assert enabled == {
        (everything, PlatformSide.LEFT): DoorEnable(left=True, right=False),
        (everything, PlatformSide.RIGHT): DoorEnable(left=False, right=True),
    }


def test_each_missing_term_is_named_by_a_flag_of_its_own() -> None:
    expected = {
        "standstill": Withheld.MOVING,
        "localised": Withheld.NOT_LOCALISED,
        "near_platform": Withheld.NO_PLATFORM,
        "aligned": Withheld.MISALIGNED,
        "holding_applied": Withheld.NOT_HELD,
        "traction_cut": Withheld.TRACTION,
        "no_emergency": Withheld.EMERGENCY,
        "authorised": Withheld.NOT_AUTHORISED,
        "centre_heard": Withheld.CENTRE_SILENT,
    }
    for term, flag in expected.items():
        terms = DoorTerms(*(True,) * 9)._replace(**{term: False})
        assert withheld(terms) is flag
    assert set(WITHHELD_WITHOUT) == set(DoorTerms._fields)


@given(st.lists(st.booleans(), min_size=9, max_size=9))
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
