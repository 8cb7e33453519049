"""Tables of their own that a campaign with `layout = "..."` shows beside the common report.

A layout is one module with one function, named in `LAYOUTS`.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Final

from metro_hil.cases import Case, CaseResult
from metro_hil.report.layouts.florence import florence_tables
from metro_hil.report.layouts.tables import LayoutTable, print_layout

if TYPE_CHECKING:
    from rich.console import Console

Pairs = Sequence[tuple[Case, CaseResult | None]]
LAYOUTS: Final[Mapping[str, Callable[[Pairs], list[LayoutTable]]]] = {"florence": florence_tables}
"""By the name in the campaign's file: from cases, None where no result came back, to tables."""


def show_layout(console: "Console", name: str, pairs: Pairs) -> None:
    """Print the tables of this layout; a name that is none says so."""
    tables_of = LAYOUTS.get(name)
    if tables_of is None:
        words = f"no layout {name}; known are {', '.join(sorted(LAYOUTS))}"
        console.print(words, markup=False, soft_wrap=True)
        return
    print_layout(console, tables_of(pairs))
