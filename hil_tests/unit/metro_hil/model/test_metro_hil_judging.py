"""The verdict of a case: nothing becomes a pass that was not shown."""

import pytest

from metro_hil.model.case import MonitorResult, Verdict
from metro_hil.model.verdict import judge


def said(verdict: Verdict, margin: float | None = 1.0, name: str = "m") -> MonitorResult:
    return MonitorResult(name=name, verdict=verdict, margin=margin, unit="m", at_s=3.0)


def verdict_of(*monitors: MonitorResult, **changed: object) -> tuple[Verdict, str]:
    facts: dict[str, object] = {"died": "", "never_began": (), "moved_m": 100.0, "violated": False}
    return judge(monitors, **(facts | changed))  # type: ignore[arg-type]


def test_a_run_whose_monitors_all_pass_is_a_pass() -> None:
    assert verdict_of(said(Verdict.PASS)) == (Verdict.PASS, "")


def test_one_violation_fails_the_case_and_is_named_with_margin_and_instant() -> None:
    verdict, reason = verdict_of(said(Verdict.PASS), said(Verdict.FAIL, -0.25, "limit"))

    assert verdict is Verdict.FAIL
    assert reason == "limit violated by 0.25 m at 3.00 s"


def test_a_controller_that_died_fails_even_where_no_monitor_minds() -> None:
    verdict, reason = verdict_of(said(Verdict.PASS), died="ValueError: no")

    assert verdict is Verdict.FAIL
    assert "ValueError: no" in reason


def test_a_fault_that_never_began_blocks() -> None:
    assert verdict_of(said(Verdict.PASS), never_began=["fault bus_off"]) == (
        Verdict.BLOCKED,
        "never began: fault bus_off",
    )


def test_a_violation_counts_more_than_a_fault_that_never_began() -> None:
    verdict, _ = verdict_of(said(Verdict.FAIL, -1.0), never_began=["fault bus_off"], violated=True)

    assert verdict is Verdict.FAIL


def test_a_monitor_that_saw_nothing_makes_the_case_inconclusive() -> None:
    verdict, reason = verdict_of(said(Verdict.PASS), said(Verdict.INCONCLUSIVE, None, "doors"))

    assert verdict is Verdict.INCONCLUSIVE
    assert "doors" in reason


@pytest.mark.parametrize(
    ("moved_m", "expected"), [(0.99, Verdict.INCONCLUSIVE), (1.0, Verdict.PASS)]
)
def test_a_train_that_never_moved_has_shown_nothing(moved_m: float, expected: Verdict) -> None:
    assert verdict_of(said(Verdict.PASS), moved_m=moved_m)[0] is expected
