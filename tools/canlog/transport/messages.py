"""Reassembled messages as columns, and what went wrong with the incomplete ones."""

import enum
from dataclasses import dataclass
from typing import Any

from canlog.frames import Bytes, Ints


class TransportKind(enum.IntEnum):
    """Transport type of a message."""

    BROADCAST = 0
    """J1939: announced to all nodes (BAM)."""
    CONNECTION = 1
    """J1939: sent to one node that requests the packets (RTS and CTS)."""
    SINGLE = 2
    """ISO-TP: sent in one frame."""
    SEGMENTED = 3
    """ISO-TP: sent as a first frame and consecutive frames."""
    EXTENDED = 4
    """J1939: a connection of the extended transport protocol (ETP)."""


class TransportStatus(enum.IntEnum):
    """Whether a message is complete."""

    WHOLE = 0
    UNFINISHED = 1
    """The log ends, or another message begins, before the last frame."""
    WRONG_SEQUENCE = 2
    """A frame is missing or out of order."""
    TIMEOUT = 3
    """The next frame exceeded the receiver's timeout."""
    ABORTED = 4
    """J1939: one side aborted the connection."""


def incomplete_text(status: TransportStatus) -> str:
    """Return why a message is not complete."""
    return f"incomplete: {status.name.lower().replace('_', ' ')}"


@dataclass(frozen=True, slots=True, eq=False)
class Messages:
    """`n` messages in order of their last frames."""

    first_ns: Ints
    """(n,) stamp of the first frame of each message."""
    at_ns: Ints
    """(n,) stamp of the last frame."""
    key: Any
    """(n,) uint32: key of the frames with the data, with KEY_EXTENDED for 29 bits."""
    group: Ints
    """(n,) parameter group number for J1939; -1 for ISO-TP."""
    channel: Bytes
    """(n,) index into `channels`."""
    kind: Bytes
    """(n,) value of TransportKind."""
    status: Bytes
    """(n,) value of TransportStatus. Only WHOLE messages have data."""
    data: Bytes
    """The data of all messages, concatenated."""
    data_ends: Ints
    """(n,) where the data of each message ends."""
    rows: Ints
    """Numbers of the frames in the log, message after message."""
    row_ends: Ints
    channels: tuple[str, ...]

    def __len__(self) -> int:
        return len(self.at_ns)

    def payload(self, at: int) -> bytes:
        """Return the data of one message; empty if it is incomplete."""
        first = int(self.data_ends[at - 1]) if at else 0
        return self.data[first : int(self.data_ends[at])].tobytes()

    def frames(self, at: int) -> list[int]:
        """Return the frame numbers in the log, from 0, of one message."""
        first = int(self.row_ends[at - 1]) if at else 0
        found: list[int] = self.rows[first : int(self.row_ends[at])].tolist()
        return found
