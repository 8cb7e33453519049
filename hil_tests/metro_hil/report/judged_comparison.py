"""Compares two campaigns in total and scenario by scenario, and finds what is not proven."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from metro_hil.model.case import MonitorResult
from metro_hil.report.campaign.ledger import exercised, known_margin
from metro_hil.report.comparison import (
    FAMILIES,
    SIGNIFICANT_RATIO,
    Campaign,
    CampaignComparison,
    MeasureTrend,
    Pair,
    PairedShift,
    Taste,
    compare,
    family,
    paired,
    shifts_of,
    taste_of,
)
from metro_hil.report.detectable import Detectable, detectable
from metro_hil.report.relevance import ROUNDING_RATIO, relevance_of


@dataclass(frozen=True, slots=True)
class Drop:
    """A margin that is smaller in the second campaign."""

    case_id: str
    before: MonitorResult
    after: MonitorResult
    relevance_ratio: float
    """The drop divided by the smallest difference that matters in its unit."""


@dataclass(frozen=True, slots=True)
class ScenarioComparison:
    """Comparison of one scenario alone, with its own error rate of 5 %."""

    name: str
    matched: int
    worse: int
    """Number of verdicts that got worse."""
    better: int
    detectable: tuple[tuple[str, Detectable], ...]
    """What each family of tests can detect."""
    shifts: tuple[PairedShift, ...]
    """Shifts of the series in which some pair differs."""
    largest_drop: Drop | None

    @property
    def significantly_worse(self) -> tuple[PairedShift, ...]:
        return tuple(shift for shift in self.shifts if shift.direction is MeasureTrend.WORSE)


@dataclass(frozen=True, slots=True)
class JudgedComparison:
    """Everything that `hil compare` shows."""

    pool: CampaignComparison
    """Comparison of all cases together."""
    detectable: tuple[tuple[str, Detectable], ...]
    """What the pool can detect, by family."""
    scenarios: tuple[ScenarioComparison, ...]
    largest_drop: Drop | None
    unseen: tuple[tuple[str, int], ...]
    """Monitors that judged a case in the first campaign but not in the second, with the number of
    such pairs."""

    @property
    def significantly_worse(self) -> tuple[PairedShift, ...]:
        return self.pool.significantly_worse

    @property
    def worse_scenarios(self) -> tuple[ScenarioComparison, ...]:
        return tuple(each for each in self.scenarios if each.significantly_worse)

    @property
    def unproven(self) -> tuple[str, ...]:
        """Reasons why the absence of a worse result is no proof that nothing got worse; empty if
        none."""
        said = []
        if dim := [shift for shift in self.pool.shifts if cannot_tell(shift)]:
            names = ", ".join([shift.name for shift in dim])
            pairs = max(shift.pairs for shift in dim)
            said.append(f"{pairs} pairs are too few to judge {names}")
        said += [f"{name}: judged nothing in B in {count} pairs" for name, count in self.unseen]
        if self.pool.only_a:
            said.append(f"{len(self.pool.only_a)} cases of A are not in B")
        return tuple(said)


def cannot_tell(shift: PairedShift) -> bool:
    """Whether a pair got worse by a relevant amount, but too few pairs exist for significance."""
    least, effect_ratio = shift.least_p_ratio, shift.effect_ratio
    if least is None or effect_ratio is None or least < SIGNIFICANT_RATIO:
        return False
    taste = taste_of(shift)
    rose, fell = effect_ratio > -1.0, effect_ratio < 1.0
    return (taste is Taste.MORE and fell) or (taste is Taste.LESS and rose)


def judge_comparison(
    a: Campaign, b: Campaign, relevance: Mapping[str, float] | None = None
) -> JudgedComparison:
    """Compare two campaigns. Pure; the order of cases and results does not matter.

    Args:
        relevance: smallest differences that matter, by unit, where they are not the usual ones.
    """
    chosen = relevance or {}
    pool, pairs = compare(a, b, chosen), paired(a, b)
    return JudgedComparison(
        pool=pool,
        detectable=_detectable(pool.shifts, len(pairs)),
        scenarios=tuple(_scenarios(pairs, chosen)),
        largest_drop=largest_drop(pairs, chosen),
        unseen=_unseen(pairs),
    )


def _scenarios(pairs: Sequence[Pair], chosen: Mapping[str, float]) -> list[ScenarioComparison]:
    """Comparison of each scenario, in the order of the first campaign."""
    by_name: dict[str, list[Pair]] = {}
    for pair in pairs:
        by_name.setdefault(pair[0].case.scenario, []).append(pair)
    found = []
    for name, mine in by_name.items():
        shifts = shifts_of(mine, chosen, only_moved=True)
        found.append(
            ScenarioComparison(
                name=name,
                matched=len(mine),
                worse=sum(x.as_expected and not y.as_expected for x, y in mine),
                better=sum(y.as_expected and not x.as_expected for x, y in mine),
                detectable=_detectable(shifts, len(mine)),
                shifts=tuple(shifts),
                largest_drop=largest_drop(mine, chosen),
            )
        )
    return found


def _detectable(shifts: Sequence[PairedShift], pairs: int) -> tuple[tuple[str, Detectable], ...]:
    """What each family with a test can detect."""
    tests = Counter(family(shift) for shift in shifts if shift.p_ratio is not None)
    return tuple((name, detectable(pairs, tests[name])) for name in FAMILIES if tests[name])


def largest_drop(pairs: Sequence[Pair], chosen: Mapping[str, float]) -> Drop | None:
    """The largest drop of a margin in one case, relative to the smallest difference that matters;
    None if no margin fell by that much."""
    worst = max(_drops(pairs, chosen), key=lambda drop: drop.relevance_ratio, default=None)
    return None if worst is None or worst.relevance_ratio < ROUNDING_RATIO else worst


def _drops(pairs: Sequence[Pair], chosen: Mapping[str, float]) -> list[Drop]:
    found = []
    for x, y in pairs:
        before = {(m.name, m.unit): m for m in x.monitors() if exercised(m)}
        for monitor in y.monitors():
            was = before.get((monitor.name, monitor.unit))
            old, new = None if was is None else known_margin(was), known_margin(monitor)
            if was is None or old is None or new is None or not exercised(monitor):
                continue
            ratio = (old - new) / (relevance_of(monitor.unit, chosen) or 1.0)
            found.append(Drop(y.case.id, was, monitor, ratio))
    return found


def _unseen(pairs: Sequence[Pair]) -> tuple[tuple[str, int], ...]:
    lost: Counter[str] = Counter()
    for x, y in pairs:
        if y.result is None:
            continue
        judged = {monitor.name for monitor in y.monitors() if exercised(monitor)}
        lost.update(m.name for m in x.monitors() if exercised(m) and m.name not in judged)
    return tuple(sorted(lost.items()))
