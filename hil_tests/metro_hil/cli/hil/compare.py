"""`hil compare`: what got worse from one campaign to another, and whether by chance."""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from metro_hil.engine.errors import UsageError
from metro_hil.model.run_options import EXIT_FAILED, EXIT_OK

if TYPE_CHECKING:
    from rich.console import Console

    from metro_hil.report.comparison import Campaign, CampaignComparison, PairedShift, VerdictChange

CHANGES_SHOWN: Final = 20


def add(verbs: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    parser = verbs.add_parser(
        "compare",
        help="compare two campaigns: what got worse, by how much",
        description="Compare two campaigns case by case: verdicts that changed, and for each "
        "margin and measure the paired difference with a signed-rank test, corrected for their "
        "number. Exit code 1 when a verdict got worse.",
    )
    parser.add_argument(
        "before", metavar="A", help="of a campaign, of its folder or its beginning, or a path"
    )
    parser.add_argument("after", metavar="B", help="the one that is compared with it")
    parser.add_argument("--json", action="store_true", help="one JSON object on standard output")
    parser.add_argument(
        "--fail-on-worse",
        action="store_true",
        help="exit code 1 also when a margin or measure got significantly worse",
    )
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """1 when a verdict got worse or, if wanted, a margin or measure did."""
    from metro_hil.engine.folder import find_folder

    before, after = find_folder(options.before).path, find_folder(options.after).path
    comparison = compare_campaigns(before, after)
    if not comparison.matched:
        raise UsageError(f"{before} and {after}: no case is in both, so nothing can be compared")
    if options.json:
        print(comparison_json(comparison, before, after))
    else:
        from rich.console import Console

        print_comparison(Console(), comparison, before, after)
    failed = comparison.worse or (options.fail_on_worse and comparison.significantly_worse)
    return EXIT_FAILED if failed else EXIT_OK


def compare_campaigns(a: Path, b: Path) -> "CampaignComparison":
    """Of two campaign folders. Raises EngineError when one cannot be read."""
    from metro_hil.report.comparison import compare

    return compare(_read(a), _read(b))


def _read(path: Path) -> "Campaign":
    from metro_hil.engine.folder import CampaignFolder
    from metro_hil.engine.journal import read_journal, refuse_damage

    folder = CampaignFolder(path)
    content = read_journal(folder.journal_path)
    refuse_damage(folder.journal_path, content, "`hil resume --repair` runs their cases again")
    return folder.cases(), content.results


def comparison_json(comparison: "CampaignComparison", a: Path, b: Path) -> str:
    import dataclasses

    import msgspec

    document = {
        "a": str(a),
        "b": str(b),
        **{f.name: getattr(comparison, f.name) for f in dataclasses.fields(comparison)},
        "significantly_worse": [shift.name for shift in comparison.significantly_worse],
    }
    return msgspec.json.encode(document).decode()


def print_comparison(
    console: "Console", comparison: "CampaignComparison", a: Path, b: Path
) -> None:
    """The verdicts first, then what moved, then what cannot be compared."""
    from rich.text import Text

    said = [f"A {a}", f"B {b}", _matched(comparison)]
    if comparison.redefined:
        said.append(
            f"{comparison.redefined} of these are defined differently in A and B, beyond the "
            "controller: their differences may be due to that"
        )
    for line in said:
        console.print(Text(line), soft_wrap=True)
    for title, changes, style in (
        ("Verdicts that got worse", comparison.worse, "red"),
        ("Verdicts that got better", comparison.better, "green"),
        ("Verdicts that changed, but are neither", comparison.changed, ""),
    ):
        _print_changes(console, title, changes, style)
    if not comparison.worse:
        console.print(Text("No verdict got worse.", "green"))
    _print_shifts(console, comparison)
    for name, ids in (("A", comparison.only_a), ("B", comparison.only_b)):
        if ids:
            shown = ", ".join(ids[:CHANGES_SHOWN])
            more = f" and {len(ids) - CHANGES_SHOWN} more" if len(ids) > CHANGES_SHOWN else ""
            console.print(Text(f"Only in {name}: {len(ids)} cases: {shown}{more}"), soft_wrap=True)


def _matched(comparison: "CampaignComparison") -> str:
    by_factors = comparison.matched_by_factors
    how = f" ({by_factors} of them by factors and seed)" if by_factors else ""
    return (
        f"{comparison.matched} cases are in both{how}; {comparison.identical} of them "
        "bit-identical: the same frames at the same instants"
    )


def _print_changes(
    console: "Console", title: str, changes: "tuple[VerdictChange, ...]", style: str
) -> None:
    from rich.table import Table
    from rich.text import Text

    if not changes:
        return
    table = Table(title=Text(f"{title}: {len(changes)}", f"bold {style}"), title_justify="left")
    for name in ("case", "A", "B", "factors", "reason in B"):
        table.add_column(name)
    for change in changes[:CHANGES_SHOWN]:
        cells = (change.case_id, change.before, change.after, change.factors, change.reason)
        table.add_row(*map(Text, cells))
    console.print(table)
    if len(changes) > CHANGES_SHOWN:
        console.print(f"  and {len(changes) - CHANGES_SHOWN} more: --json lists them all")


def _print_shifts(console: "Console", comparison: "CampaignComparison") -> None:
    from rich.table import Table
    from rich.text import Text

    moved = [shift for shift in comparison.shifts if shift.unchanged < shift.pairs]
    still = len(comparison.shifts) - len(moved)
    if moved:
        title = Text("B less A, pair by pair, with 95 % intervals (bootstrap)", "bold")
        table = Table(title=title, title_justify="left")
        for name in ("of", "pairs", "mean", "median", "p (Holm)", "effect", ""):
            table.add_column(name, justify="left" if name in ("of", "") else "right")
        for shift in moved:
            table.add_row(*_cells(shift))
        console.print(table)
    if still:
        console.print(Text(f"{still} margins and measures are equal in all pairs."))
    if comparison.shifts:
        tests = sum(shift.p_ratio is not None for shift in comparison.shifts)
        console.print(
            Text(
                f"Wilcoxon signed-rank tests, two-sided, Holm's correction over {tests} of them; "
                "effect: rank-biserial, -1 all fell, +1 all rose. Errors count by magnitude."
            ),
            soft_wrap=True,
        )


def _cells(shift: "PairedShift") -> list[Any]:
    from rich.text import Text

    from metro_hil.report.campaign.units import number_text

    def interval(one: Any) -> str:
        bounds = f"[{number_text(one.low)}, {number_text(one.high)}]"
        unit = "" if shift.unit in ("", "1") else f" {shift.unit}"
        return f"{number_text(one.best)}{unit}\n{bounds}"

    assert shift.effect_ratio is not None
    style = {"worse": "red", "better": "green"}.get(shift.direction.value, "")
    kind = "margin of " if shift.kind == "margin" else ""
    p = "–" if shift.p_holm_ratio is None else f"{shift.p_holm_ratio:.3g}"
    said = "\n".join([shift.direction.value, *shift.notes])
    return [
        Text(f"{kind}{shift.name}"),
        f"{shift.pairs}\n{shift.unchanged} equal" if shift.unchanged else str(shift.pairs),
        interval(shift.mean),
        interval(shift.median),
        p,
        f"{shift.effect_ratio:+.2f}",
        Text(said, style),
    ]
