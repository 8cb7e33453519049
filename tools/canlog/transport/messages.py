"""Messages put together from frames, as columns, and what went wrong with the others."""

import enum
from dataclasses import dataclass
from typing import Any

from canlog.frames import Bytes, Ints


class TransportKind(enum.IntEnum):
    """How a message was sent."""

    BROADCAST = 0
    """J1939: announced to all (BAM)."""
    CONNECTION = 1
    """J1939: to one node that asks for the packets (RTS and CTS)."""
    SINGLE = 2
    """ISO-TP: in one frame."""
    SEGMENTED = 3
    """ISO-TP: a first frame and consecutive ones."""


class TransportStatus(enum.IntEnum):
    """Whether a message is whole."""

    WHOLE = 0
    UNFINISHED = 1
    """The log ends, or another message begins, before the last frame."""
    WRONG_SEQUENCE = 2
    """A frame is missing or out of turn."""
    TIMEOUT = 3
    """The next frame came too late for the receiver."""
    ABORTED = 4
    """J1939: one of both gave the connection up."""


@dataclass(frozen=True, slots=True, eq=False)
class Messages:
    """`n` messages in the order of their last frames."""

    first_ns: Ints
    """(n,) stamp of the first frame of each."""
    at_ns: Ints
    """(n,) stamp of the last frame."""
    key: Any
    """(n,) uint32: of the frames with the data, with KEY_EXTENDED for 29 bits."""
    group: Ints
    """(n,) parameter group number of J1939; -1 in ISO-TP."""
    channel: Bytes
    """(n,) index into `channels`."""
    kind: Bytes
    """(n,) as in TransportKind."""
    status: Bytes
    """(n,) as in TransportStatus. What is not WHOLE has no data."""
    data: Bytes
    """The data of all, one behind the other."""
    data_ends: Ints
    """(n,) where those of each end."""
    rows: Ints
    """Numbers of the frames in the log that they come from, one message behind the other."""
    row_ends: Ints
    channels: tuple[str, ...]

    def __len__(self) -> int:
        return len(self.at_ns)

    def payload(self, at: int) -> bytes:
        """The data of one message; none of one that is not whole."""
        first = int(self.data_ends[at - 1]) if at else 0
        return self.data[first : int(self.data_ends[at])].tobytes()

    def frames(self, at: int) -> list[int]:
        """Which frames of the log, from 0, one message comes from."""
        first = int(self.row_ends[at - 1]) if at else 0
        found: list[int] = self.rows[first : int(self.row_ends[at])].tolist()
        return found
