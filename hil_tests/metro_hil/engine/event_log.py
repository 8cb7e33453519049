"""Shows one case on the terminal: verdict, margins, events with their times, and its logs."""

from collections.abc import Sequence
from pathlib import Path
from typing import Final

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from metro_hil.engine.progress import COLOURS, margin_words
from metro_hil.model.case import Case, CaseResult, expected_text, fault_text, mismatch

EVENTS_SHOWN_MAX: Final = 60


def tell(console: Console, case: Case, result: CaseResult | None, logs: Sequence[Path]) -> None:
    """Print verdict, margins, measures, events and log paths of a case for a person."""

    def say(words: str, style: str = "") -> None:
        console.print(words, style=style, markup=False, highlight=False, soft_wrap=True)

    say(f"{case.id}  (scenario {case.scenario}, seed {case.seed}, {case.bench.value})", "bold")
    for key, value in case.factors.items():
        say(f"  {key} = {value}")
    if result is None:
        say("no result yet", "magenta")
        return
    wrong = mismatch(case, result)
    judged = f"expected {expected_text(case)}" if wrong else "as expected"
    words, reason = f"{result.verdict.value} ({judged})", wrong or result.reason
    say(f"{words}: {reason}" if reason else words, COLOURS[result.verdict])
    say(f"{result.exit_reason} after {result.sim_s:.2f} s, {result.frames} frames")
    say(f"chain {result.chain}")
    for fault in result.faults:
        say(f"fault {fault_text(fault)}")
    if result.monitors:
        console.print(_margins(result))
    if result.measures:
        console.print(_measures(result))
    for event in result.events[:EVENTS_SHOWN_MAX]:
        say(f"{event.at_s:10.2f} s  {event.what}")
    if (more := len(result.events) - EVENTS_SHOWN_MAX) > 0:
        say(f"{'':>10}    and {more} more")
    for path in logs:
        say(f"log: {path}")


def _margins(result: CaseResult) -> Table:
    table = Table(title="monitors", title_justify="left")
    for column in ("monitor", "verdict", "margin", "at", "requirements", "detail"):
        table.add_column(column, overflow="fold")
    for monitor in result.monitors:
        table.add_row(
            escape(monitor.name),
            f"[{COLOURS[monitor.verdict]}]{monitor.verdict.value}[/]",
            escape(margin_words(monitor.margin, monitor.unit)),
            "" if monitor.at_s is None else f"{monitor.at_s:.2f} s",
            escape(", ".join(monitor.requirements)),
            escape(monitor.detail),
        )
    return table


def _measures(result: CaseResult) -> Table:
    table = Table(title="measures", title_justify="left")
    table.add_column("measure")
    table.add_column("value", justify="right")
    for name, value in result.measures.items():
        table.add_row(escape(name), "" if value is None else f"{value:.6g}")
    return table
