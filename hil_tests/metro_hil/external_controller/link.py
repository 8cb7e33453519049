"""A controller's process and the messages exchanged with it, each within a time limit."""

import contextlib
import os
import signal
import socket
import subprocess
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from firmware_py.binary_grants import BinaryForm
from firmware_py.clock.clock import NS_PER_S, WallClock
from firmware_py.grants import (
    BINARY,
    JSON,
    Form,
    GrantProtocolError,
    Hello,
    JsonForm,
    OfController,
    encode,
    read_controller,
)
from firmware_py.settings import SettingsError

SOCKET_WORD: Final = "{grant}"
START_S: Final = 30.0
"""Wall time for a program to start and to answer hello, s."""
LEASE_S: Final = 5.0
"""Wall time for each answer, s."""
END_S: Final = 1.0
POLL_S: Final = 0.05
READ_BYTES: Final = 1 << 16
LAST_LINES: Final = 4
FORMS: Final[Mapping[str, Form]] = {JSON: JsonForm(), BINARY: BinaryForm()}


class ControllerStartError(SettingsError):
    """The case cannot run with this controller; the text says why."""


class ControllerDiedError(Exception):
    """The controller ended, hung or broke the protocol in a run; the text says when and how."""


class LinkDownError(Exception):
    """No valid answer; the text begins with what the controller did."""


@dataclass(frozen=True, slots=True)
class ControllerProgram:
    """Command and environment of a controller."""

    words: tuple[str, ...]
    """The command; {grant} in a word stands for the Unix socket."""
    environment: Mapping[str, str]


class ControllerLink:
    """One process. `close` ends it; if the bench dies, the end of its input tells it to end."""

    def __init__(
        self, program: ControllerProgram, *, start_s: float = START_S, lease_s: float = LEASE_S
    ) -> None:
        """Start the process. Raises ControllerStartError."""
        self.form = FORMS[JSON]
        """Form of the messages; after `greet` it may be another one."""
        self._lease_s, self._start_s = lease_s, start_s
        self._clock = WallClock()
        self._received = bytearray()
        self._wait_s = -1.0
        """Present limit of the socket's calls, s."""
        self._errors = tempfile.TemporaryFile()  # noqa: SIM115
        self._process: subprocess.Popen[bytes] | None = None
        self._socket: socket.socket | None = None
        try:
            if any(SOCKET_WORD in word for word in program.words):
                self._socket = self._accepted(program)
            else:
                self._socket = self._attached(program)
        except BaseException:
            self.close()
            raise

    def _attached(self, program: ControllerProgram) -> socket.socket:
        """Start the program with one end of a socket pair as its standard input and output."""
        ours, theirs = socket.socketpair()
        with theirs:
            self._start(program.words, program.environment, theirs.fileno())
        return ours

    def _accepted(self, program: ControllerProgram) -> socket.socket:
        with tempfile.TemporaryDirectory(prefix="grant-") as folder:
            path = str(Path(folder) / "s")
            words = tuple(word.replace(SOCKET_WORD, path) for word in program.words)
            with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as listener:
                listener.bind(path)
                listener.listen(1)
                listener.settimeout(POLL_S)
                self._start(words, program.environment, subprocess.DEVNULL)
                until_ns = self._clock.now_ns() + round(self._start_s * NS_PER_S)
                while self._clock.now_ns() < until_ns:
                    with contextlib.suppress(TimeoutError):
                        return listener.accept()[0]
                    assert self._process is not None
                    if self._process.poll() is not None:
                        raise ControllerStartError(f"controller: {self._end_words()}")
        raise ControllerStartError(
            f"controller: did not connect to {SOCKET_WORD} within {self._start_s:g} s"
        )

    def _start(self, words: tuple[str, ...], environment: Mapping[str, str], wire: int) -> None:
        try:
            # The process has its own session: Ctrl-C reaches the bench only.
            self._process = subprocess.Popen(
                words,
                stdin=wire,
                stdout=wire,
                stderr=self._errors,
                env=dict(environment),
                start_new_session=True,
            )
        except OSError as error:
            raise ControllerStartError(
                f"controller: {words[0]}: cannot be started: {error.strerror}"
            ) from error

    @property
    def pid(self) -> int:
        assert self._process is not None
        return self._process.pid

    def greet(self, message: Hello) -> OfController:
        """Send hello and return the answer. Raises LinkDownError."""
        line = self.greet_bytes(encode(message))
        try:
            return read_controller(line)
        except GrantProtocolError as error:
            raise LinkDownError(f"broke the protocol: {error}") from error

    def greet_bytes(self, line: bytes) -> bytes:
        """Like `exchange_bytes`, within the time for a start."""
        return self._exchange(line, self._start_s)

    def exchange_bytes(self, message: bytes) -> bytes:
        """Send one message and return the answer. Raises LinkDownError."""
        return self._exchange(message, self._lease_s)

    def _exchange(self, message: bytes, lease_s: float) -> bytes:
        assert self._socket is not None
        until_ns = self._clock.now_ns() + round(lease_s * NS_PER_S)
        try:
            self._wait_for_at_most(lease_s)
            self._socket.sendall(message)
            return self._answer(until_ns)
        except TimeoutError:
            raise LinkDownError(f"hung: no answer within {lease_s:g} s") from None
        except OSError:
            raise LinkDownError(f"died: {self._end_words()}") from None
        except GrantProtocolError as error:
            raise LinkDownError(f"broke the protocol: {error}") from error

    def _answer(self, until_ns: int) -> bytes:
        assert self._socket is not None
        received = self._received
        while not (end := self.form.end(received)):
            if received:
                left_ns = until_ns - self._clock.now_ns()
                if left_ns <= 0:
                    raise TimeoutError
                self._wait_for_at_most(left_ns / NS_PER_S)
            piece = self._socket.recv(READ_BYTES)
            if not piece:
                raise LinkDownError(f"died: {self._end_words()}")
            received += piece
        message = bytes(received[:end])
        del received[:end]
        if received:
            raise LinkDownError("broke the protocol: it sends without being asked")
        return message

    def _wait_for_at_most(self, wait_s: float) -> None:
        """Limit each call of the socket; equal limits in a row cost nothing."""
        assert self._socket is not None
        if wait_s != self._wait_s:
            self._wait_s = wait_s
            self._socket.settimeout(wait_s)

    def _end_words(self) -> str:
        """How the process ended, with the end of its standard error."""
        assert self._process is not None
        try:
            code = self._process.wait(END_S)
        except subprocess.TimeoutExpired:
            words = "it closed its connection"
        else:
            words = f"signal {signal.Signals(-code).name}" if code < 0 else f"exit code {code}"
        said = self._last_words()
        return f"{words}: {said}" if said else words

    def _last_words(self) -> str:
        # Both processes share the file position, so `pread` reads without moving it.
        size = os.fstat(self._errors.fileno()).st_size
        length = min(size, READ_BYTES)
        text = os.pread(self._errors.fileno(), length, size - length).decode("utf-8", "replace")
        return " | ".join(line.strip() for line in text.strip().splitlines()[-LAST_LINES:])

    def close(self, patience_s: float = 0.0) -> None:
        """End the process in any state; it has `patience_s` to end by itself."""
        if self._socket is not None:
            self._socket.close()
        process = self._process
        if process is not None:
            try:
                process.wait(patience_s)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
        if not self._errors.closed:
            self._errors.close()
