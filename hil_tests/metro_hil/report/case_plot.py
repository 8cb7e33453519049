"""The plot of one case: speed below all curves, place in its interval, and states over time."""

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from firmware_py.storage.whole_file import whole_file
from firmware_py.trackdb import LineMap
from metro_hil.model.log_columns import Columns, Numbers
from metro_hil.report.plot import (
    EMERGENCY,
    INK,
    KMH_PER_MPS,
    PERMITTED,
    PLATFORM,
    QUIET,
    TRAIN,
)
from plant_emulator.faults.declared_wayside import TemporaryRestriction
from plant_emulator.faults.plan import read_faults

NAME: Final = "case.png"
MARGIN_RATIO: Final = 0.03
MARGIN_M_MIN: Final = 8.0
AHEAD_M_MAX: Final = 250.0
"""Greatest distance to an end of authority that is drawn, m; beyond it, the curves would become too
small."""
ENDS_MAX: Final = 4
END_APART_M: Final = 1.0
STANDS_MAX: Final = 12
STAND_APART_M: Final = 0.05
WORD_WIDTH_RATIO: Final = 0.0065
"""Least width of a segment for each letter of its label, as a share of the whole time."""
BELIEVED: Final = "#7fb2ea"
WARNING: Final = "#e8b13a"
SERVICE: Final = "#e0752d"
RESTRICTION: Final = "#8e44ad"
SHADE_EMERGENCY: Final = "#f6d3d5"
SHADE_SERVICE: Final = "#fbe3d0"
LANE_COLOURS: Final[Mapping[str, str]] = {
    "emergency": EMERGENCY,
    "service": SERVICE,
    "warning": WARNING,
    "nominal": "#a9d3ac",
    "authorised": "#a9d3ac",
    "no_authority": "#d3d9df",
    "standby": "#d3d9df",
    "asleep": "#aab4be",
    "restricted": "#d7bde2",
    "creep": "#c39bd3",
    "jog": "#9fd8d4",
    "open": BELIEVED,
}
OTHER_COLOUR: Final = "#e4e7eb"


@dataclass(frozen=True, slots=True)
class RestrictionSpan:
    """A stretch of line with a temporary speed limit."""

    start_m: float
    end_m: float
    limit_mps: float


def stretches_of(faults: Sequence[Mapping[str, Any]]) -> tuple[RestrictionSpan, ...]:
    """The temporary restrictions among the faults and orders of a case. Raises SettingsError."""
    orders = (plan.parameters for plan in read_faults(faults, "faults"))
    return tuple(
        RestrictionSpan(order.start_m, order.end_m, order.limit_mps)
        for order in orders
        if isinstance(order, TemporaryRestriction)
    )


def draw_case(
    path: Path,
    title: str,
    line: LineMap,
    cycles: Columns,
    truth: Columns,
    restrictions: Sequence[RestrictionSpan] = (),
) -> bool:
    """Write a PNG. False if the truth log is empty, so that nothing can be drawn."""
    if len(truth) < 2 or not len(cycles):
        return False
    with mpl.rc_context({"font.size": 10, "axes.edgecolor": QUIET, "text.color": INK}):
        figure = Figure(figsize=(13.0, 9.0), dpi=100, layout="constrained")
        FigureCanvasAgg(figure)
        grid = figure.add_gridspec(3, 1, height_ratios=[6.0, 2.0, 1.7])
        speed = figure.add_subplot(grid[0])
        place = figure.add_subplot(grid[1], sharex=speed)
        strip = figure.add_subplot(grid[2])
        span_m = _span_m(cycles, truth)
        _draw_speed(speed, line, cycles, truth, restrictions, span_m)
        _draw_place(place, cycles, truth)
        _draw_strip(strip, cycles, truth)
        speed.set_xlim(*span_m)
        figure.suptitle(title, x=0.012, ha="left", fontsize=13, fontweight="bold")
        with whole_file(path) as part:
            figure.savefig(part)
    return True


def _span_m(cycles: Columns, truth: Columns) -> tuple[float, float]:
    """Range that the train covered, extended to the end of its authority if that is near."""
    front_m = truth.numbers("front_m")
    low_m, high_m = float(np.nanmin(front_m)), float(np.nanmax(front_m))
    near = [end_m for end_m in _ends_m(cycles) if high_m < end_m < high_m + AHEAD_M_MAX]
    high_m = max([high_m, *near])
    margin_m = max(MARGIN_M_MIN, MARGIN_RATIO * (high_m - low_m))
    return low_m - margin_m, high_m + margin_m


def _ends_m(cycles: Columns) -> list[float]:
    """Ends of authority that the controller used, in the order in which they came.

    Before the first authority, the controller limits itself to its present place; that is not an
    end to draw.
    """
    to_end_m = cycles.numbers("distance_to_authority_m")
    ends_m = cycles.numbers("front_high_m") + to_end_m
    found: list[float] = []
    for end_m in ends_m[np.isfinite(ends_m) & (to_end_m > END_APART_M)]:
        if not found or abs(end_m - found[-1]) > END_APART_M:
            found.append(float(end_m))
    return list(dict.fromkeys(round(end_m, 1) for end_m in found))


def _draw_speed(
    axes: Axes,
    line: LineMap,
    cycles: Columns,
    truth: Columns,
    restrictions: Sequence[RestrictionSpan],
    span_m: tuple[float, float],
) -> None:
    top_kmh = _draw_limits(axes, line, restrictions, span_m)
    at_m = cycles.numbers("front_m")
    for column, color, width, label in (
        ("emergency_mps", EMERGENCY, 1.5, "emergency brake"),
        ("service_mps", SERVICE, 1.1, "service brake"),
        ("warning_mps", WARNING, 1.1, "warning"),
        ("permitted_mps", PERMITTED, 1.4, "permitted"),
    ):
        kmh = cycles.numbers(column) * KMH_PER_MPS
        axes.plot(np.where(np.isnan(kmh), np.nan, at_m), kmh, color=color, lw=width, label=label)
    axes.plot(at_m, cycles.numbers("speed_mps") * KMH_PER_MPS, color=BELIEVED, lw=4.0,
              alpha=0.6, label="speed, believed")  # fmt: skip
    front_m, speed_kmh = truth.numbers("front_m"), truth.numbers("speed_mps") * KMH_PER_MPS
    axes.plot(front_m, speed_kmh, color=TRAIN, lw=1.6, label="speed, true")
    shades = _shade_brakes(axes, cycles, truth)
    _draw_stations(axes, line, span_m)
    _draw_ends(axes, cycles, span_m)
    _draw_stands(axes, front_m, speed_kmh)
    low_kmh = min(0.0, float(np.nanmin(speed_kmh)))
    highest_kmh = max(top_kmh + 16.0, float(np.nanmax(speed_kmh)) + 8.0)
    axes.set_ylim(low_kmh - (2.0 if low_kmh < 0.0 else 0.0), highest_kmh)
    axes.set_ylabel("speed, km/h")
    axes.set_xlabel("chainage of the front coupler, m", labelpad=1)
    axes.grid(axis="y", color="#e4e7eb", lw=0.7)
    handles = [*axes.get_legend_handles_labels()[0], *shades]
    axes.legend(handles=handles, loc="lower center", ncols=5, frameon=False, fontsize=8.5,
                bbox_to_anchor=(0.5, 1.0))  # fmt: skip
    _bare(axes)


def _draw_limits(
    axes: Axes, line: LineMap, restrictions: Sequence[RestrictionSpan], span_m: tuple[float, float]
) -> float:
    """Draw civil limits as steps and temporary ones as bars; return the highest in km/h."""
    civil_m = np.arange(span_m[0], span_m[1], max(0.1, (span_m[1] - span_m[0]) / 2000.0))
    civil_kmh = np.array([line.limit_mps(float(x)) for x in civil_m]) * KMH_PER_MPS
    axes.plot(civil_m, civil_kmh, color=INK, lw=1.1, ls=(0, (6, 3)), label="civil limit", zorder=5)
    for number, stretch in enumerate(restrictions):
        axes.plot(
            (stretch.start_m, stretch.end_m),
            (stretch.limit_mps * KMH_PER_MPS,) * 2,
            color=RESTRICTION,
            lw=3.0,
            label="" if number else "temporary restriction",
        )
    return float(np.max(civil_kmh))


def _shade_brakes(axes: Axes, cycles: Columns, truth: Columns) -> list[Patch]:
    """Shade where the emergency brake was on, and where protection braked, while the train
    moved."""
    moving = truth.numbers("speed_mps") != 0.0
    emergency = np.array(truth.flags("emergency"), dtype=np.bool_) & moving
    service = np.array([state == "service" for state in cycles.texts("supervision")])
    for (log, on), color in (
        ((truth, emergency), SHADE_EMERGENCY),
        ((cycles, service), SHADE_SERVICE),
    ):
        at_m = log.numbers("front_m")
        for first, last in _runs(on):
            low_m, high_m = np.nanmin(at_m[first:last]), np.nanmax(at_m[first:last])
            axes.axvspan(low_m, max(high_m, low_m + 0.05), color=color, lw=0.0, zorder=0.5)
    return [
        Patch(color=SHADE_EMERGENCY, label="emergency brake on"),
        Patch(color=SHADE_SERVICE, label="protection brakes"),
    ]


def _runs(on: "np.ndarray[Any, np.dtype[np.bool_]]") -> list[tuple[int, int]]:
    """First row, and row after the last, of each stretch of true values."""
    edges = np.flatnonzero(np.diff(np.concatenate(([False], on, [False])).astype(np.int8)))
    return [(int(a), int(b)) for a, b in zip(edges[::2], edges[1::2], strict=True)]


def _draw_stations(axes: Axes, line: LineMap, span_m: tuple[float, float]) -> None:
    for station in line.stations:
        low_m, high_m = station.platform_start_m, station.platform_end_m
        if high_m < span_m[0] or low_m > span_m[1]:
            continue
        axes.axvspan(max(low_m, span_m[0]), min(high_m, span_m[1]), color=PLATFORM, zorder=0)
        if span_m[0] <= station.stop_m <= span_m[1]:
            axes.axvline(station.stop_m, color=QUIET, lw=0.8, ls=":")
            _upright(axes, station.stop_m, f"{station.name} {station.stop_m:g} m", QUIET)


def _draw_ends(axes: Axes, cycles: Columns, span_m: tuple[float, float]) -> None:
    shown = [end_m for end_m in _ends_m(cycles) if span_m[0] <= end_m <= span_m[1]]
    for end_m in shown[-ENDS_MAX:]:
        axes.axvline(end_m, color=EMERGENCY, lw=2.2)
        _upright(axes, end_m, f"end of authority {end_m:g} m", EMERGENCY)


def _draw_stands(axes: Axes, front_m: Numbers, speed_kmh: Numbers) -> None:
    """Draw every place where the train came to rest."""
    stopped = np.flatnonzero((speed_kmh[:-1] != 0.0) & (speed_kmh[1:] == 0.0)) + 1
    shown: list[float] = []
    if speed_kmh[-1] != 0.0:
        end = (float(front_m[-1]), float(speed_kmh[-1]))
        axes.plot(*end, marker="x", ms=8, mew=2, color=TRAIN, zorder=6)
        axes.annotate("the run ends", end, xytext=(6, 6), textcoords="offset points",
                      fontsize=8.5, color=TRAIN)  # fmt: skip
    for row in stopped:
        at_m = float(front_m[row])
        if all(abs(at_m - other_m) > STAND_APART_M for other_m in shown):
            shown.append(at_m)
    for number, at_m in enumerate(shown[:STANDS_MAX]):
        axes.plot([at_m], [0.0], marker="v", ms=9, color=TRAIN, clip_on=False, zorder=6)
        axes.annotate(
            f"stands at {at_m:.2f} m",
            (at_m, 0.0),
            xytext=(-6, 10 + 12 * (number % 4)),
            textcoords="offset points",
            ha="right",
            fontsize=8.5,
            color=TRAIN,
        )


def _upright(axes: Axes, at_m: float, words: str, color: str) -> None:
    axes.annotate(
        words,
        (at_m, 0.98),
        xycoords=("data", "axes fraction"),
        xytext=(-3, 0),
        textcoords="offset points",
        rotation=90,
        va="top",
        ha="right",
        fontsize=8.5,
        color=color,
    )


def _draw_place(axes: Axes, cycles: Columns, truth: Columns) -> None:
    """Draw ends and best estimate of the position interval, each minus the true front."""
    times_s, true_s = cycles.numbers("t_s"), truth.numbers("t_s")
    true_m = np.interp(times_s, true_s, truth.numbers("front_m"))
    true_m = np.where(times_s <= true_s[-1], true_m, np.nan)
    low_m, best_m, high_m = (
        cycles.numbers(name) - true_m for name in ("front_low_m", "front_m", "front_high_m")
    )
    axes.axhline(0.0, color=INK, lw=0.9)
    axes.fill_between(true_m, low_m, high_m, color="#cfe1f5", lw=0.0, label="position interval")
    axes.plot(true_m, low_m, color=TRAIN, lw=0.9)
    axes.plot(true_m, high_m, color=TRAIN, lw=0.9)
    axes.plot(true_m, best_m, color=PERMITTED, lw=1.3, label="best estimate")
    outside = (low_m > 0.0) | (high_m < 0.0)
    if np.any(outside):
        axes.plot(true_m[outside], np.zeros(int(outside.sum())), ".", color=EMERGENCY,
                  label="truth outside")  # fmt: skip
    axes.set_ylabel("minus true place, m")
    axes.set_xlabel("true chainage of the front coupler, m", labelpad=1)
    axes.grid(axis="y", color="#e4e7eb", lw=0.7)
    axes.legend(loc="upper right", ncols=3, frameon=False, fontsize=8.5)
    _bare(axes)


def _draw_strip(axes: Axes, cycles: Columns, truth: Columns) -> None:
    """Draw the states of controller and doors over time."""
    cycle_s, truth_s = cycles.numbers("t_s"), truth.numbers("t_s")
    lanes: list[tuple[str, Numbers, Sequence[str]]] = [
        ("mode", cycle_s, cycles.texts("mode")),
        ("protection", cycle_s, cycles.texts("supervision")),
        ("operation", cycle_s, cycles.texts("phase")),
        ("left doors", truth_s, truth.texts("door_left")),
        ("right doors", truth_s, truth.texts("door_right")),
    ]
    end_s = float(max(cycle_s[-1], truth_s[-1]))
    for row, (_, times_s, states) in enumerate(lanes):
        for begin_s, until_s, state in _segments(times_s, states, end_s):
            color = LANE_COLOURS.get(state, OTHER_COLOUR)
            axes.broken_barh([(begin_s, until_s - begin_s)], (row - 0.4, 0.8), facecolors=color,
                             edgecolor="white", lw=0.6)  # fmt: skip
            words = state.replace("_", " ")
            if until_s - begin_s > WORD_WIDTH_RATIO * len(words) * end_s:
                ink = "white" if color == EMERGENCY else INK
                axes.text((begin_s + until_s) / 2.0, row, words, ha="center", va="center",
                          fontsize=8, color=ink)  # fmt: skip
    axes.set_yticks(range(len(lanes)), [name for name, _, _ in lanes])
    axes.set_ylim(len(lanes) - 0.5, -0.5)
    axes.set_xlim(0.0, end_s)
    axes.set_xlabel("time, s", labelpad=1)
    axes.tick_params(axis="y", length=0)
    _bare(axes)


def _segments(
    times_s: Numbers, states: Sequence[str], end_s: float
) -> list[tuple[float, float, str]]:
    """Begin, end and state of each stretch of rows with equal state."""
    changes = [0] + [
        row for row, (a, b) in enumerate(itertools.pairwise(states), start=1) if a != b
    ]
    ends_s = [*(float(times_s[row]) for row in changes[1:]), end_s]
    return [
        (float(times_s[row]), until_s, states[row])
        for row, until_s in zip(changes, ends_s, strict=True)
    ]


def _bare(axes: Axes) -> None:
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
