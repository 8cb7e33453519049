"""Limits under the train and ahead: civil limits, temporary restrictions, the end of authority."""

import itertools
import math
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from can_dbc.vobc import TargetKind
from firmware_py.trackdb import LineMap
from metro_hil.metrics.worst_motion import (
    CONFIG,
    FAR_M,
    KMH,
    Section,
    ceilings,
    intervals,
    limits,
    line_of,
    sections,
)
from vobc.atp.ceiling import PROFILES_MAX, CeilingMap
from vobc.vocabulary import Ceiling, Interval, Restriction

LENGTH_M = 68.59
SLACK_MPS = 1e-5
JUST_M = 1e-6
MARGINS_MPS = (
    0.0,
    CONFIG.warning_margin_mps,
    CONFIG.service_margin_mps,
    CONFIG.emergency_margin_mps,
)
SLOW = Restriction(1500.0, 1900.0, 30 * KMH)
OPEN_LINE = ceilings(line_of((), ((0.0, 6000.0, 70 * KMH),)), length_m=LENGTH_M)
SLOW_LINE = ceilings(
    line_of((), ((0.0, 1500.0, 70 * KMH), (1500.0, 1900.0, 30 * KMH), (1900.0, 6000.0, 70 * KMH))),
    length_m=LENGTH_M,
)
lines_by_chance = st.builds(
    line_of,
    st.lists(
        st.tuples(
            st.sampled_from([0.0, 0.0, 3.0, 120.0]), st.floats(5.0, 400.0), st.floats(-40.0, 40.0)
        ),
        max_size=8,
    ).map(sections),
    st.builds(
        limits,
        st.floats(5.0, 25.0),
        st.lists(st.tuples(st.floats(50.0, 3000.0), st.floats(3.0, 25.0)), max_size=5),
    ),
)
restrictions_by_chance = st.lists(
    st.builds(
        lambda start_m, run_m, limit_mps: Restriction(start_m, start_m + run_m, limit_mps),
        st.floats(0.0, 2500.0),
        st.floats(1.0, 500.0),
        st.floats(1.0, 20.0),
    ),
    max_size=3,
)


def four(ceiling: Ceiling) -> tuple[float, float, float, float]:
    return (
        ceiling.permitted_mps,
        ceiling.warning_mps,
        ceiling.service_mps,
        ceiling.emergency_mps,
    )


def exact(front_m: float) -> Interval:
    return intervals(front_m, 0.0, 0.0)


@pytest.mark.parametrize(("ceiling_map", "extra"), [(SLOW_LINE, ()), (OPEN_LINE, (SLOW,))])
def test_a_limit_is_released_exactly_when_the_rear_of_the_hindmost_front_is_clear(
    ceiling_map: CeilingMap, extra: tuple[Restriction, ...]
) -> None:
    """This holds for civil limits and temporary restrictions; the foremost front is long past."""
    clear_m = 1900.0 + LENGTH_M

    held = ceiling_map.at(intervals(clear_m + 2.0, 2.0 + JUST_M, 5.0), FAR_M, extra)
    free = ceiling_map.at(intervals(clear_m + 2.0, 2.0 - JUST_M, 5.0), FAR_M, extra)

    assert four(held) == pytest.approx([30 * KMH + margin for margin in MARGINS_MPS])
    assert four(free) == pytest.approx([70 * KMH + margin for margin in MARGINS_MPS])


@pytest.mark.parametrize(("ceiling_map", "extra"), [(SLOW_LINE, ()), (OPEN_LINE, (SLOW,))])
def test_a_limit_holds_once_the_foremost_front_reaches_it(
    ceiling_map: CeilingMap, extra: tuple[Restriction, ...]
) -> None:
    at_it = ceiling_map.at(intervals(1490.0, 3.0, 10.0), FAR_M, extra)
    before_it = ceiling_map.at(intervals(1490.0, 3.0, 10.0 - JUST_M), FAR_M, extra)

    assert four(at_it) == pytest.approx([30 * KMH + margin for margin in MARGINS_MPS])
    assert four(before_it) == pytest.approx(four(at_it), abs=1e-3), "the curve leads to it"


@given(front_m=st.floats(300.0, 2400.0), width_m=st.floats(0.0, 40.0))
def test_a_temporary_restriction_is_a_civil_limit_ahead_under_and_behind_the_train(
    front_m: float, width_m: float
) -> None:
    front = Interval(front_m - width_m, front_m, front_m)

    temporary, civil = OPEN_LINE.at(front, FAR_M, (SLOW,)), SLOW_LINE.at(front, FAR_M)

    assert replace(temporary, target=None) == replace(civil, target=None)
    if civil.target is not None:
        assert temporary.target == replace(civil.target, kind=TargetKind.RESTRICTION)


def test_a_restriction_above_the_civil_limit_changes_nothing() -> None:
    loose = Restriction(1500.0, 1900.0, 80 * KMH)

    for front_m in (1300.0, 1500.0, 1700.0, 1950.0):
        assert OPEN_LINE.at(exact(front_m), FAR_M, (loose,)) == OPEN_LINE.at(exact(front_m), FAR_M)


def test_the_lowest_of_overlapping_restrictions_counts() -> None:
    tighter = Restriction(1600.0, 1700.0, 10 * KMH)

    both = OPEN_LINE.at(exact(1650.0), FAR_M, (tighter, SLOW))

    assert both.permitted_mps == pytest.approx(10 * KMH)
    assert both == OPEN_LINE.at(exact(1650.0), FAR_M, (SLOW, tighter))


@given(
    line=lines_by_chance,
    front_m=st.floats(50.0, 2500.0),
    to_end_m=st.floats(-20.0, 800.0),
    widths_m=st.tuples(st.floats(0.0, 20.0), st.floats(0.0, 20.0)),
    wider_m=st.tuples(st.floats(0.0, 20.0), st.floats(0.0, 20.0)),
    length_m=st.floats(18.0, 160.0),
    restrictions=restrictions_by_chance,
)
def test_a_wider_interval_never_raises_a_speed(
    line: LineMap,
    front_m: float,
    to_end_m: float,
    widths_m: tuple[float, float],
    wider_m: tuple[float, float],
    length_m: float,
    restrictions: list[Restriction],
) -> None:
    ceiling_map = ceilings(line, length_m=length_m)
    narrow = intervals(front_m, *widths_m)
    wide = intervals(front_m, widths_m[0] + wider_m[0], widths_m[1] + wider_m[1])
    end_m = front_m + to_end_m

    by_narrow = four(ceiling_map.at(narrow, end_m, restrictions))
    by_wide = four(ceiling_map.at(wide, end_m, restrictions))

    for narrow_mps, wide_mps in zip(by_narrow, by_wide, strict=True):
        assert wide_mps <= narrow_mps + SLACK_MPS


@given(
    line=lines_by_chance,
    front_m=st.floats(50.0, 2500.0),
    to_end_m=st.floats(-20.0, 800.0),
    width_m=st.floats(0.0, 20.0),
    restrictions=restrictions_by_chance,
)
def test_another_restriction_never_raises_a_speed_and_the_four_stay_in_order(
    line: LineMap,
    front_m: float,
    to_end_m: float,
    width_m: float,
    restrictions: list[Restriction],
) -> None:
    ceiling_map = ceilings(line, length_m=LENGTH_M)
    front = intervals(front_m, width_m, width_m)
    end_m = front_m + to_end_m

    by_count = [
        four(ceiling_map.at(front, end_m, restrictions[:count]))
        for count in range(len(restrictions) + 1)
    ]

    for fewer, more in itertools.pairwise(by_count):
        for fewer_mps, more_mps in zip(fewer, more, strict=True):
            assert more_mps <= fewer_mps
    for speeds_mps in by_count:
        assert list(speeds_mps) == sorted(speeds_mps)
        assert min(speeds_mps) >= 0.0


@pytest.mark.parametrize("beyond_m", [0.0, JUST_M, 3.0, 500.0])
def test_a_train_that_may_have_reached_its_end_of_authority_is_permitted_zero_speed(
    beyond_m: float,
) -> None:
    """It is enough that the foremost front may be there."""
    ceiling = OPEN_LINE.at(Interval(1000.0, 1010.0, 1020.0), 1020.0 - beyond_m)

    assert four(ceiling) == (0.0, 0.0, 0.0, 0.0)
    assert ceiling.distance_to_authority_m == pytest.approx(-beyond_m)


@pytest.mark.parametrize(
    "front",
    [
        Interval(math.nan, 1000.0, 1000.0),
        Interval(1000.0, 1000.0, math.nan),
        Interval(-math.inf, 1000.0, 1000.0),
        Interval(1000.0, 1000.0, math.inf),
    ],
)
def test_a_position_that_is_not_finite_permits_zero_speed(front: Interval) -> None:
    assert four(OPEN_LINE.at(front, 5000.0)) == (0.0, 0.0, 0.0, 0.0)
    assert four(OPEN_LINE.at(exact(1000.0), math.nan)) == (0.0, 0.0, 0.0, 0.0)


def test_a_line_that_the_brake_cannot_hold_is_refused_by_name() -> None:
    steep = line_of(((500.0, 600.0, -99.0),))

    with pytest.raises(ValueError, match=r"line by chance: gradient_permille -99\.0: guaranteed_"):
        ceilings(steep, length_m=LENGTH_M)


def test_evicted_interval_widths_give_the_same_speeds_again() -> None:
    fall = line_of(((900.0, 1100.0, -35.0),))
    ceiling_map = ceilings(fall, length_m=LENGTH_M)
    step_m = CONFIG.interval_step_m
    fronts = [
        Interval(1300.0 - step_m * steps, 1300.0, 1300.0) for steps in range(2 * PROFILES_MAX)
    ]

    first = [ceiling_map.at(front, 1500.0) for front in fronts]

    assert [ceiling_map.at(front, 1500.0) for front in fronts] == first
    assert first[0].emergency_mps > first[-1].emergency_mps, "the fall is still under the train"


@given(width_steps=st.integers(0, 40), over_m=st.floats(0.01, 0.49))
def test_over_gradients_an_interval_counts_as_wide_as_the_next_multiple_of_its_step(
    width_steps: int, over_m: float
) -> None:
    fall: tuple[Section, ...] = ((900.0, 1100.0, -35.0),)
    ceiling_map = ceilings(line_of(fall), length_m=LENGTH_M)
    multiple_m = (width_steps + 1) * CONFIG.interval_step_m

    between = Interval(1180.0 - multiple_m + over_m, 1180.0, 1180.0)

    assert ceiling_map.at(between, 1400.0) == ceiling_map.at(
        Interval(1180.0 - multiple_m, 1180.0, 1180.0), 1400.0
    )
