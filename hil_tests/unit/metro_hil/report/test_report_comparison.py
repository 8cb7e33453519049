"""Comparison of two campaigns: verdicts, shifts, and what a statistical test may claim."""

import dataclasses
import itertools
from collections.abc import Callable, Sequence
from typing import Any

import msgspec
import numpy as np
import pytest
import scipy
from hypothesis import given, settings
from hypothesis import strategies as st

from metro_hil.model.case import Case, CaseResult, Setup, Verdict
from metro_hil.report.comparison import (
    MeasureTrend,
    PairedShift,
    compare,
    holm,
    rank_biserial_ratio,
    signed_rank_p_ratio,
)


def campaign_of(
    values: Sequence[float], measure: str = "stop_error_worst_m"
) -> tuple[list[Case], list[CaseResult]]:
    cases = [
        Case(id=f"s/{n}", index=n, scenario="s", seed=n, setup=Setup()) for n in range(len(values))
    ]
    results = [
        CaseResult(
            case_id=case.id,
            index=case.index,
            verdict=Verdict.PASS,
            chain=f"{value}",
            measures={measure: value},
        )
        for case, value in zip(cases, values, strict=True)
    ]
    return cases, results


def only_shift(
    a: Sequence[float], b: Sequence[float], measure: str = "jerk_max_mps3"
) -> PairedShift:
    (shift,) = compare(campaign_of(a, measure), campaign_of(b, measure)).shifts
    return shift


numbers = st.integers(-40, 40).map(lambda n: n / 4.0)
"""Quarters, so that differences are exact and ties are common."""


def p_of(differences: list[float]) -> float:
    """The p-value by scipy where it is exact, otherwise by all sign flips, or by scipy for many
    pairs."""
    sizes = np.abs(differences)
    if len(set(sizes.tolist())) == len(sizes):
        return float(scipy.stats.wilcoxon(differences, method="exact").pvalue)
    ranks = scipy.stats.rankdata(sizes)
    rose = ranks[np.array(differences) > 0.0].sum()
    signs = np.array(list(itertools.product((0.0, 1.0), repeat=len(sizes))))
    sums = signs @ ranks
    return float(min(1.0, 2.0 * min(np.mean(sums <= rose), np.mean(sums >= rose))))


@settings(max_examples=40, deadline=None)
@given(st.lists(st.tuples(numbers, numbers), min_size=1, max_size=12))
def test_p_equals_that_of_scipy_on_the_pairs(pairs: list[tuple[float, float]]) -> None:
    a, b = (np.array(column) for column in zip(*pairs, strict=True))

    shift = only_shift(a.tolist(), b.tolist())

    differences = b - a
    assert shift.unchanged == int(np.sum(differences == 0.0))
    assert shift.mean.best == pytest.approx(differences.mean(), abs=1e-9)
    assert shift.median.best == pytest.approx(np.median(differences), abs=1e-9)
    if shift.unchanged == len(pairs):
        assert shift.p_ratio is None
    else:
        wanted = p_of(differences[differences != 0.0].tolist())
        assert shift.p_ratio == pytest.approx(wanted)
        assert shift.p_holm_ratio == pytest.approx(wanted), "one test needs no correction"


def test_p_of_many_pairs_equals_that_of_scipy() -> None:
    differences = np.random.default_rng(1).normal(0.3, 1.0, 80)

    shift = only_shift([0.0] * 80, differences.tolist())

    assert shift.p_ratio == pytest.approx(scipy.stats.wilcoxon(differences).pvalue)


@settings(max_examples=30, deadline=None)
@given(st.lists(numbers, min_size=12, max_size=30, unique=True), st.floats(0.5, 5.0))
def test_a_shift_of_all_pairs_is_found_in_its_direction(values: list[float], step: float) -> None:
    shift = only_shift(values, [value + step for value in values])

    assert shift.direction is MeasureTrend.WORSE, "jerk that grows is worse"
    assert shift.effect_ratio == 1.0
    assert shift.mean.low > 0.0
    assert only_shift([v + step for v in values], values).direction is MeasureTrend.BETTER


def test_errors_are_compared_by_magnitude() -> None:
    a = [0.01 * n for n in range(1, 13)]

    shift = only_shift(a, [-value - 0.005 for value in a], "stop_I_error_m")

    assert shift.direction is MeasureTrend.WORSE
    assert shift.mean.best == pytest.approx(0.005)


def test_a_measure_without_a_better_side_is_only_different() -> None:
    a = [100.0 + n for n in range(12)]

    assert only_shift(a, [v - 3.0 - v / 99 for v in a], "run_time_s").direction is (
        MeasureTrend.DIFFERENT
    )


def test_five_pairs_cannot_show_anything_and_this_is_reported() -> None:
    shift = only_shift([1.0, 2.0, 3.0, 4.0, 5.0], [2.0, 3.5, 5.2, 7.0, 9.0])

    assert shift.direction is MeasureTrend.UNCLEAR
    assert any("no test can reach 5 %" in note for note in shift.notes)


def test_equal_pairs_and_ties_are_reported() -> None:
    shift = only_shift([1.0] * 10, [1.0, 1.0, *[2.0] * 8])

    assert shift.unchanged == 2
    assert "2 of 10 pairs are equal and not in the test" in shift.notes
    assert any("ties" in note for note in shift.notes)


def test_equal_campaigns_have_nothing_to_test() -> None:
    comparison = compare(campaign_of([1.0, 2.0]), campaign_of([1.0, 2.0]))

    assert comparison.identical == comparison.matched == 2
    assert comparison.shifts[0].p_ratio is None
    assert comparison.shifts[0].notes == ("all pairs are equal: nothing to test",)


@given(st.lists(st.floats(0.0, 1.0), min_size=1, max_size=12))
def test_holm_keeps_the_order_and_is_never_milder(p_ratios: list[float]) -> None:
    corrected = holm(p_ratios)

    assert all(0.0 <= raw <= new <= 1.0 for raw, new in zip(p_ratios, corrected, strict=True))
    order = np.argsort(p_ratios, kind="stable")
    assert np.all(np.diff(np.array(corrected)[order]) >= 0.0)
    assert min(corrected) == pytest.approx(min(1.0, len(p_ratios) * min(p_ratios)))


def test_holm_of_a_textbook_example() -> None:
    assert holm([0.01, 0.04, 0.03, 0.005]) == pytest.approx([0.03, 0.06, 0.06, 0.02])


def test_many_measures_are_corrected_together() -> None:
    """One of twenty measures looks significant alone, but not after the correction for twenty."""
    generator = np.random.default_rng(5)
    cases, before = campaign_of([0.0] * 8)
    after = []
    for result in before:
        noise = {f"jerk_{n}_mps3": float(generator.normal()) for n in range(20)}
        after.append(msgspec.structs.replace(result, measures=noise | {"jerk_max_mps3": 1.0}))
    start = [
        msgspec.structs.replace(r, measures=dict.fromkeys(after[0].measures, 0.0)) for r in before
    ]

    shifts = compare((cases, start), (cases, after)).shifts

    lone = next(shift for shift in shifts if shift.name == "jerk_max_mps3")
    assert lone.p_ratio is not None
    assert lone.p_ratio < 0.05
    assert lone.p_holm_ratio is not None
    assert lone.p_holm_ratio == pytest.approx(min(1.0, lone.p_ratio * 21), rel=1e-9)
    assert lone.direction is MeasureTrend.UNCLEAR


def test_verdicts_are_sorted_into_worse_and_better() -> None:
    cases, results = campaign_of([1.0, 2.0, 3.0, 4.0])
    verdicts = [Verdict.FAIL, Verdict.PASS, Verdict.FAIL, Verdict.PASS]
    before = [msgspec.structs.replace(r, verdict=v) for r, v in zip(results, verdicts, strict=True)]
    turned = [Verdict.PASS, Verdict.BLOCKED, Verdict.LOST]
    after = [
        msgspec.structs.replace(r, verdict=v) for r, v in zip(results[:3], turned, strict=True)
    ]

    comparison = compare((cases, before), (cases, after))

    assert [c.case_id for c in comparison.better] == ["s/0"]
    assert [(c.case_id, c.after) for c in comparison.worse] == [
        *(("s/1", "blocked"), ("s/3", "missing")),
    ]
    assert [c.case_id for c in comparison.changed] == ["s/2"]


def test_cases_with_other_ids_are_matched_by_factors_and_seed(campaign: Callable[..., Any]) -> None:
    made = campaign(21)
    renamed = [msgspec.structs.replace(case, id=f"new-{case.index}") for case in made.cases[:-1]]
    results = [
        msgspec.structs.replace(r, case_id=f"new-{r.index}") for r in reversed(made.results[:-1])
    ]

    comparison = compare((made.cases, made.results), (renamed, results))

    assert comparison.matched == comparison.matched_by_factors == comparison.identical == 20
    assert comparison.only_a == (made.cases[-1].id,)
    assert comparison.only_b == ()
    assert comparison.worse == ()


def test_one_id_with_another_seed_is_another_case(campaign: Callable[..., Any]) -> None:
    made = campaign(3)
    other = [msgspec.structs.replace(case, seed=case.seed + 100) for case in made.cases]

    comparison = compare((made.cases, made.results), (other, made.results))

    assert comparison.matched == 0
    assert len(comparison.only_a) == len(comparison.only_b) == 3


def test_cases_that_were_redefined_are_counted(campaign: Callable[..., Any]) -> None:
    made = campaign(3)
    other = [
        msgspec.structs.replace(case, setup=Setup(load_ratio=0.3)) if case.index else case
        for case in made.cases
    ]

    assert compare((made.cases, made.results), (other, made.results)).redefined == 2


def test_a_margin_that_shrinks_is_worse(campaign: Callable[..., Any]) -> None:
    made = campaign(30)
    after = [
        msgspec.structs.replace(
            r,
            monitors=tuple(
                msgspec.structs.replace(m, margin=m.margin - 0.02 - r.index * 1e-4)
                if m.unit == "m/s"
                else m
                for m in r.monitors
            ),
        )
        for r in made.results
    ]

    comparison = compare((made.cases, made.results), (made.cases, after))

    assert [shift.name for shift in comparison.significantly_worse] == [
        "below civil limit plus emergency margin"
    ]
    assert not comparison.worse


@given(st.lists(numbers.filter(lambda x: x != 0.0), min_size=1, max_size=20))
def test_the_effect_size_agrees_with_counting_ranks(differences: list[float]) -> None:
    array = np.array(differences)

    effect = rank_biserial_ratio(array)

    sizes = np.abs(array)
    ranks = [np.sum(sizes < size) + (np.sum(sizes == size) + 1) / 2.0 for size in sizes]
    rose = sum(rank for rank, value in zip(ranks, array, strict=True) if value > 0.0)
    fell = sum(rank for rank, value in zip(ranks, array, strict=True) if value < 0.0)
    assert effect == pytest.approx((rose - fell) / (rose + fell))
    assert signed_rank_p_ratio(np.array([])) is None


def test_order_of_arrival_does_not_matter(campaign: Callable[..., Any]) -> None:
    a, b = campaign(21, seed=1), campaign(21, seed=2)

    one = compare((a.cases, a.results), (b.cases, b.results))
    other = compare((a.cases[::-1], a.results[::-1]), (b.cases[::-1], b.results[::-1]))

    assert dataclasses.asdict(one) == dataclasses.asdict(other)
