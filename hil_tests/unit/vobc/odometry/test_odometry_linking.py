"""One tag off its place: linking, pairs, and the bounds of the wheel scale."""

from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_py.trackdb import LineMap, SpeedSection, Station, TagSite
from vobc.config import load_config
from vobc.odometry.references import LocatedTag, References, Windows
from vobc.odometry.scale import Waypoint, WheelScale
from vobc.vocabulary import PlaceProof, TagRefusal

CONFIG = load_config("florence4").odometry
NOMINAL_M = 0.01
TAGS_M = (100.0, 350.0, 600.0)
LINE = LineMap(
    "linking",
    -100.0,
    1000.0,
    (Station("A", 0.0, -80.0, 5.0),),
    (SpeedSection(-100.0, 1000.0, 20.0),),
    tags=tuple(TagSite(index + 1, at_m) for index, at_m in enumerate(TAGS_M)),
)
WHEELS = Windows((10.0, 16.0), (14.0, 20.0))
"""Wheels and ground agree between 14 and 16 m."""


def reading(index: int, claim_m: float, *, pulses: int = 0, bound_m: float = 0.1) -> LocatedTag:
    over_m = pulses * NOMINAL_M
    return LocatedTag(LINE.tags[index], TAGS_M[index], claim_m, bound_m, pulses, over_m, 0.0)


def references() -> References:
    made = References(CONFIG, LINE, PlaceProof.SET_UP)
    made.begin(0.0)
    return made


@pytest.mark.parametrize(
    ("claim_m", "off_m"),
    [(13.91, None), (16.09, None), (13.89, -0.11), (16.11, 0.11), (10.0, -4.0), (20.0, 4.0)],
)
def test_wheels_and_ground_must_both_expect_a_tag(claim_m: float, off_m: float | None) -> None:
    refused = references().judge(reading(0, claim_m), WHEELS, disputed=False)

    assert (refused is None) is (off_m is None)
    if refused is not None:
        assert refused.reason is TagRefusal.CONTRADICTED
        assert refused.off_m == pytest.approx(off_m)
        assert references().widens(refused, 0.1)


@pytest.mark.parametrize("claim_m", [9.91, 12.0, 18.0, 20.09])
def test_while_wheels_and_ground_contradict_each_other_one_of_them_is_enough(
    claim_m: float,
) -> None:
    assert references().judge(reading(0, claim_m), WHEELS, disputed=True) is None


def test_between_two_windows_that_are_apart_a_tag_agrees_with_neither() -> None:
    apart = Windows((10.0, 12.0), (18.0, 20.0))

    refused = references().judge(reading(0, 15.0), apart, disputed=True)

    assert refused is not None
    assert (refused.reason, refused.off_m) == (TagRefusal.CONTRADICTED, pytest.approx(-3.0))


@pytest.mark.parametrize(("off_m", "widens"), [(2.125, True), (2.126, False), (-2.125, True)])
def test_a_tag_outside_widens_the_intervals_as_far_as_the_last_one_may_have_been_off(
    off_m: float, *, widens: bool
) -> None:
    """The last tag was accepted 2 m from the farther end of its windows."""
    made = references()
    made.accept(reading(0, 15.0), Windows((14.0, 17.0), (14.0, 17.0)))
    here = Windows((13.0, 17.0), (13.0, 17.0))
    claim_m = 17.0 + off_m if off_m > 0.0 else 13.0 + off_m

    refused = made.judge(reading(1, claim_m), here, disputed=False)

    assert refused is not None
    assert refused.reason is TagRefusal.OUTSIDE_WINDOW
    assert made.widens(refused, 0.125) is widens
    made.accept(reading(0, 15.0), None)
    near = replace(refused, off_m=0.2)
    assert not made.widens(near, 0.125), "a place that restarts leaves no doubt"


def test_before_the_first_accepted_tag_one_outside_widens_nothing() -> None:
    made = references()
    refused = made.judge(reading(0, 20.25), WHEELS, disputed=False)

    assert refused is not None
    assert refused.reason is TagRefusal.OUTSIDE_WINDOW
    assert not made.widens(refused, 0.1)


def test_a_repeated_tag_widens_nothing() -> None:
    made = references()
    made.accept(reading(0, 15.0), WHEELS)

    refused = made.judge(reading(0, 12.0), WHEELS, disputed=False)

    assert refused is not None
    assert not made.widens(refused, 0.1)


@pytest.mark.parametrize(("off_m", "confirm"), [(0.19, True), (-0.19, True), (0.25, False)])
def test_two_refused_tags_confirm_each_other_at_the_distance_that_the_train_ran(
    off_m: float, *, confirm: bool
) -> None:
    made = references()
    apart = round((250.0 + off_m) / NOMINAL_M)

    assert made.pairs(reading(0, 15.0), NOMINAL_M, NOMINAL_M) is False
    assert made.pairs(reading(0, 15.0), NOMINAL_M, NOMINAL_M) is False, "the same tag again"
    second = reading(1, 15.0, pulses=apart)
    assert made.pairs(second, NOMINAL_M, NOMINAL_M) is confirm


def test_an_accepted_tag_ends_the_search_for_a_pair() -> None:
    made = references()
    made.pairs(reading(0, 15.0), NOMINAL_M, NOMINAL_M)
    made.accept(reading(1, 15.0, pulses=25_000), None)

    assert not made.pairs(reading(2, 15.0, pulses=50_000), NOMINAL_M, NOMINAL_M)


@given(
    error_ratio=st.floats(CONFIG.scale_error_low_ratio, CONFIG.scale_error_high_ratio),
    spacings_m=st.lists(st.floats(20.0, 300.0), min_size=4, max_size=8),
    displaced=st.integers(0, 8),
    off_m=st.floats(-5.0, 5.0),
    radar_ratio=st.floats(-0.011, 0.011),
)
def test_one_displaced_tag_never_excludes_the_true_scale(
    error_ratio: float,
    spacings_m: list[float],
    displaced: int,
    off_m: float,
    radar_ratio: float,
) -> None:
    true_m_per_pulse = NOMINAL_M / (1.0 + error_ratio)
    scale = WheelScale(CONFIG, NOMINAL_M)

    at_m = 0.0
    for index, spacing_m in enumerate(spacings_m):
        at_m += spacing_m
        shown_m = at_m + (off_m if index == displaced else 0.0)
        pulses = int(at_m / true_m_per_pulse)
        over = (at_m * (1.0 + radar_ratio), 0.011 * at_m)
        scale.measure(Waypoint(shown_m, 0.1, pulses, *over))

        assert scale.low_m <= true_m_per_pulse <= scale.high_m


@given(
    error_ratio=st.floats(CONFIG.scale_error_low_ratio, CONFIG.scale_error_high_ratio),
    radar_ratio=st.floats(-0.2, 0.2),
)
def test_a_wrong_radar_never_excludes_the_true_scale(
    error_ratio: float, radar_ratio: float
) -> None:
    true_m_per_pulse = NOMINAL_M / (1.0 + error_ratio)
    scale = WheelScale(CONFIG, NOMINAL_M)

    for at_m in (100.0, 350.0, 600.0, 850.0):
        over = (at_m * (1.0 + radar_ratio), 0.011 * at_m)
        scale.measure(Waypoint(at_m, 0.1, int(at_m / true_m_per_pulse), *over))

        assert scale.low_m <= true_m_per_pulse <= scale.high_m


def test_tags_250_m_apart_bound_the_scale_to_half_a_percent() -> None:
    scale = WheelScale(replace(CONFIG, scale_margin_ratio=0.002), NOMINAL_M)

    for index in range(3):
        at_m = 250.0 * index
        scale.measure(Waypoint(at_m, 0.19, 25_000 * index, at_m, 0.012 * at_m))

    assert 0.995 < scale.low_m / NOMINAL_M < 1.0 < scale.high_m / NOMINAL_M < 1.005
