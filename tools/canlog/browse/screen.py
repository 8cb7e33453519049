"""Builds the screen of the terminal browser as lines of styled text that fit the terminal."""

import enum
from collections.abc import Iterator, Sequence
from itertools import islice
from typing import Final

import numpy as np

from canlog.browse.lanes import Lane
from canlog.browse.spark import Span, field, held, limits, line, spans
from canlog.browse.state import (
    ACTIONS,
    SPEEDS,
    WINDOWS_S,
    BrowserState,
    Focus,
    id_text,
    shown,
)
from canlog.database import SignalSpec
from canlog.table import Table
from canlog.views.traces import flags_text

WIDTH_MIN: Final = 60
HEIGHT_MIN: Final = 14
NAME_WIDTH: Final = 22
SIGNAL_WIDTH: Final = 24
VALUE_WIDTH: Final = 20
BYTES_SHOWN: Final = 64
"""Data bytes of a frame in the list; longer ones leave the widest terminals."""
PLOT_LABEL: Final = 11
SPARK_MIN: Final = 8
TALLEST_RATIO: Final = 0.45
"""Share of the screen height that signals may take; they take more if the message list is short."""
FRAME_LINES: Final = 5
"""Lines for head, headings, event and keys."""


class ScreenStyle(enum.Enum):
    PLAIN = ""
    DIM = "2"
    BOLD = "1"
    HEAD = "7"
    CHOSEN = "1;7"
    CHANGED = "30;43"
    BAD = "31"
    GOOD = "32"
    LINE = "36"


Segment = tuple[ScreenStyle, str]
Line = list[Segment]


def screen(state: BrowserState, width: int, height: int, *, ascii_only: bool = False) -> list[Line]:
    """Return at most `height` lines of at most `width` characters."""
    if width < WIDTH_MIN or height < HEIGHT_MIN:
        return [
            [
                (
                    ScreenStyle.PLAIN,
                    f"needs {WIDTH_MIN} x {HEIGHT_MIN}, has {width} x {height}"[:width],
                )
            ]
        ]
    if state.help:
        body = _help(width)
        lines = [
            _head(state, width),
            *body[: height - 2],
            [(ScreenStyle.DIM, "press any key to go back")],
        ]
    else:
        signals = _plot(state, width, height, ascii_only) if state.plot else []
        signals = signals or _signals(state, width, height, ascii_only)
        room = height - 4 - len(signals)
        lines = [
            _head(state, width),
            *_messages(state, room),
            *signals,
            _event(state),
            _foot(state),
        ]
    return [_cut(each, width) for each in lines[:height]]


def _head(state: BrowserState, width: int) -> Line:
    at = f"{state.seconds(state.at_ns):.6f} s"
    if state.live:
        mode = "live" if state.running else "frozen"
    else:
        mode = f"plays x{SPEEDS[state.speed]:g}" if state.running else "stopped"
    count = sum(len(lane) for lane in state.lanes.lanes.values() if lane.of_frames)
    left = f" {state.title}  {at}  {mode}"
    right = f"{len(state.lanes.lanes)} messages, {count} frames  order: {state.order.value} "
    return [(ScreenStyle.HEAD, left + right.rjust(max(2, width - len(left))))]


def _messages(state: BrowserState, room: int) -> Iterator[Line]:
    """Yield a heading and the part of the list around the selected message."""
    lanes = shown(state)
    yield [
        (
            ScreenStyle.DIM,
            f"  {'id':>8} {'message':{NAME_WIDTH}} {'rate/s':>7} {'age':>8} {'count':>8}  data",
        )
    ]
    keys = [lane.key for lane in lanes]
    at = keys.index(state.selected) if state.selected in keys else 0
    visible = max(1, room - 1)
    first = min(max(0, at - visible // 2), max(0, len(lanes) - visible))
    for lane in lanes[first : first + visible]:
        yield _message(state, lane)
    if not lanes:
        yield [(ScreenStyle.DIM, "  nothing found")]
    for _ in range(visible - max(1, len(lanes[first : first + visible]))):
        yield []


def _message(state: BrowserState, lane: Lane) -> Line:
    row = lane.row_at(state.at_ns)
    chosen = lane.key == state.selected
    mark = ">" if chosen and state.focus is Focus.MESSAGES else " "
    name = f"{mark} {id_text(lane.key):>8} {lane.name:{NAME_WIDTH}.{NAME_WIDTH}}"
    parts: Line = [(ScreenStyle.CHOSEN if chosen else ScreenStyle.PLAIN, name)]
    if row < 0:
        return [*parts, (ScreenStyle.DIM, f" {'':>7} {'not yet':>8} {0:>8}")]
    age_ns = state.at_ns - int(lane.at_ns[row])
    stale = lane.spec is not None and 0 < lane.spec.timeout_ms * 1_000_000 < age_ns
    parts.append((ScreenStyle.PLAIN, f" {lane.rate_hz(state.at_ns):7.1f}"))
    parts.append((ScreenStyle.BAD if stale else ScreenStyle.DIM, f" {_age(age_ns):>8}"))
    parts.append((ScreenStyle.PLAIN, f" {row + 1 + lane.dropped:>8} "))
    told = lane.told(row)
    if told:
        parts.append((ScreenStyle.BOLD, f" {told} "))
    changed = zip(lane.payload(row), lane.changed(row), strict=True)
    for byte, is_new in islice(changed, BYTES_SHOWN):
        parts.append((ScreenStyle.PLAIN, " "))
        parts.append((ScreenStyle.CHANGED if is_new else ScreenStyle.PLAIN, f"{byte:02X}"))
    return parts


def _age(ns: int) -> str:
    if ns < 1_000_000_000:
        return f"{ns / 1e6:.0f} ms"
    return f"{ns / 1e9:.1f} s" if ns < 100_000_000_000 else f"{ns / 1e9:.0f} s"


def _signals(state: BrowserState, width: int, height: int, ascii_only: bool) -> list[Line]:
    """Return the signal values of the selected message, each with a small plot."""
    lane = state.lane
    if lane is None or lane.spec is None:
        return [[(ScreenStyle.DIM, "-" * width)]]
    table = _window(state, lane)
    assert table is not None
    length = f"{WINDOWS_S[state.window]:g} s"
    title = f"-- {lane.name}: {lane.spec.comment} "
    lines: list[Line] = [
        [
            (ScreenStyle.LINE, title[: width - 8].ljust(width - 8, "-")),
            (ScreenStyle.DIM, f"{length:>8}"),
        ]
    ]
    free = height - FRAME_LINES - max(1, len(shown(state)))
    visible = min(len(lane.spec.signals), max(3, int(TALLEST_RATIO * height), free))
    first = min(max(0, state.signal - visible // 2), len(lane.spec.signals) - visible)
    for number, signal in list(enumerate(lane.spec.signals))[first : first + visible]:
        lines.append(_signal(state, table, signal, number == state.signal, width, ascii_only))
    return lines


def _window(state: BrowserState, lane: Lane) -> Table | None:
    """Decode the frames of the plot window up to now, and the one before it, whose values still
    hold.
    """
    stop = lane.row_at(state.at_ns) + 1
    first = lane.row_at(state.at_ns - state.window_ns)
    return lane.table(first, stop)


def _signal(
    state: BrowserState,
    table: Table,
    signal: SignalSpec,
    chosen: bool,
    width: int,
    ascii_only: bool,
) -> Line:
    mark = ">" if chosen and state.focus is Focus.SIGNALS else " "
    style = ScreenStyle.BOLD if chosen else ScreenStyle.PLAIN
    name = f"{mark} {signal.name:{SIGNAL_WIDTH}.{SIGNAL_WIDTH}} "
    value = now_text(table, signal)
    room = width - len(name) - VALUE_WIDTH - 2
    parts: Line = [(style, name), (style, f"{value:{VALUE_WIDTH}.{VALUE_WIDTH}}  ")]
    if room >= SPARK_MIN and len(table):
        parts.append(
            (ScreenStyle.LINE, line(_spans(state, table, signal, room), ascii_only=ascii_only))
        )
    return parts


def _spans(state: BrowserState, table: Table, signal: SignalSpec, count: int) -> list[Span | None]:
    valid = table.valid(signal.name)
    values = np.asarray(table[signal.name], np.float64)[valid]
    return held(
        spans(table.at_ns[valid], values, state.at_ns - state.window_ns, state.at_ns, count)
    )


def now_text(table: Table, signal: SignalSpec) -> str:
    """Return the value of the last frame as text with its unit."""
    if not len(table):
        return "not yet"
    if not table.valid(signal.name)[-1]:
        return "not present"
    raw = int(table.raw(signal.name)[-1])
    named = signal.choices.get(raw) or flags_text(
        {float(each): name for each, name in signal.choices.items()}, raw
    )
    if named:
        return named
    value = table[signal.name][-1].item()
    text = f"{value:.7g}" if isinstance(value, float) else str(value)
    return f"{text} {signal.unit}" if signal.unit not in ("", "1") else text


def _plot(state: BrowserState, width: int, height: int, ascii_only: bool) -> list[Line]:
    """Return a large plot of the selected signal; empty for a message without signals."""
    lane = state.lane
    table = _window(state, lane) if lane is not None else None
    if lane is None or lane.spec is None or table is None or not lane.spec.signals:
        return []
    signal = lane.spec.signals[min(state.signal, len(lane.spec.signals) - 1)]
    columns, rows = width - PLOT_LABEL - 1, max(4, int(0.6 * height) - 2)
    found = _spans(state, table, signal, columns if ascii_only else 2 * columns)
    low, high = limits(found)
    title = f"-- {lane.name}.{signal.name}  {now_text(table, signal)} "
    lines: list[Line] = [[(ScreenStyle.LINE, title[:width].ljust(width, "-"))]]
    for row, text in enumerate(field(found, rows, ascii_only=ascii_only)):
        label = {0: f"{high:.5g}", rows - 1: f"{low:.5g}"}.get(row, "")
        lines.append([(ScreenStyle.DIM, f"{label:>{PLOT_LABEL}} "), (ScreenStyle.LINE, text)])
    begin = f"{state.seconds(state.at_ns - state.window_ns):.3f} s"
    end = f"{state.seconds(state.at_ns):.3f} s"
    axis = " " * (PLOT_LABEL + 1) + begin + end.rjust(max(1, columns - len(begin)))
    return [*lines, [(ScreenStyle.DIM, axis)]]


def _event(state: BrowserState) -> Line:
    """Return the note, or else the last event before the shown instant."""
    if state.note:
        return [(ScreenStyle.BOLD, f" {state.note}")]
    past = [each for each in state.happenings if each.at_ns <= state.at_ns]
    if not past:
        return []
    last = past[-1]
    style = (ScreenStyle.DIM, ScreenStyle.PLAIN, ScreenStyle.BAD)[last.weight]
    words = (
        f" {state.seconds(last.at_ns):.3f} s {last.kind.lower().replace('_', ' ')}: {last.words}"
    )
    return [(style, words)]


def _foot(state: BrowserState) -> Line:
    if state.typing:
        return [(ScreenStyle.BOLD, f" /{state.search}"), (ScreenStyle.CHOSEN, " ")]
    found = f"  search: {state.search} (Esc ends)" if state.search else ""
    marks = f"  {len(state.bookmarks)} bookmarks" if state.bookmarks else ""
    keys = " arrows move  space play  / search  enter plot  b bookmark  e event  ? keys  q end"
    return [(ScreenStyle.DIM, keys), (ScreenStyle.BOLD, found + marks)]


def _help(width: int) -> list[Line]:
    told = [(key, words) for key, (words, _) in ACTIONS.items() if words]
    half = -(-len(told) // 2)
    lines: list[Line] = [[]]
    for at in range(half):
        pair = told[at::half] if at + half < len(told) else told[at : at + 1]
        text = "".join(f"  {key:>9}  {words:<34}" for key, words in pair)
        lines.append([(ScreenStyle.PLAIN, text[:width])])
    return lines


def _cut(parts: Sequence[Segment], width: int) -> Line:
    kept: Line = []
    for style, text in parts:
        if width <= 0:
            break
        kept.append((style, text[:width]))
        width -= len(text)
    return kept
