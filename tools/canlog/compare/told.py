"""Renders differences as text for people and as JSON for programs."""

from collections.abc import Iterator, Sequence
from dataclasses import asdict
from typing import Any, Final

import numpy as np

from canlog.bus_model import Bus
from canlog.compare.dbcs import Change
from canlog.compare.logs import (
    BYTES,
    LogDifference,
    MessageDifference,
    value_text,
)
from canlog.compare.sides import SINGLE, MessagePlace
from canlog.damage import LogError
from canlog.reader import Log
from canlog.run import NS_PER_S

NAME_WIDTH: Final = 44
VALUE_WIDTH: Final = 20
SIGNALS_SHOWN: Final = 12
"""Maximum number of signals listed per message; the others are only counted."""


def difference_lines(found: LogDifference, a: Log, b: Log, context: int) -> Iterator[str]:
    """Yield a table of the differences, then the first divergence with the frames around it."""
    if not found.differs:
        pairs = sum(each.pairs for each in found.messages)
        yield f"no difference in {pairs} pairs of frames of {len(found.messages)} messages"
        return
    differing = [each for each in found.messages if each.differs]
    spans = [
        (log.end_ns - zero) / NS_PER_S for log, zero in ((a, found.zero_a_ns), (b, found.zero_b_ns))
    ]
    yield f"{len(differing)} of {len(found.messages)} messages differ;" + (
        f" A ends at {spans[0]:.6f} s, B at {spans[1]:.6f} s"
    )
    yield ""
    for each in differing:
        yield from _message_lines(each)
    first = found.first
    if first is not None:
        yield ""
        yield from _first_lines(found, a, b, context)


def _message_lines(each: MessageDifference) -> Iterator[str]:
    what = "frames" if each.group is None else "messages"
    counts = f"{each.frames_a} / {each.frames_b} {what}, {each.pairs} pairs"
    if each.only_a:
        counts += f", {each.only_a} only in A"
    if each.only_b:
        counts += f", {each.only_b} only in B"
    if each.only_a or each.only_b:
        assert each.first_only_ns is not None
        counts += f" (first at {each.first_only_ns / NS_PER_S:.6f} s)"
    if each.late_pairs:
        assert each.first_late_ns is not None
        counts += f", {each.late_pairs} pairs up to {each.apart_ms:.3f} ms apart"
        counts += f" (first at {each.first_late_ns / NS_PER_S:.6f} s)"
    yield f"{each.name}: {counts}"
    for signal in each.signals[:SIGNALS_SHOWN]:
        most = "" if signal.most is None else f", by up to {signal.most:.9g} {signal.unit}".rstrip()
        allowed = f" (allowed {signal.allowed:.9g})" if signal.allowed else ""
        yield (
            f"  {signal.signal}: {signal.frames} {what}{most}{allowed};"
            f" first at {signal.at_ns / NS_PER_S:.6f} s: {signal.value_a} / {signal.value_b}"
        )
    if len(each.signals) > SIGNALS_SHOWN:
        yield f"  and {len(each.signals) - SIGNALS_SHOWN} more signals"


Around = tuple[float, str, bool]
"""Seconds, text, and whether it is the frame looked for."""


def _first_lines(found: LogDifference, a: Log, b: Log, context: int) -> Iterator[str]:
    assert found.first is not None
    message, signal = found.first
    full = message.name if signal.signal == BYTES else f"{message.name}.{signal.signal}"
    yield f"first divergence: {full} at {signal.at_ns / NS_PER_S:.6f} s"
    yield f"  {'':>14}  {'A':{NAME_WIDTH}}  B"
    sides = [
        around(log, row, zero, context)
        for log, row, zero in (
            (a, signal.first_a, found.zero_a_ns),
            (b, signal.first_b, found.zero_b_ns),
        )
    ]
    for left, right in zip(*sides, strict=True):
        yield _frame_line(left, right)
    yield from _signal_lines(found, a.bus)


def _frame_line(left: Around | None, right: Around | None) -> str:
    """One frame of each log side by side; `*` marks a difference, `>` the first one."""
    mark = ">" if (left is not None and left[2]) or (right is not None and right[2]) else " "
    at_s = f"{left[0]:14.6f}" if left is not None else " " * 14
    apart = "" if left is None or right is None or left[1] == right[1] else "  *"
    here = left[1] if left is not None else ""
    there = right[1] if right is not None else ""
    return f"{mark} {at_s}  {here:{NAME_WIDTH}}  {there}{apart}".rstrip()


def _signal_lines(found: LogDifference, bus: Bus) -> Iterator[str]:
    """The values of all signals in the first frames that differ."""
    assert found.first is not None
    message, signal = found.first
    group = SINGLE if message.group is None else message.group
    mine, theirs = (
        MessagePlace(message.key, group, channel)
        for channel in (message.channel_a, message.channel_b)
    )
    spec = mine.spec(bus)
    if spec is None or signal.signal == BYTES:
        return
    yield ""
    what = "frame" if message.group is None else "message"
    yield f"  {message.name} at that {what}:"
    both = found.sides[0].side(mine), found.sides[1].side(theirs)
    tables = [side.table(spec) for side in both]
    places = [
        int(side.places[np.flatnonzero(side.rows == row)[0]])
        for side, row in zip(both, (signal.first_a, signal.first_b), strict=True)
    ]
    for each in spec.signals:
        texts = [value_text(t, each, p) for t, p in zip(tables, places, strict=True)]
        mark = "*" if texts[0] != texts[1] else " "
        yield f"  {mark} {each.name:32} {texts[0]:{VALUE_WIDTH}} {texts[1]}"


def around(log: Log, row: int, zero_ns: int, context: int) -> list[Around | None]:
    """Return `context` frames before and after a row in order of time.

    Each is a tuple of seconds, text, and whether it is the row itself. None fills up before the
    start and after the end of the log.
    """
    frames = log.frames
    if bool((np.diff(frames.at_ns) >= 0).all()):
        order, place = np.arange(len(frames)), row
    else:
        order = np.argsort(frames.at_ns, kind="stable")
        place = int(np.flatnonzero(order == row)[0])
    found: list[Around | None] = []
    for at in range(place - context, place + context + 1):
        if not 0 <= at < len(order):
            found.append(None)
            continue
        this = int(order[at])
        at_s = (int(frames.at_ns[this]) - zero_ns) / NS_PER_S
        channel = frames.channels[int(frames.channel[this])]
        name = log.bus.on(channel).name_of(int(frames.key[this]))
        found.append((at_s, f"{name} {frames.payload(this).hex().upper()}", this == row))
    return found


def difference_json(found: LogDifference, a: Log, b: Log, context: int) -> dict[str, Any]:
    """Return the comparison as JSON, with the frames of both logs around the first divergence."""
    first = found.first
    told: dict[str, Any] = {
        "a": str(a.path),
        "b": str(b.path),
        "differs": found.differs,
        "messages": [asdict(each) | {"differs": each.differs} for each in found.messages],
        "first": None,
    }
    if first is not None:
        message, signal = first
        told["first"] = asdict(signal) | {
            "message": message.name,
            "frames_a": _around_json(a, signal.first_a, found.zero_a_ns, context),
            "frames_b": _around_json(b, signal.first_b, found.zero_b_ns, context),
        }
    return told


def _around_json(log: Log, row: int, zero_ns: int, context: int) -> list[dict[str, Any]]:
    shown = (each for each in around(log, row, zero_ns, context) if each is not None)
    return [{"t_s": at_s, "frame": text, "is_it": is_it} for at_s, text, is_it in shown]


def change_lines(changes: Sequence[Change]) -> Iterator[str]:
    """Yield the changes from DBC file A to B, message by message."""
    if not changes:
        yield "no difference"
        return
    where = None
    for each in changes:
        head = each.where.partition(".")[0]
        if head != where:
            yield head
            where = head
        name = each.where.partition(".")[2]
        what = f"{name}: {each.what}" if name else each.what
        yield f"  {each.weight.value:8}{what}: {_side(each.a)} -> {_side(each.b)}"
    weights = {each.weight for each in changes}
    counted = ", ".join(
        f"{sum(each.weight is weight for each in changes)} {weight.value}"
        for weight in sorted(weights, key=lambda one: one.value)
    )
    yield f"{len(changes)} differences: {counted}"


def _side(text: str | None) -> str:
    return "none" if text is None else text or "empty"


def changes_json(changes: Sequence[Change]) -> list[dict[str, Any]]:
    return [asdict(each) | {"weight": each.weight.value} for each in changes]


def parse_tolerances(words: Sequence[str]) -> dict[str, float]:
    """Parse words of the form NAME=VALUE. Raises LogError."""
    found = {}
    for word in words:
        name, sign, text = word.partition("=")
        try:
            value = float(text)
        except ValueError:
            value = -1.0
        if not sign or not name or not value >= 0.0:
            raise LogError(f"--tolerance {word}: write NAME=VALUE with a value of 0 or more")
        found[name] = value
    return found
