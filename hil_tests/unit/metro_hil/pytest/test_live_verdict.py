"""The complaints of the fixture `bench` about a test, from given results without a run."""

from collections.abc import Sequence

import pytest

from firmware_py.settings import SettingsError
from metro_hil.model.case import CaseResult, MonitorResult, Verdict
from metro_hil.monitors import MonitorPlan, read_monitors
from metro_hil.pytest.live_verdict import (
    Expected,
    Finding,
    complaints,
    findings_of,
    findings_of_live,
    read_expected,
)

HERE = "test_mine.py:12"
SLOW = {"name": "slow", "stl": "always(speed_mps < 5)", "unit": "m/s"}


def plans() -> tuple[MonitorPlan, ...]:
    return read_monitors([SLOW], "here")


def result(verdict: Verdict, reason: str = "", *monitors: MonitorResult) -> CaseResult:
    return CaseResult(case_id="c/s1", index=0, verdict=verdict, reason=reason, monitors=monitors)


def monitor(name: str, verdict: Verdict, margin: float | None = None) -> MonitorResult:
    return MonitorResult(name=name, verdict=verdict, margin=margin, unit="m", at_s=3.0)


def names(found: Sequence[Finding]) -> list[str]:
    return [each.name for each in found]


def test_an_invariant_number_expects_all_of_its_parts() -> None:
    expected = read_expected("INV-30", plans(), HERE)

    assert expected.all == {
        *("inv-30-door-place", "inv-30-door-platform"),
        *("inv-30-door-side", "inv-30-door-speed"),
    }


@pytest.mark.parametrize(
    ("expect", "hint"),
    [
        ("slwo", "did you mean 'slow'?"),
        ("", "its own are ['slow']"),
        ("inv-99", "`hil monitors` lists the invariants"),
        ("fault tacho_stuk", "nearest valid fault: tacho_stuck"),
        ("tacho_stuck", "no monitor or invariant"),
        (["slow", "quick"], "expect='quick'"),
    ],
)
def test_an_unmonitored_name_is_refused_with_file_line_and_remedy(
    expect: str | list[str], hint: str
) -> None:
    with pytest.raises(SettingsError) as refused:
        read_expected(expect, plans(), HERE)

    assert str(refused.value).startswith(f"{HERE}: expect=")
    assert hint in str(refused.value)


def test_an_unmonitored_invariant_cannot_be_expected() -> None:
    with pytest.raises(SettingsError, match="no monitor or invariant"):
        read_expected("inv-08-rollback", read_monitors([SLOW], "here", "none"), HERE)


def test_a_passed_case_has_no_complaint() -> None:
    assert findings_of(result(Verdict.PASS, "", monitor("a", Verdict.PASS, 1.0))) == []


@pytest.mark.parametrize("verdict", [each for each in Verdict if each is not Verdict.PASS])
def test_every_verdict_except_a_pass_is_reported(verdict: Verdict) -> None:
    (found,) = findings_of(result(verdict, "for a reason"))

    assert found == Finding("", f"{verdict.value}: for a reason")


def test_each_violated_monitor_and_each_fault_that_never_began_is_named() -> None:
    failed = result(
        Verdict.FAIL, "a violated; b violated", monitor("a", Verdict.FAIL, -2.0),
        monitor("b", Verdict.FAIL), monitor("c", Verdict.PASS),
    )  # fmt: skip
    blocked = result(Verdict.BLOCKED, "never began: fault brake_weak, the branch")

    assert names(findings_of(failed)) == ["a", "b"]
    assert findings_of(failed)[0].words == "a violated by 2 m at 3.00 s"
    assert names(findings_of(blocked)) == ["fault brake_weak", "the branch"]


def test_a_dead_controller_is_reported_beside_its_violations() -> None:
    reason = "the controller ended by itself: ValueError"

    found = findings_of(result(Verdict.FAIL, reason, monitor("a", Verdict.FAIL)))

    assert names(found) == ["a", ""]
    assert names(findings_of_live((), (), (), "ValueError")) == [""]


def test_a_scenario_monitor_that_judged_nothing_is_reported() -> None:
    """A default invariant may be vacuous, for instance when no door opens."""
    unseen = [
        monitor("slow", Verdict.INCONCLUSIVE),
        monitor("inv-08-rollback", Verdict.INCONCLUSIVE),
    ]

    found = findings_of_live(unseen, plans(), ["brake_weak"], "")

    assert [each.words for each in found] == [
        "slow judged nothing",
        "fault brake_weak never began",
    ]


def test_only_an_expected_failure_that_occurred_is_acceptable() -> None:
    expected = Expected(HERE, {"slow": frozenset({"slow"})})
    slow, other = Finding("slow", "slow violated"), Finding("inv-08-rollback", "rolled")

    assert complaints(expected, [("run", slow)]) == []
    assert complaints(expected, [("run", slow), ("run", other)]) == [f"{HERE}: run: rolled"]
    assert complaints(expected, []) == [f"{HERE}: expect='slow' did not come true"]


def test_a_finding_without_a_name_is_never_expected() -> None:
    expected = Expected(HERE, {"": frozenset({"slow"})})

    assert f"{HERE}: run: lost: x" in complaints(expected, [("run", Finding("", "lost: x"))])
