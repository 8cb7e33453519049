"""Where a train is relative to platforms, on both sides of every edge, with exact floats."""

from typing import Final

import pytest

from firmware_py.trackdb import PlatformSide, Station
from vobc.atp.doors import is_aligned
from vobc.atp.place import BETWEEN, UNKNOWN, PlatformWhereabouts, place_of
from vobc.vocabulary import Interval

A: Final = Station("A", 100.0, 20.0, 105.0, PlatformSide.LEFT)
B: Final = Station("B", 600.0, 520.0, 605.0, PlatformSide.RIGHT)
LENGTH_M: Final = 50.0
WINDOW_M: Final = 0.25


def place(low_m: float, best_m: float, high_m: float) -> tuple[PlatformWhereabouts, Station | None]:
    where, station = place_of(
        (A, B), Interval(low_m, best_m, high_m), train_length_m=LENGTH_M, window_m=WINDOW_M
    )
    return where, station


@pytest.mark.parametrize(
    ("low_m", "best_m", "high_m", "where", "station"),
    [
        # The foremost front reaches the platform.
        (10.0, 12.0, 19.75, PlatformWhereabouts.BETWEEN, None),
        (10.0, 12.0, 20.0, PlatformWhereabouts.ARRIVING, A),
        # The likeliest front reaches the window; the hindmost may be far behind.
        (99.0, 99.5, 100.0, PlatformWhereabouts.ARRIVING, A),
        (99.0, 99.75, 100.0, PlatformWhereabouts.NEAR, A),
        # The whole interval is in the window, edges included.
        (99.75, 100.0, 100.25, PlatformWhereabouts.ALIGNED, A),
        (99.5, 100.0, 100.25, PlatformWhereabouts.NEAR, A),
        (99.75, 100.0, 100.5, PlatformWhereabouts.NEAR, A),
        # The hindmost front leaves the window.
        (100.25, 100.5, 101.0, PlatformWhereabouts.NEAR, A),
        (100.5, 100.75, 101.0, PlatformWhereabouts.PAST, A),
        # The hindmost rear leaves the platform.
        (155.0, 158.0, 160.0, PlatformWhereabouts.PAST, A),
        (155.25, 158.0, 160.0, PlatformWhereabouts.BETWEEN, None),
        # The next platform behaves like the first.
        (519.0, 519.5, 520.0, PlatformWhereabouts.ARRIVING, B),
        (600.0, 600.0, 600.0, PlatformWhereabouts.ALIGNED, B),
    ],
)
def test_each_end_of_the_interval_has_its_edge(
    low_m: float, best_m: float, high_m: float, where: PlatformWhereabouts, station: Station | None
) -> None:
    assert place(low_m, best_m, high_m) == (where, station)


def test_a_train_longer_than_the_gap_between_two_platforms_still_clears_the_first() -> None:
    where, station = place_of(
        (A, B), Interval(530.0, 530.0, 530.0), train_length_m=480.0, window_m=WINDOW_M
    )

    assert (where, station) == (PlatformWhereabouts.PAST, A)


def test_a_train_without_position_or_between_platforms_is_at_none() -> None:
    assert UNKNOWN == (PlatformWhereabouts.UNKNOWN, None)
    assert BETWEEN == (PlatformWhereabouts.BETWEEN, None)


@pytest.mark.parametrize(
    ("low_m", "high_m", "aligned"),
    [
        (99.75, 100.25, True),
        (99.75 - 1e-9, 100.25, False),
        (99.75, 100.25 + 1e-9, False),
        (100.0, 600.0, False),
    ],
)
def test_the_whole_interval_has_to_lie_in_the_window(
    low_m: float, high_m: float, aligned: bool
) -> None:
    assert is_aligned(A, Interval(low_m, 100.0, high_m), window_m=WINDOW_M) is aligned


@pytest.mark.parametrize(
    ("low_m", "best_m", "high_m", "where"),
    [
        (600.0, 600.0, 600.0, PlatformWhereabouts.ALIGNED),
        (599.5, 600.0, 600.5, PlatformWhereabouts.NEAR),
    ],
)
def test_a_train_that_stops_with_its_rear_at_the_platform_behind_is_at_its_own_stop(
    low_m: float, best_m: float, high_m: float, where: PlatformWhereabouts
) -> None:
    found = place_of(
        (A, B), Interval(low_m, best_m, high_m), train_length_m=510.0, window_m=WINDOW_M
    )

    assert found == (where, B)
