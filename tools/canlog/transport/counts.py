"""Statistics of reassembled messages, by channel, identifier and parameter group."""

from dataclasses import dataclass, field
from typing import Final

import numpy as np

from canlog.bus_model import Bus, MessageSpec
from canlog.frames import Ints
from canlog.gaps import Gaps
from canlog.transport.messages import Messages, TransportStatus
from canlog.transport.names import FAULTS, service_name
from canlog.transport.senders import sender_spec

NS_PER_MS: Final = 1_000_000


@dataclass(slots=True)
class TransportStats:
    """Statistics of the reassembled messages of one sender."""

    channel: str
    key: int
    """Key of the frames with the data."""
    group: int
    """Parameter group number for J1939; -1 for ISO-TP."""
    spec: MessageSpec | None
    gaps: Gaps
    """Gaps between whole messages, by their last frames."""
    whole: int = 0
    frames: int = 0
    """Number of frames that the whole messages consist of."""
    incomplete: dict[TransportStatus, int] = field(default_factory=dict)
    shortest: int = 0
    """Data bytes of the shortest whole message."""
    longest: int = 0
    services: dict[str, int] = field(default_factory=dict)
    """Number of ISO-TP messages of each service of UDS and OBD."""

    @property
    def name(self) -> str:
        """Name of the message: from the DBC file, or of a trouble code message, or empty."""
        return self.spec.name if self.spec is not None else FAULTS.get(self.group, "")

    def feed(self, found: Messages, rows: Ints) -> None:
        """Add messages: these rows of `found`, in order of time."""
        status = found.status[rows]
        for number, count in zip(*np.unique(status, return_counts=True), strict=True):
            if number != TransportStatus.WHOLE:
                why = TransportStatus(int(number))
                self.incomplete[why] = self.incomplete.get(why, 0) + int(count)
        rows = rows[status == TransportStatus.WHOLE]
        if not len(rows):
            return
        size = np.diff(found.data_ends, prepend=0)[rows]
        least = int(size.min())
        self.shortest = min(self.shortest, least) if self.whole else least
        self.longest = max(self.longest, int(size.max()))
        self.whole += len(rows)
        self.frames += int(np.diff(found.row_ends, prepend=0)[rows].sum())
        self.gaps.feed(found.at_ns[rows])
        if self.group < 0:
            heads = found.data[found.data_ends[rows] - size]
            for head, count in zip(*np.unique(heads, return_counts=True), strict=True):
                name = service_name(int(head))
                self.services[name] = self.services.get(name, 0) + int(count)


def sender_stats(bus: Bus, channel: str, key: int, group: int) -> TransportStats:
    """Return empty statistics of one sender."""
    spec = sender_spec(bus, channel, group)
    period_ms, timeout_ms = (spec.period_ms, spec.timeout_ms) if spec is not None else (0, 0)
    gaps = Gaps(period_ms * NS_PER_MS, timeout_ms * NS_PER_MS)
    return TransportStats(channel, key, group, spec, gaps)
