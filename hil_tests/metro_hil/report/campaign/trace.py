"""From each requirement to its evidence: scenarios, cases, worst margin, frames of the worst."""

import enum
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Final

from metro_hil.model.case import MonitorResult, Verdict
from metro_hil.model.requirements import Requirement
from metro_hil.report.campaign.ledger import Entry, Ledger, exercised, known_margin

UNKNOWN_SOURCE: Final = "not in the catalogue"
SAYS_SOMETHING: Final = (Verdict.PASS, Verdict.FAIL, Verdict.INCONCLUSIVE)
"""Cases with another verdict are evidence of nothing."""


class Standing(enum.Enum):
    """Where a requirement stands after this campaign."""

    MET = "met"
    """There is evidence and all of it is good."""
    VIOLATED = "violated"
    PARTLY = "partly"
    """What evidence there is is good, but cases that name it gave none."""
    OPEN = "open"
    """No evidence at all."""


class Evidence(enum.Enum):
    """What one case says of one requirement."""

    GOOD = "good"
    BAD = "bad"
    EXPECTED = "violated as expected"
    """The case is there to show a violation, and did."""
    NOTHING = "none"


@dataclass(slots=True)
class Trace:
    """The evidence for one requirement."""

    requirement: Requirement
    scenarios: list[str] = field(default_factory=list)
    """That name it, with or without evidence."""
    counts: dict[Evidence, int] = field(default_factory=lambda: dict.fromkeys(Evidence, 0))
    worst: tuple[Entry, MonitorResult] | None = None
    """Of all monitors that name it. Units may differ; the one relative to zero counts."""

    @property
    def evidence(self) -> int:
        """Cases with good or bad evidence; a violation as expected proves nothing."""
        return self.counts[Evidence.GOOD] + self.counts[Evidence.BAD]

    @property
    def cases(self) -> int:
        return sum(self.counts.values())

    @property
    def standing(self) -> Standing:
        if self.counts[Evidence.BAD]:
            return Standing.VIOLATED
        if not self.counts[Evidence.GOOD]:
            return Standing.OPEN
        return Standing.PARTLY if self.counts[Evidence.NOTHING] else Standing.MET


def trace_requirements(catalogue: Mapping[str, Requirement], ledger: Ledger) -> list[Trace]:
    """One for each requirement of the catalogue in its order, then those only cases name."""
    traces = {name: Trace(requirement) for name, requirement in catalogue.items()}
    for entry in ledger.entries:
        for name in sorted(_named(entry)):
            if name not in traces:
                traces[name] = Trace(Requirement(name, UNKNOWN_SOURCE, ""))
            _add(traces[name], entry)
    known = [traces[name] for name in catalogue]
    return known + [traces[name] for name in sorted(set(traces) - set(catalogue))]


def _named(entry: Entry) -> set[str]:
    by_monitors = {name for result in entry.monitors() for name in result.requirements}
    return {*entry.case.requirements, *by_monitors}


def _add(trace: Trace, entry: Entry) -> None:
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


def evidence_of(entry: Entry, name: str, watching: Sequence[MonitorResult]) -> Evidence:
    """What this case says of the requirement.

    Monitors that name the requirement are heard first. A case that names it itself answers for it
    with its whole verdict, if at least one of its monitors was exercised.
    """
    if entry.verdict not in SAYS_SOMETHING:
        return Evidence.NOTHING
    if any(result.verdict is Verdict.FAIL for result in watching):
        expected = entry.as_expected and entry.case.expected is Verdict.FAIL
        return Evidence.EXPECTED if expected else Evidence.BAD
    if name in entry.case.requirements:
        if not entry.as_expected and entry.verdict is not Verdict.INCONCLUSIVE:
            return Evidence.BAD
        if entry.as_expected and any(exercised(result) for result in entry.monitors()):
            return Evidence.GOOD
        return Evidence.NOTHING
    passed = any(result.verdict is Verdict.PASS for result in watching)
    return Evidence.GOOD if passed else Evidence.NOTHING
