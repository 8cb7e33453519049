"""Designs of sweeps, each checked against its definition by counting."""

import itertools
import math
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from firmware_py.settings import SettingsError
from metro_hil.campaign import define
from metro_hil.campaign.designs import design, exclusion
from metro_hil.campaign.factors import Factor, LevelScale, NumberRange, read_factors
from metro_hil.campaign.problems import Findings
from metro_hil.campaign.schema import DesignKind, SweepKeys


def factors_of(sizes: list[int]) -> list[Factor]:
    return [Factor(f"train.f{i}", tuple(range(size))) for i, size in enumerate(sizes)]


def levels_of(table: dict[str, Any]) -> tuple[Any, ...]:
    findings = Findings()
    (factor,) = read_factors({"train.x": table}, findings)
    assert not findings
    return factor.levels


def seen(points: list[dict[str, Any]], keys: tuple[str, ...]) -> set[tuple[Any, ...]]:
    return {tuple(point[key] for key in keys) for point in points}


@given(st.lists(st.integers(1, 4), min_size=1, max_size=5))
def test_a_factorial_has_every_combination_once(sizes: list[int]) -> None:
    factors = factors_of(sizes)

    points = design(SweepKeys(), factors)

    assert len(points) == math.prod(sizes)
    everything = set(itertools.product(*(range(size) for size in sizes)))
    assert seen(points, tuple(factor.key for factor in factors)) == everything


@settings(max_examples=40)
@given(st.lists(st.integers(1, 4), min_size=2, max_size=6), st.integers(1, 3))
def test_a_covering_array_covers(sizes: list[int], strength: int) -> None:
    factors = factors_of(sizes)
    keys = SweepKeys(design=DesignKind.COVERING, strength=strength)

    points = design(keys, factors)

    for some in itertools.combinations(factors, min(strength, len(factors))):
        wanted = set(itertools.product(*(factor.levels for factor in some)))
        assert seen(points, tuple(factor.key for factor in some)) == wanted
    assert points == design(keys, factors)


@settings(max_examples=40)
@given(
    st.lists(st.integers(2, 4), min_size=3, max_size=4),
    st.integers(0, 3),
    st.integers(0, 3),
    st.integers(0, 3),
)
def test_a_covering_array_covers_what_is_left_of_an_exclusion(
    sizes: list[int], first: int, second: int, third: int
) -> None:
    """Brute force: the array must cover a pair if a whole point with it is not excluded."""
    factors = factors_of(sizes)
    text = f"f0 == {first} and f1 >= {second} or f2 == {third} and f1 == 0"
    keys = SweepKeys(design=DesignKind.PAIRWISE, exclude=(text,))
    names = [factor.key for factor in factors]
    left = [
        dict(zip(names, levels, strict=True))
        for levels in itertools.product(*(factor.levels for factor in factors))
        if not (
            (levels[0] == first and levels[1] >= second) or (levels[2] == third and levels[1] == 0)
        )
    ]

    points = design(keys, factors)

    assert all(point in left for point in points)
    for some in itertools.combinations(names, 2):
        assert seen(points, some) == seen(left, some)


def test_a_pairwise_design_is_much_smaller_than_all_combinations() -> None:
    points = design(SweepKeys(design=DesignKind.PAIRWISE), factors_of([4] * 8))

    assert 16 <= len(points) <= 40


@given(st.integers(1, 60), st.integers(1, 4), st.integers(0, 2**32))
def test_a_latin_hypercube_meets_each_stratum_once(count: int, width: int, seed: int) -> None:
    factors = [Factor(f"train.x{i}", (), NumberRange(0.0, 1.0)) for i in range(width)]
    keys = SweepKeys(design=DesignKind.LHS, count=count, seed=seed)

    points = design(keys, factors)

    for factor in factors:
        strata = sorted(math.floor(point[factor.key] * count + 1e-9) for point in points)
        assert strata == list(range(count))
    assert points == design(keys, factors)


@given(st.integers(0, 6), st.integers(0, 1000))
def test_a_sobol_design_of_a_power_of_two_is_balanced(power: int, seed: int) -> None:
    factors = [Factor("train.x", (), NumberRange(0.0, 8.0)), Factor("train.y", ("a", "b"))]
    count = 2**power

    points = design(SweepKeys(design=DesignKind.SOBOL, count=count, seed=seed), factors)

    assert len(points) == count
    if power >= 1:
        assert sum(point["train.y"] == "a" for point in points) == count // 2
    if power >= 3:
        for low in range(8):
            here = sum(low <= point["train.x"] < low + 1 for point in points)
            assert here == count // 8


def test_a_sobol_design_of_another_count_is_noted() -> None:
    table = {
        "sweep": {
            "design": "sobol",
            "count": 10,
            "factors": {"train.load_ratio": {"low": 0.0, "high": 1.0}},
        }
    }

    (note,) = define(table, source="x").campaign.notes

    assert "no power of two" in note
    assert "8 or 16" in note


def test_random_points_are_those_of_their_seed_and_within_the_ranges() -> None:
    factors = [
        Factor("train.x", (), NumberRange(1e-3, 1e3, LevelScale.LOG)),
        Factor("train.n", (), NumberRange(3.0, 5.0, integer=True)),
        Factor("train.c", ("a", "b", "c")),
    ]

    points = design(SweepKeys(design=DesignKind.RANDOM, count=300, seed=5), factors)

    assert points == design(SweepKeys(design=DesignKind.RANDOM, count=300, seed=5), factors)
    assert points != design(SweepKeys(design=DesignKind.RANDOM, count=300, seed=6), factors)
    assert {point["train.n"] for point in points} == {3, 4, 5}
    assert {point["train.c"] for point in points} == {"a", "b", "c"}
    assert all(1e-3 <= point["train.x"] <= 1e3 for point in points)
    below_one = sum(point["train.x"] < 1.0 for point in points)
    assert 100 <= below_one <= 200, "half of a range of six decades lies below its middle one"


def test_excluded_random_points_are_sampled_again() -> None:
    factors = [Factor("train.load_ratio", (), NumberRange(0.0, 1.0))]
    keys = SweepKeys(design=DesignKind.RANDOM, count=50, exclude=("load_ratio > 0.5",))

    points = design(keys, factors)

    assert len(points) == 50
    assert max(point["train.load_ratio"] for point in points) <= 0.5
    with pytest.raises(SettingsError, match="refused"):
        design(SweepKeys(design=DesignKind.RANDOM, count=5, exclude=("load_ratio >= 0",)), factors)


@pytest.mark.parametrize(
    ("table", "levels"),
    [
        ({"low": 0.0, "high": 1.0, "count": 3}, (0.0, 0.5, 1.0)),
        ({"low": 10.0, "high": 10.05, "step": 0.01}, (10.0, 10.01, 10.02, 10.03, 10.04, 10.05)),
        ({"low": 0.0, "high": 0.3, "step": 0.1}, (0.0, 0.1, 0.2, 0.3)),
        ({"low": 0.0, "high": 0.35, "step": 0.1}, (0.0, 0.1, 0.2, 0.3)),
        ({"low": 0.1, "high": 1000.0, "count": 5, "scale": "log"}, (0.1, 1.0, 10.0, 100.0, 1000.0)),
        ({"low": 1, "high": 7, "step": 3}, (1, 4, 7)),
        ({"low": 1, "high": 10, "count": 4, "integer": True}, (1, 4, 7, 10)),
        ({"low": 1, "high": 3, "count": 9, "integer": True}, (1, 2, 3)),
        ({"low": -0.01, "high": 0.05, "count": 7}, (-0.01, 0.0, 0.01, 0.02, 0.03, 0.04, 0.05)),
    ],
)
def test_levels_are_written_like_a_person_writes_them(
    table: dict[str, Any], levels: tuple[Any, ...]
) -> None:
    made = levels_of(table)

    assert made == levels
    assert [type(level) for level in made] == [type(level) for level in levels]


def test_too_many_combinations_are_refused_before_they_are_made() -> None:
    with pytest.raises(SettingsError, match="100000000 combinations, 1000000 are possible"):
        design(SweepKeys(), factors_of([100] * 4))
    with pytest.raises(SettingsError, match="take fewer factors"):
        design(SweepKeys(design=DesignKind.PAIRWISE), factors_of([400] * 3))


def test_exclusions_accept_short_and_full_factor_names() -> None:
    factors = [
        Factor("fault.0.start_s", (1.0, 2.0)),
        Factor("fault.1.start_s", (1.0, 2.0)),
        Factor("train.load_ratio", (0.0, 1.0)),
        Factor("train.consist", ("a", "b")),
    ]
    point = {"fault.0.start_s": 1.0, "fault.1.start_s": 2.0, "train.load_ratio": 1.0}

    assert exclusion(["fault_0_start_s < fault_1_start_s"], factors)(point)
    assert not exclusion(["load_ratio < 1"], factors)(point)
    for unclear in ("start_s > 1", "consist > 1"):
        with pytest.raises(SettingsError, match="unknown signal"):
            exclusion([unclear], factors)
