"""The power of a comparison: what it can find, what it predicts, and what is no pass."""

from collections.abc import Callable, Mapping, Sequence

import numpy as np
import pytest
import scipy

from metro_hil.model.case import Case, CaseResult, MonitorResult, Setup, Verdict
from metro_hil.report.comparison import MeasureTrend
from metro_hil.report.detectable import detectable, least_p_ratio, pairs_needed, shift_sd_of
from metro_hil.report.judged_comparison import JudgedComparison, judge_comparison
from metro_hil.report.relevance import RELEVANT, parse_relevance, relevance_of

Campaign = tuple[list[Case], list[CaseResult]]
FALL_MM = (3, 5, 6, 2, 9, 4, 8, 7, 1)
"""The worked example of docs/guide/comparing.md."""


def campaign_of(
    margins: Mapping[str, Sequence[float]],
    scenario: Callable[[int], str] = lambda n: "hop",
    unit: str = "m",
    still: int = 0,
) -> Campaign:
    """A case for each row of the columns, which are margins by the name of their monitor.

    Args: still: further monitors whose margin is constant.
    """
    count = len(next(iter(margins.values())))
    cases = [
        Case(id=f"{scenario(n)}/s{n}", index=n, scenario=scenario(n), seed=n, setup=Setup())
        for n in range(count)
    ]
    results = []
    for case in cases:
        found = {name: column[case.index] for name, column in margins.items()}
        found |= {f"still {n}": 1.0 for n in range(still)}
        monitors = tuple(
            MonitorResult(name=name, verdict=Verdict.PASS, margin=margin, unit=unit)
            for name, margin in found.items()
        )
        results.append(
            CaseResult(
                case_id=case.id,
                index=case.index,
                verdict=Verdict.PASS,
                chain=f"{found}",
                monitors=monitors,
            )
        )
    return cases, results


def worked_example(pairs: int) -> JudgedComparison:
    """One margin falls in all pairs; five of 54 others move by as much in either direction."""
    sizes_m = np.array(FALL_MM[:pairs]) / 1000.0
    before: dict[str, Sequence[float]] = {"stop": [1.0] * pairs}
    after: dict[str, Sequence[float]] = {"stop": (1.0 - sizes_m).tolist()}
    for n in range(5):
        signs = np.where(np.arange(pairs) % (n + 2) == 0, 1.0, -1.0)
        before[f"other {n}"] = [1.0] * pairs
        after[f"other {n}"] = (1.0 + signs * sizes_m).tolist()
    return judge_comparison(campaign_of(before, still=49), campaign_of(after, still=49))


def test_the_worked_example_of_the_guide() -> None:
    comparison = worked_example(9)

    ((family, found),) = comparison.detectable
    assert (family, found.pairs, found.tests, found.pairs_needed) == ("margins", 9, 6, 8)
    assert found.shift_sd_ratio == pytest.approx(1.55, abs=0.005)
    stop = next(shift for shift in comparison.pool.shifts if shift.name == "stop")
    assert stop.p_ratio == pytest.approx(2.0 / 2**9)
    assert stop.p_holm_ratio == pytest.approx(6 * 2.0 / 2**9)
    assert stop.direction is MeasureTrend.WORSE
    assert (stop.mean.best, stop.sd) == (pytest.approx(-0.005), pytest.approx(0.0027, abs=5e-5))
    assert stop.finds == pytest.approx(0.0042, abs=5e-5)
    assert len(comparison.pool.shifts) == 55
    assert comparison.unproven == ()


def test_three_pairs_of_the_worked_example_are_reported_as_insufficient() -> None:
    comparison = worked_example(3)

    ((_, found),) = comparison.detectable
    assert found.hopeless
    assert found.shift_sd_ratio is None
    assert comparison.significantly_worse == ()
    assert "3 pairs are too few to judge stop" in comparison.unproven[0]


@pytest.mark.parametrize(
    ("tests", "pairs"), [(0, 6), (1, 6), (3, 7), (6, 8), (12, 9), (25, 10), (60, 12)]
)
def test_the_number_of_needed_pairs_equals_that_of_the_guide(tests: int, pairs: int) -> None:
    assert pairs_needed(tests) == pairs
    assert least_p_ratio(pairs) * max(1, tests) < 0.05 <= least_p_ratio(pairs - 1) * max(1, tests)


@pytest.mark.parametrize("differences", range(1, 12))
def test_the_least_p_equals_that_of_scipy_for_differences_in_one_direction(
    differences: int,
) -> None:
    p_ratio = scipy.stats.wilcoxon(np.arange(1.0, differences + 1.0), method="exact").pvalue

    assert least_p_ratio(differences) == pytest.approx(p_ratio)


@pytest.mark.parametrize(("pairs", "tests"), [(20, 1), (40, 6), (100, 40)])
def test_four_of_five_comparisons_find_the_detectable_shift(pairs: int, tests: int) -> None:
    """The oracle makes 600 comparisons of normal differences at the first step of Holm's method."""
    shift_sd = shift_sd_of(pairs, tests)
    assert shift_sd is not None
    drawn = np.random.default_rng(7).normal(shift_sd, 1.0, (600, pairs))

    p_ratios = scipy.stats.wilcoxon(drawn, axis=1, method="approx").pvalue

    assert np.mean(p_ratios < 0.05 / tests) == pytest.approx(0.8, abs=0.06)


def test_more_pairs_find_less_and_more_tests_find_more() -> None:
    found = [detectable(pairs, 6).shift_sd_ratio for pairs in (7, 8, 20, 200)]

    assert found[0] is None
    known = [shift_sd for shift_sd in found if shift_sd is not None]
    assert known == sorted(known, reverse=True)
    assert len(known) == 3
    alone, many = detectable(20, 1).shift_sd_ratio, detectable(20, 100).shift_sd_ratio
    assert alone is not None
    assert many is not None
    assert alone < many


def test_an_irrelevant_difference_counts_as_none_and_is_not_tested() -> None:
    a = campaign_of({"stop": [1.0] * 12})
    b = campaign_of({"stop": [1.0 - 0.0004] * 12})

    (usual,) = judge_comparison(a, b).pool.shifts
    (finer,) = judge_comparison(a, b, {"m": 0.0001}).pool.shifts

    assert (usual.unchanged, usual.p_ratio, usual.direction) == (12, None, MeasureTrend.UNCLEAR)
    assert (finer.unchanged, finer.direction) == (0, MeasureTrend.WORSE)
    assert judge_comparison(a, b).largest_drop is None


def test_the_smallest_relevant_difference_counts() -> None:
    a, b = campaign_of({"stop": [0.3] * 8}), campaign_of({"stop": [0.3 - 0.0005] * 8})

    assert [shift.unchanged for shift in judge_comparison(a, b).pool.shifts] == [0]


def test_relevant_differences_are_detected_among_more_irrelevant_ones() -> None:
    """Two thirds rise by a negligible amount; the others fall by 5 cm."""
    a = campaign_of({"stop": [1.0] * 30})
    b = campaign_of({"stop": [0.95 - n * 1e-5 if n % 3 == 0 else 1.0001 for n in range(30)]})

    (shift,) = judge_comparison(a, b).pool.shifts

    assert (shift.unchanged, shift.direction) == (20, MeasureTrend.WORSE)


def test_a_scenario_that_got_worse_is_named_though_the_pool_did_not() -> None:
    """8 pairs of one scenario fell by 2 cm, and 60 of another rose by 1 to 7 cm."""
    a = campaign_of({"stop": [1.0] * 68}, lambda n: "curve" if n < 8 else "hop")
    moved = [-0.02 - n * 0.001 if n < 8 else 0.01 + n * 0.001 for n in range(68)]
    b = campaign_of({"stop": [1.0 + each for each in moved]}, lambda n: "curve" if n < 8 else "hop")

    comparison = judge_comparison(a, b)

    assert comparison.significantly_worse == ()
    assert [each.name for each in comparison.worse_scenarios] == ["curve"]
    curve, hop = comparison.scenarios
    assert (curve.matched, hop.matched) == (8, 60)
    assert [shift.name for shift in curve.significantly_worse] == ["stop"]
    drop = comparison.largest_drop
    assert drop is not None
    assert (drop.case_id, drop.after.name, drop.before.margin) == ("curve/s7", "stop", 1.0)
    assert drop.after.margin == pytest.approx(1.0 - 0.027)
    assert drop.relevance_ratio == pytest.approx(0.027 / RELEVANT["m"])
    assert hop.largest_drop is None


def test_drops_in_different_units_are_scaled_by_their_relevant_difference() -> None:
    """0.1 m/s is twenty times its relevant difference, 0.005 m ten times."""
    a_m, b_m = campaign_of({"stop": [1.0]}), campaign_of({"stop": [0.995]})
    a_mps = campaign_of({"speed": [2.0]}, unit="m/s")
    b_mps = campaign_of({"speed": [1.9]}, unit="m/s")

    def both(one: Campaign, other: Campaign) -> Campaign:
        (first,), (second,) = one[1], other[1]
        monitors = (*first.monitors, *second.monitors)
        return one[0], [
            CaseResult(case_id=first.case_id, index=0, verdict=Verdict.PASS, monitors=monitors)
        ]

    drop = judge_comparison(both(a_m, a_mps), both(b_m, b_mps)).largest_drop

    assert drop is not None
    assert (drop.after.name, drop.relevance_ratio) == ("speed", pytest.approx(20.0))


def test_a_monitor_that_no_longer_judges_is_no_pass() -> None:
    a = campaign_of({"stop": [1.0] * 10, "speed": [2.0] * 10})
    b = campaign_of({"speed": [2.0] * 10})

    comparison = judge_comparison(a, b)

    assert comparison.unseen == (("stop", 10),)
    assert comparison.unproven == ("stop: judged nothing in B in 10 pairs",)


def test_missing_cases_are_no_pass() -> None:
    a, b = campaign_of({"stop": [1.0] * 10}), campaign_of({"stop": [1.0] * 7})

    assert judge_comparison(a, b).unproven == ("3 cases of A are not in B",)


def test_equal_campaigns_of_any_size_prove_that_nothing_got_worse() -> None:
    one = campaign_of({"stop": [1.0]})

    assert judge_comparison(one, one).unproven == ()


def test_pure_improvements_need_no_proof() -> None:
    a, b = campaign_of({"stop": [1.0, 1.0]}), campaign_of({"stop": [1.1, 1.2]})

    assert judge_comparison(a, b).unproven == ()


@pytest.mark.parametrize("text", ["m", "m=", "m=x", "m=-1", "m=nan", "m=inf", "=", "0.1"])
def test_an_invalid_smallest_difference_is_refused(text: str) -> None:
    with pytest.raises(ValueError, match=r"is not UNIT=NUMBER, such as m=0\.01"):
        parse_relevance([text])


def test_a_chosen_difference_overrides_the_default_one() -> None:
    chosen = parse_relevance(["m=0.01", "=2"])

    assert relevance_of("m", chosen) == 0.01
    assert relevance_of("", chosen) == 2.0
    assert relevance_of("s", chosen) == RELEVANT["s"]
    assert relevance_of("furlong", chosen) == 0.0
