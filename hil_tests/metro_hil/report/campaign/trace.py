"""From each requirement to its evidence: scenarios, cases, worst margin, frames of the worst."""

import enum
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Final

from metro_hil.model.case import MonitorResult, Verdict
from metro_hil.model.requirements import Requirement
from metro_hil.report.campaign.ledger import Ledger, LedgerEntry, exercised, known_margin

UNKNOWN_SOURCE: Final = "not in the catalogue"
SAYS_SOMETHING: Final = (Verdict.PASS, Verdict.FAIL, Verdict.INCONCLUSIVE)
"""Cases with another verdict are evidence of nothing."""


class RequirementStanding(enum.Enum):
    """Where a requirement stands after this campaign."""

    MET = "met"
    """There is evidence and all of it is good."""
    VIOLATED = "violated"
    PARTLY = "partly"
    """What evidence there is is good, but cases that name it gave none."""
    OPEN = "open"
    """No evidence at all."""


class RequirementEvidence(enum.Enum):
    """What one case says of one requirement."""

    GOOD = "good"
    BAD = "bad"
    EXPECTED = "violated as expected"
    """The case is there to show a violation, and did."""
    NOTHING = "none"


@dataclass(slots=True)
class RequirementTrace:
    """The evidence for one requirement."""

    requirement: Requirement
    scenarios: list[str] = field(default_factory=list)
    """That name it, with or without evidence."""
    counts: dict[RequirementEvidence, int] = field(
        default_factory=lambda: dict.fromkeys(RequirementEvidence, 0)
    )
    worst: tuple[LedgerEntry, MonitorResult] | None = None
    """Of all monitors that name it. Units may differ; the one relative to zero counts."""

    @property
    def evidence(self) -> int:
        """Cases with good or bad evidence; a violation as expected proves nothing."""
        return self.counts[RequirementEvidence.GOOD] + self.counts[RequirementEvidence.BAD]

    @property
    def cases(self) -> int:
        return sum(self.counts.values())

    @property
    def standing(self) -> RequirementStanding:
        if self.counts[RequirementEvidence.BAD]:
            return RequirementStanding.VIOLATED
        if not self.counts[RequirementEvidence.GOOD]:
            return RequirementStanding.OPEN
        return (
            RequirementStanding.PARTLY
            if self.counts[RequirementEvidence.NOTHING]
            else RequirementStanding.MET
        )


def trace_requirements(
    catalogue: Mapping[str, Requirement], ledger: Ledger
) -> list[RequirementTrace]:
    """One for each requirement of the catalogue in its order, then those only cases name."""
    traces = {name: RequirementTrace(requirement) for name, requirement in catalogue.items()}
    for entry in ledger.entries:
        for name in sorted(_named(entry)):
            if name not in traces:
                traces[name] = RequirementTrace(Requirement(name, UNKNOWN_SOURCE, ""))
            _add(traces[name], entry)
    known = [traces[name] for name in catalogue]
    return known + [traces[name] for name in sorted(set(traces) - set(catalogue))]


def _named(entry: LedgerEntry) -> set[str]:
    by_monitors = {name for result in entry.monitors() for name in result.requirements}
    return {*entry.case.requirements, *by_monitors}


def _add(trace: RequirementTrace, entry: LedgerEntry) -> None:
    name = trace.requirement.id
    if entry.case.scenario not in trace.scenarios:
        trace.scenarios.append(entry.case.scenario)
    watching = [r for r in entry.monitors() if name in r.requirements and exercised(r)]
    trace.counts[evidence_of(entry, name, watching)] += 1
    for result in watching:
        margin = known_margin(result)
        if margin is None:
            continue
        least = trace.worst and known_margin(trace.worst[1])
        if least is None or margin < least:
            trace.worst = (entry, result)


def evidence_of(
    entry: LedgerEntry, name: str, watching: Sequence[MonitorResult]
) -> RequirementEvidence:
    """What this case says of the requirement.

    Monitors that name the requirement are heard first. A case that names it itself answers for it
    with its whole verdict, if at least one of its monitors was exercised.
    """
    if entry.verdict not in SAYS_SOMETHING:
        return RequirementEvidence.NOTHING
    if any(result.verdict is Verdict.FAIL for result in watching):
        expected = entry.as_expected and entry.case.expected is Verdict.FAIL
        return RequirementEvidence.EXPECTED if expected else RequirementEvidence.BAD
    if name in entry.case.requirements:
        if not entry.as_expected and entry.verdict is not Verdict.INCONCLUSIVE:
            return RequirementEvidence.BAD
        if entry.as_expected and any(exercised(result) for result in entry.monitors()):
            return RequirementEvidence.GOOD
        return RequirementEvidence.NOTHING
    passed = any(result.verdict is Verdict.PASS for result in watching)
    return RequirementEvidence.GOOD if passed else RequirementEvidence.NOTHING
