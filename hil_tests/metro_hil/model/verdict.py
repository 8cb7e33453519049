"""Derives the verdict from what a run showed; the same rules hold on every bench."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Final

from metro_hil.model.case import (
    ANY_FAULT,
    ANY_REQUIREMENT,
    WHOLE_CASE,
    Case,
    FaultResult,
    MonitorResult,
    Verdict,
)

DEAD: Final = "the controller ended by itself"
NEVER_MOVED: Final = "the train never moved"
MOVED_MIN_M: Final = 1.0
"""Minimum movement of the train, m; with less, a run shows nothing about driving."""
EXERCISED: Final = (Verdict.PASS, Verdict.FAIL)
"""Verdicts of a monitor that judged something."""


@dataclass(frozen=True, slots=True, kw_only=True)
class RunEvidence:
    """What one run showed."""

    monitors: Sequence[MonitorResult]
    faults: Sequence[FaultResult] = ()
    died: str = ""
    """How the controller ended by itself; empty if it did not."""
    branched: bool = True
    """Whether the run reached the branch of the case; True for a case without one."""
    moved_m: float
    """Greatest distance of the train from its first position, m."""
    violated: bool
    """Whether the run ended at a violation, so that its later parts were never tried."""


@dataclass(frozen=True, slots=True)
class Judgement:
    """The verdict of a case, and what the case lacks as evidence."""

    verdict: Verdict
    reason: str
    lacking: tuple[str, ...] = ()


def judge(case: Case, shown: RunEvidence) -> Judgement:
    """Derive the verdict, the reason for it, and what the case lacks as evidence."""
    gaps = _Gaps(case)
    blocked = gaps.blocked(shown)
    unmeasured = [each.name for each in shown.monitors if each.verdict is Verdict.INCONCLUSIVE]
    vacuous = gaps.vacuous(shown)
    idle = shown.moved_m < MOVED_MIN_M and not case.idle_counts
    lacking: list[str] = []
    if not shown.violated:
        lacking += [f"never began: {', '.join(blocked)}"] if blocked else []
        lacking += [f"not judged by: {', '.join(unmeasured)}"] if unmeasured else []
        lacking += [NEVER_MOVED] if idle else []
        lacking += vacuous
    failed = [each for each in shown.monitors if each.verdict is Verdict.FAIL]
    reason = "; ".join(lacking)
    if shown.died:
        verdict, reason = Verdict.FAIL, f"{DEAD}: {shown.died}"
    elif failed:
        verdict, reason = Verdict.FAIL, "; ".join(map(_text, failed))
    elif blocked:
        verdict = Verdict.BLOCKED
    elif unmeasured or idle:
        verdict = Verdict.INCONCLUSIVE
    elif vacuous:
        verdict = Verdict.VACUOUS
    else:
        nothing = not any(each.verdict in EXERCISED for each in shown.monitors)
        verdict = Verdict.VACUOUS if nothing else Verdict.PASS
        reason = "; ".join(gaps.excused)
    assert failed or not shown.violated, "a violation without a monitor that failed"
    return Judgement(verdict, reason, tuple(lacking))


class _Gaps:
    """Collects what a run did not show, and leaves out what the case's file allows."""

    def __init__(self, case: Case) -> None:
        self._case = case
        self._allowed = {name: each.reason for each in case.vacuous for name in each.names}
        self.excused: list[str] = []
        """Monitors and faults that may show nothing, each with the reason in the file."""

    def _kept(self, gaps: Iterable[tuple[str, str, str]]) -> list[str]:
        """The texts of the gaps that the file does not allow.

        Args:
            gaps: name, group and text of each.
        """
        kept = []
        for name, group, text in gaps:
            names = (name, group, WHOLE_CASE)
            reason = next((self._allowed[each] for each in names if each in self._allowed), None)
            if reason is None:
                kept.append(text)
            else:
                self.excused.append(f"allowed: {text}: {reason}")
        return kept

    def blocked(self, shown: RunEvidence) -> list[str]:
        """Faults that never began, and the branch if the run did not reach it."""
        faults = [
            (each.kind, ANY_FAULT, f"fault {each.kind}") for each in shown.faults if not each.began
        ]
        return [*self._kept(faults), *([] if shown.branched else ["the branch"])]

    def vacuous(self, shown: RunEvidence) -> list[str]:
        untouched = self._kept(
            (each.kind, ANY_FAULT, f"fault {each.kind} touched nothing")
            for each in shown.faults
            if each.began and each.touched == 0
        )
        unseen = self._kept(
            (each.name, "", f"vacuous: {each.name} ({each.detail})")
            for each in shown.monitors
            if each.asked and each.verdict is Verdict.VACUOUS
        )
        unjudged = self._kept(
            (name, ANY_REQUIREMENT, f"{name}: no monitor judged it")
            for name in self._case.requirements
            if not any(each.verdict is not Verdict.VACUOUS for each in judges(name, shown.monitors))
        )
        nothing = not any(each.verdict is not Verdict.VACUOUS for each in shown.monitors)
        words = "no monitor judged anything" if shown.monitors else "nothing is watched"
        found = [*untouched, *unseen, *unjudged]
        return [*found, *self._kept([("", "", words)])] if nothing and not unseen else found


def judges(requirement: str, monitors: Sequence[MonitorResult]) -> list[MonitorResult]:
    """The monitors that judge a requirement of the scenario.

    These are the monitors that name it; if none does, all under `[[monitor]]`.
    """
    named = [each for each in monitors if requirement in each.requirements]
    return named or [each for each in monitors if each.own]


def _text(result: MonitorResult) -> str:
    margin = "" if result.margin is None else f" by {-result.margin:.3g} {result.unit}".rstrip()
    at = "" if result.at_s is None else f" at {result.at_s:.2f} s"
    return f"{result.name} violated{margin}{at}"
