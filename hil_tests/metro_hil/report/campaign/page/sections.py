"""Sections of the page below its head: margins, measures, worst cases, failures, coverage."""

from base64 import b64encode
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from markupsafe import Markup

from metro_hil.model.case import Case, MonitorResult, Verdict, expected_text
from metro_hil.model.log_columns import Columns, RunLogError, read_columns
from metro_hil.model.run_folder import RunFolder
from metro_hil.report.campaign.evidence import FrameSpan, frames_around, kept_run, rerun_command
from metro_hil.report.campaign.ledger import Ledger, LedgerEntry, factors_text, known_margin
from metro_hil.report.campaign.page.drawing import (
    LevelGroup,
    PlotCurve,
    by_level_plot,
    curves_plot,
    histogram,
    margin_strip,
    span_of,
)
from metro_hil.report.campaign.page.matrix import SYMBOLS
from metro_hil.report.campaign.plots import plot_of
from metro_hil.report.campaign.tally import (
    MeasureTally,
    MonitorTally,
    TallyFactor,
    by_level,
    factors_of,
    worst_entries,
)
from metro_hil.report.campaign.units import unit_of, with_unit
from metro_hil.report.estimates import ConfidenceInterval

WORST_MAX: Final = 20
PLOTS_MAX: Final = 6
FAILURES_MAX: Final = 100
EVENTS_MAX: Final = 12
MEASURES_DRAWN: Final = 8
FACTORS_DRAWN: Final = 4
KMH_PER_MPS: Final = 3.6
MOVED_M: Final = 5.0
"""Distance that a run must cover to be plotted over place; shorter runs are plotted over time,
m."""


@dataclass(frozen=True, slots=True)
class MonitorView:
    """One monitor's line."""

    tally: MonitorTally
    passed: int
    failed: int
    inconclusive: int
    least: str
    least_case: str
    strip: Markup | None

    @property
    def idle(self) -> bool:
        """Whether the monitor never judged anything."""
        return not (self.tally.judged or self.inconclusive)


@dataclass(frozen=True, slots=True)
class MeasureView:
    """One measure with its distribution, in total and by factor."""

    name: str
    unit: str
    cases: int
    absent: int
    mean: ConfidenceInterval
    least: str
    most: str
    whole: Markup | None
    by_factor: tuple[tuple[str, Markup], ...]


@dataclass(frozen=True, slots=True)
class CaseView:
    """One case to look at."""

    index: int
    id: str
    scenario: str
    factors: str
    word: str
    symbol: str
    expected: str
    as_expected: bool
    reason: str
    margin: str
    monitor: str
    at: str
    frames: FrameSpan | None
    rerun: str
    plot: Markup | None
    events: tuple[tuple[str, str], ...]
    events_left_out: int


def monitor_views(tallies: Sequence[MonitorTally]) -> list[MonitorView]:
    return [_monitor(tally) for tally in tallies]


def _monitor(tally: MonitorTally) -> MonitorView:
    least, case, strip = "–", "", None
    if tally.least is not None:
        case = tally.least.entry.case.id
        least = with_unit(known_margin(tally.least.result), tally.unit)
        at_s = tally.least.result.at_s
        where = "" if at_s is None else f" at {at_s:.2f} s"
        strip = margin_strip(tally.margins(), tally.unit, f"{least}: {case}{where}")
    return MonitorView(
        tally=tally,
        passed=tally.counts[Verdict.PASS],
        failed=tally.counts[Verdict.FAIL],
        inconclusive=tally.counts[Verdict.INCONCLUSIVE],
        least=least,
        least_case=case,
        strip=strip,
    )


def measure_views(ledger: Ledger, tallies: Sequence[MeasureTally]) -> list[MeasureView]:
    """Measures that vary come first, those about stopping before others; only the first are
    drawn."""
    several = len(ledger.scenarios()) > 1
    factors = [*([_by_scenario(ledger)] if several else []), *factors_of(ledger.entries)]
    order = sorted(tallies, key=lambda tally: (not _varies(tally), "error" not in tally.name))
    return [
        _measure(tally, factors, drawn=number < MEASURES_DRAWN and _varies(tally))
        for number, tally in enumerate(order)
    ]


def _by_scenario(ledger: Ledger) -> TallyFactor:
    names = {entry.case.id: entry.case.scenario for entry in ledger.entries}
    return TallyFactor("scenario", tuple(ledger.scenarios()), names, binned=False)


def _varies(tally: MeasureTally) -> bool:
    return tally.mean.low < tally.mean.high


def _measure(tally: MeasureTally, factors: Sequence[TallyFactor], *, drawn: bool) -> MeasureView:
    values, unit = tally.values(), unit_of(tally.name)
    whole, panels = None, []
    if drawn:
        domain = span_of(values)
        mean = (tally.mean.best, tally.mean.low, tally.mean.high)
        whole = histogram(values, unit, mean, domain)
        value_of = {entry.case.id: value for entry, value in tally.points}
        entries = [entry for entry, _ in tally.points]
        for factor in factors[:FACTORS_DRAWN]:
            groups = [
                LevelGroup(level, np.array([value_of[entry.case.id] for entry in group]))
                for level, group in by_level(factor, entries)
                if group
            ]
            if len(groups) > 1:
                panels.append((factor.name, by_level_plot(groups, domain, unit)))
    return MeasureView(
        name=tally.name,
        unit=unit,
        cases=len(values),
        absent=tally.absent,
        mean=tally.mean,
        least=with_unit(min(values), unit),
        most=with_unit(max(values), unit),
        whole=whole,
        by_factor=tuple(panels),
    )


def worst_views(folder: Path, ledger: Ledger, tallies: Sequence[MonitorTally]) -> list[CaseView]:
    """The worst cases; the first ones with kept logs get a plot."""
    views, plots = [], 0
    for entry, nearest in worst_entries(ledger, tallies, count=WORST_MAX):
        plot = _plot(folder, entry, nearest) if plots < PLOTS_MAX else None
        plots += plot is not None
        views.append(case_view(folder, entry, nearest, plot))
    return views


def failure_views(folder: Path, ledger: Ledger) -> list[CaseView]:
    """All unexpected cases, in the campaign's order, up to `FAILURES_MAX`."""
    wrong = [entry for entry in ledger.entries if not entry.as_expected][:FAILURES_MAX]
    return [case_view(folder, entry, _least(entry), None) for entry in wrong]


def _least(entry: LedgerEntry) -> MonitorResult | None:
    """The monitor that was violated first, else the one with the least margin."""
    failed = [m for m in entry.monitors() if m.verdict is Verdict.FAIL]
    if failed:
        return min(failed, key=lambda m: (m.at_s is None, m.at_s or 0.0))
    return entry.result.least_margin() if entry.result is not None else None


def case_view(
    folder: Path,
    entry: LedgerEntry,
    nearest: MonitorResult | None,
    plot: Markup | None,
) -> CaseView:
    at_s = nearest.at_s if nearest is not None else None
    events = entry.result.events if entry.result is not None else ()
    return CaseView(
        index=entry.case.index,
        id=entry.case.id,
        scenario=entry.case.scenario,
        factors=_of(entry.case),
        word=entry.word,
        symbol=SYMBOLS[entry.word],
        expected=expected_text(entry.case),
        as_expected=entry.as_expected,
        reason=entry.reason,
        margin=with_unit(known_margin(nearest), nearest.unit) if nearest is not None else "–",
        monitor=nearest.name if nearest is not None else "",
        at="" if at_s is None else f"{at_s:.2f}\u202fs",
        frames=None if at_s is None else frames_around(folder, entry, at_s),
        rerun=rerun_command(entry),
        plot=plot,
        events=tuple((f"{event.at_s:.2f}", event.what) for event in events[:EVENTS_MAX]),
        events_left_out=max(0, len(events) - EVENTS_MAX),
    )


def _of(case: Case) -> str:
    return factors_text(case) if not case.factors else f"{factors_text(case)}, seed {case.seed}"


def _plot(folder: Path, entry: LedgerEntry, nearest: MonitorResult | None) -> Markup | None:
    """Plot of speed over distance, or over time if the train hardly moved; None without a log."""
    run = kept_run(folder, entry)
    if run is None:
        return None
    if plot_of(run).is_file():
        return picture(plot_of(run), f"plot of {entry.case.id}")
    try:
        return _draw(run, None if nearest is None else nearest.at_s)
    except RunLogError:
        return None


def picture(path: Path, name: str) -> Markup:
    """Inline picture, so that the page stays one file."""
    data = b64encode(path.read_bytes()).decode("ascii")
    return Markup('<img class="case" alt="{}" src="data:image/png;base64,{}">').format(name, data)


def _draw(run: RunFolder, at_s: float | None) -> Markup | None:
    truth = read_columns(run.truth_log)
    time_s, front_m = truth.numbers("t_s"), truth.numbers("front_m")
    speed_kmh = truth.numbers("speed_mps") * KMH_PER_MPS
    if len(time_s) < 2 or not np.any(np.isfinite(speed_kmh)):
        return None
    moved = float(np.nanmax(front_m) - np.nanmin(front_m)) > MOVED_M
    over, label = (front_m, "chainage of the front, m") if moved else (time_s, "time, s")
    curves = _ceilings(run, moved) if run.cycle_log.is_file() else []
    curves.append(PlotCurve("true speed", "train", over, speed_kmh))
    mark = None
    if at_s is not None:
        row = int(np.argmin(np.abs(time_s - at_s)))
        mark = (float(over[row]), float(speed_kmh[row]))
    return curves_plot(curves, x_label=label, y_label="speed, km/h", mark=mark)


def _ceilings(run: RunFolder, moved: bool) -> list[PlotCurve]:
    cycles: Columns = read_columns(run.cycle_log)
    over = cycles.numbers("front_m" if moved else "t_s")
    return [
        PlotCurve(label, style, over, cycles.numbers(column) * KMH_PER_MPS)
        for column, style, label in (
            ("emergency_mps", "emergency", "emergency brake above"),
            ("permitted_mps", "permitted", "permitted"),
        )
    ]
