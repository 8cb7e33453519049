"""`hil report`: writes the reports of a campaign again and shows where they are."""

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from metro_hil.model.run_options import EXIT_FAILED, EXIT_OK
from metro_hil.model.terminal import console_for

if TYPE_CHECKING:
    from metro_hil.report.campaign.ledger import Ledger


def add(verbs: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    parser = verbs.add_parser(
        "report",
        help="write the reports of a campaign again",
        description="Write report.html, junit.xml, measures.parquet, requirements.md and "
        "summary.json of a campaign again, from its cases and its journal.",
    )
    parser.add_argument(
        "name",
        nargs="?",
        metavar="NAME",
        help="campaign, its folder, the beginning of that name, or a path; default: the last one",
    )
    parser.add_argument("--open", action="store_true", help="open the page in the browser")
    parser.add_argument("--json", action="store_true", help="one JSON object on standard output")
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """The campaign's exit code: 0 only if every case is as expected."""
    import msgspec

    from metro_hil.cli.hil.working import info_of
    from metro_hil.engine.folder import find_folder
    from metro_hil.engine.journal import read_journal, refuse_damage
    from metro_hil.report.campaign import write_reports
    from metro_hil.report.campaign.ledger import join

    folder = find_folder(options.name)
    cases, journal = folder.cases(), read_journal(folder.journal_path)
    refuse_damage(folder.journal_path, journal)
    info = info_of(folder.manifest(), cases)
    paths = write_reports(folder.path, info, cases, journal.results)
    ledger = join(cases, journal.results, expected_cases=info.expected_cases)
    if options.json:
        document = {
            "folder": str(folder.path),
            "reports": [str(path) for path in paths],
            "passed": ledger.good,
            "subset": info.subset or None,
            "cases": ledger.expected_cases,
            "as_expected": ledger.as_expected,
            "done": ledger.expected_cases - ledger.missing,
        }
        print(msgspec.json.encode(document).decode())
    else:
        _say(paths, ledger, info.subset)
        _show_layout(info.layout, ledger)
    if options.open:
        _open(paths[0])
    return EXIT_OK if ledger.good else EXIT_FAILED


def _say(paths: list[Path], ledger: "Ledger", subset: str) -> None:
    for path in paths:
        print(path)
    words = f"{ledger.as_expected} of {ledger.expected_cases} cases as expected"
    words += f", {ledger.missing} without a result" if ledger.missing else ""
    print(f"{words} (subset: {subset})" if subset else words)


def _show_layout(name: str | None, ledger: "Ledger") -> None:
    if name is None:
        return

    from metro_hil.report.layouts import show_layout

    show_layout(console_for(), name, [(entry.case, entry.result) for entry in ledger.entries])


def _open(page: Path) -> None:
    import webbrowser

    if not webbrowser.open(page.resolve().as_uri()):
        print(f"hil report: no browser to open {page} with", file=sys.stderr)
