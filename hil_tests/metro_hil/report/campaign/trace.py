"""Evidence for each requirement: scenarios, cases, worst margin, frames of the worst."""

import enum
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Final

from metro_hil.model.case import MonitorResult, Verdict
from metro_hil.model.requirements import Requirement
from metro_hil.model.verdict import judges
from metro_hil.report.campaign.ledger import Ledger, LedgerEntry, exercised, known_margin

UNKNOWN_SOURCE: Final = "not in the catalogue"
SAYS_SOMETHING: Final = (Verdict.PASS, Verdict.FAIL)
"""Verdicts that are evidence; cases with others are not."""


class RequirementStanding(enum.Enum):
    """State of a requirement after this campaign."""

    MET = "met"
    """Every case that names it has a monitor that judged it and held."""
    VIOLATED = "violated"
    KNOWN = "known not met"
    """A case that demonstrates an expected violation shows it."""
    PARTLY = "partly"
    """All evidence is good, but some cases that name it gave none."""
    SUBSET = "held in a subset"
    """All evidence is good, but not all cases of the campaign were selected."""
    OPEN = "open"
    """There is no evidence."""


class RequirementEvidence(enum.Enum):
    """Evidence of one case for one requirement."""

    GOOD = "good"
    BAD = "bad"
    KNOWN = "known not met"
    """The case demonstrates an expected violation, and did so."""
    NOTHING = "none"


@dataclass(slots=True)
class RequirementTrace:
    """The evidence for one requirement."""

    requirement: Requirement
    subset: bool = False
    """Whether not all cases of the campaign were selected."""
    scenarios: list[str] = field(default_factory=list)
    """Scenarios that name it, with or without evidence."""
    counts: dict[RequirementEvidence, int] = field(
        default_factory=lambda: dict.fromkeys(RequirementEvidence, 0)
    )
    worst: tuple[LedgerEntry, MonitorResult] | None = None
    """Least margin of all monitors that name it, compared as numbers whatever the unit."""

    @property
    def evidence(self) -> int:
        """Number of cases that are evidence."""
        return self.cases - self.counts[RequirementEvidence.NOTHING]

    @property
    def cases(self) -> int:
        return sum(self.counts.values())

    @property
    def standing(self) -> RequirementStanding:
        if self.counts[RequirementEvidence.BAD]:
            return RequirementStanding.VIOLATED
        if self.counts[RequirementEvidence.KNOWN]:
            return RequirementStanding.KNOWN
        if not self.counts[RequirementEvidence.GOOD]:
            return RequirementStanding.OPEN
        if self.subset:
            return RequirementStanding.SUBSET
        return (
            RequirementStanding.PARTLY
            if self.counts[RequirementEvidence.NOTHING]
            else RequirementStanding.MET
        )


def trace_requirements(
    catalogue: Mapping[str, Requirement], ledger: Ledger, *, subset: bool = False
) -> list[RequirementTrace]:
    """Evidence of each requirement in the catalogue's order, then of those that only cases name.

    Args:
        subset: whether only a part of the campaign's cases was selected, so that none counts as
            met.
    """
    traces = {
        name: RequirementTrace(requirement, subset) for name, requirement in catalogue.items()
    }
    for entry in ledger.entries:
        for name in sorted(requirements_of(entry)):
            if name not in traces:
                traces[name] = RequirementTrace(Requirement(name, UNKNOWN_SOURCE, ""), subset)
            _add(traces[name], entry)
    known = [traces[name] for name in catalogue]
    return known + [traces[name] for name in sorted(set(traces) - set(catalogue))]


def requirements_of(entry: LedgerEntry) -> set[str]:
    """All requirements that the case or one of its monitors names."""
    by_monitors = {name for result in entry.monitors() for name in result.requirements}
    return {*entry.case.requirements, *by_monitors}


def _add(trace: RequirementTrace, entry: LedgerEntry) -> None:
    name = trace.requirement.id
    if entry.case.scenario not in trace.scenarios:
        trace.scenarios.append(entry.case.scenario)
    trace.counts[evidence_of(entry, name)] += 1
    for result in filter(exercised, judges(name, entry.monitors())):
        margin = known_margin(result)
        if margin is None:
            continue
        least = trace.worst and known_margin(trace.worst[1])
        if least is None or margin < least:
            trace.worst = (entry, result)


def evidence_of(entry: LedgerEntry, name: str) -> RequirementEvidence:
    """Evidence of this case for the requirement, from the monitors that judge it.

    A case whose other monitors held is no evidence for this requirement.
    """
    if entry.result is None or entry.verdict not in SAYS_SOMETHING:
        return RequirementEvidence.NOTHING
    answering = judges(name, entry.monitors())
    failed = any(result.verdict is Verdict.FAIL for result in answering)
    if failed or (entry.result.died and name in entry.case.requirements):
        return RequirementEvidence.KNOWN if entry.as_expected else RequirementEvidence.BAD
    if not entry.as_expected:
        return RequirementEvidence.NOTHING
    asked = all(result.verdict is Verdict.PASS for result in answering if result.asked)
    held = asked and any(result.verdict is Verdict.PASS for result in answering)
    return RequirementEvidence.GOOD if held else RequirementEvidence.NOTHING
