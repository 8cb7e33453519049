"""Stops before and after the additions to control by chasing time, as [Wu 2022] presents them."""

import math
from collections.abc import Sequence
from typing import Final

from metro_hil.model.case import Case, CaseResult
from metro_hil.report.layouts.tables import LayoutCell, LayoutTable, Mark

SCENARIOS: Final = {
    "hefei-before": "before",
    "hefei-early": "early transition",
    "hefei-small": "small brake",
    "hefei-after": "after, with both",
}
WINDOW_M: Final = 0.30
CM_PER_M: Final = 100.0

Pairs = Sequence[tuple[Case, CaseResult | None]]


def hefei_tables(pairs: Pairs) -> list[LayoutTable]:
    """Tables of those scenarios `hefei-before` to `hefei-after` that the campaign has."""
    of = {
        name: [pair for pair in pairs if pair[0].scenario == scenario]
        for scenario, name in SCENARIOS.items()
    }
    known = {name: cases for name, cases in of.items() if cases}
    if not known:
        return []
    return [_errors(known), _ride(known)]


def platforms(pairs: Pairs) -> list[str]:
    """The platforms at which the cases end, in the order of their names."""
    return sorted({case.setup.end for case, _ in pairs if case.setup.end is not None})


def errors_m(pairs: Pairs, platform: str) -> list[float]:
    """Errors of all stops at one platform, m."""
    found = [
        result.measures.get(f"stop_{platform}_error_m")
        for case, result in pairs
        if result is not None and case.setup.end == platform
    ]
    return [error_m for error_m in found if error_m is not None]


def _errors(of: dict[str, list[tuple[Case, CaseResult | None]]]) -> LayoutTable:
    every = [pair for pairs in of.values() for pair in pairs]
    names = platforms(every)
    head = (LayoutCell(""), *(LayoutCell(name) for name in names), LayoutCell("all"))
    first = next(iter(of.values()))
    rows = []
    for name, pairs in of.items():
        cells = []
        for places in (*((one,) for one in names), tuple(names)):
            ours = [error for place in places for error in errors_m(pairs, place)]
            theirs = [error for place in places for error in errors_m(first, place)]
            cells.append(LayoutCell(_mean_and_worst(ours), _mark(ours, theirs)))
        rows.append((LayoutCell(name), *cells))
    remarks = tuple(_share(name, pairs) for name, pairs in of.items())
    title = "Stop error per platform: mean and worst of |error|, cm (the paper's figures 7 and 8)"
    return LayoutTable(title, (head,), tuple(rows), remarks)


def _ride(of: dict[str, list[tuple[Case, CaseResult | None]]]) -> LayoutTable:
    columns = (
        ("notch changes, mean", "notch_changes_mean_count", _mean),
        ("at most", "notch_changes_max_count", max),
        ("back and forth in blending", "notch_reversals_count", sum),
        ("jerk at most, m/s³", "jerk_max_mps3", max),
        ("jerk, mean of runs", "jerk_max_mps3", _mean),
    )
    head = (LayoutCell(""), *(LayoutCell(words) for words, _, _ in columns))
    rows = []
    for name, pairs in of.items():
        cells = []
        for _, measure, join in columns:
            values = [result.measures.get(measure) for _, result in pairs if result is not None]
            known = [value for value in values if value is not None]
            cells.append(LayoutCell(f"{join(known):.3g}" if known else "–"))
        rows.append((LayoutCell(name), *cells))
    title = "Notch changes for a stop, and jerk low-passed at 2 Hz"
    return LayoutTable(title, (head,), tuple(rows), ())


def _mean(values: Sequence[float]) -> float:
    return math.fsum(values) / len(values)


def _mean_and_worst(found_m: Sequence[float]) -> str:
    if not found_m:
        return "–"
    sizes_cm = [abs(error_m) * CM_PER_M for error_m in found_m]
    return f"{_mean(sizes_cm):.1f} / {max(sizes_cm):.1f}"


def _mark(ours: Sequence[float], theirs: Sequence[float]) -> Mark:
    """Comparison with the first row."""
    if not ours or not theirs:
        return Mark.INCOMPLETE
    ours_m, theirs_m = _mean([abs(one) for one in ours]), _mean([abs(one) for one in theirs])
    if ours_m == theirs_m:
        return Mark.NONE
    return Mark.BETTER if ours_m < theirs_m else Mark.WORSE


def _share(name: str, pairs: Pairs) -> str:
    found = [error_m for place in platforms(pairs) for error_m in errors_m(pairs, place)]
    within = sum(abs(error_m) <= WINDOW_M for error_m in found)
    return f"{name}: {within} of {len(pairs)} stops within {WINDOW_M * CM_PER_M:.0f} cm."
