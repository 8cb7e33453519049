"""Layouts: further tables and figures for a campaign with `layout = "..."`.

A layout is one or two modules and an entry in `LAYOUTS`.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Final

from metro_hil.model.case import Case, CaseResult
from metro_hil.report.layouts.florence import florence_tables
from metro_hil.report.layouts.hefei import hefei_tables
from metro_hil.report.layouts.lines import lines_tables
from metro_hil.report.layouts.tables import LayoutFigure, LayoutTable, print_layout

if TYPE_CHECKING:
    from rich.console import Console

Pairs = Sequence[tuple[Case, CaseResult | None]]


def _draws_nothing(folder: Path, cases: Sequence[Case]) -> list[LayoutFigure]:
    return []


def _wants_nothing(cases: Sequence[Case]) -> list[str]:
    return []


def _florence_figures(folder: Path, cases: Sequence[Case]) -> list[LayoutFigure]:
    # Plots import heavy libraries, which a mere table does not need.
    from metro_hil.report.layouts.florence_figures import florence_figures

    return florence_figures(folder, cases)


def _florence_logs(cases: Sequence[Case]) -> list[str]:
    from metro_hil.report.layouts.florence_figures import wanted_cases

    return wanted_cases(cases)


def _hefei_figures(folder: Path, cases: Sequence[Case]) -> list[LayoutFigure]:
    from metro_hil.report.layouts.hefei_plot import draw_hefei

    return draw_hefei(folder, cases)


def _hefei_logs(cases: Sequence[Case]) -> list[str]:
    from metro_hil.report.layouts.hefei_plot import wanted_cases

    return wanted_cases(cases)


def _lines_maps(folder: Path, cases: Sequence[Case]) -> list[LayoutFigure]:
    from metro_hil.report.layouts.lines_maps import draw_maps

    return draw_maps(folder, cases)


@dataclass(frozen=True, slots=True)
class Layout:
    """Functions that make a campaign's tables and figures."""

    tables: Callable[[Pairs], list[LayoutTable]]
    """Makes tables from cases and results; a result may be None."""
    draw: Callable[[Path, Sequence[Case]], list[LayoutFigure]] = _draws_nothing
    """Writes pictures of cases with kept logs below the campaign's folder."""
    wants: Callable[[Sequence[Case]], list[str]] = _wants_nothing
    """Ids of the cases whose logs the pictures need."""


LAYOUTS: Final[Mapping[str, Layout]] = {
    "florence": Layout(florence_tables, _florence_figures, _florence_logs),
    "hefei": Layout(hefei_tables, _hefei_figures, _hefei_logs),
    "lines": Layout(lines_tables, _lines_maps),
}
"""Layouts by the name in a campaign's file."""


def show_layout(console: "Console", name: str, pairs: Pairs) -> None:
    """Print the tables of this layout, or that it does not exist."""
    layout = LAYOUTS.get(name)
    if layout is None:
        words = f"no layout {name}; known are {', '.join(sorted(LAYOUTS))}"
        console.print(words, markup=False, soft_wrap=True)
        return
    print_layout(console, layout.tables(pairs))
