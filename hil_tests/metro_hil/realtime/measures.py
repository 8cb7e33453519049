"""Measures of a case in real time, from the logs of its processes."""

import json
from typing import Protocol

import numpy as np

from metro_hil.metrics.case import motion_measures
from metro_hil.metrics.comfort import comfort_of, inertia_of
from metro_hil.metrics.fastest_run import journey_fastest_s
from metro_hil.model.case_setup import CaseParts
from metro_hil.model.log_columns import Columns, RunLogError, read_columns
from metro_hil.model.run_folder import RunFolder
from metro_hil.realtime.ends import TrueMotion
from metro_hil.realtime.observer import RunObserver
from plant_emulator.process import TRUTH_COLUMNS

BIT_RATE = 250_000


class Watched(Protocol):
    """A run that is over."""

    hearing: RunObserver
    motion: TrueMotion


def realtime_measures(
    folder: RunFolder, made: CaseParts, run: Watched, *, truth_known: bool
) -> dict[str, float | None]:
    """Return the measures by name, as in lockstep; one that was not taken is None or missing."""
    measures: dict[str, float | None] = {}
    truth = _read(folder, "truth.csv") if truth_known else None
    if truth is not None:
        seen = up_to(truth, run.motion.t_s)
        journey, fastest_s = made.journey, journey_fastest_s(made.journey, made.config.ato)
        measures.update(motion_measures(seen, journey.stops, journey.planned_run_s, fastest_s))
        measures["arrived_count"] = float(run.motion.arrived)
    cycles = _read(folder, "cycles.csv")
    measures.update(_commanded(cycles, made))
    measures["brake_reports_count"] = float(len(run.hearing.brake_reports.found))
    measures["controller_slips_count"] = _last(cycles, "slips")
    measures["rejected_frames_count"] = _refused(folder)
    elapsed_s = run.motion.t_s
    if elapsed_s > 0.0:
        measures["bus_load_ratio"] = run.hearing.train.bits / (BIT_RATE * elapsed_s)
    measures.update(_gateway(folder))
    return measures


def _commanded(cycles: Columns | None, made: CaseParts) -> dict[str, float | None]:
    try:
        comfort = comfort_of(None, cycles, inertia_kg=inertia_of(made.scenario.train))
    except RunLogError:
        return {}
    asked = comfort.measures()
    return {name: asked[name] for name in ("commanded_accel_max_mps2", "commanded_jerk_max_mps3")}


def up_to(truth: Columns, end_s: float) -> Columns:
    """Return the truth until the end of the case, when the controller ends and the train brakes."""
    rows = zip(*(truth.texts(name) for name in TRUTH_COLUMNS), strict=True)
    return Columns.of_rows("truth", TRUTH_COLUMNS, [row for row in rows if float(row[0]) <= end_s])


def lateness_us_p99(folder: RunFolder) -> float | None:
    """Return the 99th percentile of the lateness of the controller's cycles, from its log."""
    cycles = _read(folder, "cycles.csv")
    try:
        late_us = None if cycles is None else cycles.numbers("lateness_us")
    except RunLogError:
        return None
    if late_us is None or not np.any(~np.isnan(late_us)):
        return None
    return float(np.nanpercentile(late_us, 99.0))


def _gateway(folder: RunFolder) -> dict[str, float | None]:
    """Return how long frames waited in the gateway without a delaying fault."""
    told = _json(folder, "gateway.json")
    names = ("wait_p50_us", "wait_p99_us", "wait_max_us")
    values = {name: told.get(name) for name in names}
    return {
        f"gateway_{name}": float(value)
        for name, value in values.items()
        if isinstance(value, int | float)
    }


def _refused(folder: RunFolder) -> float | None:
    refused = _json(folder, "plant.json").get("refused_frames")
    return float(sum(refused.values())) if isinstance(refused, dict) else None


def _last(columns: Columns | None, name: str) -> float | None:
    try:
        values = None if columns is None else columns.numbers(name)
    except RunLogError:
        return None
    return float(values[-1]) if values is not None and len(values) else None


def _read(folder: RunFolder, name: str) -> Columns | None:
    try:
        return read_columns(folder.path / name)
    except RunLogError:
        return None


def _json(folder: RunFolder, name: str) -> dict[str, object]:
    try:
        told = json.loads((folder.path / name).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    return told if isinstance(told, dict) else {}
