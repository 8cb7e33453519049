"""A trial of one mutant: which results detect it, and which do not count."""

from collections.abc import Mapping, Sequence

import msgspec
import pytest

from metro_hil.model.case import (
    BenchKind,
    Case,
    CaseResult,
    ControllerSpec,
    MonitorResult,
    Setup,
    Verdict,
)
from metro_hil.model.verdict import DEAD
from metro_hil.sensitivity.findings import MutantFinding, MutantOutcome, count_text
from metro_hil.sensitivity.mutants import ControllerMutant
from metro_hil.sensitivity.report import document, junit_xml, summary
from metro_hil.sensitivity.session import Depth, in_order, not_tried, trial, usable_cases

MUTANT = ControllerMutant(
    name="late", rule="in time", file="vobc/a.py", old="1", new="2", source="some.toml"
)


def argued() -> ControllerMutant:
    return ControllerMutant(
        name="late", rule="in time", file="vobc/a.py", old="1", new="2", argued="it is equivalent"
    )


def case(number: int, scenario: str = "stops") -> Case:
    return Case(
        id=f"{scenario}/s{number}", index=number, scenario=scenario, seed=number, setup=Setup()
    )


def monitor(name: str, margin: float) -> MonitorResult:
    verdict = Verdict.PASS if margin >= 0.0 else Verdict.FAIL
    return MonitorResult(name=name, verdict=verdict, margin=margin, unit="m", at_s=3.0)


def result(of: Case, *monitors: MonitorResult, reason: str = "") -> CaseResult:
    failed = reason or any(each.verdict is Verdict.FAIL for each in monitors)
    return CaseResult(
        case_id=of.id,
        index=of.index,
        verdict=Verdict.FAIL if failed else Verdict.PASS,
        reason=reason,
        monitors=monitors,
    )


def run(
    mutant: ControllerMutant,
    cases: Sequence[Case],
    mutated: Mapping[str, CaseResult],
    true: Mapping[str, CaseResult] | None = None,
    *,
    likely: int = 0,
    depth: Depth = Depth.USUAL,
) -> tuple[MutantFinding, list[tuple[str, bool]]]:
    """The finding and the requested runs. Runs without a given result pass."""
    asked = []
    trying = trial(mutant, cases, likely=likely, depth=depth)
    ask = next(trying)
    while True:
        asked.append((ask.case.id, ask.mutated))
        known = mutated if ask.mutated else true or {}
        answer = known.get(ask.case.id, result(ask.case, monitor("place", 1.0)))
        try:
            ask = trying.send(answer)
        except StopIteration as end:
            return end.value, asked


def test_the_first_case_that_differs_from_the_true_controller_detects_the_mutant() -> None:
    cases = [case(1), case(2), case(3)]
    bad = result(cases[1], monitor("place", -0.5), monitor("speed", -2.0))
    good = result(cases[1], monitor("place", 0.1), monitor("speed", 0.2))

    finding, asked = run(MUTANT, cases, {cases[1].id: bad}, {cases[1].id: good})

    assert finding.outcome is MutantOutcome.NOTICED
    assert (finding.case, finding.scenario, finding.tried) == ("stops/s2", "stops", 2)
    assert (finding.monitor, finding.margin, finding.unit) == ("speed", -2.0, "m")
    assert asked == [("stops/s1", True), ("stops/s2", True), ("stops/s2", False)]
    assert finding.by() == "stops/s2: speed -2 m at 3.00 s"


def test_a_monitor_that_the_true_controller_violates_too_is_not_named() -> None:
    only = case(1)
    bad = result(only, monitor("place", -0.5), monitor("speed", -2.0))
    good = msgspec.structs.replace(
        result(only, monitor("place", 0.1), monitor("speed", -1.0)), verdict=Verdict.PASS
    )

    finding, _ = run(MUTANT, [only], {only.id: bad}, {only.id: good})

    assert finding.monitor == "place"


def test_a_case_that_the_true_controller_fails_detects_nothing() -> None:
    only = case(1)
    bad = result(only, monitor("place", -0.5))

    finding, _ = run(MUTANT, [only], {only.id: bad}, {only.id: bad})

    assert finding.outcome is MutantOutcome.UNNOTICED
    assert finding.why == "none of 1 cases notices it"


@pytest.mark.parametrize("error", ["NameError: name 'x' is not defined", "TypeError: no"])
def test_a_mutant_with_a_syntax_error_is_invalid_and_not_detected(error: str) -> None:
    only = case(1)

    finding, _ = run(MUTANT, [only], {only.id: result(only, reason=f"{DEAD}: {error}")})

    assert finding.outcome is MutantOutcome.INVALID
    assert error in finding.why


def test_a_mutant_that_trips_an_assertion_of_the_controller_is_detected() -> None:
    only = case(1)

    finding, _ = run(MUTANT, [only], {only.id: result(only, reason=f"{DEAD}: AssertionError: x")})

    assert finding.outcome is MutantOutcome.NOTICED
    assert "AssertionError" in finding.by()


def test_a_justified_mutant_is_tried_with_the_cases_of_its_list() -> None:
    cases = [case(number) for number in range(5)]

    finding, asked = run(argued(), cases, {}, likely=2)

    assert finding.outcome is MutantOutcome.ARGUED
    assert finding.why == "it is equivalent"
    assert len(asked) == 2
    assert len(run(argued(), cases, {})[1]) == 1
    assert len(run(argued(), cases, {}, depth=Depth.THOROUGH)[1]) == 5


def test_a_justification_is_refuted_by_a_case_that_detects_the_mutant() -> None:
    only = case(1)
    bad = result(only, monitor("place", -0.5))

    finding, _ = run(argued(), [only], {only.id: bad})

    assert finding.outcome is MutantOutcome.REFUTED
    assert not finding.outcome.in_order


def test_a_quick_trial_ends_with_the_likely_cases() -> None:
    cases = [case(number) for number in range(5)]

    finding, asked = run(MUTANT, cases, {}, likely=2, depth=Depth.QUICK)

    assert finding.outcome is MutantOutcome.UNNOTICED
    assert len(asked) == 2


def test_named_cases_come_first_and_then_one_of_each_scenario() -> None:
    cases = [case(1, "a"), case(2, "a"), case(3, "b"), case(4, "b"), case(5, "c")]
    mutant = ControllerMutant(
        name="m", rule="r", file="f.py", old="1", new="2", tries=("b/s4", "c", "unknown")
    )

    ordered = [each.id for each in in_order(mutant, cases)]

    assert ordered == ["b/s4", "c/s5", "a/s1", "b/s3", "a/s2"]


def test_only_cases_of_the_shipped_controller_in_virtual_time_are_used() -> None:
    own = case(1)
    real = msgspec.structs.replace(case(2), bench=BenchKind.PROCESSES)
    other = msgspec.structs.replace(case(3), controller=ControllerSpec(kind="command", command="x"))

    assert usable_cases([own, real, other]) == (own,)


def test_the_report_fails_for_each_undetected_mutant() -> None:
    began = not_tried(MUTANT)
    findings = [
        msgspec.structs.replace(began, mutant=outcome.value, outcome=outcome, difference="-1\n+2")
        for outcome in MutantOutcome
    ]
    report = document("own", findings, cases=3, of_mutants=10, interrupted=True)

    text = junit_xml(report).decode()
    lines = summary(report)

    assert text.count("<failure") == 2
    assert text.count("<error") == 2
    assert 'tests="6" failures="2" errors="2"' in text
    assert lines[-1].startswith(f"own: {count_text(findings)}; a selection of 10; interrupted")
    assert not any(line.startswith("not tried") for line in lines)
    assert any("add a scenario that notices it" in line for line in lines)


def test_an_untried_mutant_fails_the_report() -> None:
    assert [each for each in MutantOutcome if each.in_order] == [
        MutantOutcome.NOTICED,
        MutantOutcome.ARGUED,
    ]
