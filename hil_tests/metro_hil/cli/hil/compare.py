"""`hil compare`: what got worse between two campaigns, and whether by chance."""

import argparse
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from metro_hil.engine.errors import UsageError
from metro_hil.model.run_options import EXIT_FAILED, EXIT_OK
from metro_hil.model.terminal import console_for

if TYPE_CHECKING:
    from rich.console import Console

    from metro_hil.report.comparison import Campaign, CampaignComparison, PairedShift, VerdictChange
    from metro_hil.report.detectable import Detectable
    from metro_hil.report.judged_comparison import Drop, JudgedComparison, ScenarioComparison

CHANGES_SHOWN: Final = 20


def add(verbs: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    parser = verbs.add_parser(
        "compare",
        help="compare two campaigns: what got worse, by how much",
        description="Compare two campaigns case by case, in total and by scenario: what "
        "such a comparison can find, verdicts that changed, the largest single drop of a margin, "
        "and for each margin and measure the paired difference with a signed-rank test, corrected "
        "for their number. Exit code 1 when a verdict got worse.",
    )
    parser.add_argument(
        "before", metavar="A", help="campaign, its folder, the beginning of that name, or a path"
    )
    parser.add_argument("after", metavar="B", help="campaign to compare with A")
    parser.add_argument("--json", action="store_true", help="one JSON object on standard output")
    parser.add_argument(
        "--fail-on-worse",
        action="store_true",
        help="exit code 1 also if a margin or measure got significantly worse, in total or in one "
        "scenario, or if the comparison is inconclusive",
    )
    parser.add_argument(
        "--relevant",
        action="append",
        default=[],
        metavar="UNIT=NUMBER",
        help="smallest difference that matters, such as m=0.01; may be repeated; "
        "docs/guide/comparing.md has the others",
    )
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Exit code 1 if a verdict got worse or, on request, a margin or measure did."""
    from metro_hil.engine.folder import find_folder

    before, after = find_folder(options.before).path, find_folder(options.after).path
    from metro_hil.report.relevance import parse_relevance

    try:
        relevance = parse_relevance(options.relevant)
    except ValueError as error:
        raise UsageError(f"--relevant {error}") from error
    judged = compare_campaigns(before, after, relevance)
    if not judged.pool.matched:
        raise UsageError(f"{before} and {after}: no case is in both, so nothing can be compared")
    if options.json:
        print(comparison_json(judged, before, after))
    else:
        print_comparison(console_for(), judged, before, after)
    asked = options.fail_on_worse
    shifted = judged.significantly_worse or judged.worse_scenarios
    if asked and judged.unproven and not options.json:
        print("--fail-on-worse: the comparison cannot tell, which is not a pass")
    failed = judged.pool.worse or (asked and (shifted or judged.unproven))
    return EXIT_FAILED if failed else EXIT_OK


def compare_campaigns(
    a: Path, b: Path, relevance: Mapping[str, float] | None = None
) -> "JudgedComparison":
    """Compare two campaign folders. Raises EngineError if one cannot be read."""
    from metro_hil.report.judged_comparison import judge_comparison

    return judge_comparison(_read(a), _read(b), relevance)


def _read(path: Path) -> "Campaign":
    from metro_hil.engine.folder import CampaignFolder
    from metro_hil.engine.journal import read_journal, refuse_damage

    folder = CampaignFolder(path)
    content = read_journal(folder.journal_path)
    refuse_damage(folder.journal_path, content)
    return folder.cases(), content.results


def comparison_json(judged: "JudgedComparison", a: Path, b: Path) -> str:
    import dataclasses

    import msgspec

    parts = [
        (f.name, getattr(part, f.name))
        for part in (judged.pool, judged)
        for f in dataclasses.fields(part)
        if f.name != "pool"
    ]
    document = {
        "a": str(a),
        "b": str(b),
        **dict(parts),
        "significantly_worse": [shift.name for shift in judged.significantly_worse],
        "worse_scenarios": [each.name for each in judged.worse_scenarios],
        "unproven": judged.unproven,
    }
    return msgspec.json.encode(document).decode()


def print_comparison(console: "Console", judged: "JudgedComparison", a: Path, b: Path) -> None:
    """Print what can be detected, then verdicts, then shifts, then what cannot be compared."""
    from rich.text import Text

    comparison = judged.pool
    said = [f"A {a}", f"B {b}", _matched(comparison)]
    said += [f"can find: {words}" for words in _detectable_lines(judged.detectable)]
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
    if len(judged.scenarios) > 1:
        _print_scenarios(console, judged.scenarios)
    _print_shifts(console, comparison)
    if judged.largest_drop is not None:
        drop = f"Largest single drop of a margin: {drop_words(judged.largest_drop)}"
        console.print(Text(drop, "bold"), soft_wrap=True)
    for words in judged.unproven:
        console.print(Text(f"Not proven: {words}", "yellow"), soft_wrap=True)
    for name, ids in (("A", comparison.only_a), ("B", comparison.only_b)):
        if ids:
            shown = ", ".join(ids[:CHANGES_SHOWN])
            more = f" and {len(ids) - CHANGES_SHOWN} more" if len(ids) > CHANGES_SHOWN else ""
            console.print(Text(f"Only in {name}: {len(ids)} cases: {shown}{more}"), soft_wrap=True)


def _detectable_lines(found: "Sequence[tuple[str, Detectable]]") -> list[str]:
    return [f"{name}: {detectable_words(each)}" for name, each in found]


def detectable_words(found: "Detectable") -> str:
    """Text about the smallest detectable difference, which stands before the differences."""
    size = f"{found.pairs} pairs, {found.tests} tests"
    if found.hopeless:
        return f"nothing, with {size}; it takes {found.pairs_needed} pairs, so run more seeds"
    shift = ""
    if found.shift_sd_ratio is not None:
        shift = (
            f", and a mean difference of {found.shift_sd_ratio:.2g} standard deviations in four of "
            "five comparisons"
        )
    return f"with {size}: {found.pairs_needed} pairs that all go the same way{shift}"


def drop_words(drop: "Drop") -> str:
    from metro_hil.report.campaign.units import number_text, with_unit

    before, after = number_text(drop.before.margin), with_unit(drop.after.margin, drop.after.unit)
    return (
        f"{drop.after.name} in {drop.case_id}: {before} to {after}, "
        f"{drop.relevance_ratio:.3g} times what matters"
    )


def _print_scenarios(console: "Console", scenarios: "Sequence[ScenarioComparison]") -> None:
    """Print a table of the scenarios; those that got worse come first."""
    from rich.table import Table
    from rich.text import Text

    def rank(each: "ScenarioComparison") -> tuple[bool, bool, float]:
        drop = each.largest_drop
        return (
            not each.worse,
            not each.significantly_worse,
            -(drop.relevance_ratio if drop else 0.0),
        )

    title = Text("Each scenario by itself", "bold")
    table = Table(title=title, title_justify="left")
    for name in ("scenario", "pairs", "verdicts", "worse margins and measures", "largest drop"):
        table.add_column(name)
    moved = sorted([each for each in scenarios if each.shifts or each.worse or each.better],
                   key=rank)  # fmt: skip
    for each in moved[:CHANGES_SHOWN]:
        dim = [name for name, found in each.detectable if found.hopeless]
        worse = ", ".join([shift.name for shift in each.significantly_worse])
        cells = (
            each.name,
            str(each.matched),
            f"{each.worse} worse, {each.better} better" if each.worse or each.better else "as in A",
            worse or (f"too few pairs for {' and '.join(dim)}" if dim else "none shown"),
            drop_words(each.largest_drop) if each.largest_drop else "none",
        )
        bad = "red" if each.worse or each.significantly_worse else ""
        table.add_row(*[Text(cell, bad) for cell in cells])
    console.print(table)
    if len(moved) > CHANGES_SHOWN:
        console.print(f"  and {len(moved) - CHANGES_SHOWN} more: --json lists them all")
    if still := len(scenarios) - len(moved):
        console.print(Text(f"{still} scenarios are equal in all pairs."))


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
        for name in ("of", "pairs", "mean", "median", "finds", "p (Holm)", "effect", ""):
            table.add_column(name, justify="left" if name in ("of", "") else "right")
        for shift in moved:
            table.add_row(*_cells(shift))
        console.print(table)
    if still:
        console.print(Text(f"{still} margins and measures differ in no pair by more than matters."))
    if comparison.shifts:
        tests = sum(shift.p_ratio is not None for shift in comparison.shifts)
        console.print(
            Text(
                f"{tests} Wilcoxon signed-rank tests, two-sided, Holm's correction within margins, "
                "within measures of which less is better, and within the others; finds: the mean "
                "difference found in four of five comparisons; effect: rank-biserial, -1 all fell, "
                "+1 all rose. Errors count by magnitude; docs/guide/comparing.md has the method."
            ),
            soft_wrap=True,
        )


def _cells(shift: "PairedShift") -> list[Any]:
    from rich.text import Text

    from metro_hil.report.campaign.units import number_text, with_unit

    def interval(one: Any) -> str:
        bounds = f"[{number_text(one.low)}, {number_text(one.high)}]"
        unit = "" if shift.unit in ("", "1") else f" {shift.unit}"
        return f"{number_text(one.best)}{unit}\n{bounds}"

    assert shift.effect_ratio is not None
    style = {"worse": "red", "better": "green"}.get(shift.direction.value, "")
    kind = "margin of " if shift.kind == "margin" else ""
    p = "–" if shift.p_holm_ratio is None else f"{shift.p_holm_ratio:.3g}"
    said = "\n".join([shift.direction.value, *shift.notes])
    finds = "nothing" if shift.finds is None else with_unit(shift.finds, shift.unit)
    return [
        Text(f"{kind}{shift.name}"),
        f"{shift.pairs}\n{shift.unchanged} equal" if shift.unchanged else str(shift.pairs),
        interval(shift.mean),
        interval(shift.median),
        finds,
        p,
        f"{shift.effect_ratio:+.2f}",
        Text(said, style),
    ]
