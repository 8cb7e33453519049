"""The speed-distance plot of one run: place, speed, and permitted speed of the train."""

from collections.abc import Sequence
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from firmware_py.storage.whole_file import whole_file
from firmware_py.trackdb import LineMap, TagKind
from metro_hil.metrics.stops import StationStop
from metro_hil.model.log_columns import Columns, Numbers

KMH_PER_MPS = 3.6
MARGIN_M = 25.0

INK = "#1f2933"
QUIET = "#7b8794"
TRAIN = "#0b62c4"
TARGET = "#55a3e8"
PERMITTED = "#d98a00"
EMERGENCY = "#c0242b"
PLATFORM = "#dfe7ee"


def draw_run(
    path: Path,
    title: str,
    line: LineMap,
    cycles: Columns,
    truth: Columns | None,
    stops: Sequence[StationStop],
) -> bool:
    """Write a PNG; without `truth` (an external plant) it shows the controller's own estimate.

    False if there is nothing to draw because the train's place was never known.
    """
    moved_m = (truth or cycles).numbers("front_m")
    if np.all(np.isnan(moved_m)):
        return False
    with mpl.rc_context({"font.size": 10, "axes.edgecolor": QUIET, "text.color": INK}):
        figure = Figure(figsize=(13.0, 8.0), dpi=110, layout="constrained")
        FigureCanvasAgg(figure)
        speed, profile, accel = figure.subplots(
            3, 1, sharex=True, gridspec_kw={"height_ratios": [6.0, 0.9, 2.4]}
        )
        low_m, high_m = float(np.nanmin(moved_m)) - MARGIN_M, float(np.nanmax(moved_m)) + MARGIN_M
        _draw_speed(speed, line, cycles, truth, (low_m, high_m))
        _draw_stations(speed, line, stops, (low_m, high_m))
        _draw_profile(profile, line, (low_m, high_m))
        _draw_accel(accel, cycles, truth)
        accel.set_xlabel("chainage of the front coupler, m")
        accel.set_xlim(low_m, high_m)
        figure.suptitle(title, x=0.012, ha="left", fontsize=13, fontweight="bold")
        with whole_file(path) as part:
            figure.savefig(part)
    return True


def _draw_speed(
    axes: Axes,
    line: LineMap,
    cycles: Columns,
    truth: Columns | None,
    span_m: tuple[float, float],
) -> None:
    at_m = cycles.numbers("front_m")
    civil_m = np.arange(span_m[0], span_m[1], 1.0)
    civil_kmh = np.array([line.limit_mps(float(x)) for x in civil_m]) * KMH_PER_MPS
    top_kmh = float(np.max(civil_kmh)) + 14.0
    axes.plot(civil_m, civil_kmh, color=QUIET, lw=1.2, ls=(0, (6, 2)), label="civil limit")
    for column, color, width, label in (
        ("emergency_mps", EMERGENCY, 1.3, "emergency brake above"),
        ("permitted_mps", PERMITTED, 1.3, "permitted (ceiling)"),
        ("target_mps", TARGET, 1.0, "target of the ATO"),
    ):
        x_m, y_kmh = _along(at_m, cycles.numbers(column) * KMH_PER_MPS)
        axes.plot(x_m, y_kmh, color=color, lw=width, label=label)
    source = truth or cycles
    label = "speed, true" if truth else "speed, by the controller's odometry"
    axes.plot(
        source.numbers("front_m"),
        source.numbers("speed_mps") * KMH_PER_MPS,
        color=TRAIN,
        lw=2.2,
        label=label,
    )
    _draw_tags(axes, line, span_m)
    axes.set_ylim(0.0, top_kmh)
    axes.set_ylabel("speed, km/h")
    axes.grid(axis="y", color="#e4e7eb", lw=0.7)
    axes.legend(loc="upper center", ncols=6, frameon=False, bbox_to_anchor=(0.5, 1.0), fontsize=9)
    _bare(axes)


def _along(at_m: Numbers, values: Numbers) -> tuple[Numbers, Numbers]:
    """Keep a gap where one of both values is unknown."""
    return np.where(np.isnan(values), np.nan, at_m), values


def _draw_tags(axes: Axes, line: LineMap, span_m: tuple[float, float]) -> None:
    for kinds, marker, size in (
        ({TagKind.BALISE}, "|", 50.0),
        ({TagKind.T1, TagKind.T2, TagKind.T3, TagKind.STOP}, "^", 22.0),
    ):
        at_m = [t.position_m for t in line.tags if t.kind in kinds]
        shown_m = [x for x in at_m if span_m[0] <= x <= span_m[1]]
        axes.scatter(shown_m, [1.2] * len(shown_m), marker=marker, s=size, color=QUIET, zorder=4)


def _draw_stations(
    axes: Axes, line: LineMap, stops: Sequence[StationStop], span_m: tuple[float, float]
) -> None:
    errors_m = {stop.station: stop.error_m for stop in stops}
    for station in line.stations:
        if not span_m[0] <= station.stop_m <= span_m[1]:
            continue
        start_m = max(station.platform_start_m, span_m[0])
        axes.axvspan(start_m, station.platform_end_m, color=PLATFORM, zorder=0)
        error_m = errors_m.get(station.name)
        text = station.name if error_m is None else f"{station.name}  {error_m * 100.0:+.1f} cm"
        axes.annotate(
            text,
            (station.stop_m, 0.0),
            xytext=(-4, 14),
            textcoords="offset points",
            rotation=90,
            va="bottom",
            ha="right",
            fontsize=9,
            color=INK,
        )
        axes.axvline(station.stop_m, color=QUIET, lw=0.8)


def _draw_profile(axes: Axes, line: LineMap, span_m: tuple[float, float]) -> None:
    at_m = np.arange(span_m[0], span_m[1], 2.0)
    height_m = np.array([line.height_m(float(x)) for x in at_m])
    height_m = height_m - float(np.min(height_m))
    axes.fill_between(at_m, height_m, -0.3, color="#c9d3dc", lw=0.0)
    for curve in line.curves:
        if curve.end_m > span_m[0] and curve.start_m < span_m[1]:
            axes.axvspan(curve.start_m, curve.end_m, color="#f0d9a8", lw=0.0, zorder=0)
            axes.annotate(
                f"R {curve.radius_m:.0f} m",
                ((curve.start_m + curve.end_m) / 2.0, 0.9),
                xycoords=("data", "axes fraction"),
                ha="center",
                va="top",
                fontsize=8,
                color=INK,
            )
    axes.set_ylim(-0.3, max(4.0, float(np.max(height_m)) + 1.0))
    axes.set_ylabel("height, m")
    _bare(axes)


def _draw_accel(axes: Axes, cycles: Columns, truth: Columns | None) -> None:
    axes.axhline(0.0, color=QUIET, lw=0.7)
    axes.plot(
        cycles.numbers("front_m"),
        cycles.numbers("demand_mps2"),
        color=TARGET,
        lw=1.0,
        label="demanded",
    )
    source, label = (truth, "true, mean of all cars") if truth else (cycles, "by odometry")
    at_m, accel_mps2 = source.numbers("front_m"), source.numbers("accel_mps2")
    axes.plot(at_m, accel_mps2, color=TRAIN, lw=1.4, label=label)
    axes.set_ylim(-1.4, 1.4)
    axes.set_ylabel("acceleration, m/s²")
    axes.grid(axis="y", color="#e4e7eb", lw=0.7)
    axes.legend(loc="upper right", ncols=2, frameon=False, fontsize=9)
    _bare(axes)


def _bare(axes: Axes) -> None:
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
