"""Collects all data of the page of a log, as JSON and one block of bytes."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from canlog.bit_activity import ActivityView
from canlog.frames import KEY_EXTENDED
from canlog.reader import Log
from canlog.shelf import in_pieces
from canlog.views.extremes import kept
from canlog.views.facts import message_head, statistics, verdict_codes, verdict_names
from canlog.views.happenings import event_head, happenings
from canlog.views.packed import NOT_DATA, KeyGroup, Ordered, PackedBytes, add_frames, ordered
from canlog.views.place import doubts_of, journey_of
from canlog.views.span import date_text, zero_of
from canlog.views.traces import SignalTrace, find_names, trace_names, trace_of

KIND_NAMES: Final = {2: " (remote)", 4: " (error)", 6: " (error)"}
CURVE_POINTS_MAX: Final = 40_000


@dataclass(frozen=True, slots=True, eq=False)
class PageData:
    head: dict[str, Any]
    block: PackedBytes
    log: Ordered


def page_data(log: Log, title: str, words: Sequence[str], *, with_frames: bool) -> PageData:
    """Collect the data of a whole log.

    Args:
        words: signals to draw first, as in `canlog plot`.
        with_frames: include the frames; without them the page requests what it shows from a
            server.

    Raises:
        LogError: for a word that names no signal.
    """
    panels = [[n for part in word.split(",") for n in find_names(log, part)] for word in words]
    zero_ns = zero_of(log)
    in_order = ordered(log.frames, log.room)
    block = PackedBytes()
    activity = ActivityView()
    for _, piece in in_pieces(in_order.frames):
        activity.feed(piece)
    head: dict[str, Any] = {
        "title": title,
        "zero": str(zero_ns),
        "date": date_text(zero_ns),
        "span": [log.start_ns - zero_ns, log.end_ns - zero_ns],
        "panels": panels,
        "messages": _messages(log, in_order.groups, activity),
        "events": [event_head(each, zero_ns) for each in happenings(log)],
        "warnings": [*map(str, log.warnings), *(doubts_of(log.run.folder) if log.run else ())],
        "inOrder": in_order.order is None,
        "stats": statistics(log),
        "verdicts": verdict_names(),
        "remote": not with_frames,
    }
    if with_frames:
        head["frames"] = add_frames(block, in_order, zero_ns)
        for name, column in frame_columns(log).items():
            block.add(name, in_order.taken(column))
    else:
        head["frames"] = {"count": len(log), "channels": list(log.frames.channels)}
    head["cycles"] = log.run is not None and len(log.run.cycle_ns) > 0
    head["extras"] = _extras(block, log, head["messages"], zero_ns, with_columns=with_frames)
    head["journey"] = _journey(block, log, zero_ns)
    head["block"] = block.index
    return PageData(head, block, in_order)


def _messages(log: Log, groups: Iterable[KeyGroup], activity: ActivityView) -> list[dict[str, Any]]:
    """Return what the page knows of each message, each by a name of its own."""
    found: list[dict[str, Any]] = []
    names: set[str] = set()
    for group in groups:
        spec = log.bus.on(group.channel).spec_at(group.key)
        name = log.name_at(group.key, group.channel) if not group.flags & 4 else "error frame"
        name += KIND_NAMES.get(group.flags & NOT_DATA, "") if not group.flags & 4 else ""
        if name in names:
            # One J1939 message with two priorities has two identifiers.
            name += f" {group.key & ~KEY_EXTENDED:08X}"
        names.add(name)
        head = message_head(group, spec, name)
        one = activity.found.get((group.key, group.channel)) if not group.flags else None
        if one is not None:
            head["flips"] = one.flips.ravel().tolist()
            head["entropy"] = one.entropy_bits.round(3).tolist()
        found.append(head)
    return found


def frame_columns(log: Log) -> dict[str, Any]:
    """Return extra columns about each frame, in log order.

    `verdict` is a code; `cycle` is the controller's cycle, counted from 1, with 0 for none.
    """
    found = {}
    codes = verdict_codes(log)
    if codes is not None:
        found["verdict"] = codes
    if log.run is not None and len(log.run.cycle_ns):
        found["cycle"] = (log.run.cycle_of + 1).astype(np.uint32)
    return found


def _extras(
    block: PackedBytes,
    log: Log,
    messages: Sequence[Mapping[str, Any]],
    zero_ns: int,
    *,
    with_columns: bool,
) -> list[dict[str, Any]]:
    """Add what has no frame of its own: columns of a run folder, and reassembled messages."""
    found = []
    framed = {each["name"] for each in messages}
    for name in trace_names(log):
        if name.partition(".")[0] in framed:
            continue
        trace = trace_of(log, name)
        if not len(trace):
            continue
        if with_columns:
            _add_instants(block, f"{name} t", trace, zero_ns)
            block.add(f"{name} v", trace.values.astype(np.float32))
        found.append({"name": name, "unit": trace.unit})
    return found


def _add_instants(block: PackedBytes, name: str, trace: SignalTrace, zero_ns: int) -> None:
    block.add(name, (trace.at_ns - zero_ns).astype(np.float64))


def _journey(block: PackedBytes, log: Log, zero_ns: int) -> dict[str, Any] | None:
    journey = journey_of(log)
    if journey is None:
        return None
    curves = []
    for number, curve in enumerate(journey.curves):
        thin = kept(
            curve.at_ns,
            curve.speed_mps,
            start_ns=int(curve.at_ns[0]),
            end_ns=int(curve.at_ns[-1]),
            columns=CURVE_POINTS_MAX // 4,
        )
        block.add(f"curve {number} t", (curve.at_ns[thin] - zero_ns).astype(np.float64))
        block.add(f"curve {number} x", curve.place_m[thin].astype(np.float32))
        block.add(f"curve {number} y", curve.speed_mps[thin].astype(np.float32))
        curves.append({"role": curve.role, "name": curve.name})
    if journey.authority is not None:
        _add_instants(block, "authority t", journey.authority, zero_ns)
        block.add("authority x", journey.authority.values.astype(np.float32))
    return {
        "curves": curves,
        "authority": journey.authority is not None,
        **journey.line.head(),
    }
