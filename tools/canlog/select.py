"""Selects frames of a log by name, identifier, node, value, instant, rate or change."""

import fnmatch
import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, Final, Protocol

import numpy as np

from canlog.damage import STANDARD_MAX, LogError
from canlog.database import Bus, MessageSpec
from canlog.frames import KEY_EXTENDED, TX, Bools, Frames, Ints
from canlog.table import Groups, Table, taken
from canlog.verdict_codes import UNCONFIRMED

NS_PER_S: Final = 1_000_000_000
IDENTIFIER: Final = re.compile("[0-9a-f]+x?")
PATTERN: Final = re.compile(r"(?:[0-9a-f?.]{2})+")
"""Data bytes in hexadecimal; a point or question mark stands for any digit."""
RECEIVED, SENT = "rx", "tx"


@dataclass(frozen=True, slots=True)
class KeyRange:
    """A range of identifiers, or those that match one in the bits of a mask."""

    first: int
    last: int
    mask: int = 0xFFFF_FFFF

    def holds(self, key: Any) -> Bools:
        """(n,) whether each uint32 key is in the range."""
        masked = key & np.uint32(self.mask)
        found: Bools = (masked >= np.uint32(self.first)) & (masked <= np.uint32(self.last))
        return found


@dataclass(frozen=True, slots=True)
class DataPattern:
    """Required values of the first data bytes, under a mask."""

    wanted: bytes
    mask: bytes

    def holds(self, frames: Frames) -> Bools:
        """(n,) frames that are long enough and match the bytes."""
        size = len(self.wanted)
        found: Bools = (frames.length >= size) & frames.is_data
        if size > frames.data.shape[1]:
            return np.zeros(len(frames), np.bool_)
        mask = np.frombuffer(self.mask, np.uint8)
        wanted = np.frombuffer(self.wanted, np.uint8) & mask
        found &= ((frames.data[:, :size] & mask) == wanted).all(axis=1)
        return found


class Condition(Protocol):
    """A condition on the signals of a frame."""

    def covers(self, spec: MessageSpec) -> bool:
        """Whether frames of this message can fulfil the condition."""

    def holds(self, table: Table) -> Bools:
        """(n,) which frames fulfil the condition."""


@dataclass(frozen=True, slots=True)
class Selection:
    """The requested frames; an empty or None criterion excludes nothing."""

    names: tuple[str, ...] = ()
    """Patterns of message names."""
    keys: tuple[KeyRange, ...] = ()
    nodes: tuple[str, ...] = ()
    """Sending nodes."""
    where: Condition | None = None
    spans_ns: tuple[tuple[int, int], ...] | None = None
    """First and last stamp of each span."""
    rate_hz: float | None = None
    """Maximum frames per second of each message."""
    rejected: bool = False
    """Only frames that the codec rejects."""
    direction: str = ""
    """RECEIVED or SENT; empty for both."""
    data: DataPattern | None = None
    changed: bool = False
    """Only frames whose data differs from the frame before of the same message."""


def parse_key(text: str) -> int:
    """Parse a key: `103` and `0x103` have 11 bits; eight digits or a trailing x mean 29 bits.

    Raises LogError.
    """
    digits = text.lower().removeprefix("0x")
    if not IDENTIFIER.fullmatch(digits):
        raise LogError(f"{text}: no identifier; write it in hexadecimal")
    number = int(digits.rstrip("x"), 16)
    extended = len(digits) == 8 or digits.endswith("x") or number > 0x7FF
    if number > 0x1FFF_FFFF:
        raise LogError(f"{text}: no identifier has more than 29 bits")
    return number | KEY_EXTENDED if extended else number


def parse_keys(text: str) -> KeyRange:
    """Parse `103`, `100-1FF`, or `100/7F0` for identifiers that match 100 in the bits of 7F0.

    Raises:
        LogError: for any other text.
    """
    first, dash, last = text.partition("-")
    if dash and first:
        low, high = parse_key(first), parse_key(last)
        if low & KEY_EXTENDED != high & KEY_EXTENDED:
            # If either end has 29 bits, both have.
            low, high = low | KEY_EXTENDED, high | KEY_EXTENDED
        if low > high:
            raise LogError(f"--id {text}: {first} is above {last}")
        return KeyRange(low, high)
    value, slash, mask_text = text.partition("/")
    key = parse_key(value)
    if not slash:
        return KeyRange(key, key)
    mask = parse_key(mask_text) & ~KEY_EXTENDED
    if mask > STANDARD_MAX:
        key |= KEY_EXTENDED
    masked = key & (mask | KEY_EXTENDED)
    return KeyRange(masked, masked, mask | KEY_EXTENDED)


def parse_data(text: str) -> DataPattern:
    """Parse `0A..FF`: the first byte is 0A, the third FF. Raises LogError."""
    digits = text.lower().replace(" ", "")
    if not PATTERN.fullmatch(digits):
        raise LogError(f"--data {text}: write bytes in hexadecimal, with points for any, as 0A..FF")
    wild = "?."
    wanted = bytes.fromhex("".join("0" if sign in wild else sign for sign in digits))
    mask = bytes.fromhex("".join("0" if sign in wild else "f" for sign in digits))
    return DataPattern(wanted, mask)


@dataclass(slots=True)
class Selector:
    """Selects frames of blocks in order."""

    wanted: Selection
    bus: Bus
    _slots: dict[tuple[int, str], int] = field(default_factory=dict)
    """By key and channel: the time slot in which the last frame was shown."""
    _before: dict[tuple[int, str], bytes] = field(default_factory=dict)
    """By key and channel: the data of the last frame."""

    def __post_init__(self) -> None:
        nodes = set(self.bus.nodes)
        for node in self.wanted.nodes:
            if node not in nodes:
                raise LogError(f"--node {node}: the DBC file has {', '.join(sorted(nodes))}")
        names = [*self.bus.messages]
        for pattern in self.wanted.names:
            if not fnmatch.filter(names, pattern):
                raise LogError(f"--message {pattern}: no message of {self.bus.name} matches")

    def rows(self, frames: Frames, groups: Groups, code: Any = None) -> Ints:
        """Return the rows of the selected frames, rising. `code`: verdicts, if the bus is
        judged.
        """
        keep = self._by_message(frames, groups)
        if self.wanted.spans_ns is not None:
            inside = np.zeros(len(frames), np.bool_)
            for first_ns, last_ns in self.wanted.spans_ns:
                inside |= (frames.at_ns >= first_ns) & (frames.at_ns <= last_ns)
            keep &= inside
        if self.wanted.direction:
            sent = (frames.flags & np.uint8(TX)) != 0
            keep &= sent if self.wanted.direction == SENT else ~sent
        if self.wanted.data is not None:
            keep &= self.wanted.data.holds(frames)
        if self.wanted.rejected:
            keep &= code > UNCONFIRMED if code is not None else False
        if self.wanted.where is not None:
            keep &= self._by_value(frames, groups, keep)
        if self.wanted.changed:
            keep &= self._by_change(frames, groups)
        if self.wanted.rate_hz is not None:
            keep &= self._by_rate(frames, groups, keep)
        return np.flatnonzero(keep)

    def _by_message(self, frames: Frames, groups: Groups) -> Bools:
        wanted = self.wanted
        if not (wanted.names or wanted.keys or wanted.nodes):
            return np.ones(len(frames), np.bool_)
        keep = np.zeros(len(frames), np.bool_)
        for each in wanted.keys:
            keep |= each.holds(frames.key)
        for key, channel in groups.places:
            spec = self.bus.on(channel).spec_at(key)
            if spec is None:
                continue
            named = any(fnmatch.fnmatchcase(spec.name, pattern) for pattern in wanted.names)
            if named or set(spec.senders) & set(wanted.nodes):
                keep[groups.rows(key, channel=channel)] = True
        return keep

    def _by_value(self, frames: Frames, groups: Groups, keep: Bools) -> Bools:
        found = np.zeros(len(frames), np.bool_)
        assert self.wanted.where is not None
        for key, channel in groups.places:
            spec = self.bus.on(channel).spec_at(key)
            rows = groups.rows(key, channel=channel)
            if spec is not None and self.wanted.where.covers(spec) and keep[rows].any():
                found[rows] = self.wanted.where.holds(groups.table(spec, channel, (key,)))
        return found

    def _by_change(self, frames: Frames, groups: Groups) -> Bools:
        changed = np.zeros(len(frames), np.bool_)
        for key, channel in groups.places:
            rows = groups.rows(key, channel=channel)
            told = np.column_stack([taken(frames, rows), frames.length[rows]])
            differs = np.ones(len(rows), np.bool_)
            differs[1:] = (told[1:] != told[:-1]).any(axis=1)
            differs[0] = self._before.get((key, channel)) != told[0].tobytes()
            self._before[key, channel] = told[-1].tobytes()
            changed[rows] = differs
        return changed

    def _by_rate(self, frames: Frames, groups: Groups, keep: Bools) -> Bools:
        assert self.wanted.rate_hz is not None
        shown = np.zeros(len(frames), np.bool_)
        slot_ns = max(1, round(NS_PER_S / self.wanted.rate_hz))
        for place in groups.places:
            rows = groups.rows(place[0], channel=place[1])
            rows = rows[keep[rows]]
            if len(rows):
                slots = frames.at_ns[rows] // slot_ns
                before = np.concatenate([[self._slots.get(place, -1)], slots[:-1]])
                self._slots[place] = int(slots[-1])
                shown[rows] = slots != before
        return shown


def around(instants_ns: Sequence[int], within_s: float) -> tuple[tuple[int, int], ...]:
    """Return spans of `within_s` seconds before and after each instant."""
    within_ns = round(within_s * NS_PER_S)
    return tuple((at_ns - within_ns, at_ns + within_ns) for at_ns in instants_ns)
