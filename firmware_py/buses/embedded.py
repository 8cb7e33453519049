"""Client side of the embedded bus: a CAN port on a hub process, without kernel CAN."""

import socket
from collections.abc import Collection, Sequence
from typing import Final

from firmware_py.buses.errors import BusError
from firmware_py.buses.hub_control import (
    ClientStatus,
    HubHandle,
    HubStatus,
    check_answer,
    connect_hub,
    hub_status,
    start_hub,
    stop_hub,
)
from firmware_py.buses.records import (
    MAX_NAME_BYTES,
    RECORD_BYTES,
    Control,
    RecordReader,
    pack_frame,
    pack_text,
)
from firmware_py.ports import CanFrame, LinkCounters

__all__ = [
    "ClientStatus",
    "EmbeddedPort",
    "HubHandle",
    "HubStatus",
    "hub_status",
    "open_embedded",
    "start_hub",
    "stop_hub",
]

OUTBOX_BYTES: Final = 4096 * RECORD_BYTES
READ_BYTES: Final = 64 * 1024
READS_PER_DRAIN: Final = 4
"""Maximum number of reads in one drain; the rest waits for the next."""


class EmbeddedPort:
    """A node on a hub; a `CanPort`. It does not receive its own frames."""

    def __init__(
        self, connection: socket.socket, accept_ids: Collection[int] | None, greeting_rest: bytes
    ) -> None:
        """Take over a connection that the hub has accepted, with the data that followed the
        greeting.
        """
        connection.setblocking(False)
        self._socket = connection
        self._reader = RecordReader(accept_ids)
        self._early = greeting_rest
        self._outbox = bytearray()
        self._lost_link = 0
        self.counters = LinkCounters()
        self.alive = True
        """Whether the hub is connected. Once False it stays False, and the port sends and receives
        nothing."""

    def fileno(self) -> int:
        """Descriptor for a selector that waits for frames; -1 once closed."""
        return self._socket.fileno()

    def send(self, now_ns: int, can_id: int, data: bytes) -> None:
        """Pass one frame to the hub.

        Raises:
            ValueError: for an identifier or data that no classic 11-bit frame can carry.
        """
        record = pack_frame(can_id, data)
        if not self.alive or len(self._outbox) >= OUTBOX_BYTES:
            self.counters.dropped_out += 1
            return
        self.counters.sent += 1
        self._outbox += record
        self._flush()

    def receive(self, now_ns: int) -> Sequence[CanFrame]:
        """Return all frames of other nodes that arrived since the last call.

        Stamps are the hub's. A frame that arrived after the caller read the clock is stamped
        `now_ns`.
        """
        if self._outbox:
            self._flush()
        frames = self._reader.feed(self._early, now_ns) if self._early else []
        self._early = b""
        for _ in range(READS_PER_DRAIN):
            data = self._read()
            if not data:
                break
            frames += self._reader.feed(data, now_ns)
        counters = self.counters
        counters.received += len(frames)
        counters.dropped_in = self._reader.lost
        counters.errors = self._reader.errors + self._lost_link
        return frames

    def close(self) -> None:
        self.alive = False
        self._drop_outbox()
        self._socket.close()

    def _read(self) -> bytes:
        if not self.alive:
            return b""
        try:
            data = self._socket.recv(READ_BYTES)
        except BlockingIOError:
            return b""
        except OSError:
            data = b""
        if not data:
            self._lose_link()
        return data

    def _flush(self) -> None:
        outbox = self._outbox
        try:
            while outbox and self.alive:
                with memoryview(outbox) as view:
                    taken = self._socket.send(view)
                del outbox[:taken]
        except BlockingIOError:
            return
        except OSError:
            self._lose_link()

    def _lose_link(self) -> None:
        self.alive = False
        self._lost_link = 1
        self.counters.errors = self._reader.errors + self._lost_link
        self._drop_outbox()

    def _drop_outbox(self) -> None:
        """Count frames that never left as dropped.

        A frame that was sent only in part did not arrive.
        """
        unsent = -(-len(self._outbox) // RECORD_BYTES)
        self.counters.sent -= unsent
        self.counters.dropped_out += unsent
        self._outbox.clear()


def open_embedded(
    name: str, *, node: str, accept_ids: Collection[int] | None = None
) -> EmbeddedPort:
    """Connect to the hub of that name.

    Raises:
        BusError: if no hub answers, or the hub refuses.
    """
    spoken = node.encode()
    if not 0 < len(spoken) <= MAX_NAME_BYTES:
        raise BusError(f"node name {node!r}: 1 to {MAX_NAME_BYTES} bytes are needed")
    connection = connect_hub(name)
    try:
        connection.sendall(pack_text(Control.HELLO, spoken))
        greeting = b""
        while len(greeting) < RECORD_BYTES:
            data = connection.recv(READ_BYTES)
            if not data:
                raise BusError(
                    f"embedded:{name}: the hub closed the connection during the greeting"
                )
            greeting += data
        check_answer(name, greeting, Control.WELCOME)
    except OSError as error:
        connection.close()
        words = "does not answer" if isinstance(error, TimeoutError) else str(error.strerror)
        raise BusError(f"embedded:{name}: the hub failed at the greeting: {words}") from error
    except BusError:
        connection.close()
        raise
    return EmbeddedPort(connection, accept_ids, greeting[RECORD_BYTES:])
