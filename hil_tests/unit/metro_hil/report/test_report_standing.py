"""When published figures count as those of the present code."""

from collections.abc import Callable, Sequence

import msgspec
import pytest

from metro_hil.model.case import Case, CaseResult
from metro_hil.report.law_figures import Pairs, Results, read_results, results_json, results_of
from metro_hil.report.standing import Standing, stamped, standings

OLD, NEW = "0123456789abcdef", "fedcba9876543210"
NAME = "table-8-predictive"


@pytest.fixture
def pairs(case_of: Callable[..., Case], result_of: Callable[..., CaseResult]) -> Pairs:
    """Three runs; the second has the worst stop."""
    cases = [
        case_of(n, NAME, error=0.0, load=load, seed=1) for n, load in enumerate((0.0, 0.5, 1.0))
    ]
    stops = ((0.01, -0.02, 0.03, 0.01), (0.01, -0.09, 0.03, 0.01), (0.01, 0.02, 0.03, 0.01))
    return [(case, result_of(case, own)) for case, own in zip(cases, stops, strict=True)]


@pytest.fixture
def results(pairs: Pairs) -> Results:
    """The results as they are read back from the file."""
    return read_results(results_json(results_of("florence", pairs, sources=OLD)))


def standing(
    results: Results, pairs: Pairs, sources: str, probes_max: int | None = None
) -> tuple[Standing, list[str]]:
    """The standing, and the ids of the cases that were run for it."""
    known = {case.id: result for case, result in pairs}
    ran: list[str] = []

    def run(cases: Sequence[Case]) -> list[CaseResult]:
        ran.extend(case.id for case in cases)
        return [result for case in cases if (result := known[case.id]) is not None]

    cases = [case for case, _ in pairs]
    (found,) = standings(results, sources, plan=lambda _: cases, run=run, probes_max=probes_max)
    return found, ran


def changed(pairs: Pairs, place: int, **measures: float | None) -> Pairs:
    case, result = pairs[place]
    assert result is not None
    result = msgspec.structs.replace(result, measures={**result.measures, **measures})
    return [*pairs[:place], (case, result), *pairs[place + 1 :]]


def test_no_case_is_run_while_the_sources_are_unchanged(results: Results, pairs: Pairs) -> None:
    found, ran = standing(results, pairs, OLD)

    assert str(found) == f"{NAME} (predictive): current, same sources"
    assert ran == []


def test_other_sources_with_the_same_digits_are_current(results: Results, pairs: Pairs) -> None:
    found, ran = standing(results, pairs, NEW)

    assert str(found) == f"{NAME} (predictive): current, same digits in 2 cases run again"
    assert ran == [pairs[1][0].id, pairs[0][0].id]
    assert stamped(results, [found], NEW)["predictive"][NAME].sources == NEW


def test_the_case_with_the_worst_stop_goes_first(results: Results, pairs: Pairs) -> None:
    _, ran = standing(results, pairs, NEW, probes_max=1)

    assert ran == [pairs[1][0].id]


@pytest.mark.parametrize("place", [0, 1])
def test_figures_with_another_digit_are_stale(results: Results, pairs: Pairs, place: int) -> None:
    found, _ = standing(results, changed(pairs, place, stop_II_error_m=0.0212), NEW)

    assert f"stop_II_error_m of {pairs[place][0].id} is 0.0212, published was" in found.reason
    assert str(found).endswith("; `make figures` measures it again")
    assert stamped(results, [found], NEW)["predictive"][NAME].sources == OLD


def test_a_digit_that_is_not_kept_does_not_count(results: Results, pairs: Pairs) -> None:
    found, _ = standing(results, changed(pairs, 0, stop_II_error_m=-0.0200001), NEW)

    assert found.reason == ""


def test_an_added_or_missing_measure_is_stale(results: Results, pairs: Pairs) -> None:
    found, _ = standing(results, changed(pairs, 0, felt_jerk_2hz_mps3=0.7), NEW)

    assert "felt_jerk_2hz_mps3" in found.reason


def test_another_number_of_cases_is_stale(results: Results, pairs: Pairs) -> None:
    found, ran = standing(results, pairs[:2], NEW)

    assert "it has 2 cases now, published are 3" in found.reason
    assert ran == []


def test_figures_without_a_kept_case_are_stale(results: Results, pairs: Pairs) -> None:
    """No evidence is no proof: the figures may be of any age."""
    bare = msgspec.structs.replace(results["predictive"][NAME], sources="", probes=())

    found, _ = standing({"predictive": {NAME: bare}}, pairs, NEW)

    assert "no case of it was kept" in found.reason


def test_means_are_kept_by_load(results: Results) -> None:
    assert results["predictive"][NAME].figures.load_means_m == {
        "0": pytest.approx(0.0175),
        "0.5": pytest.approx(0.035),
        "1": pytest.approx(0.0175),
    }
