"""The figure of a simulated line.

It shows trains over time and place, voltages, substations, and the use of regenerated energy.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Final

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from firmware_py.storage.whole_file import whole_file
from metro_hil.energy.line.model import LAP_S, STOPS_M, TRAINS
from metro_hil.energy.line.simulate import LineSeries
from metro_hil.energy.line.table_four import TableFour

INK, QUIET, USED, BURNT = "#1f2933", "#7b8794", "#2f9e44", "#c0242b"
SHOWN_S: Final = 720.0
KW: Final = 1000.0


def draw(path: Path, table: TableFour, before: LineSeries, after: LineSeries) -> None:
    """Write a PNG: the traditional law on the left, the synchronised timetable on the right."""
    with mpl.rc_context({"font.size": 8, "axes.edgecolor": QUIET, "text.color": INK}):
        figure = Figure(figsize=(15.0, 13.0), dpi=100, layout="constrained")
        FigureCanvasAgg(figure)
        figure.suptitle(
            f"seven trains on a part of the Changping line, {table.supply.name} network"
        )
        rows = figure.subplots(4, 2)
        for column, (name, record) in enumerate((("traditional", before), ("synchronised", after))):
            first = int(np.searchsorted(record.time_s, LAP_S))
            last = int(np.searchsorted(record.time_s, LAP_S + SHOWN_S))
            part = slice(first, last)
            _diagram(rows[0][column], name, record, part)
            _voltages(rows[1][column], record, part)
            _substations(rows[2][column], table.supply.network().joints, record, part)
        for one, other in rows[:3]:
            # Both sides share their scales, for comparison.
            other.sharey(one)
            one.autoscale(axis="y")
        _regeneration(rows[3][0], table)
        _changes(rows[3][1], table)
        with whole_file(path) as aside:
            figure.savefig(aside)


def _diagram(axes: Axes, name: str, record: LineSeries, part: slice) -> None:
    time_s = record.time_s[part] - LAP_S
    for train in range(TRAINS):
        axes.plot(time_s, record.place_m[part, train] / KW, linewidth=1.0)
    for stop_m in STOPS_M:
        axes.axhline(stop_m / KW, color=QUIET, linewidth=0.4)
    axes.set_ylabel("place in km")
    axes.set_title(f"{name}: line diagram", fontsize=9)


def _voltages(axes: Axes, record: LineSeries, part: slice) -> None:
    time_s = record.time_s[part] - LAP_S
    for train in range(TRAINS):
        axes.plot(time_s, record.voltage_v[part, train], linewidth=0.7)
    axes.set_ylabel("voltage at the train in V")


def _substations(axes: Axes, joints: Sequence[str], record: LineSeries, part: slice) -> None:
    time_s = record.time_s[part] - LAP_S
    given_kw = record.given_w[part] / KW
    axes.stackplot(time_s, given_kw.T, labels=joints)
    axes.set_ylabel("substations in kW")
    axes.set_xlabel("time in s")
    axes.margins(y=0.15)
    axes.legend(fontsize=7, loc="upper right", ncols=5)


def _regeneration(axes: Axes, table: TableFour) -> None:
    names = _names(table)
    used = [row.mean(lambda outcome: outcome.used_kwh) for row in table.rows]
    burnt = [row.mean(lambda outcome: outcome.burnt_kwh) for row in table.rows]
    places = np.arange(len(names))
    axes.barh(places, used, color=USED, label="used by trains")
    axes.barh(places, burnt, left=used, color=BURNT, label="braking resistors")
    axes.set_yticks(places, names)
    axes.invert_yaxis()
    axes.set_xlabel("regenerated energy in kWh a lap")
    axes.legend(fontsize=7)


def _changes(axes: Axes, table: TableFour) -> None:
    names = _names(table)
    places = np.arange(len(names))
    means = np.array([100.0 * row.change.mean_ratio for row in table.rows])
    halves = np.array([100.0 * (row.change.half_ratio or 0.0) for row in table.rows])
    axes.barh(places, means, xerr=halves, color="#0b62c4")
    axes.set_yticks(places, names)
    axes.invert_yaxis()
    axes.set_xlabel("actual energy against traditional in %, 95 % interval")


def _names(table: TableFour) -> Sequence[str]:
    """Return the names of the laws; an indented row belongs to the law above it."""
    names: list[str] = []
    law = ""
    for row in table.rows:
        law = law if row.name.startswith(" ") else row.name
        names.append(row.name if row.name == law else f"{law}, {row.name.strip()}")
    return names
