"""`hil show`: shows the outcome of a campaign, or the event log of one of its cases."""

import argparse
from collections import Counter
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Final

from metro_hil.cli.hil.working import print_layout
from metro_hil.model.run_options import EXIT_FAILED, EXIT_OK
from metro_hil.model.terminal import console_for

if TYPE_CHECKING:
    from rich.console import Console

    from metro_hil.engine.folder import CampaignFolder
    from metro_hil.engine.totals import Totals
    from metro_hil.model.case import Case, CaseResult
    from metro_hil.report.campaign.ledger import Ledger

WORST_SHOWN: Final = 10
UNEXPECTED_SHOWN: Final = 20
MISSING: Final = "missing"


def add(verbs: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    parser = verbs.add_parser(
        "show",
        help="show the outcome of a campaign, or the event log of a case",
        description="Show the outcome of a campaign, or the event log of one of its cases.",
    )
    parser.add_argument(
        "name",
        nargs="?",
        metavar="NAME",
        help="campaign, its folder, the beginning of that name, or a path; default: the last one",
    )
    parser.add_argument("case", nargs="?", metavar="CASE", help="id, its beginning, or number")
    parser.add_argument("--json", action="store_true", help="one JSON object on standard output")
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Exit code of the campaign."""
    import msgspec

    from metro_hil.engine.folder import find_folder
    from metro_hil.engine.journal import once_each, read_journal, refuse_damage
    from metro_hil.engine.run_campaign import totals_of

    folder = find_folder(options.name)
    cases, found = folder.cases(), read_journal(folder.journal_path)
    refuse_damage(folder.journal_path, found)
    by_id = once_each(found.results)
    if options.case is not None:
        return _show_case(folder, cases, by_id, options)
    totals = totals_of(folder, cases, found.results, found.sessions)
    if options.json:
        document = {
            "folder": str(folder.path),
            "subset": folder.manifest().subset or None,
            **msgspec.to_builtins(totals),
            "results": list(by_id.values()),
        }
        print(msgspec.json.encode(document).decode())
    else:
        _show_campaign(console_for(), folder, cases, by_id, totals)
    return EXIT_OK if totals.passed else EXIT_FAILED


def _show_case(
    folder: "CampaignFolder",
    cases: "Sequence[Case]",
    by_id: "dict[str, CaseResult]",
    options: argparse.Namespace,
) -> int:
    import msgspec

    from metro_hil.engine.choosing import pick_case
    from metro_hil.engine.event_log import tell
    from metro_hil.model.case import as_expected

    case = pick_case(cases, options.case)
    result = by_id.get(case.id)
    kept = folder.kept(case.id)
    logs = sorted(kept.path.iterdir()) if kept.path.is_dir() else []
    if options.json:
        document = {"case": case, "result": result, "logs": [str(path) for path in logs]}
        print(msgspec.json.encode(document).decode())
    else:
        tell(console_for(), case, result, logs)
        if not logs:
            print(f"no logs were kept; hil rerun {folder.path} {case.id}")
    return EXIT_OK if result is not None and as_expected(case, result) else EXIT_FAILED


def _show_campaign(
    console: "Console",
    folder: "CampaignFolder",
    cases: "Sequence[Case]",
    by_id: "dict[str, CaseResult]",
    totals: "Totals",
) -> None:
    from metro_hil.report.campaign.ledger import join

    manifest = folder.manifest()
    console.print(f"{manifest.name}  {manifest.title}", style="bold", markup=False, highlight=False)
    console.print(f"{folder.path}, begun {manifest.started}", markup=False, highlight=False)
    console.print(_verdicts(cases, by_id))
    unexpected = _unexpected(cases, by_id, set(totals.unexpected))
    ledger = join(cases, list(by_id.values()), expected_cases=totals.cases)
    for table in (unexpected, _worst(ledger), _requirements(ledger, subset=bool(manifest.subset))):
        if table is not None:
            console.print(table)
    print_layout(console, manifest.layout, cases, list(by_id.values()))
    for problem in totals.problems:
        console.print(problem, style="bold red", markup=False, highlight=False)
    if totals.missing:
        words = f"without a result: {len(totals.missing)} of {totals.cases}"
        words += f"; hil resume {folder.path}"
        console.print(words, style="magenta", markup=False, highlight=False, soft_wrap=True)
    state = "passed" if totals.passed else "FAILED"
    state += f" (subset: {manifest.subset})" if manifest.subset else ""
    console.print(state, style="green" if totals.passed else "bold red")


def _verdicts(cases: "Sequence[Case]", by_id: "dict[str, CaseResult]") -> Any:
    from rich.table import Table

    from metro_hil.model.case import Verdict

    table = Table(title="verdicts by scenario", title_justify="left")
    table.add_column("scenario", overflow="fold")
    for verdict in Verdict:
        table.add_column(verdict.value, justify="right")
    table.add_column(MISSING, justify="right")
    counts: dict[str, Counter[str]] = {}
    for case in cases:
        result = by_id.get(case.id)
        name = result.verdict.value if result else MISSING
        counts.setdefault(case.scenario, Counter())[name] += 1
    columns = (*(verdict.value for verdict in Verdict), MISSING)
    for scenario, found in counts.items():
        table.add_row(scenario, *(str(found[name]) if found[name] else "·" for name in columns))
    return table


def _worst(ledger: "Ledger") -> Any:
    """Table of the least margins, in the report's order."""
    from rich.markup import escape
    from rich.table import Table

    from metro_hil.engine.progress import margin_words
    from metro_hil.report.campaign.tally import tally_monitors, worst_entries

    ranked = worst_entries(ledger, tally_monitors(ledger), count=len(ledger.entries))
    table = Table(title="least margins, each over its usual size", title_justify="left")
    for column in ("case", "monitor", "margin", "at", "verdict"):
        table.add_column(column, overflow="fold")
    found = [(entry, least) for entry, least in ranked if least is not None]
    for entry, least in found[:WORST_SHOWN]:
        at = "" if least.at_s is None else f"{least.at_s:.2f} s"
        words = (escape(least.name), escape(margin_words(least.margin, least.unit)), at)
        table.add_row(escape(entry.case.id), *words, entry.word)
    return table


def _unexpected(cases: "Sequence[Case]", by_id: "dict[str, CaseResult]", names: set[str]) -> Any:
    """Table of the unexpected cases with their reasons; None if there are none."""
    from rich.markup import escape
    from rich.table import Table

    from metro_hil.model.case import expected_text, mismatch

    if not names:
        return None
    table = Table(title="not as expected", title_justify="left")
    for column in ("case", "verdict", "expected", "reason"):
        table.add_column(column, overflow="fold")
    found = [case for case in cases if case.id in names]
    for case in found[:UNEXPECTED_SHOWN]:
        result = by_id[case.id]
        reason = mismatch(case, result)
        words = (result.verdict.value, escape(expected_text(case)), escape(reason))
        table.add_row(escape(case.id), *words)
    if (more := len(found) - UNEXPECTED_SHOWN) > 0:
        table.add_row(f"and {more} more", "", "", "report.html has them all")
    return table


def _requirements(ledger: "Ledger", *, subset: bool) -> Any:
    """Table of requirements as in the report; None if no case names one."""
    from rich.markup import escape
    from rich.table import Table

    from metro_hil.model.requirements import shipped_requirements
    from metro_hil.report.campaign.trace import RequirementEvidence, trace_requirements

    traces = trace_requirements(shipped_requirements(), ledger, subset=subset)
    traces = [one for one in traces if one.cases]
    if not traces:
        return None
    table = Table(title="requirements", title_justify="left")
    table.add_column("requirement")
    table.add_column("standing")
    for column in ("cases", "passed", "failed", "known", "no evidence"):
        table.add_column(column, justify="right")
    shown = (
        RequirementEvidence.GOOD,
        RequirementEvidence.BAD,
        RequirementEvidence.KNOWN,
        RequirementEvidence.NOTHING,
    )
    for trace in traces:
        counts = (trace.cases, *(trace.counts[evidence] for evidence in shown))
        name, standing = escape(trace.requirement.id), trace.standing.value
        table.add_row(name, standing, *(str(count) if count else "·" for count in counts))
    return table
