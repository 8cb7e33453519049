"""Compares two logs message by message and signal by signal; it prints nothing."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from fnmatch import fnmatchcase
from typing import Any, Final

import numpy as np

from canlog.bus_model import CHANNEL_SIGN, Bus
from canlog.compare.pairing import Pairs, pair, reach_ns
from canlog.compare.sides import SINGLE, MessagePlace, Side, Sides
from canlog.damage import LogError
from canlog.database import MessageSpec, SignalSpec
from canlog.frames import Bools, Ints
from canlog.reader import Log
from canlog.table import Table
from canlog.views.traces import TRAILER, flags_text

START: Final = "start"
ABSOLUTE: Final = "absolute"
ONE_LSB: Final = 1
BYTES: Final = "data"
"""Stands for a signal name in a difference of raw data: an unknown message, or its length."""


@dataclass(frozen=True, slots=True)
class Allowed:
    """Differences that are allowed."""

    lsb: int = ONE_LSB
    """Allowed steps of the raw value, or of the last binary place of a float signal.

    Names, flags and multiplexers have to be equal.
    """
    physical: Mapping[str, float] = field(default_factory=dict)
    """Tolerance in the signal's unit that replaces `lsb`, by signal, MESSAGE.signal or a pattern.
    """
    ignored: tuple[str, ...] = ()
    """Patterns of messages or MESSAGE.signal to leave out."""
    trailer: bool = False
    """Whether to compare alive counters and CRCs, too."""
    timing_ms: float | None = None
    """Maximum distance in time of the frames of a pair; None accepts every pair."""


@dataclass(frozen=True, slots=True)
class SignalDifference:
    """One signal that differs."""

    signal: str
    unit: str
    frames: int
    """Number of pairs in which it differs."""
    first_a: int
    """Frame of the first difference in log A; of a reassembled message its last frame."""
    first_b: int
    at_ns: int
    """Time of the first difference in A, since A's zero."""
    value_a: str
    value_b: str
    most: float | None
    """Greatest difference in the signal's unit; None if the values are not numbers."""
    allowed: float


@dataclass(frozen=True, slots=True)
class MessageDifference:
    """Comparison of one message, or of one unknown identifier."""

    name: str
    key: int
    group: int | None
    """Parameter group of reassembled J1939 messages, -1 for ISO-TP, None for single frames."""
    channel_a: str
    channel_b: str
    frames_a: int
    frames_b: int
    pairs: int
    only_a: int
    only_b: int
    first_only_ns: int | None
    """Time since zero of the first frame that only one log has."""
    apart_ms: float
    """Greatest distance in time of the two frames of a pair."""
    late_pairs: int
    """Number of pairs further apart than allowed."""
    first_late_ns: int | None
    signals: tuple[SignalDifference, ...]

    @property
    def differs(self) -> bool:
        return bool(self.signals or self.only_a or self.only_b or self.late_pairs)


@dataclass(frozen=True, slots=True)
class LogDifference:
    """All differences between logs A and B."""

    zero_a_ns: int
    zero_b_ns: int
    messages: tuple[MessageDifference, ...]
    """Messages of both logs, by key."""
    sides: tuple[Sides, Sides]

    @property
    def differs(self) -> bool:
        return any(each.differs for each in self.messages)

    @property
    def first(self) -> tuple[MessageDifference, SignalDifference] | None:
        """The earliest value that differs."""
        found = [(each.at_ns, m.key, m, each) for m in self.messages for each in m.signals]
        return min(found, key=lambda one: one[:2])[2:] if found else None


def compare(a: Log, b: Log, allowed: Allowed, align: str = START) -> LogDifference:
    """Compare two logs. Raises LogError for an alignment, tolerance or pattern that matches
    nothing.
    """
    sides = Sides(a), Sides(b)
    places = _places(*sides, a.bus)
    _check(allowed, a, [each.name for each in places])
    zero_a, zero_b = zero_of(a, align), zero_of(b, align)
    found = [
        _message(sides, place, a.bus, (zero_a, zero_b), allowed)
        for place in places
        if not any(_matched(each, allowed.ignored) for each in place.texts(a.bus))
    ]
    return LogDifference(zero_a, zero_b, tuple(found), sides)


@dataclass(frozen=True, slots=True)
class _Pair:
    """The same messages in both logs, which may have other names for the channel."""

    a: MessagePlace
    b: MessagePlace
    name: str

    def texts(self, bus: Bus) -> tuple[str, ...]:
        """Return the names by which a user may ask for it."""
        spec = self.a.spec(bus)
        return (self.a.name(bus), *([] if spec is None else [spec.name]))


def _places(a: Sides, b: Sides, bus: Bus) -> list[_Pair]:
    """Return the places of both logs. Channels match by name, or by order if names differ."""
    names_a, names_b = (sorted({each.channel for each in side.places}) for side in (a, b))
    other = {name: name for name in (*names_a, *names_b)}
    if names_a != names_b and len(names_a) == len(names_b):
        other = dict(zip(names_b, names_a, strict=True))
    back = {mine: theirs for theirs, mine in other.items()}
    renamed = (each._replace(channel=other[each.channel]) for each in b.places)
    found = {*a.places, *renamed}
    pairs = []
    for place in sorted(found):
        plain = place.name(bus)
        spread = sum(each[:2] == place[:2] for each in found) > 1
        name = f"{place.channel}{CHANNEL_SIGN}{plain}" if spread else plain
        theirs = place._replace(channel=back.get(place.channel, place.channel))
        pairs.append(_Pair(place, theirs, name))
    return pairs


def zero_of(log: Log, align: str) -> int:
    """Return the stamp that counts as zero. Raises LogError for a message that the log lacks."""
    if align == ABSOLUTE:
        return 0
    if align == START:
        return log.run.start_ns if log.run is not None else log.start_ns
    table = log.table(align)
    if not len(table):
        raise LogError(f"--align {align}: {log.path} holds no frame of it")
    return int(table.at_ns.min())


def _check(allowed: Allowed, log: Log, places: Sequence[str]) -> None:
    names = [f"{m.name}.{s.name}" for m in log.bus.messages.values() for s in m.signals]
    known = [*names, *log.bus.messages, *(name.partition(".")[2] for name in names), *places]
    for option, patterns in (("--tolerance", allowed.physical), ("--ignore", allowed.ignored)):
        for pattern in patterns:
            if not any(fnmatchcase(name, pattern) for name in known):
                raise LogError(f"{option} {pattern}: no message or signal of {log.bus.name}")


def _matched(name: str, patterns: Sequence[str]) -> bool:
    return any(fnmatchcase(name, pattern) for pattern in patterns)


def _message(
    sides: tuple[Sides, Sides], place: _Pair, bus: Bus, zero_ns: tuple[int, int], allowed: Allowed
) -> MessageDifference:
    spec = place.a.spec(bus)
    a, b = sides[0].side(place.a), sides[1].side(place.b)
    a_ns, b_ns = a.at_ns - zero_ns[0], b.at_ns - zero_ns[1]
    pairs = pair(a_ns, b_ns, reach_ns(spec, a_ns, b_ns))
    apart = np.abs(a_ns[pairs.a] - b_ns[pairs.b])
    late = _late(apart, allowed)
    firsts = [*a_ns[pairs.only_a[:1]].tolist(), *b_ns[pairs.only_b[:1]].tolist()]
    signals = list(_bytes(a, b, pairs, spec, a_ns[pairs.a]))
    if spec is not None and len(pairs.a):
        signals += _signals((a, b), spec, pairs, a_ns, allowed)
    return MessageDifference(
        name=place.name,
        key=place.a.key,
        group=None if place.a.group == SINGLE else place.a.group,
        channel_a=place.a.channel,
        channel_b=place.b.channel,
        frames_a=len(a_ns),
        frames_b=len(b_ns),
        pairs=len(pairs.a),
        only_a=len(pairs.only_a),
        only_b=len(pairs.only_b),
        first_only_ns=min(firsts) if firsts else None,
        apart_ms=float(apart.max(initial=0)) / 1e6,
        late_pairs=len(late),
        first_late_ns=int(a_ns[pairs.a[late[0]]]) if len(late) else None,
        signals=tuple(signals),
    )


def _late(apart_ns: Ints, allowed: Allowed) -> Ints:
    if allowed.timing_ms is None:
        return np.empty(0, np.int64)
    return np.flatnonzero(apart_ns > allowed.timing_ms * 1e6)


def _bytes(
    a: Side, b: Side, pairs: Pairs, spec: MessageSpec | None, at_ns: Ints
) -> Iterator[SignalDifference]:
    """Compare the payloads of an unknown message, and the lengths of a known one."""
    where = np.flatnonzero(a.unequal(b, (pairs.a, pairs.b), whole=spec is None))
    if not len(where):
        return
    first = int(where[0])
    mine, other = int(pairs.a[first]), int(pairs.b[first])
    yield SignalDifference(
        signal=BYTES,
        unit="",
        frames=len(where),
        first_a=int(a.rows[mine]),
        first_b=int(b.rows[other]),
        at_ns=int(at_ns[first]),
        value_a=a.text(mine),
        value_b=b.text(other),
        most=None,
        allowed=0.0,
    )


def _signals(
    sides: tuple[Side, Side], spec: MessageSpec, pairs: Pairs, a_ns: Ints, allowed: Allowed
) -> Iterator[SignalDifference]:
    tables = sides[0].table(spec), sides[1].table(spec)
    chosen = pairs.a, pairs.b
    places = [side.places[rows] for side, rows in zip(sides, chosen, strict=True)]
    for signal in spec.signals:
        full = f"{spec.name}.{signal.name}"
        trailer = signal.name.lower() in TRAILER and not allowed.trailer
        if trailer or _matched(full, allowed.ignored):
            continue
        limit = tolerance(signal, full, allowed)
        unequal, apart = _unequal(signal, tables, places, limit, full, allowed)
        where = np.flatnonzero(unequal)
        if not len(where):
            continue
        first = int(where[0])
        values = [
            value_text(table, signal, int(place[first]))
            for table, place in zip(tables, places, strict=True)
        ]
        yield SignalDifference(
            signal=signal.name,
            unit=signal.unit,
            frames=len(where),
            first_a=int(sides[0].rows[pairs.a[first]]),
            first_b=int(sides[1].rows[pairs.b[first]]),
            at_ns=int(a_ns[pairs.a[first]]),
            value_a=values[0],
            value_b=values[1],
            most=None if apart is None else float(np.nanmax(apart[where], initial=0.0)),
            allowed=limit,
        )


def is_exact(signal: SignalSpec) -> bool:
    """Whether the signal must be equal: names, flags and multiplexers have no near values."""
    return bool(signal.choices) or signal.is_multiplexer or signal.length == 1


def tolerance(signal: SignalSpec, full: str, allowed: Allowed) -> float:
    """Return the tolerance in the signal's unit; 0 for a float signal without one of its own."""
    for pattern, limit in allowed.physical.items():
        if fnmatchcase(full, pattern) or fnmatchcase(signal.name, pattern):
            return limit
    return 0.0 if is_exact(signal) else allowed.lsb * signal.lsb


def _unequal(
    signal: SignalSpec,
    tables: tuple[Table, Table],
    places: Sequence[Ints],
    limit: float,
    full: str,
    allowed: Allowed,
) -> tuple[Bools, Any]:
    """Return (k,) which pairs differ, and by how much in the unit; None for named values."""
    valid = [t.valid(signal.name)[p] for t, p in zip(tables, places, strict=True)]
    values = [t[signal.name][p] for t, p in zip(tables, places, strict=True)]
    both, one = valid[0] & valid[1], valid[0] != valid[1]
    if signal.is_float:
        apart, over = _float_unequal(signal, values, limit, allowed)
    else:
        raws = [t.raw(signal.name)[p] for t, p in zip(tables, places, strict=True)]
        # Subtract the smaller from the larger number, so that unsigned values never wrap; the
        # difference of signed values fits 64 bits as unsigned.
        steps = np.where(raws[0] > raws[1], raws[0] - raws[1], raws[1] - raws[0])
        steps = steps.view(np.uint64) if steps.dtype == np.int64 else steps
        apart = steps.astype(np.float64) * abs(signal.scale)
        own = limit != allowed.lsb * signal.lsb
        over = apart > limit * (1 + 1e-12) if own else steps > allowed.lsb
    return (over & both) | one, None if signal.choices else np.where(both, apart, 0.0)


def _float_unequal(
    signal: SignalSpec, values: Sequence[Any], limit: float, allowed: Allowed
) -> tuple[Any, Bools]:
    kind = {16: np.float16, 32: np.float32, 64: np.float64}[signal.length]
    with np.errstate(invalid="ignore", over="ignore"):
        apart = np.abs(values[0] - values[1])
        same = (values[0] == values[1]) | (np.isnan(values[0]) & np.isnan(values[1]))
        place = np.maximum(*(np.spacing(np.abs(each).astype(kind)) for each in values))
        most = limit if limit else allowed.lsb * place.astype(np.float64) * abs(signal.scale)
        over = ~same & ~(apart <= most)
    return np.where(same, 0.0, apart), over


def value_text(table: Table, signal: SignalSpec, place: int) -> str:
    """Return a value as text for people."""
    if not table.valid(signal.name)[place]:
        return "not present"
    raw = int(table.raw(signal.name)[place])
    by_number = {float(each): name for each, name in signal.choices.items()}
    named = signal.choices.get(raw) or flags_text(by_number, raw) or None
    value = table[signal.name][place].item()
    text = named or (f"{value:.9g}" if isinstance(value, float) else str(value))
    return f"{text} {signal.unit}" if signal.unit not in ("", "1") and named is None else text
