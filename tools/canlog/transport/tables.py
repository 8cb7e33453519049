"""Reassembled J1939 messages as tables of the signals that the DBC files define."""

from canlog.bus_model import Bus, LogPart, MessageSpec
from canlog.frames import Frames
from canlog.table import Table, table_of
from canlog.transport.messages import Messages, TransportStatus
from canlog.transport.reassembly import Reassembler, TransportOptions, carries_parts


class LongTables:
    """Tables of reassembled messages; feed it the blocks of a log."""

    def __init__(self, bus: Bus) -> None:
        self._bus = bus
        self.unknown: dict[int, int] = {}
        """Number of whole messages by parameter groups that no DBC file defines."""
        self._reassembler: Reassembler | None = None
        if any(each.by_group for each in (bus, *bus.by_channel.values())):
            self._reassembler = Reassembler(TransportOptions(isotp=False))

    def carries(self, key: int) -> bool:
        """Whether frames of a key are only parts of messages."""
        return self._reassembler is not None and carries_parts(key)

    def feed(self, frames: Frames) -> dict[LogPart, Table]:
        """Return the messages that end in the next block."""
        if self._reassembler is None:
            return {}
        return self._tables(self._reassembler.feed(frames))

    def _tables(self, parts: list[Messages]) -> dict[LogPart, Table]:
        rows: dict[LogPart, tuple[MessageSpec, list[tuple[int, int, bytes]]]] = {}
        for found in parts:
            for at in range(len(found)):
                channel = found.channels[int(found.channel[at])]
                group = int(found.group[at])
                spec = self._bus.on(channel).by_group.get(group)
                if found.status[at] != TransportStatus.WHOLE:
                    continue
                if spec is None:
                    self.unknown[group] = self.unknown.get(group, 0) + 1
                    continue
                place = LogPart(spec.name, channel, spec.origin(int(found.key[at])))
                row = int(found.at_ns[at]), found.frames(at)[-1], found.payload(at)
                rows.setdefault(place, (spec, []))[1].append(row)
        return {
            place: table_of(spec, [data for *_, data in mine], [at_ns for at_ns, *_ in mine],
                            [row for _, row, _ in mine])
            for place, (spec, mine) in rows.items()
        }  # fmt: skip
