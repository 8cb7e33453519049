"""Evidence for a requirement, and completeness of the catalogue."""

from collections.abc import Callable
from typing import Any

import msgspec
import pytest

from metro_hil.model.case import Case, CaseResult, ExpectedFailure, MonitorResult, Setup, Verdict
from metro_hil.model.requirements import CatalogueError, parse_requirements, shipped_requirements
from metro_hil.report.campaign.ledger import join
from metro_hil.report.campaign.trace import (
    RequirementEvidence,
    RequirementStanding,
    RequirementTrace,
    trace_requirements,
)


def case_and_result(
    verdict: Verdict = Verdict.PASS, *fails: str, **monitor: Any
) -> tuple[Case, CaseResult]:
    watching = {"name": "m", "verdict": verdict, "margin": 0.5, "unit": "m", **monitor}
    expected = tuple(ExpectedFailure(monitor=name) for name in fails)
    case = Case(id="c", index=0, scenario="s", seed=1, setup=Setup(), expected=expected)
    result = CaseResult(
        case_id="c",
        index=0,
        verdict=verdict,
        monitors=(MonitorResult(**{"requirements": ("INV-01",), **watching}),),
    )
    return case, result


def trace_of(case: Case, result: CaseResult | None, name: str = "INV-01") -> RequirementTrace:
    ledger = join([case], [result] if result else [], expected_cases=1)
    traces = trace_requirements(shipped_requirements(), ledger)
    return next(trace for trace in traces if trace.requirement.id == name)


def test_the_catalogue_is_complete() -> None:
    wanted = [f"INV-{n:02d}" for n in range(1, 44)] + [f"ACC-{n:02d}" for n in range(1, 31)]

    papers = ["S001-T7", "S001-T8", "S001-T9", "S000-TIMING", "S004-F7"]
    assert list(shipped_requirements()) == [*wanted, *papers]


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("[[requirement]]\nid = 'INV-1'\nsource = 'x'\n", "text must be"),
        ("[[requirement]]\nid = 'inv'\nsource = 'x'\ntext = 'y'\n", "not like INV-04"),
        ("[[requirement]]\nid = 'A-1'\nsource = 'x'\ntext = 'y'\nnote = 1\n", "note"),
        ("[[requirement]]\nid = 'A-1'\nsource = 'x'\ntext = 'y'\n" * 2, "A-1 comes twice"),
        ("[requirement]\n", "no .*requirement"),
        ("other = 1\n", "other"),
        ("= 1", "not TOML"),
    ],
)
def test_an_error_in_a_catalogue_is_reported_by_name(text: str, said: str) -> None:
    with pytest.raises(CatalogueError, match=rf"mine\.toml.*{said}"):
        parse_requirements(text, "mine.toml")


def test_an_exercised_monitor_is_evidence() -> None:
    assert trace_of(*case_and_result()).standing is RequirementStanding.MET


def test_a_monitor_that_was_not_exercised_is_no_evidence() -> None:
    case, result = case_and_result(Verdict.VACUOUS, margin=None)

    trace = trace_of(case, result)

    assert trace.standing is RequirementStanding.OPEN
    assert trace.counts[RequirementEvidence.NOTHING] == 1
    assert trace.worst is None


def test_a_case_without_an_exercised_monitor_is_no_evidence() -> None:
    case, result = case_and_result(Verdict.VACUOUS, margin=None, requirements=())
    case = msgspec.structs.replace(case, requirements=("ACC-10",))

    assert trace_of(case, result, "ACC-10").standing is RequirementStanding.OPEN


def test_a_violation_counts_even_if_other_cases_pass() -> None:
    good, good_result = case_and_result()
    bad, bad_result = case_and_result(Verdict.FAIL, margin=-0.1)
    bad = msgspec.structs.replace(bad, id="d", index=1)
    bad_result = msgspec.structs.replace(bad_result, case_id="d", index=1)

    ledger = join([good, bad], [good_result, bad_result], expected_cases=2)
    trace = trace_requirements(shipped_requirements(), ledger)[0]

    assert trace.standing is RequirementStanding.VIOLATED
    assert trace.worst is not None
    assert trace.worst[0].case.id == "d"


def test_an_expected_violation_shows_that_the_requirement_is_not_met() -> None:
    trace = trace_of(*case_and_result(Verdict.FAIL, "m", margin=-1.0))

    assert trace.counts[RequirementEvidence.KNOWN] == 1
    assert trace.standing is RequirementStanding.KNOWN


def test_a_requirement_that_one_case_meets_and_another_is_known_not_to_meet_is_not_met() -> None:
    good, good_result = case_and_result()
    known, known_result = case_and_result(Verdict.FAIL, "m", margin=-1.0)
    known = msgspec.structs.replace(known, id="d", index=1)
    known_result = msgspec.structs.replace(known_result, case_id="d", index=1)

    ledger = join([good, known], [good_result, known_result], expected_cases=2)

    trace = trace_requirements(shipped_requirements(), ledger)[0]
    assert trace.standing is RequirementStanding.KNOWN


def test_a_requirement_of_a_subset_is_not_met() -> None:
    case, result = case_and_result()

    ledger = join([case], [result], expected_cases=1)

    trace = trace_requirements(shipped_requirements(), ledger, subset=True)[0]
    assert trace.standing is RequirementStanding.SUBSET


def test_a_requirement_of_the_scenario_counts_only_through_its_own_monitors() -> None:
    case, result = case_and_result(own=False, asked=False)
    case = msgspec.structs.replace(case, requirements=("ACC-12",))

    assert trace_of(case, result, "ACC-12").standing is RequirementStanding.OPEN
    assert trace_of(case, result, "INV-01").standing is RequirementStanding.MET


def test_an_incomplete_case_is_no_evidence() -> None:
    case, result = case_and_result()
    result = msgspec.structs.replace(result, lacking=("fault x touched nothing",))

    assert trace_of(case, result).standing is RequirementStanding.OPEN


@pytest.mark.parametrize("verdict", [Verdict.LOST, Verdict.INVALID, Verdict.BLOCKED])
def test_a_case_without_a_verdict_is_no_evidence(verdict: Verdict) -> None:
    case, result = case_and_result()
    result = msgspec.structs.replace(result, verdict=verdict)

    assert trace_of(case, result).standing is RequirementStanding.OPEN


def test_a_missing_case_leaves_its_requirements_open(case_of: Callable[..., Case]) -> None:
    case = case_of(0, "table-8", error=0.0, load=0.0, seed=1)

    assert trace_of(case, None, "ACC-02").standing is RequirementStanding.OPEN


def test_a_requirement_unknown_to_the_catalogue_is_still_shown() -> None:
    case, result = case_and_result(requirements=("MINE-1",))

    assert trace_of(case, result, "MINE-1").standing is RequirementStanding.MET
