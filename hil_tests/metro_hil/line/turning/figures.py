"""The train graph: the place of each train over time, in both directions."""

import itertools
from pathlib import Path
from typing import Final

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from firmware_py.storage.whole_file import whole_file
from firmware_py.trackdb.network import Running
from firmware_py.trackdb.paths import TrackPlace
from metro_hil.line.energy_figures import INK, QUIET, draw_substations, draw_voltages
from metro_hil.line.turning.conductor import FleetRecord
from metro_hil.line.turning.headway import Turnback
from metro_hil.line.turning.plan import FleetPlan
from metro_hil.line.turning.supply import FleetSupply
from metro_hil.model.network_places import NetworkAxis

KM: Final = 1000.0


def draw(
    path: Path,
    plan: FleetPlan,
    record: FleetRecord,
    turned: list[Turnback],
    supply: FleetSupply | None = None,
) -> None:
    """Draw the graph and write it as a PNG."""
    with mpl.rc_context({"font.size": 8, "axes.edgecolor": QUIET, "text.color": INK}):
        figure = Figure(
            figsize=(13.0, 8.0 if supply is None else 12.0), dpi=100, layout="constrained"
        )
        FigureCanvasAgg(figure)
        trains = "1 train" if plan.trains == 1 else f"{plan.trains} trains"
        figure.suptitle(f"{trains} on {plan.network.name}")
        shown = [each for each in turned if each.headways_s]
        ratios = [3.0, *([] if supply is None else [1.5, 1.5]), *([1.0] if shown else [])]
        rows = figure.subplots(len(ratios), 1, height_ratios=ratios, squeeze=False)[:, 0]
        _graph(rows[0], plan, record)
        if supply is not None and plan.supply is not None:
            numbers = range(1, plan.trains + 1)
            draw_voltages(rows[1], plan.supply, [supply.volts_of(each) for each in numbers])
            at_s = [row.at_s for row in supply.rows]
            draw_substations(rows[2], plan.supply, at_s, [row.substations_w for row in supply.rows])
            for axes in rows[1:3]:
                axes.sharex(rows[0])
        if shown:
            _headways(rows[-1], plan, shown)
        with whole_file(path) as part:
            figure.savefig(part)


def _graph(axes: Axes, plan: FleetPlan, record: FleetRecord) -> None:
    axis = NetworkAxis(plan.network)
    for number in range(1, plan.trains + 1):
        points = [each for each in record.points if each.train == number]
        label = f"train {number}"
        for _, trip in itertools.groupby(points, key=lambda each: each.trip):
            shown = list(trip)
            axes.plot(
                [each.at_s for each in shown],
                [axis.place_m(each.place) / KM for each in shown],
                linewidth=1.0,
                color=f"C{number - 1}",
                label=label,
            )
            label = "_"
    for track in plan.network.tracks:
        for edge in track.platforms:
            at_m = (edge.start_m + edge.end_m) / 2.0
            place_km = axis.place_m(TrackPlace(track.name, at_m, Running.UP)) / KM
            axes.axhline(place_km, color=QUIET, linewidth=0.3)
            axes.annotate(
                edge.station,
                (0.0, place_km),
                xytext=(3, 2),
                textcoords="offset points",
                color=QUIET,
                fontsize=7,
            )
    axes.set_xlabel("time in s")
    axes.set_ylabel("place of the train's middle in km")
    axes.set_xlim(0.0, max(1.0, record.duration_s))
    axes.legend(fontsize=7, loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=10, frameon=False)


def _headways(axes: Axes, plan: FleetPlan, turned: list[Turnback]) -> None:
    for index, each in enumerate(turned):
        numbers = range(2, len(each.headways_s) + 2)
        axes.plot(
            numbers, each.headways_s, "o", markersize=3, color=f"C{index}", label=each.limit.station
        )
        axes.axhline(each.limit.total_s, color=f"C{index}", linewidth=0.8, linestyle="--")
    if plan.service.headway_s:
        axes.axhline(plan.service.headway_s, color=INK, linewidth=0.8, linestyle=":")
    axes.set_ylim(bottom=0.0)
    axes.set_xlabel("number of the train that turns")
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    axes.set_ylabel("headway in s")
    axes.set_title(
        "dashed: analytic limit; dotted: timetable", fontsize=7, loc="right", color=QUIET
    )
    axes.legend(fontsize=7, loc="lower right")
