"""Counts and figures of a campaign: by scenario, by monitor, by measure, by level of a factor."""

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from metro_hil.model.case import MonitorResult, Verdict
from metro_hil.report.campaign.ledger import (
    Ledger,
    LedgerEntry,
    exercised,
    factor_text,
    known_margin,
)
from metro_hil.report.estimates import ConfidenceInterval, mean_with_interval, pass_share

LEVELS_MAX: Final = 12
"""A factor with more values than this is divided into bins."""
BINS: Final = 8


@dataclass(frozen=True, slots=True)
class MonitorOutcome:
    """One monitor's result for one case."""

    entry: LedgerEntry
    result: MonitorResult


@dataclass(frozen=True, slots=True)
class MonitorTally:
    """Results of one monitor over all cases that it watched."""

    name: str
    unit: str
    requirements: tuple[str, ...]
    counts: dict[Verdict, int]
    not_exercised: int
    """Number of results, with any verdict, in which the monitor judged nothing."""
    share: ConfidenceInterval | None
    """Share of passes among the cases that the monitor judged."""
    seen: tuple[MonitorOutcome, ...]
    """Results with a margin from monitors that judged something, in the campaign's order."""
    mean: ConfidenceInterval | None
    least: MonitorOutcome | None
    unmeasured: int
    """Number of results without a margin from monitors that judged something."""

    @property
    def judged(self) -> int:
        return self.counts[Verdict.PASS] + self.counts[Verdict.FAIL]

    def margins(self) -> list[float]:
        return [margin for one in self.seen if (margin := known_margin(one.result)) is not None]


@dataclass(frozen=True, slots=True)
class MeasureTally:
    """Values of one measure over all cases that have it."""

    name: str
    points: tuple[tuple[LedgerEntry, float], ...]
    absent: int
    """Number of cases with a result but without this measure."""
    mean: ConfidenceInterval

    def values(self) -> list[float]:
        return [value for _, value in self.points]


@dataclass(frozen=True, slots=True)
class TallyFactor:
    """One factor, and how it sorts the cases."""

    name: str
    levels: tuple[str, ...]
    level_of: dict[str, str]
    """Level by case id; cases without this factor are missing."""
    binned: bool


def tally_monitors(ledger: Ledger) -> list[MonitorTally]:
    """Tallies in the order in which the monitors first appear."""
    groups: dict[tuple[str, str], list[MonitorOutcome]] = {}
    for entry in ledger.entries:
        for result in entry.monitors():
            groups.setdefault((result.name, result.unit), []).append(MonitorOutcome(entry, result))
    return [_tally_monitor(name, unit, group) for (name, unit), group in groups.items()]


def _tally_monitor(name: str, unit: str, group: Sequence[MonitorOutcome]) -> MonitorTally:
    live = [one for one in group if exercised(one.result)]
    seen = tuple(one for one in live if known_margin(one.result) is not None)
    counts = {verdict: sum(one.result.verdict is verdict for one in live) for verdict in Verdict}
    return MonitorTally(
        name=name,
        unit=unit,
        requirements=tuple(sorted({r for one in group for r in one.result.requirements})),
        counts=counts,
        not_exercised=len(group) - len(live),
        share=pass_share(counts[Verdict.PASS], counts[Verdict.PASS] + counts[Verdict.FAIL]),
        seen=seen,
        mean=mean_with_interval([known_margin(one.result) or 0.0 for one in seen]),
        least=min(seen, key=lambda one: known_margin(one.result) or 0.0, default=None),
        unmeasured=len(live) - len(seen),
    )


def tally_measures(ledger: Ledger) -> list[MeasureTally]:
    """Tallies in the order of first appearance, without measures for which no case has a number."""
    with_result = [entry for entry in ledger.entries if not entry.missing]
    names = dict.fromkeys(name for entry in with_result for name in entry.measures())
    tallies = []
    for name in names:
        points = tuple(
            (entry, value)
            for entry in with_result
            if (value := entry.measures().get(name)) is not None and np.isfinite(value)
        )
        mean = mean_with_interval([value for _, value in points])
        if mean is not None:
            tallies.append(MeasureTally(name, points, len(with_result) - len(points), mean))
    return tallies


def factors_of(entries: Sequence[LedgerEntry]) -> list[TallyFactor]:
    """Factors with at least two values, in the order in which the cases name them."""
    names = list(dict.fromkeys(name for entry in entries for name in entry.case.factors))
    factors = [_factor(name, entries) for name in names]
    return [factor for factor in factors if len(factor.levels) > 1]


def _factor(name: str, entries: Sequence[LedgerEntry]) -> TallyFactor:
    values = {e.case.id: e.case.factors[name] for e in entries if name in e.case.factors}
    numbers = all(isinstance(v, int | float) and not isinstance(v, bool) for v in values.values())
    texts = {case_id: factor_text(value) for case_id, value in values.items()}
    if numbers:
        distinct = sorted(
            {text: float(value) for text, value in ((texts[i], values[i]) for i in values)}.items(),
            key=lambda p: p[1],
        )
        if len(distinct) > LEVELS_MAX:
            return _binned(name, {i: float(value) for i, value in values.items()})
        return TallyFactor(name, tuple(text for text, _ in distinct), texts, binned=False)
    order = list(dict.fromkeys(texts.values()))
    if len(order) > LEVELS_MAX:
        kept = order[: LEVELS_MAX - 1]
        rest = f"{len(order) - len(kept)} others"
        texts = {i: text if text in kept else rest for i, text in texts.items()}
        order = [*kept, rest]
    return TallyFactor(name, tuple(order), texts, binned=len(order) > LEVELS_MAX)


def _binned(name: str, values: dict[str, float]) -> TallyFactor:
    """Bins of equal width between the least and the greatest value."""
    edges = np.linspace(min(values.values()), max(values.values()), BINS + 1)
    labels = [f"{factor_text(a)} … {factor_text(b)}" for a, b in itertools.pairwise(edges.tolist())]
    places = {
        case_id: labels[int(np.clip(np.searchsorted(edges, value, side="right") - 1, 0, BINS - 1))]
        for case_id, value in values.items()
    }
    return TallyFactor(name, tuple(labels), places, binned=True)


def by_level(
    factor: TallyFactor, entries: Sequence[LedgerEntry]
) -> list[tuple[str, list[LedgerEntry]]]:
    """Entries of each level, in the factor's order, including empty levels."""
    groups: dict[str, list[LedgerEntry]] = {level: [] for level in factor.levels}
    for entry in entries:
        level = factor.level_of.get(entry.case.id)
        if level is not None:
            groups[level].append(entry)
    return list(groups.items())


def worst_entries(
    ledger: Ledger, tallies: Sequence[MonitorTally], *, count: int
) -> list[tuple[LedgerEntry, MonitorResult | None]]:
    """Cases to look at first: unexpected ones, then the least margins relative to the usual ones.

    The usual margin of a monitor is the median of its margins' magnitudes. So metres and metres per
    second can be ordered together. A margin that equals the monitor's best one, such as a correct
    count, is no bad sign; such cases come last.
    """
    usual = {(tally.name, tally.unit): (_usual(tally), _best(tally)) for tally in tallies}
    ranked = []
    for entry in ledger.entries:
        nearest, depth = _nearest(entry, usual)
        if nearest is not None or not entry.as_expected:
            ranked.append((entry.as_expected, depth, entry.case.index, entry, nearest))
    ranked.sort(key=lambda row: row[:3])
    return [(entry, nearest) for *_, entry, nearest in ranked[:count]]


def _nearest(
    entry: LedgerEntry, usual: dict[tuple[str, str], tuple[float, float]]
) -> tuple[MonitorResult | None, float]:
    """The monitor with the least margin relative to its usual one, and that ratio."""
    depths = []
    for number, result in enumerate(entry.monitors()):
        margin = known_margin(result)
        if margin is not None and exercised(result):
            median, best = usual[result.name, result.unit]
            depths.append((margin >= max(best, 0.0), margin / median, number, result))
    if not depths:
        return None, math.inf if entry.as_expected else 0.0
    at_best, depth, _, nearest = min(depths, key=lambda row: row[:3])
    return nearest, math.inf if at_best else depth


def _usual(tally: MonitorTally) -> float:
    margins = np.abs(tally.margins())
    return float(np.median(margins)) or 1.0 if len(margins) else 1.0


def _best(tally: MonitorTally) -> float:
    return max(tally.margins(), default=math.inf)
