"""Starts, queries and stops the hub process of an embedded bus, and connects to it."""

import contextlib
import errno
import fcntl
import json
import os
import select
import signal
import socket
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from firmware_py import rendezvous
from firmware_py.buses.errors import BusError
from firmware_py.buses.records import (
    RECORD_BYTES,
    REFUSAL_WORDS,
    Announcement,
    Control,
    pack_announcement,
    read_announcement,
)
from firmware_py.clock.clock import WallClock

ANSWER_S: Final = 2.0
"""Time after which a hub that has not answered counts as dead, s."""
START_S: Final = 10.0
STOP_S: Final = 3.0
POLL_NS: Final = 20_000_000
NS_PER_S: Final = 1_000_000_000
BUFFER_BYTES: Final = 1 << 20
READY: Final = "ready"
"""The only line that a hub writes to its standard output."""


@dataclass(frozen=True, slots=True)
class ClientStatus:
    """One node on a hub."""

    node: str
    sent: int
    waiting: int
    """Frames in the hub that the node has not received yet."""
    dropped: int
    """Frames that the node missed because too many were waiting."""


@dataclass(frozen=True, slots=True)
class HubStatus:
    """Status that a hub reports of itself."""

    bus: str
    pid: int
    bound: bool
    """The hub ends with the process that started it."""
    uptime_s: float
    frames: int
    dropped: int
    """Frames missed by any client, including clients that have left."""
    malformed: int
    """Records from clients that were not frames."""
    clients: tuple[ClientStatus, ...]


class HubHandle:
    """A hub that this process started."""

    def __init__(self, name: str, process: subprocess.Popen[str], *, bound: bool) -> None:
        self.name = name
        self.bound = bound
        self._process = process

    @property
    def pid(self) -> int:
        return self._process.pid

    @property
    def running(self) -> bool:
        return self._process.poll() is None

    def stop(self) -> None:
        """End the hub, by SIGKILL if it does not react to SIGTERM; no effect if it has ended
        already.
        """
        if self._process.stdin is not None:
            with contextlib.suppress(OSError):
                self._process.stdin.close()
        for ask in (self._process.terminate, self._process.kill):
            ask()
            with contextlib.suppress(subprocess.TimeoutExpired):
                self._process.wait(STOP_S)
                return


def start_hub(name: str, bound: bool) -> HubHandle:
    """Start a hub process and wait until it answers.

    Args:
        name: name of the bus; there is one hub of a name per user and machine.
        bound: end the hub as soon as this process ends, for whatever reason.

    Raises:
        BusError: if a hub of that name runs already or the new one does not start.
    """
    log_path = rendezvous.bench_dir(name) / "hub.log"
    command = [sys.executable, "-m", "firmware_py.buses.hub", name]
    with log_path.open("w", encoding="utf-8") as log:
        process = subprocess.Popen(  # noqa: S603 - our own interpreter and module, a checked name
            command + (["--with-parent"] if bound else []),
            stdin=subprocess.PIPE if bound else subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=log,
            text=True,
            # A keyboard interrupt goes to the starter only, which ends the hub last.
            start_new_session=True,
        )
    handle = HubHandle(name, process, bound=bound)
    output = process.stdout
    assert output is not None
    with output:
        answered = select.select([output], [], [], START_S)[0]
        if answered and output.readline().strip() == READY:
            return handle
    handle.stop()
    raise BusError(f"embedded:{name}: {_last_words(log_path)}")


def hub_status(name: str) -> HubStatus | None:
    """Return the status of the hub of that name; None if none runs.

    Raises:
        BusError: if a hub runs but does not answer.
    """
    try:
        connection = connect_hub(name)
    except NoHubError:
        return None
    with connection:
        try:
            connection.sendall(pack_announcement(Control.ASK))
            answer = _read_to_end(connection)
        except OSError as error:
            raise BusError(f"embedded:{name}: the hub does not answer") from error
    check_answer(name, answer, Control.STATUS)
    return _parse_status(name, answer)


def stop_hub(name: str) -> bool:
    """End the hub of that name, whichever process started it.

    Returns whether there was one.

    Raises:
        BusError: if the hub cannot be ended.
    """
    clock = WallClock()
    lock_path = rendezvous.hub_lock(name)
    for number in (signal.SIGTERM, signal.SIGKILL):
        pid = _holder(lock_path)
        if pid is None:
            return number is signal.SIGKILL
        try:
            os.kill(pid, number)
        except ProcessLookupError:
            continue
        except PermissionError as error:
            raise BusError(
                f"embedded:{name}: hub {pid} belongs to another user and cannot be ended"
            ) from error
        until_ns = clock.now_ns() + int(STOP_S * NS_PER_S)
        while clock.now_ns() < until_ns:
            if _holder(lock_path) is None:
                return True
            clock.wait_until(clock.now_ns() + POLL_NS)
    raise BusError(f"embedded:{name}: the hub does not end")


class NoHubError(BusError):
    """No hub of that name runs."""


def connect_hub(name: str) -> socket.socket:
    """Connect to a hub; no call on the connection waits longer than `ANSWER_S`.

    Raises:
        NoHubError: if no hub listens there.
        BusError: if one does but cannot be reached.
    """
    path = rendezvous.hub_socket(name)
    connection = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    connection.settimeout(ANSWER_S)
    for option in (socket.SO_SNDBUF, socket.SO_RCVBUF):
        with contextlib.suppress(OSError):
            connection.setsockopt(socket.SOL_SOCKET, option, BUFFER_BYTES)
    try:
        connection.connect(str(path))
    except OSError as error:
        connection.close()
        if error.errno in (errno.ENOENT, errno.ECONNREFUSED):
            raise NoHubError(
                f"embedded:{name}: no hub of that name runs; start it with `vcan up {name}`"
            ) from error
        words = error.strerror or "it does not answer"
        raise BusError(f"embedded:{name}: cannot reach the hub: {words}") from error
    return connection


def check_answer(name: str, answer: bytes, expected: Control) -> Announcement:
    """Return the hub's first record if it is the expected one.

    Raises:
        BusError: if it is another record, with the hub's reason.
    """
    said = read_announcement(answer) if len(answer) >= RECORD_BYTES else None
    if said is not None and said.control is expected:
        return said
    if said is not None and said.control is Control.REFUSED and said.detail in REFUSAL_WORDS:
        words = REFUSAL_WORDS[said.detail]
        raise BusError(f"embedded:{name}: refused: {words}")
    raise BusError(f"embedded:{name}: the program that answers is not a hub of this project")


def _read_to_end(connection: socket.socket) -> bytes:
    answer = bytearray()
    while data := connection.recv(1 << 16):
        answer += data
    return bytes(answer)


def _parse_status(name: str, answer: bytes) -> HubStatus:
    said = read_announcement(answer)
    assert said is not None
    try:
        told: dict[str, Any] = json.loads(answer[RECORD_BYTES : RECORD_BYTES + said.detail])
        clients = tuple(ClientStatus(**client) for client in told.pop("clients"))
        return HubStatus(clients=clients, **told)
    except (ValueError, KeyError, TypeError) as error:
        raise BusError(f"embedded:{name}: the hub's status makes no sense: {error}") from error


def _holder(lock_path: Path) -> int | None:
    """Process id of the running hub that holds the lock; None if no process holds it."""
    try:
        with lock_path.open("r", encoding="ascii") as lock:
            try:
                fcntl.flock(lock, fcntl.LOCK_SH | fcntl.LOCK_NB)
            except BlockingIOError:
                text = lock.read().strip()
                return int(text) if text.isdecimal() else None
    except FileNotFoundError:
        pass
    return None


def _last_words(log_path: Path) -> str:
    lines = log_path.read_text(encoding="utf-8", errors="replace").strip().splitlines()
    if not lines:
        return "the hub did not start"
    return lines[-1].removeprefix("hub: ")
