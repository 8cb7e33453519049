"""The process that imports the modules of programs once, and forks each program that is asked for.

A fork takes milliseconds; a program that imports for itself takes up to a second. A fork executes
the program's own file with the arguments, folder, environment and open files of its client, so it
prints and returns what the program does.
"""

import argparse
import atexit
import contextlib
import gc
import importlib
import io
import json
import os
import runpy
import selectors
import signal
import socket
import sys
import threading
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final, NoReturn

from metro_tools.warm.client import REFUSED

REQUEST_BYTES: Final = 1 << 20
FILES: Final = 3
"""Open files that come with a request: standard input, output and error."""
AT_START: Final = ("PYTHONPATH", "PYTHONSAFEPATH", "PYTHONHASHSEED", "VOBC_NATIVE")
"""Variables that count when a module is imported, so a fork cannot heed other values."""


def main(argv: Sequence[str] | None = None) -> NoReturn:
    """`WarmPrograms` starts this program; people do not."""
    parser = argparse.ArgumentParser(prog="python -m metro_tools.warm.server", description=__doc__)
    parser.add_argument("--socket", type=int, required=True, help="a listening socket")
    parser.add_argument("--values", required=True, help="AT_START of clients, as JSON")
    parser.add_argument("module", nargs="*", help="imported before the first fork")
    options = parser.parse_args(argv)
    for name in options.module:
        # A program that needs a module that cannot be imported reports it by itself.
        with contextlib.suppress(Exception):
            importlib.import_module(name)
    # A collection in a fork would touch all pages of these modules, and so copy them.
    gc.collect()
    gc.freeze()
    with socket.socket(fileno=options.socket) as listening:
        _Server(listening, json.loads(options.values)).serve()


class _Server:
    """Forks programs, and passes on their signals and their status."""

    def __init__(self, listening: socket.socket, values: Mapping[str, str | None]) -> None:
        self._listening, self._values = listening, dict(values)
        self._own = values_at_start(os.environ)
        self._selector = selectors.DefaultSelector()
        self._selector.register(listening, selectors.EVENT_READ)

    def serve(self) -> NoReturn:
        while True:
            for key, _ in self._selector.select():
                if key.fileobj is self._listening:
                    self._accept()
                else:
                    key.data()

    def _accept(self) -> None:
        connection, _ = self._listening.accept()
        body, files, _, _ = socket.recv_fds(
            connection, REQUEST_BYTES, FILES, socket.MSG_CMSG_CLOEXEC
        )
        request = json.loads(body) if len(files) == FILES else {}
        fits = bool(request) and values_at_start(request["environment"]) == self._values
        pid = os.fork() if fits else None
        if pid == 0:
            # A descriptor of the server must not keep the program's client waiting.
            self._selector.close()
            self._listening.close()
            connection.close()
            _become({**request, "own": self._own}, files)
        for each in files:
            os.close(each)
        if pid is None:
            with contextlib.suppress(OSError):
                connection.send(REFUSED)
            connection.close()
        else:
            _Child(pid, connection, self._selector)


class _Child:
    """A program that runs, and the connection to its client."""

    def __init__(
        self, pid: int, connection: socket.socket, selector: selectors.BaseSelector
    ) -> None:
        self._pid, self._connection, self._selector = pid, connection, selector
        self._ended = os.pidfd_open(pid)
        selector.register(connection, selectors.EVENT_READ, self._on_client)
        selector.register(self._ended, selectors.EVENT_READ, self._on_end)

    def _on_client(self) -> None:
        """Pass a signal on. The program of a client that was killed is killed, too."""
        try:
            number = self._connection.recv(1)
        except OSError:
            number = b""
        signal.pidfd_send_signal(self._ended, number[0] if number else signal.SIGKILL)
        if not number:
            self._selector.unregister(self._connection)

    def _on_end(self) -> None:
        _, status = os.waitpid(self._pid, 0)
        with contextlib.suppress(KeyError):
            self._selector.unregister(self._connection)
        self._selector.unregister(self._ended)
        os.close(self._ended)
        with contextlib.suppress(OSError):
            self._connection.send(str(os.waitstatus_to_exitcode(status)).encode())
        self._connection.close()


def values_at_start(environment: Mapping[str, str]) -> dict[str, str | None]:
    return {name: environment.get(name) for name in AT_START}


def _become(request: Mapping[str, Any], files: Sequence[int]) -> NoReturn:
    """Execute the program and end as Python does."""
    os.setpgid(0, 0)
    for number, file in enumerate(files):
        os.dup2(file, number)
        os.close(file)
    os.chdir(request["folder"])
    os.umask(request["mask"])
    os.environ.clear()
    os.environ.update(request["environment"])
    for name, value in request["own"].items():
        os.environ.pop(name, None)
        if value is not None:
            os.environ[name] = value
    _open_standard_files()
    sys.argv[:] = request["words"]
    if "PYTHONSAFEPATH" not in os.environ:
        sys.path.insert(0, str(Path(sys.argv[0]).parent))
    status = 1
    try:
        status = _run(sys.argv[0])
        threading._shutdown()  # type: ignore[attr-defined]
        atexit._run_exitfuncs()
        for file_object in (sys.stdout, sys.stderr):
            with contextlib.suppress(OSError, ValueError):
                file_object.flush()
    finally:
        # Skip the cleanup of modules that the server imported for other programs.
        os._exit(status)


def _open_standard_files() -> None:
    """Make the text files of this process again; those of the server have its buffers."""
    sys.stdin = open(0, encoding=sys.stdin.encoding)  # noqa: SIM115
    setattr(sys, "__stdin__", sys.stdin)  # noqa: B010
    for name, number in (("stdout", 1), ("stderr", 2)):
        old = getattr(sys, name)
        new = io.TextIOWrapper(
            open(number, "wb", closefd=False),  # noqa: SIM115
            encoding=old.encoding,
            errors=old.errors,
            line_buffering=number == 2 or os.isatty(number),
        )
        setattr(sys, name, new)
        setattr(sys, f"__{name}__", new)


def _run(program: str) -> int:
    """Execute a program's file as Python does, and return its exit status."""
    try:
        runpy.run_path(program, run_name="__main__")
    except SystemExit as end:
        if end.code is None or isinstance(end.code, int):
            return (end.code or 0) & 0xFF
        print(end.code, file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        signal.signal(signal.SIGINT, signal.SIG_DFL)
        os.kill(os.getpid(), signal.SIGINT)
    except BaseException:
        sys.excepthook(*sys.exc_info())
        return 1
    return 0


if __name__ == "__main__":
    main()
