"""The plant's end of its feed: sends datagrams to a Unix socket of a listener."""

import contextlib
import os
import socket
from collections import deque
from typing import Final

from firmware_py.settings import SettingsError
from plant_emulator.faults.feed import pack_change, pack_truth
from plant_emulator.faults.plan import FaultPlan
from plant_emulator.truth import Truth

PATH_BYTES_MAX: Final = 107
"""Longest path of a Unix socket."""
BUFFER_BYTES: Final = 1 << 20
CHANGES_MAX: Final = 4096
"""Maximum number of changes that wait for a listener; the oldest ones are dropped."""


class FeedSender:
    """Sends without waiting; datagrams that no listener takes are counted."""

    def __init__(self, path: str) -> None:
        """Open the feed; a listener may appear later.

        Raises SettingsError for an impossible path.
        """
        size = len(os.fsencode(path))
        if size > PATH_BYTES_MAX:
            raise SettingsError(
                f"--truth-feed {path}: {size} bytes long; a socket's path has at most "
                f"{PATH_BYTES_MAX}"
            )
        self.sent = 0
        self.lost = 0
        """Number of datagrams that found no listener or a full one."""
        self._changes: deque[bytes] = deque()
        """Changes that were not delivered yet. A listener that missed one would apply a fault for
        ever, or never."""
        self._path = path
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        with contextlib.suppress(OSError):
            self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, BUFFER_BYTES)

    def truth(self, truth: Truth, now_ns: int) -> None:
        """Send a sample of the truth; this is an observer of the plant."""
        if self._changes:
            self._send_changes()
        self._send(pack_truth(truth, now_ns))

    def change(self, plan: FaultPlan, active: bool, now_ns: int) -> None:
        """Send a change of a fault. An undelivered change is sent again before the next truth."""
        if len(self._changes) == CHANGES_MAX:
            self._changes.popleft()
        self._changes.append(pack_change(plan.index, active, now_ns))
        self._send_changes()

    def _send_changes(self) -> None:
        changes = self._changes
        while changes and self._send(changes[0]):
            changes.popleft()

    def _send(self, message: bytes) -> bool:
        try:
            self._socket.sendto(message, self._path)
        except OSError:
            self.lost += 1
            return False
        self.sent += 1
        return True

    def close(self) -> None:
        self._socket.close()
