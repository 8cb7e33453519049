"""The hub of the embedded bus: one process that merges the frames of all clients into one total
order.

It receives whole records from clients, stamps them, and passes them to every other client. No
client can block it: frames that a client does not read wait in that client's queue. When the queue
is full, the hub drops and counts frames for that client alone, and reports to it where they are
missing.
"""

import contextlib
import json
import os
import selectors
import socket
from dataclasses import dataclass, field
from typing import Final

from firmware_py.buses.records import (
    MAX_NAME_BYTES,
    PROTOCOL_VERSION,
    RECORD_BYTES,
    Control,
    HubRefusal,
    pack_announcement,
    pack_lost,
    pack_text,
    read_announcement,
    stamp_frames,
    whole_records_bytes,
)
from firmware_py.clock.clock import Clock

QUEUE_RECORDS: Final = 100_000
"""Capacity of a client's queue; at 2,000 frames/s a client may pause for 50 s."""
MAX_CLIENTS: Final = 64
READ_BYTES: Final = 256 * 1024
NS_PER_S: Final = 1_000_000_000


@dataclass(eq=False, slots=True)
class _Client:
    """One connection with its input and output buffers."""

    socket: socket.socket
    name: str = ""
    """Name of the node; empty until the client has introduced itself."""
    heard: bytearray = field(default_factory=bytearray)
    """Bytes of an incomplete record."""
    queue: bytearray = field(default_factory=bytearray)
    waits_for_room: bool = False
    """The selector reports when the socket accepts more data."""
    sent: int = 0
    queued: int = 0
    dropped: int = 0
    told_dropped: int = 0
    leaves_when_told: bool = False


class Hub:
    """Serves one listening socket until asked to stop."""

    def __init__(
        self,
        bus_name: str,
        listener: socket.socket,
        clock: Clock,
        *,
        bound: bool = False,
        queue_records: int = QUEUE_RECORDS,
    ) -> None:
        self._bus_name = bus_name
        self._listener = listener
        self._clock = clock
        self._bound = bound
        self._queue_bytes = queue_records * RECORD_BYTES
        self._start_ns = clock.now_ns()
        self._frames = 0
        self._dropped_by_gone = 0
        self._malformed = 0
        self._clients: list[_Client] = []
        self._running = True
        self._selector = selectors.DefaultSelector()
        listener.setblocking(False)
        self._selector.register(listener, selectors.EVENT_READ)

    def end_on(self, descriptor: int) -> None:
        """Stop as soon as `descriptor` becomes readable or its other end is closed."""
        self._selector.register(descriptor, selectors.EVENT_READ, data="end")

    def serve(self) -> None:
        """Work until asked to end; then close every connection."""
        while self._running:
            self.serve_once(None)
        self.close()

    def serve_once(self, timeout_s: float | None) -> None:
        """Wait for one or more events and process all of them."""
        for key, events in self._selector.select(timeout_s):
            if key.data == "end":
                self._running = False
            elif key.data is None:
                self._welcome()
            else:
                self._attend(key.data, events)

    def close(self) -> None:
        for client in list(self._clients):
            self._part_from(client)
        self._selector.close()
        self._listener.close()

    def status(self) -> dict[str, object]:
        """Status for `vcan status`, as plain values."""
        now_ns = self._clock.now_ns()
        named = [client for client in self._clients if client.name]
        return {
            "bus": self._bus_name,
            "pid": os.getpid(),
            "bound": self._bound,
            "uptime_s": (now_ns - self._start_ns) / NS_PER_S,
            "frames": self._frames,
            "dropped": self._dropped_by_gone + sum(client.dropped for client in self._clients),
            "malformed": self._malformed,
            "clients": [
                {
                    "node": client.name,
                    "sent": client.sent,
                    "waiting": len(client.queue) // RECORD_BYTES,
                    "dropped": client.dropped,
                }
                for client in named
            ],
        }

    def _welcome(self) -> None:
        try:
            connection, _ = self._listener.accept()
        except OSError:
            return  # The client gave up before it was accepted.
        connection.setblocking(False)
        client = _Client(connection)
        if len(self._clients) >= MAX_CLIENTS:
            self._refuse(client, HubRefusal.TOO_MANY_CLIENTS)
            connection.close()
            return
        self._clients.append(client)
        self._selector.register(connection, selectors.EVENT_READ, data=client)

    def _attend(self, client: _Client, events: int) -> None:
        if client.socket.fileno() < 0:
            return  # The client was disconnected earlier in this round.
        if events & selectors.EVENT_WRITE:
            self._flush(client)
        if events & selectors.EVENT_READ and client.socket.fileno() >= 0:
            self._read(client)

    def _read(self, client: _Client) -> None:
        try:
            data = client.socket.recv(READ_BYTES)
        except BlockingIOError:
            return
        except OSError:
            data = b""
        if not data:
            self._part_from(client)
            return
        if client.leaves_when_told:
            return
        heard = client.heard
        heard += data
        if not client.name and not self._greet(client):
            return
        whole = len(heard) - len(heard) % RECORD_BYTES
        if whole:
            self._take(client, heard[:whole])
            del heard[:whole]

    def _take(self, sender: _Client, records: bytearray) -> None:
        """Stamp whole records of one client and pass them on."""
        offered = len(records) // RECORD_BYTES
        stamped = stamp_frames(records, self._clock.now_ns())
        frames = len(stamped) // RECORD_BYTES
        self._malformed += offered - frames
        self._frames += frames
        sender.sent += frames
        for client in list(self._clients):
            if client is not sender and client.name:
                self._pass_on(client, stamped)

    def _pass_on(self, client: _Client, records: bytearray) -> None:
        queue = client.queue
        room = max(0, self._queue_bytes - len(queue))
        room -= room % RECORD_BYTES
        if room < len(records):
            client.dropped += (len(records) - room) // RECORD_BYTES
            records = records[:room]
        queue += records
        if not client.waits_for_room:
            self._flush(client)

    def _flush(self, client: _Client) -> None:
        """Send what the socket accepts now; the selector reports when it accepts the rest."""
        queue = client.queue
        try:
            while queue:
                with memoryview(queue) as view:
                    taken = client.socket.send(view)
                del queue[:taken]
                if client.dropped != client.told_dropped:
                    # Report the missing frames behind the last one that found room.
                    queue += pack_lost(client.dropped)
                    client.told_dropped = client.dropped
        except BlockingIOError:
            pass
        except OSError:
            self._part_from(client)
            return
        if client.leaves_when_told and not queue:
            self._part_from(client)
        elif bool(queue) != client.waits_for_room:
            client.waits_for_room = bool(queue)
            wanted = selectors.EVENT_READ | (selectors.EVENT_WRITE if queue else 0)
            self._selector.modify(client.socket, wanted, data=client)

    def _greet(self, client: _Client) -> bool:
        """Process a greeting that may still be incomplete; returns True once the client is
        connected.
        """
        heard = client.heard
        if len(heard) < RECORD_BYTES:
            return False
        said = read_announcement(heard)
        if said is None or said.control not in (Control.HELLO, Control.ASK):
            return self._refuse(client, HubRefusal.NOT_A_HELLO)
        if said.version != PROTOCOL_VERSION:
            return self._refuse(client, HubRefusal.WRONG_VERSION)
        if said.control is Control.ASK:
            client.leaves_when_told = True
            client.queue += pack_text(Control.STATUS, json.dumps(self.status()).encode())
            self._flush(client)
            return False
        if not 0 < said.detail <= MAX_NAME_BYTES:
            return self._refuse(client, HubRefusal.BAD_NAME)
        greeting_bytes = RECORD_BYTES + whole_records_bytes(said.detail)
        if len(heard) < greeting_bytes:
            return False
        try:
            client.name = heard[RECORD_BYTES : RECORD_BYTES + said.detail].decode()
        except UnicodeDecodeError:
            return self._refuse(client, HubRefusal.BAD_NAME)
        del heard[:greeting_bytes]
        client.queue += pack_announcement(Control.WELCOME)
        self._flush(client)
        return client.socket.fileno() >= 0

    def _refuse(self, client: _Client, reason: HubRefusal) -> bool:
        client.leaves_when_told = True
        client.queue += pack_announcement(Control.REFUSED, reason)
        self._flush(client)
        return False

    def _part_from(self, client: _Client) -> None:
        if client in self._clients:
            self._clients.remove(client)
            self._dropped_by_gone += client.dropped
            with contextlib.suppress(KeyError, ValueError):
                self._selector.unregister(client.socket)
        client.socket.close()
