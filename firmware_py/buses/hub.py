"""The process of an embedded bus's hub: `python -m firmware_py.buses.hub NAME [--with-parent]`."""

import argparse
import fcntl
import os
import signal
import socket
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TextIO

from firmware_py import rendezvous
from firmware_py.buses.errors import BusError
from firmware_py.buses.hub_control import READY
from firmware_py.buses.hub_server import Hub
from firmware_py.clock.clock import WallClock
from firmware_py.clock.realtime import enter_realtime

LOCK_TRIES = 10
LOCK_PAUSE_NS = 30_000_000
BACKLOG = 64
PRIORITY = 75
"""Real-time priority, below a controller's and above a plant's: a bus must not be slower than its
nodes."""


def main(argv: Sequence[str] | None = None) -> int:
    """Serve until SIGTERM, SIGINT or, with a parent, the end of standard input."""
    parser = argparse.ArgumentParser(prog="hub", description="Hub of an embedded CAN bus.")
    parser.add_argument("name", help="name of the bus, for example vcan0")
    parser.add_argument(
        "--with-parent", action="store_true", help="end when standard input is closed"
    )
    options = parser.parse_args(argv)
    try:
        with take_lock(options.name):
            serve(options.name, with_parent=options.with_parent)
    except BusError as error:
        print(f"hub: {error}", file=sys.stderr)
        return 1
    return 0


def serve(name: str, *, with_parent: bool) -> None:
    """Listen, print READY, and serve until asked to end. The caller holds the lock."""
    path = rendezvous.hub_socket(name)
    hub = Hub(name, _listen(path), WallClock(), bound=with_parent)
    hub.end_on(_signals())
    if with_parent:
        hub.end_on(sys.stdin.fileno())
    # The hub also works without real-time priority.
    enter_realtime(PRIORITY)
    print(READY, flush=True)
    try:
        hub.serve()
    finally:
        path.unlink(missing_ok=True)


def take_lock(name: str) -> TextIO:
    """Return the lock that makes this process the hub of that name until the file is closed.

    A process that only checks for a hub holds the lock for a moment, so this retries for longer
    than that.

    Raises:
        BusError: if another hub has the lock.
    """
    path = rendezvous.hub_lock(name)
    clock = WallClock()
    lock = os.fdopen(os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600), "r+")
    for _ in range(LOCK_TRIES):
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            clock.wait_until(clock.now_ns() + LOCK_PAUSE_NS)
            continue
        lock.truncate(0)
        lock.write(f"{os.getpid()}\n")
        lock.flush()
        return lock
    holder = lock.read().strip()
    lock.close()
    raise BusError(f"a hub of bus {name!r} runs already (process {holder})")


def _listen(path: Path) -> socket.socket:
    """Bind the socket.

    The holder of the lock may replace a socket that a killed hub left behind.
    """
    path.unlink(missing_ok=True)
    listener = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    listener.bind(str(path))
    listener.listen(BACKLOG)
    return listener


def _signals() -> int:
    """Return a descriptor that becomes readable when a signal asks the process to end."""
    reader, writer = os.pipe()
    os.set_blocking(writer, False)
    signal.set_wakeup_fd(writer)
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda *_: None)
    return reader


if __name__ == "__main__":
    sys.exit(main())
