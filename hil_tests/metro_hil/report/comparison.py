"""Compares two campaigns: what got worse, what better, by how much, and whether by chance.

Differences below the smallest that matters in their unit count as equal. The others are tested by
Wilcoxon's signed-rank test, with Holm's correction within each of three families: margins, measures
of which less is better, and all others. The family of a series does not depend on the signs of its
differences, so the choice favours neither campaign.
"""

import enum
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final

import msgspec
import numpy as np

from metro_hil.model.case import Case, CaseResult, ControllerSpec, PlantSpec, Verdict
from metro_hil.model.log_columns import Numbers
from metro_hil.report.campaign.ledger import (
    LedgerEntry,
    exercised,
    factors_text,
    join,
    known_margin,
)
from metro_hil.report.campaign.units import unit_of
from metro_hil.report.detectable import (
    LEVEL_RATIO,
    least_p_ratio,
    shift_sd_of,
)
from metro_hil.report.estimates import (
    ConfidenceInterval,
    mean_with_interval,
    median_with_interval,
)
from metro_hil.report.relevance import InUnit, relevance_of, that_matter

ZERO: Final = InUnit(0.0)
SIGNIFICANT_RATIO: Final = LEVEL_RATIO
"""Greatest significant p, after Holm's correction."""
EXACT_MAX: Final = 50
PAIRS_MIN: Final = 6
"""Least number of differences with which a two-sided signed-rank test can reach 5 %."""
MORE_IS_WORSE: Final = ("jerk", "missed", "emergency", "slips", "rejected")
"""Parts of the names of measures for which greater is worse."""
ERROR: Final = "error"
"""Part of the names of measures that are compared by magnitude; greater is worse."""


class MeasureTrend(enum.Enum):
    """Direction of a measure's change, after correction for all tested ones."""

    WORSE = "worse"
    BETTER = "better"
    DIFFERENT = "different"
    """A difference of a measure for which neither more nor less is known to be better."""
    UNCLEAR = "no difference shown"


class Taste(enum.Enum):
    """Which values of a series are better."""

    MORE = "more"
    LESS = "less"
    NEITHER = "neither"


@dataclass(frozen=True, slots=True)
class VerdictChange:
    """One case whose verdict changed."""

    case_id: str
    factors: str
    before: str
    after: str
    reason: str
    """Reason in the second campaign."""


@dataclass(frozen=True, slots=True)
class PairedShift:
    """Paired differences of one margin or measure between the two campaigns."""

    name: str
    kind: str
    """`margin` or `measure`."""
    unit: str
    pairs: int
    unchanged: int
    """Number of pairs without a difference that matters; the signed-rank test leaves them out."""
    mean: ConfidenceInterval
    median: ConfidenceInterval
    p_ratio: float | None
    """p of Wilcoxon's signed-rank test, two-sided; None if there is nothing to test."""
    p_holm_ratio: float | None
    effect_ratio: float | None
    """Matched-pairs rank-biserial correlation: -1 if all fell, +1 if all rose."""
    direction: MeasureTrend
    notes: tuple[str, ...]
    sd: InUnit = ZERO
    """Standard deviation of the differences."""
    relevant: InUnit = ZERO
    """Smallest difference that matters; pairs that differ by less count as unchanged."""
    finds: InUnit | None = None
    """Mean difference that four of five such comparisons find, given the scatter of these
    differences; None if none can."""
    least_p_ratio: float | None = None
    """Corrected p if all pairs differed in the same direction: the least possible one."""


@dataclass(frozen=True, slots=True)
class CampaignComparison:
    """The second campaign against the first."""

    matched: int
    matched_by_factors: int
    """Number of matched pairs with different ids, matched by scenario, factors and seed."""
    redefined: int
    """Number of pairs whose cases are defined differently, apart from the controller; that may
    cause differences."""
    identical: int
    """Number of pairs with equal hashes: the same frames at the same times."""
    only_a: tuple[str, ...]
    only_b: tuple[str, ...]
    worse: tuple[VerdictChange, ...]
    better: tuple[VerdictChange, ...]
    changed: tuple[VerdictChange, ...]
    """Cases with another verdict that are as expected in both campaigns or in neither."""
    shifts: tuple[PairedShift, ...]

    @property
    def significantly_worse(self) -> tuple[PairedShift, ...]:
        return tuple(shift for shift in self.shifts if shift.direction is MeasureTrend.WORSE)


Campaign = tuple[Sequence[Case], Sequence[CaseResult]]
Pair = tuple[LedgerEntry, LedgerEntry]


def compare(
    a: Campaign, b: Campaign, relevance: Mapping[str, float] | None = None
) -> CampaignComparison:
    """Compare two campaigns. Pure; the order of cases and results does not matter.

    Args:
        relevance: smallest differences that matter, by unit, where they are not the usual ones.
    """
    by_id, by_factors, rest_a, rest_b = _matched(a, b)
    pairs = _in_order(by_id, by_factors)
    moved = [(x, y) for x, y in pairs if x.word != y.word]
    return CampaignComparison(
        matched=len(pairs),
        matched_by_factors=len(by_factors),
        redefined=sum(_definition(x.case) != _definition(y.case) for x, y in pairs),
        identical=sum(_identical(x, y) for x, y in pairs),
        only_a=tuple(entry.case.id for entry in rest_a),
        only_b=tuple(entry.case.id for entry in rest_b),
        worse=tuple(_change(x, y) for x, y in pairs if x.as_expected and not y.as_expected),
        better=tuple(_change(x, y) for x, y in pairs if y.as_expected and not x.as_expected),
        changed=tuple(_change(x, y) for x, y in moved if x.as_expected is y.as_expected),
        shifts=tuple(shifts_of(pairs, relevance)),
    )


def paired(a: Campaign, b: Campaign) -> list[Pair]:
    """Pairs of the same cases of both campaigns, in the order of the first."""
    by_id, by_factors, _, _ = _matched(a, b)
    return _in_order(by_id, by_factors)


def _in_order(by_id: Sequence[Pair], by_factors: Sequence[Pair]) -> list[Pair]:
    return sorted([*by_id, *by_factors], key=lambda pair: pair[0].case.index)


def _matched(
    a: Campaign, b: Campaign
) -> tuple[list[Pair], list[Pair], list[LedgerEntry], list[LedgerEntry]]:
    """Pairs by id, pairs by factors and seed, and the unmatched cases of both."""
    entries_a = join(*a, expected_cases=len(a[0])).entries
    entries_b = join(*b, expected_cases=len(b[0])).entries
    by_id, rest_a, rest_b = _match(entries_a, entries_b, lambda e: (e.case.id, _key(e)))
    by_factors, rest_a, rest_b = _match(rest_a, rest_b, _key)
    return by_id, by_factors, rest_a, rest_b


def _key(entry: LedgerEntry) -> tuple[str, bytes, int]:
    case = entry.case
    return case.scenario, msgspec.json.encode(case.factors, order="sorted"), case.seed


def _match(
    entries_a: Sequence[LedgerEntry],
    entries_b: Sequence[LedgerEntry],
    key: Callable[[LedgerEntry], object],
) -> tuple[list[Pair], list[LedgerEntry], list[LedgerEntry]]:
    """Pairs of equal keys in order, then the unmatched cases of both."""
    waiting: dict[object, list[LedgerEntry]] = {}
    for entry in entries_b:
        waiting.setdefault(key(entry), []).append(entry)
    pairs, rest_a = [], []
    for entry in entries_a:
        partners = waiting.get(key(entry))
        if partners:
            pairs.append((entry, partners.pop(0)))
        else:
            rest_a.append(entry)
    taken = {other.case.id for _, other in pairs}
    return pairs, rest_a, [entry for entry in entries_b if entry.case.id not in taken]


def _definition(case: Case) -> Case:
    return msgspec.structs.replace(
        case, id="", index=0, controller=ControllerSpec(), plant=PlantSpec(), requirements=()
    )


def _identical(x: LedgerEntry, y: LedgerEntry) -> bool:
    chains = [entry.result.chain for entry in (x, y) if entry.result is not None]
    return len(chains) == 2 and chains[0] == chains[1] != ""


def _change(x: LedgerEntry, y: LedgerEntry) -> VerdictChange:
    return VerdictChange(y.case.id, factors_text(y.case), x.word, y.word, y.reason)


def shifts_of(
    pairs: Sequence[Pair],
    chosen: Mapping[str, float] | None = None,
    *,
    only_moved: bool = False,
) -> list[PairedShift]:
    """Shifts of margins, then of measures, with Holm's correction within each family.

    Args:
        chosen: as `relevance` of `compare`.
        only_moved: leave out series whose pairs are all equal.
    """
    series = [
        (key, np.array(differences), relevance_of(key[2], chosen or {}))
        for key, differences in [*_margins(pairs).items(), *_measures(pairs).items()]
    ]
    raw = [_raw(*each) for each in series if not only_moved or len(that_matter(*each[1:]))]
    corrected: dict[str, list[float]] = {}
    for name in FAMILIES:
        mine = [one.p_ratio for one in raw if one.p_ratio is not None and family(one) == name]
        corrected[name] = holm(mine)[::-1]
    tests = {name: len(ps) for name, ps in corrected.items()}
    return [
        one
        if one.p_ratio is None
        else _judged(one, corrected[family(one)].pop(), taste_of(one), tests[family(one)])
        for one in raw
    ]


def _margins(pairs: Sequence[Pair]) -> dict[tuple[str, str, str], list[float]]:
    found: dict[tuple[str, str, str], list[float]] = {}
    for x, y in pairs:
        before = {(m.name, m.unit): known_margin(m) for m in x.monitors() if exercised(m)}
        for monitor in y.monitors():
            old, new = before.get((monitor.name, monitor.unit)), known_margin(monitor)
            if exercised(monitor) and old is not None and new is not None:
                found.setdefault((monitor.name, "margin", monitor.unit), []).append(new - old)
    return found


def _measures(pairs: Sequence[Pair]) -> dict[tuple[str, str, str], list[float]]:
    found: dict[tuple[str, str, str], list[float]] = {}
    for x, y in pairs:
        if Verdict.INVALID in (x.verdict, y.verdict):
            continue
        before: Mapping[str, float | None] = x.measures()
        for name, new in y.measures().items():
            old = before.get(name)
            if old is None or new is None or not np.isfinite(old) or not np.isfinite(new):
                continue
            difference = abs(new) - abs(old) if ERROR in name else new - old
            found.setdefault((name, "measure", unit_of(name)), []).append(difference)
    return found


def _raw(key: tuple[str, str, str], differences: Numbers, relevant: float) -> PairedShift:
    """Shift of one series, before correction."""
    name, kind, unit = key
    nonzero = that_matter(differences, relevant)
    mean = mean_with_interval(differences.tolist())
    median = median_with_interval(differences.tolist())
    assert mean is not None
    assert median is not None
    return PairedShift(
        name=name,
        kind=kind,
        unit=unit,
        pairs=len(differences),
        unchanged=len(differences) - len(nonzero),
        mean=mean,
        median=median,
        p_ratio=signed_rank_p_ratio(nonzero),
        p_holm_ratio=None,
        effect_ratio=rank_biserial_ratio(nonzero),
        direction=MeasureTrend.UNCLEAR,
        notes=tuple(_notes(differences, nonzero)),
        sd=InUnit(float(np.std(differences, ddof=1))) if len(differences) > 1 else ZERO,
        relevant=InUnit(relevant),
    )


def _notes(differences: Numbers, nonzero: Numbers) -> list[str]:
    """Remarks that a reader needs to judge the figures."""
    if not len(nonzero):
        return ["all pairs are equal: nothing to test"]
    notes = []
    unchanged = len(differences) - len(nonzero)
    if unchanged:
        notes.append(f"{unchanged} of {len(differences)} pairs are equal and not in the test")
    if len(nonzero) < PAIRS_MIN:
        notes.append(f"only {len(nonzero)} differences: no test can reach 5 %")
    if len(np.unique(np.abs(nonzero))) < len(nonzero):
        exact = "exact for these ties" if len(nonzero) <= EXACT_MAX else "approximate"
        notes.append(f"ties in rank: p is {exact}")
    return notes


def signed_rank_p_ratio(nonzero: Numbers) -> float | None:
    """p of Wilcoxon's signed-rank test, two-sided, of non-zero differences.

    It is exact up to `EXACT_MAX` differences, even with ties, and uses the normal approximation
    beyond.
    """
    if not len(nonzero):
        return None
    from scipy.stats import wilcoxon

    tied = len(np.unique(np.abs(nonzero))) < len(nonzero)
    if tied and len(nonzero) <= EXACT_MAX:
        # With ties, scipy would enumerate all sign flips, which takes seconds.
        return _exact_p_ratio(nonzero)
    method = "exact" if len(nonzero) <= EXACT_MAX else "asymptotic"
    return float(wilcoxon(nonzero, zero_method="wilcox", method=method).pvalue)


def _exact_p_ratio(nonzero: Numbers) -> float:
    """Exact p over all sign flips: counts how many flips give each sum of (doubled) ranks."""
    from scipy.stats import rankdata

    doubled = np.rint(2.0 * rankdata(np.abs(nonzero))).astype(np.int64)
    counts = np.zeros(int(doubled.sum()) + 1)
    counts[0] = 1.0
    for rank in doubled.tolist():
        counts[rank:] = counts[rank:] + counts[: len(counts) - rank]
    rose = int(doubled[nonzero > 0.0].sum())
    tail = min(counts[: rose + 1].sum(), counts[rose:].sum())
    return float(min(1.0, 2.0 * tail / counts.sum()))


def rank_biserial_ratio(nonzero: Numbers) -> float | None:
    """Share of the rank sum that rose minus the share that fell (Kerby 2014)."""
    if not len(nonzero):
        return None
    from scipy.stats import rankdata

    ranks = rankdata(np.abs(nonzero))
    return float(np.sum(ranks * np.sign(nonzero)) / np.sum(ranks))


def holm(p_ratios: Sequence[float]) -> list[float]:
    """p after Holm's step-down correction, in the given order (Holm 1979)."""
    order = sorted(range(len(p_ratios)), key=lambda place: p_ratios[place])
    corrected, reached = [0.0] * len(p_ratios), 0.0
    for rank, place in enumerate(order):
        reached = max(reached, min(1.0, (len(p_ratios) - rank) * p_ratios[place]))
        corrected[place] = reached
    return corrected


MARGINS: Final = "margins"
JUDGED: Final = "measures of which less is better"
OTHERS: Final = "other measures"
FAMILIES: Final = (MARGINS, JUDGED, OTHERS)


def family(shift: PairedShift) -> str:
    if shift.kind == "margin":
        return MARGINS
    return OTHERS if taste_of(shift) is Taste.NEITHER else JUDGED


def taste_of(shift: PairedShift) -> Taste:
    if shift.kind == "margin":
        return Taste.MORE
    worse_when_more = ERROR in shift.name or any(part in shift.name for part in MORE_IS_WORSE)
    return Taste.LESS if worse_when_more else Taste.NEITHER


def _judged(shift: PairedShift, p_holm_ratio: float, taste: Taste, tests: int) -> PairedShift:
    effect_ratio = shift.effect_ratio or 0.0
    if p_holm_ratio >= SIGNIFICANT_RATIO or effect_ratio == 0.0:
        direction = MeasureTrend.UNCLEAR
    elif taste is Taste.NEITHER:
        direction = MeasureTrend.DIFFERENT
    else:
        rose = effect_ratio > 0.0
        direction = MeasureTrend.BETTER if rose is (taste is Taste.MORE) else MeasureTrend.WORSE
    least = min(1.0, least_p_ratio(shift.pairs) * tests)
    shift_sd = shift_sd_of(shift.pairs, tests) if least < SIGNIFICANT_RATIO else None
    return replace(
        shift,
        p_holm_ratio=p_holm_ratio,
        direction=direction,
        least_p_ratio=least,
        finds=None if shift_sd is None else InUnit(shift_sd * shift.sd),
    )
