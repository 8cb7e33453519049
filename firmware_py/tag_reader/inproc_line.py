"""A serial line in virtual time: two ports in one process, each byte with its duration on the wire.

Counters count bytes.
"""

from collections import deque
from collections.abc import Sequence
from typing import Final

from firmware_py.ports import LinkCounters, SerialChunk

BAUD: Final = 115_200
BITS_PER_BYTE: Final = 10
"""Bits of a byte in 8N1: start bit, eight data bits, stop bit."""
CAPACITY_BYTES: Final = 4096
_BITS_NS: Final = BITS_PER_BYTE * 1_000_000_000


class _Wire:
    """One direction of the line. Queued bytes follow each other without a gap."""

    def __init__(self, baud: int, capacity_bytes: int) -> None:
        self.held_bytes = 0
        self._baud = baud
        self._capacity_bytes = capacity_bytes
        self._free_ns = 0
        self._pieces: deque[tuple[int, bytes]] = deque()
        """Start of the first byte's start bit, and the bytes."""
        self._taken = 0
        """Number of bytes of the first piece that were already taken."""

    def put(self, now_ns: int, data: bytes) -> bool:
        """Queue bytes; returns False if they exceed the capacity together with the bytes not yet
        taken.
        """
        if self.held_bytes + len(data) > self._capacity_bytes:
            return False
        start_ns = max(now_ns, self._free_ns)
        self._free_ns = start_ns + self._time_ns(len(data))
        self._pieces.append((start_ns, data))
        self.held_bytes += len(data)
        return True

    def take(self, now_ns: int) -> list[SerialChunk]:
        """Return the bytes whose stop bit has ended, stamped with the end of the last byte of each
        piece.
        """
        chunks: list[SerialChunk] = []
        while self._pieces:
            start_ns, data = self._pieces[0]
            done = min(self._done_bytes(now_ns - start_ns), len(data))
            if done <= self._taken:
                break
            chunks.append(SerialChunk(start_ns + self._time_ns(done), data[self._taken : done]))
            self.held_bytes -= done - self._taken
            self._taken = done
            if done < len(data):
                break
            self._pieces.popleft()
            self._taken = 0
        return chunks

    def _time_ns(self, byte_count: int) -> int:
        return byte_count * _BITS_NS // self._baud

    def _done_bytes(self, elapsed_ns: int) -> int:
        """Return the largest number of bytes whose `_time_ns` does not exceed `elapsed_ns`."""
        return ((elapsed_ns + 1) * self._baud - 1) // _BITS_NS


class InprocSerialPort:
    def __init__(self, outgoing: _Wire, incoming: _Wire) -> None:
        self.counters = LinkCounters()
        self._outgoing = outgoing
        self._incoming = incoming
        self._closed = False

    def send(self, now_ns: int, data: bytes) -> None:
        if not data:
            return
        if not self._closed and self._outgoing.put(now_ns, data):
            self.counters.sent += len(data)
        else:
            self.counters.dropped_out += len(data)

    def receive(self, now_ns: int) -> Sequence[SerialChunk]:
        if self._closed or not self._incoming.held_bytes:
            return ()
        chunks = self._incoming.take(now_ns)
        for chunk in chunks:
            self.counters.received += len(chunk.data)
        return chunks

    def close(self) -> None:
        self._closed = True


def inproc_line(
    *, baud: int = BAUD, capacity_bytes: int = CAPACITY_BYTES
) -> tuple[InprocSerialPort, InprocSerialPort]:
    """Create the two ends of one line.

    Data that does not fit into a direction is dropped as a whole and counted.
    """
    assert baud > 0
    one, other = _Wire(baud, capacity_bytes), _Wire(baud, capacity_bytes)
    return InprocSerialPort(one, other), InprocSerialPort(other, one)
