"""Judges the runs of the fixture `bench`: what they violated, and what they never tried.

With `expect=` a test names the monitors or invariants that its run must violate. Any other
violation fails the test, and so does an expected violation that did not come.
"""

import difflib
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

from firmware_py.settings import SettingsError, nearest
from metro_hil.model.case import CaseResult, MonitorResult, Verdict
from metro_hil.monitors.plan import MonitorPlan, invariants_named
from plant_emulator.faults import declared  # noqa: F401  # enters all kinds into the catalogue
from plant_emulator.faults.kinds import CATALOGUE

Expect = str | Sequence[str]
"""Names of monitors, names or numbers of invariants, or `fault KIND` for one that never begins."""
FAULT: Final = "fault "
NEVER_BEGAN: Final = "never began: "
DIED: Final = "the controller"
OTHER: Final = ""
"""Name of findings that no test can expect."""


def place_of_call() -> str:
    """File and line of the call of the caller."""
    frame = sys._getframe(2)
    return f"{frame.f_code.co_filename}:{frame.f_lineno}"


@dataclass(frozen=True, slots=True)
class Expected:
    """What one call of the bench expects."""

    where: str
    """File and line of the call."""
    names: Mapping[str, frozenset[str]]
    """Monitors or faults by the name that the test wrote."""

    @property
    def all(self) -> frozenset[str]:
        return frozenset().union(*self.names.values())


def read_expected(expect: Expect, plans: Sequence[MonitorPlan], where: str) -> Expected:
    """Raises SettingsError for a name that is no monitor, invariant or fault of the scenario."""
    __tracebackhide__ = True
    written = [expect] if isinstance(expect, str) else list(expect)
    names = {}
    for name in written:
        meant = _meant(name, frozenset(plan.name for plan in plans))
        if not meant:
            raise SettingsError(f"{where}: expect={name!r}: {_hint(name, plans)}")
        names[name] = meant
    return Expected(where, names)


def _meant(name: str, known: frozenset[str]) -> frozenset[str]:
    if name in known or (name.startswith(FAULT) and name.removeprefix(FAULT) in CATALOGUE):
        return frozenset({name})
    return frozenset(each.name for each in invariants_named(name)) & known


def _hint(name: str, plans: Sequence[MonitorPlan]) -> str:
    if name.startswith(FAULT):
        near = nearest(name.removeprefix(FAULT), sorted(CATALOGUE), "fault")
        return f"no such fault; {near}"
    known = sorted({plan.name for plan in plans})
    close = difflib.get_close_matches(name, known, n=1)
    own = [plan.name for plan in plans if plan.asked]
    names = f"did you mean {close[0]!r}? " if close else f"its own are {own}; " if own else ""
    return (
        "no monitor or invariant that this scenario watches has this name; "
        f"{names}`hil monitors` lists the invariants"
    )


@dataclass(frozen=True, slots=True)
class Finding:
    """One fact that a test must expect or avoid."""

    name: str
    words: str


def findings_of(result: CaseResult) -> list[Finding]:
    """Findings of a case that ran to its end: everything that is not a pass."""
    found = [Finding(each.name, _words(each)) for each in _failed(result.monitors)]
    if result.verdict is Verdict.PASS:
        return found
    if result.verdict is Verdict.BLOCKED and result.reason.startswith(NEVER_BEGAN):
        names = result.reason.removeprefix(NEVER_BEGAN).split(", ")
        return [*found, *[Finding(name, f"{name} never began") for name in names]]
    if not found or result.reason.startswith(DIED):
        found.append(Finding(OTHER, f"{result.verdict.value}: {result.reason}"))
    return found


def findings_of_live(
    monitors: Sequence[MonitorResult],
    plans: Sequence[MonitorPlan],
    never_began: Sequence[str],
    died: str,
) -> list[Finding]:
    """Findings of a run that a test drove.

    Args:
        never_began: kinds of planned faults that never began.
        died: how the controller ended by itself; empty if the test got that exception.
    """
    found = [Finding(each.name, _words(each)) for each in _failed(monitors)]
    named = {plan.name for plan in plans if plan.asked}
    found += [
        Finding(OTHER, f"{each.name} judged nothing{': ' if each.detail else ''}{each.detail}")
        for each in monitors
        if each.name in named and each.verdict not in (Verdict.PASS, Verdict.FAIL)
    ]
    found += [Finding(f"{FAULT}{kind}", f"{FAULT}{kind} never began") for kind in never_began]
    if died:
        found.append(Finding(OTHER, f"the controller ended by itself: {died}"))
    return found


def _failed(monitors: Sequence[MonitorResult]) -> list[MonitorResult]:
    return [each for each in monitors if each.verdict is Verdict.FAIL]


def _words(monitor: MonitorResult) -> str:
    margin = "" if monitor.margin is None else f" by {-monitor.margin:.3g} {monitor.unit}".rstrip()
    at = "" if monitor.at_s is None else f" at {monitor.at_s:.2f} s"
    return f"{monitor.name} violated{margin}{at}"


def complaints(expected: Expected, found: Sequence[tuple[str, Finding]]) -> list[str]:
    """Sentences for the test's failure; none if everything is as expected.

    Args:
        found: findings of each run of one call, with the run's name.
    """
    said = [
        f"{expected.where}: {run}: {finding.words}"
        for run, finding in found
        if finding.name not in expected.all
    ]
    came = {finding.name for _, finding in found}
    said += [
        f"{expected.where}: expect={name!r} did not come true"
        for name, meant in expected.names.items()
        if not meant & came
    ]
    return said
