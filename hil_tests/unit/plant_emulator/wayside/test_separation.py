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
