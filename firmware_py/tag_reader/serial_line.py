"""The tag reader's serial line: a real port for the controller, a pseudo-terminal for the plant.

Counters count bytes. A chunk is stamped with the instant of its read, so a byte may have waited in
the kernel since the last read.
"""

import contextlib
import errno
import os
import select
import stat
import termios
import tty
from collections.abc import Sequence
from pathlib import Path
from typing import Final

import serial

from firmware_py.ports import LinkCounters, SerialChunk

BAUD: Final = 115_200
READ_BYTES: Final = 4096
FIRST_RETRY_NS: Final = 100_000_000
LONGEST_RETRY_NS: Final = 2_000_000_000

_REASONS: Final = {
    errno.ENOENT: "no such device",
    errno.EACCES: "permission denied; on most systems members of the group dialout may open it",
    errno.EPERM: "permission denied; on most systems members of the group dialout may open it",
    errno.EBUSY: "in use by another program",
    errno.EAGAIN: "in use by another program",
    errno.EISDIR: "a directory, not a serial line",
    errno.ENOTTY: "not a serial line",
    errno.ENXIO: "the device behind it is gone",
    errno.EIO: "the device behind it is gone",
}


class SerialError(Exception):
    """A serial line cannot be opened; the text names its path and the cause."""


def open_serial(path: str | Path) -> "SerialLine":
    """Open the line at `path`, 115200 8N1, exclusively.

    Raises SerialError.

    Bytes already waiting in the kernel are discarded because their age is unknown.
    """
    try:
        return SerialLine(str(path), _opened(str(path)))
    except OSError as error:
        raise SerialError(f"{path}: {_reason(error)}") from error


class SerialLine:
    """A port that survives the loss of its device: it closes a failed line, counts the failure and
    reopens the line.
    """

    def __init__(self, path: str, device: serial.Serial) -> None:
        self.counters = LinkCounters()
        self.disconnects = 0
        self.reconnects = 0
        self._path = path
        self._device: serial.Serial | None = device
        self._retry_ns = 0
        self._backoff_ns = FIRST_RETRY_NS
        self._closed = False

    @property
    def path(self) -> str:
        return self._path

    @property
    def connected(self) -> bool:
        return self._device is not None

    def send(self, now_ns: int, data: bytes) -> None:
        """Send bytes; those that the line does not accept at once are dropped and counted."""
        device = self._live_device(now_ns)
        written = 0
        if device is not None:
            try:
                # Write directly, because pyserial's write busy-waits while a full line accepts
                # nothing.
                written = os.write(device.fileno(), data)
            except BlockingIOError:
                pass
            except OSError:
                self._lose(now_ns)
        self.counters.sent += written
        self.counters.dropped_out += len(data) - written

    def receive(self, now_ns: int) -> Sequence[SerialChunk]:
        device = self._live_device(now_ns)
        if device is None:
            return ()
        try:
            data = device.read(READ_BYTES)
        except OSError:
            self._lose(now_ns)
            return ()
        if not data:
            return ()
        self._backoff_ns = FIRST_RETRY_NS
        self.counters.received += len(data)
        return (SerialChunk(now_ns, data),)

    def close(self) -> None:
        self._closed = True
        self._release()

    def _live_device(self, now_ns: int) -> serial.Serial | None:
        if self._device is None and not self._closed and now_ns >= self._retry_ns:
            try:
                self._device = _opened(self._path)
                self.reconnects += 1
            except OSError:
                self.counters.errors += 1
                self._wait(now_ns)
        return self._device

    def _lose(self, now_ns: int) -> None:
        self.disconnects += 1
        self.counters.errors += 1
        self._release()
        self._wait(now_ns)

    def _wait(self, now_ns: int) -> None:
        """Increase the retry delay until bytes arrive: a device that opens and fails again is not
        healthy.
        """
        self._retry_ns = now_ns + self._backoff_ns
        self._backoff_ns = min(2 * self._backoff_ns, LONGEST_RETRY_NS)

    def _release(self) -> None:
        if self._device is not None:
            with contextlib.suppress(OSError):
                self._device.close()
            self._device = None


class PtyLine:
    """The reader's end of a pseudo-terminal.

    Like a wire, it stores nothing for a later reader.

    Bytes are dropped and counted while no program has the other end open, and while its buffer is
    full.
    """

    def __init__(self, master: int, slave_path: str) -> None:
        self.counters = LinkCounters()
        self._master = master
        self._slave_path = slave_path
        self._poll = select.poll()
        self._poll.register(master, select.POLLIN)
        self._was_listening = False

    def send(self, now_ns: int, data: bytes) -> None:
        written = 0
        if self._listening():
            with contextlib.suppress(OSError):
                written = os.write(self._master, data)
        self.counters.sent += written
        self.counters.dropped_out += len(data) - written

    def receive(self, now_ns: int) -> Sequence[SerialChunk]:
        if not self._events() & select.POLLIN:
            return ()
        try:
            data = os.read(self._master, READ_BYTES)
        except OSError:
            return ()
        self.counters.received += len(data)
        return (SerialChunk(now_ns, data),)

    def close(self) -> None:
        if self._master >= 0:
            self._poll.unregister(self._master)
            os.close(self._master)
            self._master = -1

    def _events(self) -> int:
        if self._master < 0:
            return select.POLLHUP
        return next((events for _, events in self._poll.poll(0)), 0)

    def _listening(self) -> bool:
        listening = not self._events() & select.POLLHUP
        if self._was_listening and not listening and self._master >= 0:
            self._forget_unread()
        self._was_listening = listening
        return listening

    def _forget_unread(self) -> None:
        """Discard unread bytes of the last listener, so that the next listener does not receive
        them first.
        """
        with contextlib.suppress(OSError, termios.error):
            slave = os.open(self._slave_path, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
            try:
                termios.tcflush(slave, termios.TCIFLUSH)
            finally:
                os.close(slave)


def open_pty() -> tuple[PtyLine, str]:
    """Open a pseudo-terminal in raw mode.

    Returns the reader's end and the path for the controller.

    The path stays valid while the port is open, however often the controller opens and closes it.
    """
    try:
        master, slave = os.openpty()
    except OSError as error:
        raise SerialError(f"no pseudo-terminal available: {error.strerror}") from error
    try:
        tty.setraw(slave)
        path = os.ttyname(slave)
    finally:
        os.close(slave)
    os.set_blocking(master, False)
    return PtyLine(master, path), path


def _opened(path: str) -> serial.Serial:
    """Open the device. Raises OSError, of which serial.SerialException is a subclass."""
    mode = Path(path).stat().st_mode
    if stat.S_ISDIR(mode):
        raise OSError(errno.EISDIR, os.strerror(errno.EISDIR))
    if not stat.S_ISCHR(mode):
        raise OSError(errno.ENOTTY, os.strerror(errno.ENOTTY))
    return serial.Serial(path, BAUD, timeout=0, exclusive=True)


def _reason(error: OSError) -> str:
    code = error.errno
    if code is None and isinstance(error.__context__, termios.error):
        # pyserial does not report the error number when it cannot configure the line.
        code = error.__context__.args[0]
    return _REASONS.get(code or 0, error.strerror or str(error))
