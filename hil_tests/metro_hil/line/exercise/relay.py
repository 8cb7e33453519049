"""Carries the radio of trains to their wayside and cuts it, as a separate process.

A cut holds all bytes back in both directions, like a network over which TCP retries. When the cut
ends, the held bytes arrive in one old burst.
"""

import argparse
import contextlib
import selectors
import socket
import sys
from collections.abc import Sequence
from typing import Final

from firmware_py.clock.realtime import die_with_parent

CHUNK_BYTES: Final = 1 << 16
HELD_BYTES: Final = 1 << 22
"""Maximum number of bytes held for one direction of a connection; more stays in the kernel, and the
sender waits."""


class _Way:
    """One direction of one connection."""

    def __init__(self, source: socket.socket, sink: socket.socket) -> None:
        self.source, self.sink = source, sink
        self.held = bytearray()
        self.ended = False

    def read(self) -> None:
        try:
            data = self.source.recv(CHUNK_BYTES)
        except BlockingIOError:
            return
        except OSError:
            data = b""
        self.held += data
        self.ended = self.ended or not data

    def write(self) -> None:
        while self.held:
            try:
                sent = self.sink.send(self.held)
            except BlockingIOError:
                return
            except OSError:
                self.ended = True
                return
            del self.held[:sent]


class Relay:
    """One listening port for each name; all connections lead to one endpoint."""

    def __init__(self, names: Sequence[str], host: str, port: int) -> None:
        self.ports: dict[str, int] = {}
        self._target = (host, port)
        self._selector = selectors.DefaultSelector()
        self._ways: dict[str, list[tuple[_Way, _Way]]] = {name: [] for name in names}
        self._cut: set[str] = set()
        self._listeners = []
        for name in names:
            listener = socket.create_server(("127.0.0.1", 0))
            listener.setblocking(False)
            self.ports[name] = listener.getsockname()[1]
            self._selector.register(listener, selectors.EVENT_READ, name)
            self._listeners.append(listener)

    def cut(self, name: str, *, cut: bool) -> None:
        if cut:
            self._cut.add(name)
        else:
            self._cut.discard(name)

    def step(self, wait_s: float) -> None:
        """Accept new connections, read what arrived, and pass on what is not cut."""
        for key, _ in self._selector.select(wait_s):
            if key.data is None:
                continue
            if isinstance(key.data, _Way):
                if len(key.data.held) < HELD_BYTES:
                    key.data.read()
            else:
                self._connect(key.fileobj, key.data)
        for name, pairs in self._ways.items():
            if name in self._cut:
                continue
            for pair in list(pairs):
                for way in pair:
                    way.write()
                if any(way.ended and not way.held for way in pair):
                    self._close(pair)
                    pairs.remove(pair)

    def _connect(self, listener: object, name: str) -> None:
        assert isinstance(listener, socket.socket)
        near, _ = listener.accept()
        try:
            far = socket.create_connection(self._target, 1.0)
        except OSError:
            near.close()
            return
        pair = (_Way(near, far), _Way(far, near))
        for way in pair:
            way.source.setblocking(False)
            way.source.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            self._selector.register(way.source, selectors.EVENT_READ, way)
        self._ways[name].append(pair)

    def _close(self, pair: tuple[_Way, _Way]) -> None:
        for way in pair:
            with contextlib.suppress(KeyError, ValueError):
                self._selector.unregister(way.source)
            way.source.close()

    def attend(self, file: object) -> None:
        """Let `step` also wake up for this file."""
        self._selector.register(file, selectors.EVENT_READ, None)  # type: ignore[arg-type]


def main(argv: Sequence[str] | None = None) -> int:
    """Print the ports, one a line; obey `cut NAME` and `heal NAME` on standard input."""
    parser = argparse.ArgumentParser(
        prog="python -m metro_hil.line.exercise.relay", description=__doc__
    )
    parser.add_argument("host")
    parser.add_argument("port", type=int)
    parser.add_argument("names", nargs="+")
    parser.add_argument("--parent", type=int, required=True)
    options = parser.parse_args(argv)
    die_with_parent(options.parent)
    relay = Relay(options.names, options.host, options.port)
    for name, port in relay.ports.items():
        print(f"{name} {port}", flush=True)
    sys.stdin.reconfigure(line_buffering=True)  # type: ignore[union-attr]
    with selectors.DefaultSelector() as orders:
        orders.register(sys.stdin, selectors.EVENT_READ)
        relay.attend(sys.stdin)
        while True:
            relay.step(0.05)
            if orders.select(0.0):
                words = sys.stdin.readline().split()
                if not words:
                    return 0
                relay.cut(words[1], cut=words[0] == "cut")


if __name__ == "__main__":
    sys.exit(main())
