"""`hil laws`: how each control law came out in the campaigns that were taken over."""

import argparse
import sys
from pathlib import Path

from metro_hil.model.run_options import EXIT_OK


def add(verbs: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    parser = verbs.add_parser(
        "laws",
        help="show how each control law came out",
        description="Print the figures of each control law, scenario by scenario, that the pages "
        "below docs/reference/laws show. With --run those of campaigns are taken over.",
    )
    parser.add_argument(
        "--run", metavar="FOLDER", dest="runs", action="append", default=[],
        help="of a campaign that was run; several are taken over one after another",
    )  # fmt: skip
    parser.add_argument(
        "--write", action="store_true", help="keep the figures, for the pages (`make docs`)"
    )
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Raises UsageError for a folder that is no campaign's."""
    from metro_hil.campaign.scenarios import shipped_scenarios
    from metro_hil.engine.folder import find_folder
    from metro_hil.engine.journal import once_each, read_journal, refuse_damage
    from metro_hil.report.law_figures import (
        RESULTS,
        merged_results,
        read_results,
        results_json,
        results_of,
        titled,
    )

    kept = Path(__file__).resolve().parents[2] / RESULTS
    found = read_results(kept.read_text(encoding="utf-8")) if kept.is_file() else {}
    for name in options.runs:
        folder = find_folder(name)
        journal = read_journal(folder.journal_path)
        refuse_damage(folder.journal_path, journal, "`hil resume --repair` runs their cases again")
        by_id = once_each(journal.results)
        pairs = [(case, by_id.get(case.id)) for case in folder.cases()]
        found = merged_results(found, results_of(folder.manifest().name, pairs))
    found = titled(found, {each.name: each.title for each in shipped_scenarios()})
    text = results_json(found)
    if options.write:
        kept.write_text(text, encoding="utf-8")
        print(f"figures: {kept}", file=sys.stderr)
    else:
        print(text, end="")
    return EXIT_OK
