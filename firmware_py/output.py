"""Standard output and standard error of a command.

Write failures are counted, not raised.

A full disk behind `>`, a reader that closed the pipe and a terminal without UTF-8 must not cause a
traceback. A command that only prints ends at the first loss. A command inside `working` continues.
At the end `Program` reports the loss in one line, with exit code 3.
"""

import codecs
import io
import os
import select
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, Final, TextIO

EXIT_ENVIRONMENT: Final = 3
SHOWN: Final = "metro.shown"
"""Name of the codec error handler that replaces characters a terminal cannot show by `?`."""
STRICT: Final = ("strict", "surrogateescape")
"""Error handlers that Python selects by default; the user selected any other one."""
CLOSED: Final = "closed"
STDOUT: Final = 1
STDERR: Final = 2


class _Losses:
    """Lost output of this process."""

    def __init__(self) -> None:
        self.reason = ""
        """Why output is no longer written; empty while it is."""
        self.unshown: dict[str, int] = {}
        """Characters missing in the encoding, with their counts."""
        self.working = 0
        """Number of nested `working` sections, which a loss must not end."""

    def text(self, encoding: str) -> str:
        """Describe the loss in one line; empty without a loss."""
        if self.reason:
            return f"standard output: {self.reason}; the rest of the output is lost"
        if self.unshown:
            first, more = next(iter(self.unshown)), len(self.unshown) - 1
            others = f" and {more} other character{'s' if more > 1 else ''}" if more else ""
            return (
                f"standard output: {encoding} cannot show {first!a}{others}; "
                "set PYTHONIOENCODING=utf-8, or LANG to a UTF-8 locale"
            )
        return ""


losses: Final = _Losses()


@contextmanager
def working(really: bool = True) -> Iterator[None]:
    """Keep the command running inside this context when standard output is lost, because a train is
    moving.
    """
    losses.working += really
    try:
        yield
    finally:
        losses.working -= really


class _Stream(io.RawIOBase):
    """One of the two streams; after the first failure it discards all output."""

    def __init__(self, number: int, name: str, reason: str = "") -> None:
        self._number, self.name, self._reason = number, name, reason

    def fileno(self) -> int:
        return self._number

    def isatty(self) -> bool:
        return os.isatty(self._number)

    def writable(self) -> bool:
        return True

    def write(self, data: Any, /) -> int:
        while not self._reason:
            try:
                return os.write(self._number, data)
            except BlockingIOError:
                select.select((), (self._number,), ())
            except OSError as error:
                self._reason = error.strerror or str(error)
        if self._number == STDOUT:
            losses.reason = self._reason
            if not losses.working and threading.current_thread() is threading.main_thread():
                raise SystemExit(EXIT_ENVIRONMENT)
        return len(data)


def guard() -> None:
    """Replace both streams by guarded ones. Streams that a test has replaced stay unchanged."""
    _open_missing()
    codecs.register_error(SHOWN, _show)
    if sys.stdout is sys.__stdout__:
        sys.stdout = _guarded(sys.stdout, STDOUT, "<stdout>")
    if sys.stderr is sys.__stderr__:
        sys.stderr = _guarded(sys.stderr, STDERR, "<stderr>")


def _open_missing() -> None:
    """Open /dev/null for a closed descriptor; otherwise the next opened log would get its
    number.
    """
    for number in range(STDERR + 1):
        try:
            os.fstat(number)
        except OSError:
            os.set_inheritable(os.open(os.devnull, os.O_RDWR), True)


def _guarded(stream: TextIO | None, number: int, name: str) -> TextIO:
    if not isinstance(stream, io.TextIOWrapper):
        # Python provides no stream if the descriptor was closed.
        raw = _Stream(number, name, CLOSED)
        return io.TextIOWrapper(io.BufferedWriter(raw), "utf-8", "replace", line_buffering=True)
    errors = stream.errors or "strict"
    if errors in STRICT:
        errors = SHOWN
    return io.TextIOWrapper(
        io.BufferedWriter(_Stream(number, name)),
        encoding=stream.encoding,
        errors=errors,
        line_buffering=stream.line_buffering,
        write_through=stream.write_through,
    )


def _show(error: UnicodeError) -> tuple[str, int]:
    if not isinstance(error, UnicodeEncodeError):
        raise error
    for character in error.object[error.start : error.end]:
        losses.unshown[character] = losses.unshown.get(character, 0) + 1
    return "?" * (error.end - error.start), error.end


def flushed() -> str:
    """Flush both streams and describe the loss in one line, or return an empty text.

    Later writes never raise.
    """
    losses.working += 1
    for stream in (sys.stdout, sys.stderr):
        stream.flush()
    return losses.text(sys.stdout.encoding)
