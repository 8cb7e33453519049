"""The bench's end of the truth feed: a Unix datagram socket that the plant writes to."""

import contextlib
import socket
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Final

from firmware_py.clock.clock import Clock

MESSAGE_BYTES: Final = 4096
BUFFER_BYTES: Final = 1 << 21
MESSAGES_PER_DRAIN: Final = 2000
NS_PER_S: Final = 1_000_000_000
_SO_TIMESTAMPNS: Final = 35
_TIMESPEC: Final = struct.Struct("@qq")


class FeedSocket:
    """Returns messages with their send instants, as far as the kernel provides them."""

    def __init__(self, path: Path, clock: Clock) -> None:
        """Bind the socket. Raises OSError."""
        self.path = path
        self._clock = clock
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        try:
            with contextlib.suppress(OSError):
                self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, BUFFER_BYTES)
            with contextlib.suppress(OSError):
                self._socket.setsockopt(socket.SOL_SOCKET, _SO_TIMESTAMPNS, 1)
            self._socket.setblocking(False)
            self._socket.bind(str(path))
        except OSError:
            self._socket.close()
            raise

    def fileno(self) -> int:
        return self._socket.fileno()

    def receive(self, now_ns: int) -> Iterator[tuple[int, bytes]]:
        """Yield the messages since the last call with the instant of each, never later than now."""
        for _ in range(MESSAGES_PER_DRAIN):
            try:
                message, notes, _, _ = self._socket.recvmsg(
                    MESSAGE_BYTES, socket.CMSG_SPACE(_TIMESPEC.size)
                )
            except BlockingIOError:
                return
            yield min(self._sent_ns(notes, now_ns), now_ns), message

    def close(self) -> None:
        self._socket.close()
        self.path.unlink(missing_ok=True)

    def _sent_ns(self, notes: list[tuple[int, int, bytes]], now_ns: int) -> int:
        for level, kind, stamp in notes:
            if level == socket.SOL_SOCKET and kind == _SO_TIMESTAMPNS:
                seconds, past_ns = _TIMESPEC.unpack(stamp[: _TIMESPEC.size])
                return int(seconds) * NS_PER_S + int(past_ns) - self._clock.epoch_offset_ns
        return now_ns


def tell(sender: socket.socket, path: Path, message: bytes) -> bool:
    """Send one datagram without waiting; return whether it was taken."""
    try:
        sender.sendto(message, socket.MSG_DONTWAIT, str(path))
    except OSError:
        return False
    return True
