"""Separation: no authority reaches into the stretch of another train, whichever way that runs."""

from math import inf
from pathlib import Path
from typing import Final

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from firmware_py.trackdb.circuit import load_path
from plant_emulator.wayside.separation import SPACE_M, Stretch, apart, limit_m

FERRY: Final = str(Path(__file__).resolve().parents[4] / "docs/examples/line/ferry.toml")
OUT: Final = load_path(f"{FERRY}:out")
BACK: Final = load_path(f"{FERRY}:back")
SCISSORS: Final = FERRY.replace("ferry", "scissors")
IN2: Final = load_path(f"{SCISSORS}:in2")
OUT1: Final = load_path(f"{SCISSORS}:out1")
K1_IN_M: Final = IN2.legs[2].path_m(30.0)
"""The crossing by the chainage of each path. A vehicle 20 m away clears it."""
K1_OUT_M: Final = OUT1.legs[1].path_m(30.0)
CLEAR_M: Final = 20.0


def out(rear_m: float, end_m: float) -> Stretch:
    return Stretch(OUT, rear_m, end_m)


@pytest.mark.parametrize(
    ("other", "limit"),
    [
        (out(400.0, 600.0), 400.0 - SPACE_M),
        # It follows: all of it is behind the rear.
        (out(100.0, 190.0), inf),
        # It ends exactly at the rear.
        (out(100.0, 200.0), inf),
        # It overlaps the train, which must not move.
        (out(100.0, 200.5), 100.0 - SPACE_M),
    ],
)
def test_the_near_end_of_a_stretch_ahead_limits_the_authority(other: Stretch, limit: float) -> None:
    assert limit_m(out(200.0, 270.0), [other]) == limit


def test_of_a_train_that_comes_the_end_of_its_authority_limits() -> None:
    """`tail` is 260 m long, from 800 m of the path out; 0 m to 260 m of the path back."""
    comes = Stretch(BACK, BACK.legs[0].path_m(200.0), BACK.legs[0].path_m(60.0))

    assert limit_m(out(600.0, 670.0), [comes]) == 860.0 - SPACE_M


def test_a_train_on_another_track_does_not_limit() -> None:
    west = BACK.legs[1]
    beside = Stretch(BACK, west.from_m + 10.0, west.to_m - 10.0)

    assert limit_m(out(200.0, 270.0), [beside]) == inf
    assert apart(out(200.0, 700.0), beside)


def test_a_stretch_over_two_tracks_counts_on_each() -> None:
    over = Stretch(BACK, BACK.legs[0].path_m(100.0), BACK.legs[1].from_m + 50.0)

    assert list(over.parts_on(OUT)) == [(800.0, 900.0)]
    assert not apart(out(750.0, 820.0), over)


places = st.floats(-100.0, 1000.0)


@settings(max_examples=60, deadline=None)
@given(
    rear_m=places,
    length_m=st.floats(20.0, 200.0),
    ends=st.tuples(places, places),
    back=st.booleans(),
)
def test_an_authority_up_to_the_limit_shares_no_track(
    rear_m: float, length_m: float, ends: tuple[float, float], back: bool
) -> None:
    own = out(rear_m, rear_m + length_m)
    low_m, high_m = min(ends), max(ends) + 1.0
    path = BACK if back else OUT
    other = Stretch(path, path.line.start_m + low_m + 150.0, path.line.start_m + high_m + 150.0)
    end_m = limit_m(own, [other])

    if end_m >= own.end_m:
        granted = out(rear_m, min(end_m, OUT.line.end_m))
        assert apart(granted, other)
        assert apart(other, granted)
    else:
        # There is no room to move; the authority ends before the other stretch all the same.
        assert all(end_m <= low - SPACE_M for low, high in other.parts_on(OUT) if high > rear_m)


@pytest.mark.parametrize(
    ("rear_m", "end_m", "limit"),
    [
        # The stretch ends where a vehicle clears the other track, or has left that place.
        (-90.0, -CLEAR_M, inf),
        (CLEAR_M, 90.0, inf),
        (-90.0, -CLEAR_M + 0.01, K1_OUT_M - CLEAR_M - SPACE_M),
        (CLEAR_M - 0.01, 90.0, K1_OUT_M - CLEAR_M - SPACE_M),
    ],
)
def test_a_stretch_over_a_crossing_bars_the_crossed_track(
    rear_m: float, end_m: float, limit: float
) -> None:
    over = Stretch(IN2, K1_IN_M + rear_m, K1_IN_M + end_m)
    waits = Stretch(OUT1, K1_OUT_M - 200.0, K1_OUT_M - 130.0)

    assert limit_m(waits, [over]) == limit


@settings(deadline=None)
@given(st.floats(-200.0, 200.0), st.floats(1.0, 300.0), st.floats(-200.0, 200.0))
def test_two_trains_are_never_at_a_crossing_at_once(
    rear_m: float, length_m: float, other_m: float
) -> None:
    over = Stretch(IN2, K1_IN_M + rear_m, K1_IN_M + rear_m + length_m)
    waits = Stretch(OUT1, K1_OUT_M + other_m, K1_OUT_M + other_m + 70.0)

    def is_there(stretch: Stretch, at_m: float) -> bool:
        return stretch.rear_m < at_m + CLEAR_M and at_m - CLEAR_M < stretch.end_m

    both = is_there(over, K1_IN_M) and is_there(waits, K1_OUT_M)
    assert apart(waits, over) is apart(over, waits) is not both
    if not both and other_m < 0.0:
        reached = Stretch(OUT1, waits.rear_m, min(limit_m(waits, [over]), K1_OUT_M + 300.0))
        assert apart(reached, over)
