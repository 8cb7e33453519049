"""The verdict matrix: verdicts of each scenario, by the values of its factors."""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from metro_hil.model.case import Verdict, expected_text
from metro_hil.report.campaign.ledger import MISSING, LedgerEntry, factors_text, known_margin
from metro_hil.report.campaign.tally import TallyFactor, by_level, factors_of
from metro_hil.report.campaign.units import with_unit
from metro_hil.report.estimates import ConfidenceInterval, pass_share

SQUARES_MAX: Final = 600
"""Greatest number of cases with a square each; more cases are counted."""
PAIR_FACTORS_MAX: Final = 8
SCENARIOS_MAX: Final = 60
SYMBOLS: Final = {
    Verdict.PASS.value: "✓",
    Verdict.FAIL.value: "✗",
    Verdict.BLOCKED.value: "⊘",
    Verdict.INCONCLUSIVE.value: "?",
    Verdict.VACUOUS.value: "○",
    Verdict.INVALID.value: "!",
    Verdict.LOST.value: "∅",
    MISSING: "□",
}


@dataclass(frozen=True, slots=True)
class Square:
    """One case, or several counted together."""

    style: str
    symbol: str
    title: str
    href: str = ""


@dataclass(frozen=True, slots=True)
class Grid:
    """Squares of one scenario in rows and columns."""

    row_name: str
    column_name: str
    columns: tuple[str, ...]
    rows: tuple[tuple[str, tuple[tuple[Square, ...], ...]], ...]
    """Label of each row, and its squares for each column."""


@dataclass(frozen=True, slots=True)
class LevelRow:
    """All cases at one value of one factor."""

    factor: str
    level: str
    cases: int
    good: int
    share: ConfidenceInterval | None


@dataclass(frozen=True, slots=True)
class ScenarioView:
    """One scenario as the page shows it."""

    name: str
    cases: int
    good: int
    share: ConfidenceInterval | None
    tally: tuple[tuple[str, str, int], ...]
    """Word, symbol and number of each verdict that occurred."""
    requirements: tuple[str, ...]
    grid: Grid
    levels: tuple[LevelRow, ...]

    @property
    def style(self) -> str:
        return "good" if self.good == self.cases else "bad"


def scenario_view(name: str, entries: Sequence[LedgerEntry], *, single: bool) -> ScenarioView:
    """View of one scenario; with `single` each case has a square, else a cell shows a count."""
    good = sum(entry.as_expected for entry in entries)
    factors = factors_of(entries)
    counted = [
        (word, symbol, number)
        for word, symbol in SYMBOLS.items()
        if (number := sum(entry.word == word for entry in entries))
    ]
    return ScenarioView(
        name=name,
        cases=len(entries),
        good=good,
        share=pass_share(good, len(entries)),
        tally=tuple(counted),
        requirements=tuple(dict.fromkeys(r for e in entries for r in e.case.requirements)),
        grid=_grid(entries, factors, single=single),
        levels=tuple(_levels(entries, factors)) if len(factors) > 1 or not single else (),
    )


def _levels(entries: Sequence[LedgerEntry], factors: Sequence[TallyFactor]) -> list[LevelRow]:
    return [
        LevelRow(
            factor.name,
            level,
            len(group),
            sum(entry.as_expected for entry in group),
            pass_share(sum(entry.as_expected for entry in group), len(group)),
        )
        for factor in factors
        for level, group in by_level(factor, entries)
    ]


def _grid(entries: Sequence[LedgerEntry], factors: Sequence[TallyFactor], *, single: bool) -> Grid:
    rows, columns = most_telling(entries, factors)
    table: dict[tuple[str, str], list[LedgerEntry]] = {}
    for entry in entries:
        table.setdefault((_level(rows, entry), _level(columns, entry)), []).append(entry)
    row_labels, column_labels = _labels(rows, table, 0), _labels(columns, table, 1)
    return Grid(
        row_name=rows.name if rows else "",
        column_name=columns.name if columns else "",
        columns=column_labels,
        rows=tuple(
            (row, tuple(_cell(table.get((row, column), []), single) for column in column_labels))
            for row in row_labels
        ),
    )


def most_telling(
    entries: Sequence[LedgerEntry], factors: Sequence[TallyFactor]
) -> tuple[TallyFactor | None, TallyFactor | None]:
    """The pair of factors that best separates good from bad cases, as rows and columns."""
    if not factors:
        return None, None
    if len(factors) == 1:
        return None, factors[0]
    pairs = itertools.combinations(factors[:PAIR_FACTORS_MAX], 2)
    return max(pairs, key=lambda pair: round(_parted(entries, *pair), 9))


def _parted(entries: Sequence[LedgerEntry], rows: TallyFactor, columns: TallyFactor) -> float:
    """Variance between cells of the share of good cases."""
    cells: dict[tuple[str, str], list[bool]] = {}
    for entry in entries:
        key = (_level(rows, entry), _level(columns, entry))
        cells.setdefault(key, []).append(entry.as_expected)
    means = np.array([np.mean(cell) for cell in cells.values()])
    overall = float(np.mean([entry.as_expected for entry in entries]))
    return float(np.average((means - overall) ** 2, weights=[len(c) for c in cells.values()]))


def _level(factor: TallyFactor | None, entry: LedgerEntry) -> str:
    return "" if factor is None else factor.level_of.get(entry.case.id, "–")


def _labels(
    factor: TallyFactor | None, table: dict[tuple[str, str], list[LedgerEntry]], place: int
) -> tuple[str, ...]:
    if factor is None:
        return ("",)
    without = ("–",) if any(key[place] == "–" for key in table) else ()
    return (*factor.levels, *without)


def _cell(entries: Sequence[LedgerEntry], single: bool) -> tuple[Square, ...]:
    if single:
        return tuple(square_of(entry) for entry in entries)
    return (count_square(entries),) if entries else ()


def square_of(entry: LedgerEntry) -> Square:
    """Square of one case; an unexpected one links to its place in the list of failures."""
    style = f"v-{entry.word}" + ("" if entry.as_expected else " wrong")
    lines = [entry.case.id, factors_text(entry.case), f"{entry.word}"]
    if entry.case.expected:
        lines[-1] += f" (expected: {expected_text(entry.case)})"
    least = entry.result.least_margin() if entry.result else None
    if least is not None:
        shown = with_unit(known_margin(least), least.unit)
        lines.append(f"least margin {shown}, {least.name}")
    if entry.reason:
        lines.append(entry.reason)
    href = "" if entry.as_expected else f"#case-{entry.case.index}"
    return Square(style, SYMBOLS[entry.word], "\n".join(lines), href)


def count_square(entries: Sequence[LedgerEntry]) -> Square:
    """Square with the number of good cases; half a disc if only some are good."""
    good, all_of_them = sum(entry.as_expected for entry in entries), len(entries)
    words = [
        f"{number} {word}"
        for word in SYMBOLS
        if (number := sum(entry.word == word for entry in entries))
    ]
    if good == all_of_them:
        style, symbol = "share-all", "✓"
    elif good == 0:
        style, symbol = "share-none", "✗"
    else:
        tenth = min(9, max(1, int(10.0 * good / all_of_them)))
        style, symbol = f"share-some s{tenth}", "◐"
    title = f"{good} of {all_of_them} as expected\n" + ", ".join(words)
    return Square(style, f"{symbol}\u202f{good}/{all_of_them}", title)
