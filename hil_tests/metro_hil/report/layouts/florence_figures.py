"""Figures 5, 6 and 7 of [Allotta 2013] from the logs of a campaign, for each control law."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from firmware_py.storage.whole_file import whole_file
from firmware_py.trackdb import LineMap, load_line
from metro_hil.engine.folder import CampaignFolder
from metro_hil.metrics.comfort import felt_signals
from metro_hil.model.case import Case
from metro_hil.model.log_columns import Columns, Numbers, RunLogError, read_columns
from metro_hil.report.law_figures import law_of
from metro_hil.report.layouts.tables import LayoutFigure
from metro_hil.report.plot import EMERGENCY, INK, KMH_PER_MPS, PERMITTED, QUIET, TRAIN
from vobc.ato.settings.ato import AtoConfig

FOLDER: Final = "figures"
IDEAL: Final = "table-7"
SIGNALLED: Final = "signalling"
SERVICE: Final = "#8e44ad"
REFERENCE: Final = "#2a9d6f"
SIGNAL_M: Final = 450.0
"""Place of the scenario's stop signal, m."""
NEAR_END_RATIO: Final = 0.03
TOP_KMH: Final = 88.0
DRIVING: Final = ("departing", "running", "approaching", "stopping", "jogging", "creeping")
Drawing = Callable[[Path, str, Case, Columns, Columns], bool]


@dataclass(frozen=True, slots=True)
class PaperFigure:
    """One figure of the paper."""

    number: int
    scenario: str
    words: str
    draw: Drawing


def wanted_cases(cases: Sequence[Case]) -> list[str]:
    """Ids of the cases that the figures show: the first of each scenario, for each law."""
    return list(dict.fromkeys(case.id for _, case in _pictures(cases)))


def florence_figures(folder: Path, cases: Sequence[Case]) -> list[LayoutFigure]:
    """Write a PNG for each figure whose case has logs; leave out the others."""
    drawn = []
    for wanted, case in _pictures(cases):
        run = CampaignFolder(folder).kept(case.id)
        law = law_of(case)
        path = folder / FOLDER / f"figure-{wanted.number}-{law}.png"
        title = f"{law}: {wanted.words}"
        try:
            cycles, truth = read_columns(run.cycle_log), read_columns(run.truth_log)
            path.parent.mkdir(exist_ok=True)
            with mpl.rc_context({"font.size": 10, "axes.edgecolor": QUIET, "text.color": INK}):
                if not wanted.draw(path, title, case, cycles, truth):
                    continue
        except RunLogError:
            continue
        caption = f"As figure {wanted.number} of the paper. {title}. Case {case.id}."
        drawn.append(LayoutFigure(caption, path))
    return drawn


def _pictures(cases: Sequence[Case]) -> Iterator[tuple[PaperFigure, Case]]:
    for law in dict.fromkeys(law_of(case) for case in cases):
        for wanted in WANTED:
            own = [case for case in cases if law_of(case) == law]
            of = [case for case in own if case.scenario.startswith(wanted.scenario)]
            if of:
                yield wanted, of[0]


def _draw_ride(path: Path, title: str, case: Case, cycles: Columns, truth: Columns) -> bool:
    """Draw acceleration and jerk of the first car, low-passed at 2 Hz; figures 5 and 7."""
    signals = felt_signals(truth)
    if signals is None:
        return False
    time_s, accel_mps2 = signals[0], signals[1][:, 0]
    step_s = float(time_s[1] - time_s[0])
    jerk_mps3 = np.diff(accel_mps2) / step_s
    figure, (accel, jerk) = _figure(title, 2, (1.0, 1.0))
    limits = AtoConfig().limits
    accel.plot(cycles.numbers("t_s"), _asked(cycles), color=PERMITTED, lw=0.9, label="demanded")
    accel.plot(time_s, accel_mps2, color=TRAIN, lw=1.3, label="felt in car 1, 2 Hz")
    jerk.plot(time_s[1:], jerk_mps3, color=TRAIN, lw=1.0, label="felt in car 1, 2 Hz")
    for axes, most, unit in (
        (accel, limits.accel_mps2, "acceleration, m/s²"),
        (jerk, limits.jerk_mps3, "jerk, m/s³"),
    ):
        for sign in (-1.0, 1.0):
            label = "design limit" if sign > 0.0 else ""
            axes.axhline(sign * most, color=EMERGENCY, lw=1.0, ls=(0, (6, 3)), label=label)
        axes.axhline(0.0, color=QUIET, lw=0.7)
        axes.set_ylabel(unit)
        _dress(axes)
    _keep_in_view(accel, accel_mps2, limits.accel_mps2)
    _keep_in_view(jerk, jerk_mps3, limits.jerk_mps3)
    jerk.set_xlabel("time, s", labelpad=1)
    for axes in (accel, jerk):
        axes.set_xlim(0.0, float(time_s[-1]))
    with whole_file(path) as part:
        figure.savefig(part)
    return True


def _asked(cycles: Columns) -> Numbers:
    """The demand, where ATO has one."""
    driven = np.array([phase in DRIVING for phase in cycles.texts("phase")])
    return np.where(driven, cycles.numbers("demand_mps2"), np.nan)


def _keep_in_view(axes: Axes, values: Numbers, most: float) -> None:
    top = max(1.25 * most, 1.1 * float(np.max(np.abs(values))))
    axes.set_ylim(-top, top)


def _draw_tracking(path: Path, title: str, case: Case, cycles: Columns, truth: Columns) -> bool:
    """Draw speed with reference, signalling and service profile over place and time; figure 6."""
    if len(truth) < 2 or not len(cycles):
        return False
    figure, (place, time) = _figure(title, 2, (1.3, 1.0))
    # Before the first authority nothing is permitted; zeros would hide the curves.
    permitted = np.where(cycles.numbers("permitted_mps") > 0.0, 1.0, np.nan)
    permitted_kmh = cycles.numbers("permitted_mps") * permitted * KMH_PER_MPS
    target_kmh = cycles.numbers("target_mps") * KMH_PER_MPS
    speed_kmh = truth.numbers("speed_mps") * KMH_PER_MPS
    line = load_line(case.setup.line)
    start_m, end_m = float(truth.numbers("front_m")[0]), float(truth.numbers("front_m")[-1])
    at_m = np.linspace(start_m, end_m, 2000)
    place.plot(at_m, _service_kmh(line, at_m), color=SERVICE, lw=1.2, ls=(0, (5, 2)),
               label="service profile")  # fmt: skip
    for axes, over, over_truth in (
        (place, cycles.numbers("front_m"), truth.numbers("front_m")),
        (time, cycles.numbers("t_s"), truth.numbers("t_s")),
    ):
        axes.plot(over, permitted_kmh, color=PERMITTED, lw=1.3, label="signalling")
        axes.plot(over, target_kmh, color=REFERENCE, lw=2.6, alpha=0.6, label="reference")
        axes.plot(over_truth, speed_kmh, color=TRAIN, lw=1.4, label="speed of the train")
        axes.set_ylabel("speed, km/h")
        axes.set_xlim(float(over_truth[0]), float(over_truth[-1]))
        axes.set_ylim(0.0, TOP_KMH)
        _dress(axes)
    for mark_m, words in _marks(line, start_m, end_m).items():
        _mark(place, mark_m, words, to_left=mark_m > end_m - NEAR_END_RATIO * (end_m - start_m))
    place.set_xlabel("chainage of the front coupler, m", labelpad=1)
    time.set_xlabel("time, s", labelpad=1)
    with whole_file(path) as part:
        figure.savefig(part)
    return True


def _service_kmh(line: LineMap, at_m: Numbers) -> Numbers:
    """Speed profile from first to last place at the line's highest speed, without signals.

    It uses ATO's acceleration limits and ignores the rounding by the jerk limit.
    """
    config = AtoConfig()
    top_mps = max(section.limit_mps for section in line.speed_sections)
    up_mps = np.sqrt(2.0 * config.limits.accel_mps2 * (at_m - at_m[0]))
    down_mps = np.sqrt(2.0 * config.braking.decel_mps2 * (at_m[-1] - at_m))
    service_mps: Numbers = np.minimum(np.minimum(up_mps, down_mps), top_mps)
    return service_mps * KMH_PER_MPS


def _marks(line: LineMap, start_m: float, end_m: float) -> dict[float, str]:
    """Texts of stations, signal and speed limits, by place."""
    found = {SIGNAL_M: ["signal at stop"]}
    for station in line.stations:
        if start_m < station.stop_m <= end_m + 1.0:
            found.setdefault(station.stop_m, []).append(f"station {station.name}")
    for section in line.speed_sections[1:]:
        if start_m < section.start_m < end_m:
            limit = f"{section.limit_mps * KMH_PER_MPS:.0f} km/h from here"
            found.setdefault(section.start_m, []).append(limit)
    return {at_m: "\n".join(words) for at_m, words in found.items()}


def _mark(axes: Axes, at_m: float, words: str, *, to_left: bool) -> None:
    axes.axvline(at_m, color=QUIET, lw=0.8, ls=":")
    axes.annotate(words, (at_m, 0.99), xycoords=("data", "axes fraction"),
                  xytext=(-4 if to_left else 4, 0), textcoords="offset points", va="top",
                  ha="right" if to_left else "left", fontsize=8.5, color=INK)  # fmt: skip


def _figure(title: str, rows: int, heights: tuple[float, ...]) -> tuple[Figure, list[Axes]]:
    figure = Figure(figsize=(12.0, 7.5), dpi=90, layout="constrained")
    FigureCanvasAgg(figure)
    grid = figure.add_gridspec(rows, 1, height_ratios=heights)
    figure.suptitle(title, x=0.012, ha="left", fontsize=13, fontweight="bold")
    return figure, [figure.add_subplot(grid[row]) for row in range(rows)]


def _dress(axes: Axes) -> None:
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
    axes.grid(axis="y", color="#e4e7eb", lw=0.7)
    axes.legend(loc="lower right", ncols=4, frameon=False, fontsize=8.5, bbox_to_anchor=(1.0, 1.0))


WANTED: Final = (
    PaperFigure(5, IDEAL, "acceleration and jerk of car 1 in ideal conditions", _draw_ride),
    PaperFigure(6, SIGNALLED, "speed and its reference under signalling", _draw_tracking),
    PaperFigure(7, SIGNALLED, "acceleration and jerk of car 1 under signalling", _draw_ride),
)
