"""`hil list`: lists the campaigns that were run here."""

import argparse
from typing import Any

from metro_hil.model.run_options import EXIT_OK
from metro_hil.model.terminal import console_for


def add(verbs: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    parser = verbs.add_parser(
        "list",
        help="list the campaigns that were run here",
        description="List the campaigns below runs/hil, the last one at the end.",
    )
    parser.add_argument("--json", action="store_true", help="one JSON object on standard output")
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Always exit code 0: the list itself has not failed if a campaign has."""
    import msgspec

    from metro_hil.engine.folder import folders

    rows = [row_of(folder) for folder in folders()]
    if options.json:
        print(msgspec.json.encode({"campaigns": rows}).decode())
    else:
        _print(rows)
    return EXIT_OK


def row_of(folder: Any) -> dict[str, Any]:
    """One row about a campaign; an unreadable one gets its problem as text."""
    from metro_hil.engine.errors import EngineError
    from metro_hil.engine.journal import read_journal
    from metro_hil.engine.run_campaign import totals_of

    row: dict[str, Any] = {"folder": str(folder.path), "name": folder.path.name, "state": "?"}
    try:
        manifest, found = folder.manifest(), read_journal(folder.journal_path)
        totals = totals_of(folder, folder.cases(), found.results, found.sessions)
    except EngineError as error:
        return {**row, "state": "unreadable", "problem": str(error)}
    if found.damaged:
        state = "damaged"
    elif totals.missing:
        state = "unfinished"
    else:
        state = "passed" if totals.passed else "failed"
    return {
        **row,
        "title": manifest.title,
        "started": manifest.started,
        "state": state,
        "cases": totals.cases,
        "done": totals.done,
        "subset": manifest.subset or None,
        "counts": {name: count for name, count in totals.counts.items() if count},
    }


def _print(rows: list[dict[str, Any]]) -> None:
    from rich.markup import escape
    from rich.table import Table

    from metro_hil.engine.totals import counts_words

    console = console_for()
    if not rows:
        console.print("no campaign yet; `hil run` makes one", highlight=False)
        return
    styles = {"passed": "green", "failed": "bold red", "unfinished": "yellow"}
    table = Table()
    for column in ("campaign", "state", "cases", "verdicts"):
        table.add_column(column, overflow="fold")
    for row in rows:
        left = row.get("cases", 0) - row.get("done", 0)
        counts = counts_words(row.get("counts", {}), left)
        state, style = row["state"], styles.get(row["state"], "magenta")
        table.add_row(
            escape(row["name"]),
            f"[{style}]{state}[/]" + (f" (subset: {row['subset']})" if row.get("subset") else ""),
            f"{row.get('done', '?')} of {row.get('cases', '?')}",
            escape(row.get("problem") or counts),
        )
    console.print(table)
