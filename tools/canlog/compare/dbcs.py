"""Compares two DBC files: messages, signals, layout, scale, value names, periods, nodes."""

import enum
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Final

from canlog.database import Bus, MessageSpec, SignalSpec


class Weight(enum.Enum):
    """What a change means for a person who decodes with the other file."""

    WIRE = "wire"
    """The same bits have another meaning."""
    TIMING = "timing"
    """Messages have another period or timeout."""
    MEANING = "meaning"
    """Names, units, ranges or receivers differ: what people and programs make of the values."""
    COMMENT = "comment"


@dataclass(frozen=True, slots=True)
class Change:
    """One difference; the value of a file that lacks the item is None."""

    where: str
    """MESSAGE, MESSAGE.signal, or the whole file."""
    what: str
    weight: Weight
    a: str | None
    b: str | None


MESSAGE_PARTS: Final[tuple[tuple[str, str, Weight], ...]] = (
    ("length", "length", Weight.WIRE),
    ("is_fd", "CAN FD", Weight.WIRE),
    ("period_ms", "cycle time, ms", Weight.TIMING),
    ("timeout_ms", "timeout, ms", Weight.TIMING),
    ("senders", "senders", Weight.MEANING),
    ("comment", "comment", Weight.COMMENT),
)
SIGNAL_PARTS: Final[tuple[tuple[str, str, Weight], ...]] = (
    ("start", "start bit", Weight.WIRE),
    ("length", "bits", Weight.WIRE),
    ("big_endian", "Motorola", Weight.WIRE),
    ("signed", "signed", Weight.WIRE),
    ("is_float", "float", Weight.WIRE),
    ("scale", "scale", Weight.WIRE),
    ("offset", "offset", Weight.WIRE),
    ("is_multiplexer", "is a multiplexer", Weight.WIRE),
    ("multiplexer", "multiplexer", Weight.WIRE),
    ("multiplexer_ids", "multiplexed by", Weight.WIRE),
    ("minimum", "minimum", Weight.MEANING),
    ("maximum", "maximum", Weight.MEANING),
    ("unit", "unit", Weight.MEANING),
    ("receivers", "receivers", Weight.MEANING),
    ("comment", "comment", Weight.COMMENT),
)


def compare_buses(a: Bus, b: Bus, *, comments: bool = False) -> tuple[Change, ...]:
    """Return all differences, by message. Messages match by name, or else by key."""
    found = [*_file(a, b)]
    renamed = _renamed(a, b)
    for name, spec in a.messages.items():
        other = b.messages.get(renamed.get(name, name))
        if other is None:
            found.append(Change(name, "message", Weight.WIRE, _message_text(spec), None))
        else:
            found += _message(spec, other)
    known = {renamed.get(name, name) for name in a.messages}
    found += [
        Change(name, "message", Weight.WIRE, None, _message_text(spec))
        for name, spec in b.messages.items()
        if name not in known
    ]
    return tuple(each for each in found if comments or each.weight is not Weight.COMMENT)


def _file(a: Bus, b: Bus) -> Iterator[Change]:
    if a.baudrate != b.baudrate:
        yield Change("file", "bit rate", Weight.TIMING, str(a.baudrate), str(b.baudrate))
    for name in sorted({*a.nodes, *b.nodes}):
        mine, other = a.nodes.get(name), b.nodes.get(name)
        if mine is None or other is None:
            here, there = (None if each is None else name for each in (mine, other))
            yield Change("file", "node", Weight.MEANING, here, there)
        elif mine != other:
            yield Change(f"node {name}", "comment", Weight.COMMENT, mine, other)


def _renamed(a: Bus, b: Bus) -> dict[str, str]:
    """Return messages that the other file has under the same key but another name."""
    return {
        name: b.by_key[spec.key].name
        for name, spec in a.messages.items()
        if name not in b.messages
        and spec.key in b.by_key
        and b.by_key[spec.key].name not in a.messages
    }


def _message(a: MessageSpec, b: MessageSpec) -> Iterator[Change]:
    if a.name != b.name:
        yield Change(a.name, "name", Weight.MEANING, a.name, b.name)
    if a.key != b.key:
        yield Change(a.name, "identifier", Weight.WIRE, _key_text(a), _key_text(b))
    yield from _parts(a.name, a, b, MESSAGE_PARTS)
    mine, other = ({each.name: each for each in spec.signals} for spec in (a, b))
    for name, signal in mine.items():
        where = f"{a.name}.{name}"
        if name not in other:
            yield Change(where, "signal", Weight.WIRE, _signal_text(signal), None)
            continue
        yield from _parts(where, signal, other[name], SIGNAL_PARTS)
        yield from _choices(where, signal.choices, other[name].choices)
    for name, signal in other.items():
        if name not in mine:
            yield Change(f"{a.name}.{name}", "signal", Weight.WIRE, None, _signal_text(signal))


def _parts(
    where: str, a: Any, b: Any, parts: tuple[tuple[str, str, Weight], ...]
) -> Iterator[Change]:
    for attribute, what, weight in parts:
        mine, other = getattr(a, attribute), getattr(b, attribute)
        if attribute in ("senders", "receivers"):
            mine, other = tuple(sorted(mine)), tuple(sorted(other))
        if mine != other:
            yield Change(where, what, weight, _text(mine), _text(other))


def _choices(where: str, a: Mapping[int, str], b: Mapping[int, str]) -> Iterator[Change]:
    for raw in sorted({*a, *b}):
        if a.get(raw) != b.get(raw):
            yield Change(where, f"value {raw}", Weight.MEANING, a.get(raw), b.get(raw))


def _text(value: Any) -> str:
    if isinstance(value, tuple):
        return ", ".join(map(str, value)) or "none"
    if isinstance(value, float):
        return f"{value:g}"
    if isinstance(value, bool):
        return "yes" if value else "no"
    return "none" if value is None else str(value)


def _key_text(spec: MessageSpec) -> str:
    return f"{spec.identifier:#x}{' extended' if spec.is_extended else ''}"


def _message_text(spec: MessageSpec) -> str:
    return f"{_key_text(spec)}, {spec.length} bytes, {len(spec.signals)} signals"


def _signal_text(signal: SignalSpec) -> str:
    order = "Motorola" if signal.big_endian else "Intel"
    text = f"{signal.start}|{signal.length} {order}, x{signal.scale:g}{signal.offset:+g}"
    return f"{text} {signal.unit}".strip()
