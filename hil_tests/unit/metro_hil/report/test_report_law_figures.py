"""Figures of the control laws against handmade stops."""

from collections.abc import Callable

import msgspec
import pytest

from metro_hil.model.case import Case, CaseResult
from metro_hil.report.law_figures import (
    figures_of,
    law_of,
    merged_results,
    read_results,
    results_json,
    results_of,
    titled,
)


@pytest.fixture
def pairs(
    case_of: Callable[..., Case], result_of: Callable[..., CaseResult]
) -> list[tuple[Case, CaseResult | None]]:
    """Three runs: stops that are 1, 3, 5 and 7 cm off, stops that are 12 cm off, and no result."""
    cases = [case_of(n, "table-8-predictive", error=0.0, load=0.5, seed=n + 1) for n in range(3)]
    one = result_of(cases[0], (0.01, -0.03, 0.05, -0.07))
    ride = {"felt_jerk_2hz_mps3": 0.4, "run_time_s": 80.0}
    one = msgspec.structs.replace(one, measures={**one.measures, **ride})
    other = result_of(cases[1], (0.12, -0.12, 0.12, -0.12))
    ride = {"felt_jerk_2hz_mps3": 0.9, "run_time_s": 100.0}
    other = msgspec.structs.replace(other, measures={**other.measures, **ride})
    return [(cases[0], one), (cases[1], other), (cases[2], None)]


def test_all_stops_of_all_runs_are_in_the_figures(
    pairs: list[tuple[Case, CaseResult | None]],
) -> None:
    figures = figures_of(pairs)

    assert (figures.cases, figures.lacking, figures.stops, figures.missed) == (3, 1, 8, 0)
    assert figures.mean_m == pytest.approx((0.01 + 0.03 + 0.05 + 0.07 + 4 * 0.12) / 8)
    # The mean of two resampled runs with 4 and 12 cm is anywhere between them.
    assert figures.mean_low_m == pytest.approx(0.04)
    assert figures.mean_high_m == pytest.approx(0.12)
    assert abs(figures.worst_m or 0.0) == pytest.approx(0.12)
    assert figures.within_ratio == 0.5
    # Clopper and Pearson: one of two seeds, 1 - sqrt(0.975).
    assert figures.within_low_ratio == pytest.approx(0.0126, abs=0.001)
    assert figures.run_s == pytest.approx(90.0)
    assert figures.comfort["felt_jerk_2hz_mps3"] == 0.9
    assert figures.comfort["commanded_jerk_max_mps3"] is None


def test_cases_of_one_seed_count_as_one_draw(pairs: list[tuple[Case, CaseResult | None]]) -> None:
    """Both runs have seed 1, so their stops say nothing about another seed."""
    same = [(msgspec.structs.replace(case, seed=1), result) for case, result in pairs]

    figures = figures_of(same)

    assert figures.mean_low_m == figures.mean_high_m == pytest.approx(figures.mean_m)
    assert figures.within_ratio == 0.5
    assert figures.within_low_ratio == 0.0


@pytest.mark.parametrize(
    ("params", "believed", "law"),
    [
        ("florence4", {}, "predictive"),
        ("hefei6", {}, "chasing"),
        ("hefei6", {"ato.strategy": "pid"}, "pid"),
        ("somebody's own.toml", {}, "predictive"),
    ],
)
def test_a_case_uses_its_own_law_or_that_of_its_parameters(
    case_of: Callable[..., Case], params: str, believed: dict[str, str], law: str
) -> None:
    case = case_of(0, "any", error=0.0, load=0.5, seed=1)
    setup = msgspec.structs.replace(case.setup, params=params, believed=believed)
    assert law_of(msgspec.structs.replace(case, setup=setup)) == law


def test_cases_without_results_give_no_figures() -> None:
    figures = figures_of([])

    assert (figures.stops, figures.mean_m, figures.within_ratio, figures.run_s) == (0, *[None] * 3)


def test_figures_are_kept_by_law_and_scenario_and_newer_ones_replace_older(
    pairs: list[tuple[Case, CaseResult | None]],
) -> None:
    before = results_of("florence", pairs)
    news = results_of("other", pairs[:1])
    kept = merged_results({**before, "pid": before["predictive"]}, news)

    assert kept["predictive"]["table-8-predictive"].campaign == "other"
    assert kept["pid"]["table-8-predictive"].campaign == "florence"
    again = read_results(results_json(kept))
    assert results_json(again) == results_json(kept)
    mean_m = again["predictive"]["table-8-predictive"].figures.mean_m
    assert mean_m == kept["predictive"]["table-8-predictive"].figures.mean_m


def test_a_scenario_that_is_no_longer_shipped_is_dropped(
    pairs: list[tuple[Case, CaseResult | None]],
) -> None:
    before = results_of("florence", pairs)

    assert titled(before, {"table-8-predictive": "Brakes"})["predictive"][
        "table-8-predictive"
    ].title.startswith("Brakes")
    assert titled(before, {"other": "Brakes"}) == {"predictive": {}}
