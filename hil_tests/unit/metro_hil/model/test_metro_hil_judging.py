"""The verdict of a case: nothing without evidence becomes a pass."""

from typing import Any

import msgspec
import pytest

from metro_hil.model.case import (
    Allowance,
    Case,
    CaseResult,
    ExpectedFailure,
    FaultResult,
    MonitorResult,
    Setup,
    Verdict,
    as_expected,
    mismatch,
)
from metro_hil.model.verdict import Judgement, RunEvidence, judge

CASE = Case(id="c", index=0, scenario="s", seed=1, setup=Setup())


def said(
    verdict: Verdict, margin: float | None = 1.0, name: str = "m", **more: Any
) -> MonitorResult:
    return MonitorResult(name=name, verdict=verdict, margin=margin, unit="m", at_s=3.0, **more)


def fault(*, began: bool = True, touched: int | None = 1) -> FaultResult:
    return FaultResult(kind="bus_off", began=began, touched=touched)


def judged(*monitors: MonitorResult, case: dict[str, Any] | None = None, **shown: Any) -> Judgement:
    made = msgspec.structs.replace(CASE, **(case or {}))
    return judge(
        made, RunEvidence(**{"monitors": monitors, "moved_m": 100.0, "violated": False, **shown})
    )


def test_a_run_whose_monitors_all_pass_is_a_pass() -> None:
    assert judged(said(Verdict.PASS)) == Judgement(Verdict.PASS, "")


def test_one_violation_fails_the_case_and_is_reported_with_margin_and_instant() -> None:
    found = judged(said(Verdict.PASS), said(Verdict.FAIL, -0.25, "limit"))

    assert found.verdict is Verdict.FAIL
    assert found.reason == "limit violated by 0.25 m at 3.00 s"


def test_a_dead_controller_fails_the_case_even_without_a_violated_monitor() -> None:
    found = judged(said(Verdict.PASS), died="ValueError: no")

    assert found.verdict is Verdict.FAIL
    assert "ValueError: no" in found.reason


def test_a_fault_that_never_began_blocks() -> None:
    found = judged(said(Verdict.PASS), faults=[fault(began=False, touched=0)])

    assert (found.verdict, found.reason) == (Verdict.BLOCKED, "never began: fault bus_off")


def test_a_branch_that_never_came_blocks() -> None:
    assert judged(said(Verdict.PASS), branched=False).verdict is Verdict.BLOCKED


def test_a_fault_without_effect_makes_the_case_vacuous() -> None:
    found = judged(said(Verdict.PASS), faults=[fault(touched=0)])

    assert (found.verdict, found.reason) == (Verdict.VACUOUS, "fault bus_off touched nothing")


def test_a_fault_whose_effect_is_not_counted_is_assumed_to_act() -> None:
    assert judged(said(Verdict.PASS), faults=[fault(touched=None)]).verdict is Verdict.PASS


def test_a_violation_counts_more_than_a_fault_that_never_began() -> None:
    found = judged(said(Verdict.FAIL, -1.0), faults=[fault(began=False)], violated=True)

    assert found.verdict is Verdict.FAIL
    assert not found.lacking, "the run was cut short"


def test_a_monitor_that_could_not_judge_makes_the_case_inconclusive() -> None:
    found = judged(said(Verdict.PASS), said(Verdict.INCONCLUSIVE, None, "doors"))

    assert found.verdict is Verdict.INCONCLUSIVE
    assert "doors" in found.reason


def test_a_requested_vacuous_monitor_makes_the_case_vacuous() -> None:
    found = judged(said(Verdict.PASS), said(Verdict.VACUOUS, None, "doors"))

    assert found.verdict is Verdict.VACUOUS
    assert "doors" in found.reason


def test_a_default_invariant_may_be_vacuous() -> None:
    idle = said(Verdict.VACUOUS, None, "inv", asked=False, own=False)

    assert judged(said(Verdict.PASS), idle).verdict is Verdict.PASS


def test_a_case_without_monitors_is_vacuous() -> None:
    assert judged().verdict is Verdict.VACUOUS
    assert judged(said(Verdict.VACUOUS, None, asked=False, own=False)).verdict is Verdict.VACUOUS


def test_a_requirement_that_no_monitor_of_its_own_judged_makes_the_case_vacuous() -> None:
    """A default invariant counts only for the requirement that it names."""
    standing = said(Verdict.PASS, asked=False, own=False, requirements=("INV-04",))

    found = judged(standing, case={"requirements": ("ACC-12",)})

    assert (found.verdict, found.reason) == (Verdict.VACUOUS, "ACC-12: no monitor judged it")
    assert judged(standing, case={"requirements": ("INV-04",)}).verdict is Verdict.PASS
    assert judged(said(Verdict.PASS), case={"requirements": ("ACC-12",)}).verdict is Verdict.PASS


@pytest.mark.parametrize(
    ("moved_m", "expected"), [(0.99, Verdict.INCONCLUSIVE), (1.0, Verdict.PASS)]
)
def test_a_train_that_never_moved_is_no_evidence(moved_m: float, expected: Verdict) -> None:
    assert judged(said(Verdict.PASS), moved_m=moved_m).verdict is expected
    idle = judged(said(Verdict.PASS), moved_m=moved_m, case={"idle_counts": True})
    assert idle.verdict is Verdict.PASS


@pytest.mark.parametrize("name", ["bus_off", "faults", "case"])
def test_an_allowed_vacuous_monitor_is_skipped_with_its_reason(
    name: str,
) -> None:
    allowed = (Allowance(names=(name,), reason="it may miss"),)

    found = judged(said(Verdict.PASS), faults=[fault(touched=0)], case={"vacuous": allowed})

    assert found.verdict is Verdict.PASS
    assert found.reason == "allowed: fault bus_off touched nothing: it may miss"


def test_an_allowance_for_something_else_does_not_count() -> None:
    allowed = (Allowance(names=("another",), reason="it may miss"),)

    found = judged(said(Verdict.PASS), faults=[fault(touched=0)], case={"vacuous": allowed})

    assert found.verdict is Verdict.VACUOUS


def test_a_case_that_may_be_vacuous_as_a_whole_is_vacuous_as_expected() -> None:
    case = msgspec.structs.replace(CASE, vacuous=(Allowance(names=("case",), reason="a log"),))
    found = judge(case, RunEvidence(monitors=(), moved_m=9.0, violated=False))
    result = CaseResult(case_id="c", index=0, verdict=found.verdict, lacking=found.lacking)

    assert found.verdict is Verdict.VACUOUS
    assert as_expected(case, result)


EXPECTING = msgspec.structs.replace(
    CASE, expected=(ExpectedFailure(monitor="m", margin_min=-1.0, margin_max=-0.1),)
)


def failing(*monitors: MonitorResult, **more: Any) -> CaseResult:
    made = CaseResult(case_id="c", index=0, verdict=Verdict.FAIL, monitors=monitors)
    return msgspec.structs.replace(made, **more)


def test_a_failure_is_as_expected_when_it_is_the_one_that_was_named() -> None:
    assert as_expected(EXPECTING, failing(said(Verdict.FAIL, -0.5), said(Verdict.PASS, name="n")))


@pytest.mark.parametrize(
    ("result", "why"),
    [
        (failing(said(Verdict.FAIL, -0.5), died="exit code 7"), "but"),
        (failing(said(Verdict.FAIL, -0.5, "other"), said(Verdict.PASS)), "other failed too"),
        (failing(said(Verdict.FAIL, -0.5), said(Verdict.FAIL, -2.0, "other")), "other failed too"),
        (failing(said(Verdict.FAIL, -1.5)), "margin of -1 or more and -0.1 or less"),
        (failing(said(Verdict.FAIL, -0.05)), "margin of"),
        (failing(said(Verdict.FAIL, None)), "margin of"),
        (
            failing(said(Verdict.FAIL, -0.5), lacking=("fault x touched nothing",)),
            "touched nothing",
        ),
        (failing(said(Verdict.PASS), verdict=Verdict.PASS), "but pass"),
        (failing(said(Verdict.FAIL, -0.5), verdict=Verdict.LOST), "but lost"),
        (failing(said(Verdict.FAIL, -0.5), verdict=Verdict.INVALID), "but invalid"),
        (failing(said(Verdict.FAIL, -0.5), verdict=Verdict.BLOCKED), "but blocked"),
    ],
)
def test_every_other_outcome_is_unexpected_with_a_reason(result: CaseResult, why: str) -> None:
    assert why in mismatch(EXPECTING, result)


@pytest.mark.parametrize("margin", [-1.0, -0.1])
def test_the_ends_of_the_expected_range_belong_to_it(margin: float) -> None:
    assert as_expected(EXPECTING, failing(said(Verdict.FAIL, margin)))
