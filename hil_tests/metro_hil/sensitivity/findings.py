"""The outcome of each mutant."""

import enum
from collections.abc import Sequence

import msgspec
from msgspec.structs import replace

from metro_hil.model.case import CaseResult, Verdict


class MutantOutcome(enum.Enum):
    NOTICED = "noticed"
    ARGUED = "argued"
    """No case noticed the mutant, and its list says why none can."""
    UNNOTICED = "unnoticed"
    REFUTED = "noticed against its argument"
    INVALID = "invalid"
    """The mutant does not run, so its failure says nothing about the campaign."""
    NOT_TRIED = "not tried"

    @property
    def in_order(self) -> bool:
        return self in (MutantOutcome.NOTICED, MutantOutcome.ARGUED)


class MutantFinding(msgspec.Struct, frozen=True, kw_only=True):
    """One mutant, and the case that noticed it, if any."""

    mutant: str
    rule: str
    file: str
    source: str
    """Name of the list that holds the mutant."""
    outcome: MutantOutcome
    case: str = ""
    """Id of the case that noticed the mutant."""
    scenario: str = ""
    monitor: str = ""
    """Monitor that only the mutant violates, not the true controller; the worst of several."""
    margin: float | None = None
    unit: str = ""
    at_s: float | None = None
    why: str = ""
    """The list's argument, why the mutant is invalid, or the case's report if no monitor failed."""
    tried: int = 0
    """Number of cases that ran on the mutant."""
    difference: str = ""
    """The change of the source as a unified diff."""

    def by(self) -> str:
        """The case that noticed the mutant, or its other outcome, as text for a person."""
        if self.outcome in (MutantOutcome.NOTICED, MutantOutcome.REFUTED):
            return f"{self.case}: {self.sign()}"
        return self.why

    def sign(self) -> str:
        """Text of the violation by which the case noticed the mutant."""
        if not self.monitor:
            return self.why
        unit = "" if self.unit == "1" else f" {self.unit}"
        margin = "" if self.margin is None else f" {self.margin:.3g}{unit}"
        at = "" if self.at_s is None else f" at {self.at_s:.2f} s"
        return f"{self.monitor}{margin}{at}"


def violated(finding: MutantFinding, mutated: CaseResult, true: CaseResult) -> MutantFinding:
    """The finding with the monitor that the mutant violates and the true controller does not.

    A case may also be unexpected without such a monitor, for example if its fault never begins.
    """
    held = {each.name for each in true.monitors if each.verdict is not Verdict.FAIL}
    failed = [
        each for each in mutated.monitors if each.verdict is Verdict.FAIL and each.name in held
    ]
    if not failed:
        return replace(finding, why=mutated.reason or f"verdict {mutated.verdict.value}")
    worst = min(failed, key=lambda each: each.margin if each.margin is not None else 0.0)
    return replace(
        finding,
        monitor=worst.name,
        margin=worst.margin,
        unit=worst.unit,
        at_s=worst.at_s,
        why="",
    )


def count_text(findings: Sequence[MutantFinding]) -> str:
    """Number of mutants of each outcome, in one line."""
    counts = dict.fromkeys(MutantOutcome, 0)
    for finding in findings:
        counts[finding.outcome] += 1
    parts = [f"{count} {outcome.value}" for outcome, count in counts.items() if count]
    noun = "mutant" if len(findings) == 1 else "mutants"
    return f"{len(findings)} {noun}: {', '.join(parts)}"
