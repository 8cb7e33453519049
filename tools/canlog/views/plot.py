"""Draws panels of traces as PNG or SVG for `canlog plot`."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from canlog.run import NS_PER_S
from canlog.views.extremes import kept
from canlog.views.happenings import Happening
from canlog.views.place import at_instants
from canlog.views.span import TimeSpan
from canlog.views.traces import Floats, SignalTrace
from firmware_py.storage.whole_file import whole_file

INK: Final = "#1d2733"
QUIET: Final = "#66727f"
RULE: Final = "#e2e5e8"
WEIGHT_COLORS: Final = ("#9aa5b1", "#b97700", "#c2331f")
LINES: Final = (
    "#1f5fbf",
    "#d97a00",
    "#c2331f",
    "#0b7a5b",
    "#6a4fb3",
    "#0093a8",
    "#b0357e",
    "#7a6a12",
)
STATES: Final = (
    "#dbe7f8",
    "#d8efe6",
    "#fbecc8",
    "#e8e1f8",
    "#fbe0da",
    "#d5eef2",
    "#f7dcec",
    "#ece7c6",
)
DPI: Final = 110
WIDTH_IN: Final = 13.0
LINE_IN: Final = 2.1
STATE_IN: Final = 0.34
MARGIN_IN: Final = 1.0
LABEL_CHARS_IN: Final = 11.0
"""Characters of a state's name that fit on an inch."""
MARKS_NAMED_MAX: Final = 24
NAME_ROOM_RATIO: Final = 0.012
"""Share of the picture's width; an event nearer than this to a named one gets no name."""


@dataclass(frozen=True, slots=True)
class Picture:
    """Contents of a plot."""

    title: str
    panels: Sequence[Sequence[SignalTrace]]
    span: TimeSpan
    happenings: Sequence[Happening] = ()
    place: SignalTrace | None = None
    """Position over time, for drawing over distance instead of time."""


def draw(picture: Picture, path: Path) -> int:
    """Write the file, PNG or SVG by its suffix; equal pictures give equal bytes.

    Returns:
        The number of samples drawn in all panels.
    """
    rows = [row for panel in picture.panels for row in _rows(panel)]
    heights = [_height_in(row) for row in rows]
    look: Any = {
        "font.size": 9.5,
        "axes.edgecolor": QUIET,
        "text.color": INK,
        "axes.labelcolor": INK,
        "xtick.color": QUIET,
        "ytick.color": QUIET,
        "svg.hashsalt": "canlog",
    }
    with mpl.rc_context(look):
        figure = Figure(figsize=(WIDTH_IN, sum(heights) + MARGIN_IN), dpi=DPI, layout="constrained")
        FigureCanvasAgg(figure)
        grid = figure.subplots(
            len(rows), 1, sharex=True, squeeze=False, gridspec_kw={"height_ratios": heights}
        )
        drawn = 0
        for axes, row in zip(grid[:, 0], rows, strict=True):
            for side in ("top", "right"):
                axes.spines[side].set_visible(False)
            draw_row = _states if row[0].is_state else _lines
            drawn += draw_row(axes, row, picture)
            _marks(axes, picture, named=axes is grid[0, 0])
        _x_axis(grid[-1, 0], picture)
        figure.align_ylabels(grid[:, 0])
        figure.suptitle(picture.title, x=0.012, ha="left", fontsize=12, fontweight="bold")
        meta = {"Date": None} if path.suffix.lower() == ".svg" else {"Software": None}
        with whole_file(path) as part:
            figure.savefig(part, metadata=meta)
    return drawn


def _rows(panel: Sequence[SignalTrace]) -> Iterator[list[SignalTrace]]:
    """Yield the lines of a panel and, below them, its bands of states."""
    for is_state in (False, True):
        row = [trace for trace in panel if trace.is_state is is_state]
        if row:
            yield row


def _height_in(row: Sequence[SignalTrace]) -> float:
    return 0.15 + STATE_IN * len(row) if row[0].is_state else LINE_IN


def _lines(axes: Axes, traces: Sequence[SignalTrace], picture: Picture) -> int:
    drawn = 0
    axes.grid(visible=True, color=RULE, linewidth=0.7)
    axes.set_axisbelow(True)
    for color, trace in zip(_cycled(LINES, len(traces)), traces, strict=True):
        x, values, gaps = _sampled(trace, picture)
        drawn += len(values)
        x, values = _broken(x, values, gaps)
        few = len(values) < 60
        axes.plot(x, values, color=color, lw=1.2, marker="." if few else "", label=trace.name)
    units = list(dict.fromkeys(trace.unit for trace in traces if trace.unit not in ("", "1")))
    axes.set_ylabel(", ".join(units) if units else "")
    axes.yaxis.set_major_locator(MaxNLocator(5))
    axes.margins(y=0.08)
    axes.legend(
        loc="lower left",
        bbox_to_anchor=(0.0, 1.0),
        fontsize=8.5,
        frameon=False,
        ncols=4,
        borderaxespad=0.1,
        handlelength=1.4,
    )
    return drawn


def _sampled(trace: SignalTrace, picture: Picture) -> tuple[Floats, Floats, "np.ndarray[Any, Any]"]:
    """Return x, values, and after which samples the line is broken."""
    span = picture.span
    rows = kept(
        trace.at_ns,
        trace.values,
        start_ns=span.start_ns,
        end_ns=span.end_ns,
        columns=round(WIDTH_IN * DPI),
    )
    at_ns, values = trace.at_ns[rows], trace.values[rows]
    if trace.gap_ns:
        # A gap between sampled rows is no evidence, so compare each row with its neighbour in the
        # log.
        following = np.minimum(rows + 1, len(trace) - 1)
        gaps = (trace.at_ns[following] - at_ns) > trace.gap_ns
    else:
        gaps = np.zeros(len(rows), np.bool_)
    if picture.place is not None:
        return at_instants(picture.place, at_ns, hold=True), values, gaps
    return (at_ns - span.zero_ns) / NS_PER_S, values, gaps


def _broken(x: Floats, values: Floats, gaps: Any) -> tuple[Floats, Floats]:
    where = np.flatnonzero(gaps) + 1
    return np.insert(x, where, np.nan), np.insert(values, where, np.nan)


def _states(axes: Axes, traces: Sequence[SignalTrace], picture: Picture) -> int:
    drawn = 0
    for row, trace in enumerate(traces):
        x, values, _ = _sampled(trace, picture)
        drawn += len(values)
        if len(values):
            _band(axes, -row, trace, x, values, _limits(picture))
    axes.set_yticks([-row for row in range(len(traces))], [_short(t.name) for t in traces])
    axes.set_ylim(-len(traces) + 0.5, 0.5)
    axes.tick_params(left=False)
    return drawn


def _band(
    axes: Axes, y: float, trace: SignalTrace, x: Floats, values: Floats, limits: tuple[float, float]
) -> None:
    """Draw a state until the next one, and the last one to the end of the picture."""
    low, high = limits
    starts = np.flatnonzero(np.append(True, values[1:] != values[:-1]))
    edges = np.clip(np.append(x[starts], high), low, high)
    numbers = {value: n for n, value in enumerate(sorted(trace.choices))}
    pieces: dict[str, list[tuple[float, float]]] = {}
    for at, value in enumerate(values[starts].tolist()):
        left, right = float(edges[at]), float(edges[at + 1])
        color = STATES[numbers.get(value, len(numbers)) % len(STATES)]
        pieces.setdefault(color, []).append((left, right - left))
        text = trace.text_of(value)
        room = (right - left) / max(high - low, 1e-12) * (WIDTH_IN - 2) * LABEL_CHARS_IN
        if room > len(text):
            axes.text(
                (left + right) / 2, y, text, ha="center", va="center", fontsize=7, clip_on=True
            )
    for color, spans in pieces.items():
        axes.broken_barh(spans, (y - 0.4, 0.8), facecolor=color, edgecolor="white", lw=0.4)


def _short(name: str) -> str:
    return name.partition(".")[2]


def _cycled(colors: Sequence[str], count: int) -> list[str]:
    return [colors[index % len(colors)] for index in range(count)]


def _limits(picture: Picture) -> tuple[float, float]:
    span = picture.span
    if picture.place is None:
        return span.seconds(span.start_ns), span.seconds(span.end_ns)
    there = (picture.place.at_ns >= span.start_ns) & (picture.place.at_ns <= span.end_ns)
    places_m = picture.place.values[there]
    if not len(places_m):
        return 0.0, 1.0
    return float(np.nanmin(places_m)), float(np.nanmax(places_m))


def _x_axis(axes: Axes, picture: Picture) -> None:
    low, high = _limits(picture)
    axes.set_xlim(low, high if high > low else low + 1.0)
    if picture.place is not None:
        axes.set_xlabel(f"{picture.place.name}, {picture.place.unit or 'm'}")
    else:
        axes.set_xlabel("time, s")


def _marks(axes: Axes, picture: Picture, *, named: bool) -> None:
    """Draw a line for each event, and its name if there is room; grave events come first."""
    span = picture.span
    here = [each for each in picture.happenings if span.start_ns <= each.at_ns <= span.end_ns]
    low, high = _limits(picture)
    taken: list[float] = []
    for each in sorted(here, key=lambda each: -each.weight):
        x = _x_of(each.at_ns, picture)
        color, width = WEIGHT_COLORS[each.weight], 0.5 + 0.4 * each.weight
        axes.axvline(x, alpha=0.35 + 0.25 * each.weight, zorder=0.5, color=color, lw=width)
        near = any(abs(x - other) < NAME_ROOM_RATIO * (high - low) for other in taken)
        if named and not near and (len(here) <= MARKS_NAMED_MAX or each.weight == 2):
            taken.append(x)
            axes.annotate(
                each.kind.lower().replace("_", " "),
                (x, 1.0),
                (1, -4),
                xycoords=("data", "axes fraction"),
                textcoords="offset points",
                rotation=90,
                ha="left",
                va="top",
                fontsize=7,
                color=color,
            )


def _x_of(at_ns: int, picture: Picture) -> float:
    if picture.place is None:
        return picture.span.seconds(at_ns)
    return float(at_instants(picture.place, np.array([at_ns], np.int64), hold=True)[0])
