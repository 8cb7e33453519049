"""`python -m vobc grant`: the controller in virtual time, run by a bench in another process."""

import argparse
import os
import socket
import sys
from collections.abc import Sequence
from typing import BinaryIO, Final, Protocol

from firmware_py import __version__, grants
from firmware_py.assertions import require_assertions
from firmware_py.clock.realtime import die_with_parent
from firmware_py.handed_ports import HandedPorts
from firmware_py.settings import SettingsError
from vobc.cli.host import EXIT_ENVIRONMENT, EXIT_OK, EXIT_USAGE, say
from vobc.process import VobcDevice, read_commission

HELLO: Final = "hello"


class Lines(Protocol):
    """Both directions of the connection."""

    def readline(self, limit: int) -> bytes: ...

    def write(self, data: bytes) -> object: ...

    def flush(self) -> None: ...


def parser() -> argparse.ArgumentParser:
    top = argparse.ArgumentParser(
        prog="python -m vobc grant",
        description="The controller in virtual time: it takes part of a run in lockstep over lines "
        "of JSON, as docs/reference/lockstep_interface.md describes.",
    )
    top.add_argument(
        "--connect", metavar="SOCKET", help="Unix socket of the bench; default: standard input"
    )
    top.add_argument("--parent", type=int, metavar="PID", help="end when that process ends")
    return top


def main(argv: Sequence[str] | None = None) -> int:
    """Serve one run."""
    require_assertions("vobc")
    options = parser().parse_args(argv)
    if options.parent is not None:
        die_with_parent(options.parent)
    try:
        lines = _standard() if options.connect is None else _connected(options.connect)
        return serve(lines)
    except grants.GrantProtocolError as error:
        say(f"grant: {error}")
        return EXIT_USAGE
    except OSError as error:
        say(f"grant: {options.connect or 'standard input'}: {error.strerror or error}")
        return EXIT_ENVIRONMENT


def serve(lines: Lines) -> int:
    """Answer until the bench stops the run or disconnects. Exceptions of the controller pass
    through.

    Raises GrantProtocolError and OSError.
    """
    hello = _hear(lines)
    if hello is None:
        return EXIT_OK
    if not isinstance(hello, grants.Hello):
        raise grants.GrantProtocolError("the bench does not start with hello")
    ports = HandedPorts()
    device = _device(lines, hello, ports)
    if device is None:
        return EXIT_USAGE
    executive = device.executive
    _say(lines, grants.Ready(grants.VERSION, executive.next_due_ns(), f"vobc {__version__}"))
    while (message := _hear(lines)) is not None:
        if isinstance(message, grants.Stop):
            device.stop(message.now_ns)
            _say(lines, grants.yielded(message.now_ns, message.now_ns, ports.take()))
            return EXIT_OK
        if not isinstance(message, grants.Grant):
            raise grants.GrantProtocolError("the bench sent hello twice")
        ports.hand(
            grants.heard_frames(message),
            grants.heard_chunks(message),
            grants.heard_messages(message),
        )
        # One task for each grant, in the order of a single process.
        executive.run_next(message.now_ns)
        _say(lines, grants.yielded(message.now_ns, executive.next_due_ns(), ports.take()))
    return EXIT_OK


def _device(lines: Lines, hello: grants.Hello, ports: HandedPorts) -> VobcDevice | None:
    """Create the device. None: the commission was refused."""
    if hello.version != grants.VERSION:
        reason = f"version {hello.version} of the protocol; this controller speaks {grants.VERSION}"
        _say(lines, grants.Refuse(reason))
        return None
    left_out: list[str] = []
    try:
        commission = read_commission(hello.told, HELLO, left_out)
        device = commission.device(can=ports.can, tags=ports.tags, radio=ports.radio)
    except (SettingsError, ValueError) as error:
        _say(lines, grants.Refuse(str(error)))
        return None
    if left_out:
        say(f"ignored keys that this version does not know: {', '.join(left_out)}")
    return device


def _hear(lines: Lines) -> grants.OfBench | None:
    """The next message. None: the bench has disconnected."""
    line = lines.readline(grants.LINE_BYTES_MAX)
    return grants.read_bench(line) if line else None


def _say(lines: Lines, message: grants.OfController) -> None:
    lines.write(grants.encode(message))
    lines.flush()


class _Standard:
    """Standard input and output. Other printed text goes to standard error instead."""

    def __init__(self) -> None:
        self._input: BinaryIO = sys.stdin.buffer
        self._output = os.fdopen(os.dup(1), "wb")
        os.dup2(2, 1)

    def readline(self, limit: int) -> bytes:
        return self._input.readline(limit)

    def write(self, data: bytes) -> object:
        return self._output.write(data)

    def flush(self) -> None:
        self._output.flush()


def _standard() -> Lines:
    return _Standard()


def _connected(path: str) -> Lines:
    connection = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    connection.connect(path)
    return connection.makefile("rwb")
