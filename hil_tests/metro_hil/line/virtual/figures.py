"""The figure of a line's run.

It shows trains over time and place, voltages, substations, the use of regenerated energy, and
delays.
"""

from pathlib import Path
from typing import Final

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy.typing import NDArray

from firmware_py.storage.whole_file import whole_file
from metro_hil.line.energy_figures import (
    BURNT,
    INK,
    QUIET,
    USED,
    draw_substations,
    draw_voltages,
)
from metro_hil.line.virtual.coordinator import LineRecord
from metro_hil.line.virtual.member import LinePlan
from plant_emulator.power.box import J_PER_KWH

KW: Final = 1000.0
ON_TIME_S: Final = 2.0
Numbers = NDArray[np.float64]


def draw(path: Path, plan: LinePlan, record: LineRecord, law: str) -> None:
    """Draw the figure and write it as a PNG."""
    time_s = np.array([n * record.interval_s for n in range(len(record.rows))])
    with mpl.rc_context({"font.size": 8, "axes.edgecolor": QUIET, "text.color": INK}):
        figure = Figure(figsize=(13.0, 14.0), dpi=100, layout="constrained")
        FigureCanvasAgg(figure)
        figure.suptitle(
            f"{len(plan.starts)} trains on {plan.line.name}, law {law}, {plan.supply.name} network"
        )
        rows = figure.subplots(5, 1, height_ratios=(3.0, 2.0, 2.0, 1.4, 1.4))
        _diagram(rows[0], plan, record, time_s)
        at_s = time_s.tolist()
        trains = range(len(plan.starts))
        volts = [[row.answers[train].voltage_v for row in record.rows] for train in trains]
        draw_voltages(rows[1], plan.supply, [(at_s, train_v) for train_v in volts])
        draw_substations(rows[2], plan.supply, at_s, [row.substations_w for row in record.rows])
        _regeneration(rows[3], record)
        _lateness(rows[4], record)
        for axes in rows[:3]:
            axes.set_xlim(0.0, float(time_s[-1]) if len(time_s) > 1 else 1.0)
        for axes in rows[1:3]:
            axes.sharex(rows[0])
        with whole_file(path) as part:
            figure.savefig(part)


def _diagram(axes: Axes, plan: LinePlan, record: LineRecord, time_s: Numbers) -> None:
    for index, start in enumerate(plan.starts):
        places = [plan.traffic.place_m(row.said[index].front_m) / KW for row in record.rows]
        axes.plot(time_s, places, linewidth=1.0, label=f"train {start.train}")
    stations = plan.line.stations
    for station in stations[: plan.traffic.stations_a_lap // 2 or len(stations)]:
        axes.axhline(station.stop_m / KW, color=QUIET, linewidth=0.4)
        axes.annotate(
            station.name,
            (0.0, station.stop_m / KW),
            xytext=(3, 2),
            textcoords="offset points",
            color=QUIET,
            fontsize=7,
        )
    axes.set_ylabel("place in km")
    axes.legend(fontsize=7, loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=7, frameon=False)


def _regeneration(axes: Axes, record: LineRecord) -> None:
    names = [f"train {report.train}" for report in record.reports]
    burnt = np.array([report.energy.resistor_j for report in record.reports]) / J_PER_KWH
    braked = np.array([report.energy.braking_j for report in record.reports]) / J_PER_KWH
    places = np.arange(len(names))
    axes.bar(places, braked - burnt, color=USED, label="used by itself and others")
    axes.bar(places, burnt, bottom=braked - burnt, color=BURNT, label="braking resistors")
    axes.set_xticks(places, names)
    axes.set_ylabel("regenerated in kWh")
    axes.margins(y=0.35)
    axes.legend(fontsize=7)


def _lateness(axes: Axes, record: LineRecord) -> None:
    late_s = [run.late_s for report in record.reports for run in report.runs]
    axes.axvspan(-ON_TIME_S, ON_TIME_S, color=USED, alpha=0.12)
    if late_s:
        edge_s = max(5.0, float(np.ceil(np.max(np.abs(late_s)))))
        axes.hist(
            late_s,
            bins=[n * 0.25 for n in range(round(-4 * edge_s), round(4 * edge_s) + 1)],
            color="#0b62c4",
        )
    axes.set_xlabel("running time against plan in s")
    axes.set_ylabel("runs")
