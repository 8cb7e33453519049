"""Plots of the cases whose logs were kept, stored beside their logs."""

from collections.abc import Sequence
from pathlib import Path
from typing import Final

from firmware_py.settings import SettingsError
from metro_hil.engine.folder import CampaignFolder
from metro_hil.model.case import Case
from metro_hil.model.case_setup import Files, line_of
from metro_hil.model.log_columns import RunLogError, read_columns
from metro_hil.model.run_folder import RunFolder
from metro_hil.report.case_plot import NAME, draw_case, stretches_of

PLOTS_MAX: Final = 40
"""Greatest number of plots, each of which takes most of a second; `hil rerun` draws any other."""


def plot_of(run: RunFolder) -> Path:
    """Path of a kept run's plot, whether it exists or not."""
    return run.path / NAME


def draw_kept(folder: CampaignFolder, cases: Sequence[Case]) -> dict[str, Path]:
    """Draw plots that are missing for kept logs; return all plots by id of the case."""
    files = folder.files()
    drawn: dict[str, Path] = {}
    for case in cases:
        run = folder.kept(case.id)
        if not run.path.is_dir() or len(drawn) >= PLOTS_MAX:
            continue
        if plot_of(run).is_file() or draw_run_of(case, files, run):
            drawn[case.id] = plot_of(run)
    return drawn


def draw_run_of(case: Case, files: Files, run: RunFolder) -> bool:
    """Draw one plot. False if the logs are not enough: the run never began, or the plant is
    external."""
    try:
        cycles, truth = read_columns(run.cycle_log), read_columns(run.truth_log)
        line = line_of(case.setup, files)
        return draw_case(plot_of(run), case.id, line, cycles, truth, stretches_of(case.faults))
    except (RunLogError, SettingsError):
        return False
