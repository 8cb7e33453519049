"""Writes published figures into README.md and docs, or checks that they equal the stored ones.

A figure of a run in virtual time stands between two comments, and this tool writes the text
between:

    <!-- figure table-7-predictive mean_cm -->0.18<!-- / -->

It comes from the results of control laws, which `hil laws --check` compares with the code. Figures
that depend on a machine cannot be checked in this way. A mark above their table gives date, machine
and commit of the measurement, and `make docs` prints its age:

    <!-- measured: 2026-11-23, shared virtual machine with two cores, daf1434 -->
"""

import argparse
import json
import re
import subprocess
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from metro_tools.doc_blocks.blocks import read_blocks
from metro_tools.doc_blocks.order import documents
from metro_tools.law_doc import RESULTS

EXIT_OK: Final = 0
EXIT_OUTDATED: Final = 1
EXIT_USAGE: Final = 2
CM_PER_M: Final = 100.0
MEASURED_HEAD: Final = "measured"
SPAN: Final = re.compile(r"<!-- figure (\S+) (\S+) -->(.*?)<!-- / -->")
LIKE_SPAN: Final = re.compile(r"<!--\s*figure\b")
DAY: Final = r"\d{4}-(?:0[1-9]|1[0-2])-(?:0[1-9]|[12]\d|3[01])"
MEASURED: Final = re.compile(rf"^<!-- measured: ({DAY}), (.+), ([0-9a-f]{{7,40}}) -->$")
LIKE_MEASURED: Final = re.compile(r"^<!--\s*measured\b")

Figures = Mapping[str, Any]
"""Stored figures of one scenario."""


class FigureError(Exception):
    """A document names a figure that is not stored; the text has no file and line yet."""


def _centimetres(value_m: float) -> str:
    """Format centimetres with two decimals below 1 cm and one decimal above."""
    value_cm = abs(value_m) * CM_PER_M
    return f"{value_cm:.1f}" if value_cm >= 1.0 else f"{value_cm:.2f}"


FORMS: Final[Mapping[str, Callable[[Figures], str]]] = {
    "cases": lambda kept: str(kept["cases"]),
    "stops": lambda kept: str(kept["stops"]),
    "made": lambda kept: str(kept["stops"] - kept["missed"]),
    "mean_cm": lambda kept: f"{kept['mean_m'] * CM_PER_M:.2f}",
    "worst_cm": lambda kept: _centimetres(kept["worst_m"]),
    "load_means_cm": lambda kept: ", ".join(
        f"{value * CM_PER_M:.2f}" for value in kept.get("load_means_m", {}).values()
    ),
    "run_s": lambda kept: f"{kept['run_s']:.1f}",
}
"""Names of figures for documents, in addition to those of comfort (`jerk_max_mps3`, …)."""


def figure(results: Mapping[str, Figures], scenario: str, name: str) -> str:
    """Return a figure as it is printed. Raises FigureError."""
    kept = results.get(scenario)
    if kept is None:
        raise FigureError(f"no scenario {scenario} in {RESULTS}; `hil scenarios` lists all")
    if name in FORMS and (text := FORMS[name](kept)):
        return text
    value = kept["comfort"].get(name)
    if value is None:
        known = ", ".join([*FORMS, *sorted(kept["comfort"])])
        raise FigureError(f"{scenario} has no figure {name}; it has {known}")
    return f"{value:.0f}" if name.endswith("_count") else f"{value:.2f}"


def filled(text: str, results: Mapping[str, Figures], name: str) -> str:
    """Return a document with the stored figures filled in.

    Raises FigureError with file and line.
    """
    lines = []
    fenced = _fenced(text)
    for number, line in enumerate(text.split("\n"), start=1):
        if number in fenced:
            lines.append(line)
            continue
        if len(LIKE_SPAN.findall(line)) != len(SPAN.findall(line)):
            raise FigureError(
                f"{name}:{number}: write <!-- figure SCENARIO NAME -->…<!-- / --> on one line"
            )
        try:
            lines.append(SPAN.sub(lambda found: _span(found, results), line))
        except FigureError as error:
            raise FigureError(f"{name}:{number}: {error}") from error
    return "\n".join(lines)


def _span(found: "re.Match[str]", results: Mapping[str, Figures]) -> str:
    scenario, name, _ = found.groups()
    return f"<!-- figure {scenario} {name} -->{figure(results, scenario, name)}<!-- / -->"


@dataclass(frozen=True, slots=True)
class Measured:
    """Date, machine and commit of the measurement of a table."""

    line: int
    on: str
    machine: str
    commit: str


def measured_tables(text: str) -> tuple[list[Measured], list[tuple[int, str]]]:
    """Return the marks of a document, and table rows with figures of unknown origin."""
    lines = text.splitlines()
    marks: list[Measured] = []
    wrong: list[tuple[int, str]] = []
    fenced = _fenced(text)
    for number, line in enumerate(lines, start=1):
        if number in fenced or not LIKE_MEASURED.match(line):
            continue
        found = MEASURED.match(line)
        if found is None:
            wrong.append((number, "write <!-- measured: YYYY-MM-DD, machine, commit -->"))
        else:
            marks.append(Measured(number, *found.groups()))
    marked = {mark.line for mark in marks}
    for number, rows in _tables(lines):
        above = number - 1
        while above > 0 and not lines[above - 1].strip():
            above -= 1
        wrong += [] if above in marked else _unaccounted(number, rows)
    return marks, wrong


def _fenced(text: str) -> frozenset[int]:
    """Return the numbers of lines inside of code blocks, where marks have no meaning."""
    blocks, _ = read_blocks(text)
    return frozenset(line for each in blocks for line in range(each.line, each.end + 1))


def _tables(lines: Sequence[str]) -> Iterator[tuple[int, list[str]]]:
    """Yield each table with a column of measured figures, with the number of its first line."""
    for index, line in enumerate(lines):
        if line.startswith("|") and (index == 0 or not lines[index - 1].startswith("|")):
            rows = []
            for row in lines[index:]:
                if not row.startswith("|"):
                    break
                rows.append(row)
            if MEASURED_HEAD in _cells(line):
                yield index + 1, rows


def _unaccounted(number: int, rows: Sequence[str]) -> list[tuple[int, str]]:
    """Return the first row whose figure is neither taken from the results nor dated."""
    column = _cells(rows[0]).index(MEASURED_HEAD)
    bare = [below for below, row in enumerate(rows) if not SPAN.search(_cells(row)[column])]
    return [
        (
            number + below,
            "a measured figure of unknown age; write <!-- measured: YYYY-MM-DD, machine, "
            "commit --> above the table, or <!-- figure SCENARIO NAME -->…<!-- / --> in the row",
        )
        for below in bare[2:3]
    ]


def _cells(row: str) -> list[str]:
    return [cell.strip() for cell in row.strip().strip("|").split("|")]


def read_results(root: Path) -> dict[str, Figures]:
    """Read the results by scenario. Raises FigureError."""
    try:
        laws = json.loads((root / RESULTS).read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise FigureError(f"{RESULTS}: {error}") from error
    return {name: each["figures"] for own in laws.values() for name, each in own.items()}


def main(argv: Sequence[str] | None = None) -> int:
    """Write the figures, or with --check only report documents with outdated ones."""
    parser = argparse.ArgumentParser(prog="python -m metro_tools.figure_doc", description=__doc__)
    parser.add_argument("root", nargs="?", default=".", help="the project's folder; default: here")
    parser.add_argument("--check", action="store_true", help="write nothing; exit 1 if outdated")
    options = parser.parse_args(argv)
    root = Path(options.root)
    code = EXIT_OK
    try:
        results = read_results(root)
        for name in documents(root):
            path = root / name
            text = path.read_text(encoding="utf-8")
            made = filled(text, results, name)
            _, wrong = measured_tables(text)
            for line, words in wrong:
                print(f"{name}:{line}: {words}", file=sys.stderr)
                code = EXIT_OUTDATED
            if made != text and options.check:
                print(f"{name}: figures are outdated; run `make docs`", file=sys.stderr)
                code = EXIT_OUTDATED
            elif made != text:
                path.write_text(made, encoding="utf-8")
            if not options.check:
                _print_ages(root, name, text)
    except FigureError as error:
        print(f"figure_doc: {error}", file=sys.stderr)
        return EXIT_USAGE
    return code


def _print_ages(root: Path, name: str, text: str) -> None:
    for mark in measured_tables(text)[0]:
        since = _commits_since(root, mark.commit)
        print(
            f"{name}:{mark.line}: measured on {mark.on} at {mark.commit}, {since} ({mark.machine})"
        )


def _commits_since(root: Path, commit: str) -> str:
    done = subprocess.run(  # noqa: S603
        ["git", "rev-list", "--count", f"{commit}..HEAD"],  # noqa: S607
        cwd=root,
        capture_output=True,
        text=True,
        check=False,
    )
    count = done.stdout.strip()
    return f"{count} commits ago" if done.returncode == 0 else "a commit that is not known here"


if __name__ == "__main__":
    sys.exit(main())
