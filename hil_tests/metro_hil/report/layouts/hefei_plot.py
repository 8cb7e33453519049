"""Figures 5 to 8 of [Wu 2022] from a campaign: speed curves and stop errors, before and after."""

from collections.abc import Sequence
from pathlib import Path
from typing import Final

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from firmware_py.storage.whole_file import whole_file
from metro_hil.engine.folder import CampaignFolder
from metro_hil.engine.journal import read_journal
from metro_hil.model.case import Case
from metro_hil.model.log_columns import Numbers, RunLogError, read_columns
from metro_hil.report.layouts.hefei import CM_PER_M, WINDOW_M, Pairs, errors_m, platforms
from metro_hil.report.layouts.tables import LayoutFigure
from metro_hil.report.plot import EMERGENCY, INK, KMH_PER_MPS, PERMITTED, QUIET, TRAIN

NAME: Final = "hefei.png"
CAPTION: Final = "Speed curves and stop errors before and after (the paper's figures 5 to 8)"
SHOWN: Final = (("hefei-before", "before"), ("hefei-after", "after"))
APPROACH_M: Final = 420.0
LAST_M: Final = 20.0
SPREAD: Final = 0.28
LEAST_ERROR_CM: Final = 40.0


def wanted_cases(cases: Sequence[Case]) -> list[str]:
    """Id of the first case of each scenario in the picture."""
    firsts = (
        next((case.id for case in cases if case.scenario == scenario), None)
        for scenario, _ in SHOWN
    )
    return [name for name in firsts if name is not None]


def draw_hefei(folder: Path, cases: Sequence[Case]) -> list[LayoutFigure]:
    """Write one picture below `folder`; none if the campaign has none of the scenarios.

    The curves are those of the first case of each scenario; the stop errors come from the journal.
    """
    journal = read_journal(CampaignFolder(folder).journal_path)
    by_id = {result.case_id: result for result in journal.results}
    pairs = [(case, by_id.get(case.id)) for case in cases]
    shown = [
        (name, [pair for pair in pairs if pair[0].scenario == scenario]) for scenario, name in SHOWN
    ]
    if not any(found for _, found in shown):
        return []
    path = folder / NAME
    with mpl.rc_context({"font.size": 10, "axes.edgecolor": QUIET, "text.color": INK}):
        figure = Figure(figsize=(13.0, 12.0), dpi=100, layout="constrained")
        FigureCanvasAgg(figure)
        axes = figure.subplots(3, 2, height_ratios=(4.0, 3.0, 3.5))
        highest_cm = max(
            [LEAST_ERROR_CM]
            + [
                abs(e) * CM_PER_M
                for _, p in shown
                for name in platforms(p)
                for e in errors_m(p, name)
            ]
        )
        for column, (name, found) in enumerate(shown):
            if not found:
                continue
            _draw_curves(axes[0][column], axes[1][column], folder, found, name)
            _draw_errors(axes[2][column], found, name, 1.08 * highest_cm)
        with whole_file(path) as part:
            figure.savefig(part)
    return [LayoutFigure(CAPTION, path)]


def _draw_curves(whole: Axes, last: Axes, folder: Path, pairs: Pairs, name: str) -> None:
    case = pairs[0][0]
    logs = _logs(CampaignFolder(folder), case)
    whole.set_title(f"{name}: speed over the last {APPROACH_M:.0f} m before {case.setup.end}")
    last.set_title(f"{name}: the last {LAST_M:.0f} m, and the notches")
    if logs is None:
        return
    to_stop_m, command_kmh, actual_kmh, demand_mps2 = logs
    for axes, room_m in ((whole, APPROACH_M), (last, LAST_M)):
        near = (to_stop_m <= room_m) & (to_stop_m > -2.0)
        axes.plot(-to_stop_m[near], command_kmh[near], color=PERMITTED, lw=1.4, label="command")
        axes.plot(-to_stop_m[near], actual_kmh[near], color=TRAIN, lw=1.8, label="actual")
        axes.axvline(0.0, color=QUIET, lw=0.8, ls=":")
        axes.set_xlabel("to the stopping point, m")
        axes.set_ylabel("speed, km/h")
        axes.set_ylim(bottom=0.0)
        side = axes.twinx()
        side.plot(-to_stop_m[near], demand_mps2[near], color=EMERGENCY, lw=0.9, label="demand")
        side.set_ylim(-1.0, 2.2)
        side.set_yticks((-0.8, -0.4, 0.0))
        side.set_ylabel("demand, m/s²", y=0.17)
        handles = [*axes.get_legend_handles_labels()[0], *side.get_legend_handles_labels()[0]]
        axes.legend(handles=handles, frameon=False, loc="upper right", ncols=3, fontsize=9)


def _logs(folder: CampaignFolder, case: Case) -> tuple[Numbers, ...] | None:
    """Distance to the stop, command and actual speed, demand: by cycle, while the train moves."""
    run = folder.kept(case.id)
    try:
        cycles, truth = read_columns(run.cycle_log), read_columns(run.truth_log)
    except (RunLogError, OSError):
        return None
    time_s = truth.numbers("t_s")
    moving = truth.numbers("speed_mps") != 0.0
    if not np.any(moving):
        return None
    end_s = float(time_s[np.flatnonzero(moving)[-1]])
    rows = cycles.numbers("t_s") <= end_s
    at_s = cycles.numbers("t_s")[rows]
    actual_mps = np.interp(at_s, time_s, truth.numbers("speed_mps"))
    to_stop_m = cycles.numbers("distance_to_stop_m")[rows]
    command_mps = cycles.numbers("target_mps")[rows]
    demand_mps2 = cycles.numbers("demand_mps2")[rows]
    return to_stop_m, command_mps * KMH_PER_MPS, actual_mps * KMH_PER_MPS, demand_mps2


def _draw_errors(axes: Axes, pairs: Pairs, name: str, highest_cm: float) -> None:
    names = platforms(pairs)
    axes.axhspan(-WINDOW_M * CM_PER_M, WINDOW_M * CM_PER_M, color="#eef3ee", zorder=0)
    axes.axhline(0.0, color=INK, lw=0.8)
    for place, platform in enumerate(names):
        found_cm = [error_m * CM_PER_M for error_m in errors_m(pairs, platform)]
        share = np.arange(1, len(found_cm) + 1) / (len(found_cm) + 1)
        spots = place + (2.0 * share - 1.0) * SPREAD
        axes.plot(spots, found_cm, ".", color=TRAIN, ms=6)
    axes.set_xticks(range(len(names)), names)
    axes.set_xlim(-0.5, len(names) - 0.5)
    axes.set_ylim(-highest_cm, highest_cm)
    axes.set_ylabel("stop error, cm")
    axes.set_title(f"{name}: stop errors, shaded ±{WINDOW_M * CM_PER_M:.0f} cm")
    axes.grid(axis="y", color="#e4e7eb", lw=0.7)
