"""Prints the cases of one scenario at the end of a run: verdicts, margins, plots."""

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Final

from rich.markup import escape
from rich.table import Table

from metro_hil.engine.progress import COLOURS, margin_words
from metro_hil.model.case import Case, CaseResult, MonitorResult, Verdict, mismatch

if TYPE_CHECKING:
    from rich.console import Console

CASES_TOLD_MAX: Final = 40
PIECES_TOLD_MAX: Final = 8
SEED_ALONE: Final = re.compile(r"(?P<scenario>[^/]+)/s(?P<seed>\d+)")
"""Id of a case that scenario and seed describe completely."""


def tell_scenario(
    console: "Console",
    cases: Sequence[Case],
    results: Sequence[CaseResult],
    plots: Mapping[str, Path],
) -> None:
    """Print each verdict and the least margins; nothing for more than one scenario.

    Args:
        plots: paths by the id of the case.
    """
    by_id = {result.case_id: result for result in results}
    told = [(case, by_id[case.id]) for case in cases if case.id in by_id]
    if not told or len(told) > CASES_TOLD_MAX or len({case.scenario for case, _ in told}) != 1:
        return
    console.print(_monitors(told))
    for case, result in told:
        words, wrong = result.verdict.value, mismatch(case, result)
        if case.expected and not wrong:
            words += ", as expected"
        words = f"{words:>12}  {case.id}"
        if reason := wrong or result.reason:
            words += f"  {reason}"
        console.print(words, style=COLOURS[result.verdict], markup=False, highlight=False,
                      soft_wrap=True)  # fmt: skip
        if case.id in plots:
            console.print(f"{'':>12}  plot: {plots[case.id]}", markup=False, highlight=False,
                          soft_wrap=True)  # fmt: skip


def _monitors(told: Sequence[tuple[Case, CaseResult]]) -> Table:
    """Table of the worst case for each monitor; monitors that judged nothing are listed below."""
    worst: dict[str, tuple[Case, MonitorResult]] = {}
    idle: set[str] = set()
    for case, result in told:
        for monitor in result.monitors:
            if monitor.verdict is Verdict.VACUOUS and not monitor.asked:
                idle.add(monitor.name)
            elif monitor.name not in worst or _rank(monitor) < _rank(worst[monitor.name][1]):
                worst[monitor.name] = case, monitor
    idle -= set(worst)
    caption = f"not exercised: {', '.join(sorted(idle))}" if idle else None
    table = Table(title="least margins", title_justify="left", caption=caption,
                  caption_justify="left")  # fmt: skip
    several = len(told) > 1
    for column in ("monitor", "verdict", "margin", "at", *(["case"] if several else []), "detail"):
        table.add_column(column, overflow="fold")
    for name, (case, monitor) in worst.items():
        table.add_row(
            escape(name),
            f"[{COLOURS[monitor.verdict]}]{monitor.verdict.value}[/]",
            escape(margin_words(monitor.margin, monitor.unit)),
            "" if monitor.at_s is None else f"{monitor.at_s:.2f} s",
            *([escape(case.id.rpartition("/")[2])] if several else []),
            escape(monitor.detail),
        )
    return table


def _rank(monitor: MonitorResult) -> tuple[bool, float]:
    passed = monitor.verdict is Verdict.PASS
    return passed, monitor.margin if monitor.margin is not None else 0.0


def again(case_id: str, folder: Path) -> str:
    """Command that repeats one case; shorter if scenario and seed describe it completely."""
    from metro_hil.campaign.scenarios import is_scenario

    found = SEED_ALONE.fullmatch(case_id)
    if found is not None and is_scenario(found["scenario"]):
        return f"hil run {found['scenario']} --seed {found['seed']}"
    return f"hil rerun {folder} {case_id}"


def seeds_words(cases: Sequence[Case]) -> list[str]:
    """Which seeds were run of each scenario whose cases differ only in their seeds."""
    from metro_hil.campaign.scenarios import is_scenario

    seeds: dict[str, list[int]] = {}
    for case in cases:
        found = SEED_ALONE.fullmatch(case.id)
        if found is not None:
            seeds.setdefault(found["scenario"], []).append(int(found["seed"]))
    return [
        f"seeds of {name}: {_ranges(sorted(of))}; any of them again: hil run {name} --seed N"
        for name, of in seeds.items()
        if len(of) > 1 and is_scenario(name)
    ]


def _ranges(seeds: Sequence[int]) -> str:
    """Text such as `1 to 3, 7`; many pieces are shortened to the count and both ends."""
    pieces: list[list[int]] = []
    for seed in seeds:
        if pieces and seed == pieces[-1][-1] + 1:
            pieces[-1][1:] = [seed]
        else:
            pieces.append([seed])
    if len(pieces) > PIECES_TOLD_MAX:
        return f"{len(seeds)} of {seeds[0]} to {seeds[-1]}"
    return ", ".join(" to ".join(map(str, piece)) for piece in pieces)
