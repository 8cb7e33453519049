"""Message headers of one train: sender, incarnation, sequence number and time stamp."""

from typing import NamedTuple


class MessageHead(NamedTuple):
    """The first fields of every message, in their order."""

    source: int
    destination: int
    area: int
    term: int
    boot: int
    sequence: int
    stamp_ns: int


class MessageHeads:
    def __init__(self, address: int, boot: int) -> None:
        self.address, self.boot = address, boot
        self.sequence = 0
        """Sequence number of the last message."""

    def head(self, now_ns: int, *, to: int, area: int, term: int) -> MessageHead:
        self.sequence += 1
        return MessageHead(self.address, to, area, term, self.boot, self.sequence, now_ns)
