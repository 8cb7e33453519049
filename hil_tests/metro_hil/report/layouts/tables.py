"""A layout's tables, and how they are printed on a terminal."""

import enum
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rich.console import Console


class Mark(enum.Enum):
    """How a figure compares with the one beside it."""

    NONE = ""
    BETTER = "better"
    WORSE = "worse"
    INCOMPLETE = "incomplete"
    """Some of its values are missing, so it cannot be compared."""


@dataclass(frozen=True, slots=True)
class LayoutCell:
    """One cell, `span` columns wide."""

    text: str
    mark: Mark = Mark.NONE
    span: int = 1


@dataclass(frozen=True, slots=True)
class LayoutTable:
    """Head rows, body rows (the first cell of each is its name), and remarks below."""

    title: str
    head: tuple[tuple[LayoutCell, ...], ...]
    rows: tuple[tuple[LayoutCell, ...], ...]
    remarks: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class LayoutFigure:
    """A picture beside the tables."""

    caption: str
    path: Path


STYLES = {Mark.BETTER: "green", Mark.WORSE: "red", Mark.INCOMPLETE: "yellow", Mark.NONE: ""}
SIGNS = {Mark.BETTER: "▼", Mark.WORSE: "▲", Mark.INCOMPLETE: "?", Mark.NONE: " "}
"""Signs of the marks, readable without colours; smaller errors are better."""


def print_layout(console: "Console", tables: list[LayoutTable]) -> None:
    """Print the tables; all figures are readable without colours."""
    from rich.table import Table
    from rich.text import Text

    for table in tables:
        shown = Table(title=Text(table.title, style="bold"), title_justify="left", pad_edge=False)
        for number, names in enumerate(zip(*map(_spread, table.head), strict=True)):
            head = "\n".join(names)
            shown.add_column(Text(head), justify="right" if number else "left", no_wrap=True)
        for row in table.rows:
            cells = [
                Text(f"{cell.text}{SIGNS[cell.mark]}" if at else cell.text, STYLES[cell.mark])
                for at, cell in enumerate(row)
                for cell in (cell, *[LayoutCell("")] * (cell.span - 1))
            ]
            shown.add_row(*cells)
        console.print(shown)
        for remark in table.remarks:
            console.print(Text(f"  {remark}"))
        console.print()


def _spread(row: tuple[LayoutCell, ...]) -> list[str]:
    """One text for each column; a wide cell's text is in its first column."""
    return [text for cell in row for text in (cell.text, *[""] * (cell.span - 1))]
