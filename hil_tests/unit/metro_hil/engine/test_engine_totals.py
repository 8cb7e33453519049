"""Totals are green only for results that were shown case by case."""

import itertools

import msgspec
import pytest

from metro_hil.engine.totals import Totals, counts_words, total
from metro_hil.engine.trial_runner import trial_cases
from metro_hil.model.case import (
    Case,
    CaseResult,
    ExpectedFailure,
    Host,
    MonitorResult,
    Setup,
    Verdict,
)


def passes(cases: tuple[Case, ...]) -> list[CaseResult]:
    return [
        CaseResult(case_id=case.id, index=case.index, verdict=Verdict.PASS, chain="00")
        for case in cases
    ]


CASES = trial_cases(3)


def test_all_cases_passed_is_green() -> None:
    totals = total(3, CASES, passes(CASES))

    assert totals.passed
    assert (totals.done, totals.counts["pass"]) == (3, 3)


def test_a_campaign_without_a_run_is_not_green() -> None:
    totals = total(0, (), ())

    assert not totals.passed
    assert "nothing was shown" in totals.problems[0]


@pytest.mark.parametrize("missing", range(3))
def test_a_case_without_a_result_is_missing_and_not_lost(missing: int) -> None:
    results = [one for one in passes(CASES) if one.index != missing]

    totals = total(3, CASES, results)

    assert not totals.passed
    assert totals.missing == (CASES[missing].id,)
    assert totals.counts["lost"] == 0
    assert counts_words(totals.counts, len(totals.missing)) == "pass 2, missing 1"


@pytest.mark.parametrize("manifest", [0, 2, 4])
def test_another_number_of_cases_than_the_manifest_names_is_not_green(manifest: int) -> None:
    totals = total(manifest, CASES, passes(CASES))

    assert not totals.passed


def test_cases_with_the_same_id_are_not_green() -> None:
    twins = (CASES[0], msgspec.structs.replace(CASES[0], index=1))

    totals = total(2, twins, passes(CASES[:1]))

    assert not totals.passed
    assert "occur twice" in totals.problems[0]


def test_a_result_of_another_campaign_is_not_green() -> None:
    totals = total(3, CASES, [*passes(CASES), *passes(trial_cases(1, "foreign"))])

    assert not totals.passed
    assert "foreign" in totals.problems[0]


def test_equal_results_for_a_case_count_once() -> None:
    results = passes(CASES)
    again = msgspec.structs.replace(results[0], host=Host(wall_s=9.0))

    totals = total(3, CASES, [*results, again])

    assert totals.passed
    assert totals.counts["pass"] == 3


def test_results_that_contradict_each_other_are_not_green() -> None:
    results = passes(CASES)
    other = msgspec.structs.replace(results[0], chain="01")

    totals = total(3, CASES, [*results, other])

    assert not totals.passed
    assert CASES[0].id in totals.problems[0]


@pytest.mark.parametrize(
    ("fails", "verdict"), list(itertools.product((False, True), Verdict)), ids=str
)
def test_only_the_expected_verdict_is_green(fails: bool, verdict: Verdict) -> None:
    """If the host lost or disturbed a run, there is no result that a scenario could expect."""
    expected = (ExpectedFailure(monitor="m"),) if fails else ()
    case = Case(id="a", index=0, scenario="a", seed=1, setup=Setup(), expected=expected)
    failed = MonitorResult(name="m", verdict=Verdict.FAIL, margin=-1.0, unit="m")
    lacking = ("nothing is watched",) if verdict is Verdict.VACUOUS else ()
    result = CaseResult(
        case_id="a",
        index=0,
        verdict=verdict,
        lacking=lacking,
        monitors=(failed,) if verdict is Verdict.FAIL else (),
    )

    totals = total(1, (case,), (result,))

    assert totals.passed is (verdict is (Verdict.FAIL if fails else Verdict.PASS))


def test_a_damaged_folder_is_not_green() -> None:
    totals = total(3, CASES, passes(CASES), ["NOT DETERMINISTIC"])

    assert not totals.passed
    assert isinstance(totals, Totals)
