"""Door enable: the whole truth table, and where a train counts as standing right."""

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
    platform_at,
    withheld,
)
from vobc.vocabulary import Interval

STATIONS = (
    Station("A", 100.0, 20.0, 105.0, PlatformSide.LEFT),
    Station("B", 600.0, 520.0, 605.0, PlatformSide.RIGHT),
)
SIDES = (None, PlatformSide.LEFT, PlatformSide.RIGHT)


def test_every_combination_of_the_terms() -> None:
    """Of all 2^9 times three only the two with every term enable a side, and only the right one."""
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
def test_what_is_said_is_exactly_what_is_missing(values: list[bool]) -> None:
    said = withheld(DoorTerms(*values))

    for term, value in zip(DoorTerms._fields, values, strict=True):
        assert (WITHHELD_WITHOUT[term] in said) is not value


@pytest.mark.parametrize(
    ("low_m", "high_m", "side"),
    [
        (99.7, 100.3, PlatformSide.LEFT),
        (99.69, 100.0, None),
        (100.0, 100.31, None),
        (99.0, 101.0, None),
        (599.7, 600.3, PlatformSide.RIGHT),
        (350.0, 350.1, None),
        (99.9, 600.1, None),
    ],
)
def test_the_whole_interval_has_to_lie_in_the_window(
    low_m: float, high_m: float, side: PlatformSide | None
) -> None:
    front_m = Interval(low_m, (low_m + high_m) / 2.0, high_m)

    assert platform_at(STATIONS, front_m, window_m=0.3000001) is side


def test_the_edges_of_the_window_belong_to_it() -> None:
    """With numbers that a float holds exactly."""
    assert platform_at(STATIONS, Interval(99.75, 100.0, 100.25), window_m=0.25) is not None


@given(st.floats(0.0, 700.0), st.floats(0.0, 2.0))
def test_no_place_outside_the_window_is_a_platform(best_m: float, half_m: float) -> None:
    front_m = Interval(best_m - half_m, best_m, best_m + half_m)

    side = platform_at(STATIONS, front_m, window_m=0.3)

    distance_m = min(abs(best_m - station.stop_m) for station in STATIONS)
    assert (side is not None) == (distance_m + half_m <= 0.3) or abs(
        distance_m + half_m - 0.3
    ) < 1e-9
