"""Decides whether published figures are still those of the present code.

They are if the sources that decide them are unchanged. Otherwise some of their cases run again; if
these give the same digits, the change did not affect the figures.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Final

import msgspec

from metro_hil.model.case import Case, CaseResult
from metro_hil.report.law_figures import Results, ScenarioFigures, probed

AGAIN: Final = "`make figures` measures it again"

Plan = Callable[[str], Sequence[Case]]
"""Gives all cases of the shipped scenario with this name."""
Run = Callable[[Sequence[Case]], Sequence[CaseResult]]


@dataclass(frozen=True, slots=True)
class Standing:
    """State of the published figures of one scenario."""

    law: str
    scenario: str
    reason: str = ""
    """Why the figures are stale; empty while they hold."""
    probes: int = 0
    """Number of cases that ran again."""

    def __str__(self) -> str:
        name = f"{self.scenario} ({self.law})"
        if self.reason:
            return f"{name}: stale: {self.reason}; {AGAIN}"
        cases = "1 case" if self.probes == 1 else f"{self.probes} cases"
        again = f"same digits in {cases} run again" if self.probes else "same sources"
        return f"{name}: current, {again}"


def standings(
    results: Results, sources: str, *, plan: Plan, run: Run, probes_max: int | None = None
) -> Iterator[Standing]:
    """State of each scenario's figures; cases run only if the sources differ from the measured
    ones.

    Args:
        probes_max: greatest number of cases of a scenario to run, the one with the worst stop
            first.
    """
    for law, own in results.items():
        for name, figures in own.items():
            if figures.sources == sources:
                yield Standing(law, name)
            else:
                cases = {case.id: case for case in plan(name)}
                yield _probed(law, name, figures, cases, run, probes_max)


def _probed(
    law: str,
    name: str,
    figures: ScenarioFigures,
    cases: dict[str, Case],
    run: Run,
    probes_max: int | None,
) -> Standing:
    published = figures.figures.cases
    if len(cases) != published:
        return Standing(law, name, f"it has {len(cases)} cases now, published are {published}")
    if not figures.probes:
        return Standing(law, name, "no case of it was kept to compare with")
    chosen = figures.probes[::-1][:probes_max]
    missing = [probe.case_id for probe in chosen if probe.case_id not in cases]
    if missing:
        return Standing(law, name, f"it has no case {missing[0]} any more")
    results = run([cases[probe.case_id] for probe in chosen])
    for probe, result in zip(chosen, results, strict=True):
        now = probed(result)
        for measure in sorted({*probe.measures, *now}):
            was, is_now = probe.measures.get(measure), now.get(measure)
            if was != is_now:
                words = f"{measure} of {probe.case_id} is {is_now}, published was {was}"
                return Standing(law, name, words, len(chosen))
    return Standing(law, name, probes=len(chosen))


def stamped(results: Results, found: Sequence[Standing], sources: str) -> Results:
    """Mark figures that hold with the present sources."""
    holding = {(each.law, each.scenario) for each in found if not each.reason}
    return {
        law: {
            name: msgspec.structs.replace(each, sources=sources) if (law, name) in holding else each
            for name, each in own.items()
        }
        for law, own in results.items()
    }
