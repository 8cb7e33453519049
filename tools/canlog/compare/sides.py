"""What `canlog diff` compares at one place of a log: frames, or messages reassembled from them."""

from dataclasses import dataclass
from functools import cached_property
from typing import Any, Final, NamedTuple

import numpy as np

from canlog.bus_model import Bus, MessageSpec
from canlog.frames import Bools, Ints
from canlog.reader import Log
from canlog.table import Table, table_of
from canlog.transport.messages import Messages, TransportStatus, incomplete_text
from canlog.transport.reassembly import Reassembler, is_part, options_for
from canlog.transport.senders import by_sender, sender_name, sender_spec

SINGLE: Final = -2
"""Stands for a group: frames that are compared one by one."""


class MessagePlace(NamedTuple):
    """Where a message comes from: key of its frames, parameter group, channel."""

    key: int
    group: int
    """Parameter group of reassembled J1939 messages, -1 for ISO-TP, or SINGLE."""
    channel: str

    def spec(self, bus: Bus) -> MessageSpec | None:
        if self.group == SINGLE:
            return bus.on(self.channel).spec_at(self.key)
        return sender_spec(bus, self.channel, self.group)

    def name(self, bus: Bus) -> str:
        """Return the name without the channel."""
        if self.group == SINGLE:
            return bus.on(self.channel).name_of(self.key)
        return sender_name(bus, self.channel, self.key, self.group)


@dataclass(frozen=True, slots=True, eq=False)
class FrameSide:
    """Frames of one place, in order of time."""

    log: Log
    place: MessagePlace
    at_ns: Ints
    """(n,) stamps."""
    rows: Ints
    """(n,) numbers of the frames in the log."""
    places: Ints
    """(n,) rows of the table."""

    def table(self, spec: MessageSpec) -> Table:
        """Return the decoded values of all frames, in the order of the log."""
        return self.log.groups.table(spec, self.place.channel, (self.place.key,))

    def text(self, at: int) -> str:
        """Return the data in hexadecimal."""
        return self.log.frames.payload(int(self.rows[at])).hex(" ").upper()

    def unequal(self, other: Any, pairs: tuple[Ints, Ints], *, whole: bool) -> Bools:
        """(k,) which pairs differ in length or, if `whole`, in any byte."""
        a, b = self.log.frames, other.log.frames
        rows_a, rows_b = self.rows[pairs[0]], other.rows[pairs[1]]
        found: Bools = a.length[rows_a] != b.length[rows_b]
        if whole:
            width = max(a.data.shape[1], b.data.shape[1])
            padded = [
                np.pad(frames.data[rows], ((0, 0), (0, width - frames.data.shape[1])))
                for frames, rows in ((a, rows_a), (b, rows_b))
            ]
            found |= (padded[0] != padded[1]).any(axis=1)
        return found


@dataclass(frozen=True, slots=True, eq=False)
class LongSide:
    """Reassembled messages of one place, in order of time."""

    at_ns: Ints
    """(n,) stamps of their last frames."""
    rows: Ints
    """(n,) numbers of their last frames in the log."""
    places: Ints
    """(n,) rows of the table."""
    data: list[bytes]
    """Empty for an incomplete message."""
    status: list[TransportStatus]

    def table(self, spec: MessageSpec) -> Table:
        """Return the decoded values; an incomplete message has none."""
        return table_of(spec, self.data, self.at_ns.tolist(), self.rows.tolist())

    def text(self, at: int) -> str:
        """Return the data in hexadecimal, or why there is none."""
        if self.status[at] is TransportStatus.WHOLE:
            return self.data[at].hex(" ").upper()
        return incomplete_text(self.status[at])

    def unequal(self, other: Any, pairs: tuple[Ints, Ints], *, whole: bool) -> Bools:
        """(k,) which pairs differ in status or length or, if `whole`, in any byte."""
        found = [
            self.status[a] is not other.status[b]
            or len(self.data[a]) != len(other.data[b])
            or (whole and self.data[a] != other.data[b])
            for a, b in zip(*(rows.tolist() for rows in pairs), strict=True)
        ]
        return np.array(found, np.bool_)


Side = FrameSide | LongSide


class Sides:
    """All places of one log, each with its frames or messages."""

    def __init__(self, log: Log) -> None:
        self._log = log
        keys = [key for key in log.groups.keys if is_part(key)]
        self._rows = log.groups.rows(*keys) if keys else np.zeros(0, np.int64)
        self._parts: list[Messages] = []
        if len(self._rows):
            reassembler = Reassembler(options_for(log.bus))
            frames = log.frames[self._rows]
            self._parts = reassembler.feed(frames) + reassembler.finish()

    @cached_property
    def places(self) -> list[MessagePlace]:
        """Places with at least one frame or message."""
        single = [MessagePlace(key, SINGLE, channel) for key, channel in self._log.groups.places]
        return [*(each for each in single if len(self._singles(each))), *self._long]

    @cached_property
    def _long(self) -> dict[MessagePlace, list[tuple[Messages, Ints]]]:
        found: dict[MessagePlace, list[tuple[Messages, Ints]]] = {}
        for part in self._parts:
            for (channel, key, group), rows in by_sender(part):
                place = MessagePlace(key, group, channel)
                # Frames of ISO-TP that a DBC file defines are compared by their signals.
                if group >= 0 or MessagePlace(key, SINGLE, channel).spec(self._log.bus) is None:
                    found.setdefault(place, []).append((part, rows))
        return found

    @cached_property
    def _is_part(self) -> Bools | None:
        """(n,) frames that are compared as parts of messages; None if there are none."""
        if not self._long:
            return None
        found = np.zeros(len(self._log), np.bool_)
        for pieces in self._long.values():
            for part, rows in pieces:
                mine = np.zeros(len(part), np.bool_)
                mine[rows] = True
                frames = part.rows[np.repeat(mine, np.diff(part.row_ends, prepend=0))]
                found[self._rows[frames]] = True
        return found

    def _singles(self, place: MessagePlace) -> Ints:
        """Return which frames of a place are compared one by one."""
        rows = self._log.groups.rows(place.key, channel=place.channel)
        if self._is_part is None or place.spec(self._log.bus) is not None:
            return np.arange(len(rows))
        found: Ints = np.flatnonzero(~self._is_part[rows])
        return found

    def side(self, place: MessagePlace) -> Side:
        """Return the frames or messages of a place; none if the log lacks it."""
        if place.group != SINGLE:
            return self._long_side(place)
        chosen = self._singles(place)
        rows = self._log.groups.rows(place.key, channel=place.channel)[chosen]
        at_ns = self._log.frames.at_ns[rows]
        order = np.argsort(at_ns, kind="stable")
        return FrameSide(self._log, place, at_ns[order], rows[order], chosen[order])

    def _long_side(self, place: MessagePlace) -> LongSide:
        found = [
            (int(part.at_ns[at]), int(self._rows[part.frames(at)[-1]]), part.payload(at),
             TransportStatus(int(part.status[at])))
            for part, rows in self._long.get(place, ())
            for at in rows.tolist()
        ]  # fmt: skip
        found.sort(key=lambda one: one[:2])
        return LongSide(
            np.array([at_ns for at_ns, *_ in found], np.int64),
            np.array([row for _, row, *_ in found], np.int64),
            np.arange(len(found)),
            [data for _, _, data, _ in found],
            [status for *_, status in found],
        )
