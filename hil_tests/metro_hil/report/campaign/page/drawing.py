"""Pictures as inline SVG, coloured by the style sheet; equal numbers give equal text."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from markupsafe import Markup, escape

from metro_hil.model.log_columns import Numbers
from metro_hil.report.campaign.units import number_text, with_unit

DOTS_MAX: Final = 60
HISTOGRAM_BINS: Final = 48
POINTS_MAX: Final = 420
TICKS: Final = 5
LABEL_CHARACTERS: Final = 26
CHARACTER_PX: Final = 6.2


class PlotScale:
    """Linear map from values to pixels."""

    def __init__(self, values: tuple[float, float], pixels: tuple[float, float]) -> None:
        self.values = values
        self.pixels = pixels

    def at(self, value: float) -> float:
        low, high = self.values
        share = (value - low) / (high - low) if high > low else 0.5
        return self.pixels[0] + share * (self.pixels[1] - self.pixels[0])

    def ticks(self, count: int = TICKS) -> list[float]:
        """About `count` round values within the range."""
        low, high = self.values
        if not high > low:
            return [low]
        raw = (high - low) / count
        magnitude = 10.0 ** np.floor(np.log10(raw))
        step = float(next(m * magnitude for m in (1.0, 2.0, 5.0, 10.0) if m * magnitude >= raw))
        first, last = int(np.ceil(low / step)), int(np.floor(high / step))
        return [number * step for number in range(first, last + 1)]


def span_of(values: Sequence[float], *also: float) -> tuple[float, float]:
    """Range from least to greatest value with some room; never empty."""
    low, high = min((*values, *also)), max((*values, *also))
    room = (high - low) * 0.04 or max(abs(high) * 0.1, 1e-6)
    return low - room, high + room


def picture(width: float, height: float, title: str, parts: Sequence[str]) -> Markup:
    """The parts are trusted: the caller must escape names."""
    head = Markup('<svg viewBox="0 0 {} {}" width="{}" height="{}" role="img"><title>{}</title>')
    body = Markup("").join(Markup(part) for part in parts)  # noqa: S704
    return (
        head.format(px(width), px(height), px(width), px(height), title) + body + Markup("</svg>")
    )


def px(value: float) -> str:
    """Coordinate as text, rounded to a tenth of a pixel."""
    shown = f"{value:.1f}".removesuffix(".0")
    return "0" if shown == "-0" else shown


def line(x1: float, y1: float, x2: float, y2: float, style: str) -> str:
    return f'<line class="{style}" x1="{px(x1)}" y1="{px(y1)}" x2="{px(x2)}" y2="{px(y2)}"/>'


def box(x1: float, y1: float, x2: float, y2: float, style: str) -> str:
    return (
        f'<rect class="{style}" x="{px(x1)}" y="{px(y1)}" width="{px(max(x2 - x1, 0.5))}" '
        f'height="{px(max(y2 - y1, 0.0))}"/>'
    )


def text(x: float, y: float, words: str, style: str = "", anchor: str = "start") -> str:
    place = f'x="{px(x)}" y="{px(y)}" text-anchor="{anchor}"'
    return f'<text class="{style}" {place}>{escape(words)}</text>'


def dot(x: float, y: float, style: str, title: str = "", radius_px: float = 2.6) -> str:
    inner = f"<title>{escape(title)}</title>" if title else ""
    return f'<circle class="{style}" cx="{px(x)}" cy="{px(y)}" r="{px(radius_px)}">{inner}</circle>'


def margin_strip(values: Sequence[float], unit: str, least_title: str) -> Markup:
    """Strip of the margins: zero marks the violation, the triangle the least margin."""
    width, base = 300.0, 34.0
    scale = PlotScale(span_of(values, 0.0), (6.0, width - 6.0))
    zero_px, least = scale.at(0.0), min(values)
    parts = []
    if least < 0.0:
        parts.append(box(0.0, 4.0, zero_px, base, "bad-zone"))
    if len(values) <= DOTS_MAX:
        parts += [dot(scale.at(v), base - 7.0 - 3.0 * (i % 5), "dot") for i, v in enumerate(values)]
    else:
        parts += _bars(values, scale, base, base - 6.0, bad_below_zero=True)
    parts += [line(0.0, base, width, base, "axis"), line(zero_px, 2.0, zero_px, base, "zero")]
    x = scale.at(least)
    style = "least bad" if least < 0.0 else "least"
    parts.append(
        f'<path class="{style}" d="M{px(x)} {px(base)}l-4 7h8z">'
        f"<title>{escape(least_title)}</title></path>"
    )
    anchor = "end" if x > width * 0.6 else "start"
    shift = -7.0 if anchor == "end" else 7.0
    parts.append(text(x + shift, base + 12.0, with_unit(least, unit), "tick strong", anchor))
    if anchor == "start" and x < width * 0.4 and len(values) > 1:
        most = with_unit(max(values), unit)
        parts.append(text(scale.at(max(values)), base + 12.0, most, "tick", "end"))
    return picture(width, 50.0, f"margins, least {with_unit(least, unit)}", parts)


def _bars(
    values: Sequence[float],
    scale: PlotScale,
    base: float,
    height: float,
    *,
    bad_below_zero: bool = False,
) -> list[str]:
    low, high = min(values), max(values)
    if high - low > HISTOGRAM_BINS * np.spacing(max(abs(low), abs(high))):
        counts, edges = np.histogram(values, bins=HISTOGRAM_BINS, range=(low, high))
    else:
        # Equal, or too near to each other for bins of different edges.
        counts, edges = np.array([len(values)]), np.array([low, low])
    top = int(counts.max())
    parts = []
    for count, a, b in zip(counts.tolist(), edges[:-1].tolist(), edges[1:].tolist(), strict=True):
        if count:
            style = "bar bad" if bad_below_zero and b <= 0.0 and low < 0.0 else "bar"
            tall = max(1.0, height * count / top)
            parts.append(box(scale.at(a), base - tall, scale.at(b) - 0.4, base, style))
    return parts


def histogram(
    values: Sequence[float],
    unit: str,
    mean: tuple[float, float, float],
    domain: tuple[float, float],
) -> Markup:
    """Histogram of one measure, with the mean and its confidence interval above."""
    width, height, base = 310.0, 132.0, 104.0
    scale = PlotScale(domain, (10.0, width - 10.0))
    parts = []
    for tick in scale.ticks():
        parts.append(line(scale.at(tick), 20.0, scale.at(tick), base, "grid"))
        parts.append(text(scale.at(tick), base + 14.0, number_text(tick), "tick", "middle"))
    parts += _bars(values, scale, base, base - 26.0)
    parts.append(line(0.0, base, width, base, "axis"))
    best, low, high = (scale.at(value) for value in mean)
    parts += [line(low, 13.0, high, 13.0, "interval"), dot(best, 13.0, "mean", radius_px=3.4)]
    parts.append(text(width / 2.0, base + 27.0, unit if unit != "1" else "", "tick", "middle"))
    return picture(width, height, "distribution", parts)


@dataclass(frozen=True, slots=True)
class LevelGroup:
    """Values of one level of a factor."""

    label: str
    values: Numbers


def by_level_plot(groups: Sequence[LevelGroup], domain: tuple[float, float], unit: str) -> Markup:
    """A row for each level: a dot for every value, or 5–95 %, quartiles and median of many."""
    longest = max(len(_short(group.label)) for group in groups)
    left = 14.0 + CHARACTER_PX * longest
    width, row = left + 236.0, 19.0
    base = 6.0 + row * len(groups)
    scale = PlotScale(domain, (left + 6.0, width - 46.0))
    parts = []
    for tick in scale.ticks(3):
        parts.append(line(scale.at(tick), 2.0, scale.at(tick), base, "grid"))
        parts.append(text(scale.at(tick), base + 13.0, number_text(tick), "tick", "middle"))
    for number, group in enumerate(groups):
        y = 6.0 + row * (number + 0.5)
        parts.append(text(left - 2.0, y + 4.0, _short(group.label), "label", "end"))
        parts.append(text(width - 2.0, y + 4.0, f"n {len(group.values)}", "tick", "end"))
        parts += _row_of(group.values, scale, y)
    return picture(width, base + 18.0, f"by level, {unit}", parts)


def _row_of(values: Numbers, scale: PlotScale, y: float) -> list[str]:
    if len(values) <= DOTS_MAX:
        return [
            dot(scale.at(value), y + 2.0 * (number % 3 - 1), "dot")
            for number, value in enumerate(values.tolist())
        ]
    p5, p25, p50, p75, p95 = (
        scale.at(float(p)) for p in np.percentile(values, [5.0, 25.0, 50.0, 75.0, 95.0])
    )
    ends = [
        dot(scale.at(end), y, "dot", radius_px=1.8)
        for end in (float(values.min()), float(values.max()))
    ]
    return [
        *ends,
        line(p5, y, p95, y, "whisker"),
        box(p25, y - 5.5, p75, y + 5.5, "quartiles"),
        line(p50, y - 5.5, p50, y + 5.5, "median"),
    ]


def _short(label: str) -> str:
    return label if len(label) <= LABEL_CHARACTERS else label[: LABEL_CHARACTERS - 1] + "…"


@dataclass(frozen=True, slots=True)
class PlotCurve:
    """One curve of a plot, with a gap where y is NaN."""

    label: str
    style: str
    x: Numbers
    y: Numbers


def curves_plot(
    curves: Sequence[PlotCurve], *, x_label: str, y_label: str, mark: tuple[float, float] | None
) -> Markup:
    """Curves over a common abscissa, with a mark at the point nearest to violation."""
    width, height, left, base, top = 545.0, 236.0, 46.0, 196.0, 24.0
    right = width - 18.0
    xs = np.concatenate([curve.x[np.isfinite(curve.x)] for curve in curves])
    ys = np.concatenate([curve.y[np.isfinite(curve.y)] for curve in curves])
    x_scale = PlotScale((float(xs.min()), float(xs.max())), (left, right))
    y_scale = PlotScale((min(0.0, float(ys.min())), float(ys.max()) * 1.06 or 1.0), (base, top))
    parts = []
    for tick in x_scale.ticks(7):
        parts.append(line(x_scale.at(tick), top, x_scale.at(tick), base, "grid"))
        parts.append(text(x_scale.at(tick), base + 14.0, number_text(tick), "tick", "middle"))
    for tick in y_scale.ticks():
        parts.append(line(left, y_scale.at(tick), right, y_scale.at(tick), "grid"))
        parts.append(text(left - 5.0, y_scale.at(tick) + 3.5, number_text(tick), "tick", "end"))
    if mark is not None:
        x = x_scale.at(mark[0])
        parts += [line(x, top, x, base, "zero"), dot(x, y_scale.at(mark[1]), "mark", radius_px=4.5)]
    at = left
    for curve in curves:
        parts.append(f'<path class="curve {curve.style}" d="{_path(curve, x_scale, y_scale)}"/>')
        parts.append(line(at, 10.0, at + 16.0, 10.0, f"curve {curve.style}"))
        parts.append(text(at + 20.0, 14.0, curve.label, "tick"))
        at += 34.0 + CHARACTER_PX * len(curve.label)
    parts.append(line(left, base, right, base, "axis"))
    parts.append(text(right, base + 30.0, x_label, "tick", "end"))
    parts.append(text(left, base + 30.0, f"ordinate: {y_label}", "tick"))
    return picture(width, height, f"{y_label} over {x_label}", parts)


def _path(curve: PlotCurve, x_scale: PlotScale, y_scale: PlotScale) -> str:
    step = max(1, len(curve.x) // POINTS_MAX)
    words, pen_down = [], False
    for x, y in zip(curve.x[::step].tolist(), curve.y[::step].tolist(), strict=True):
        if not (np.isfinite(x) and np.isfinite(y)):
            pen_down = False
            continue
        words.append(f"{'L' if pen_down else 'M'}{px(x_scale.at(x))} {px(y_scale.at(y))}")
        pen_down = True
    return "".join(words)
