"""Asks a warm server for one program, lends it the open files, and ends as the program ends.

A launcher starts it by `python -I -S`, so it imports little.
"""

import json
import os
import signal
import socket
import sys
from collections.abc import Mapping, Sequence
from typing import Final, NoReturn

PASSED_ON: Final = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
STATUS_BYTES: Final = 64
REFUSED: Final = b"refused"
"""Reply of a server whose environment differs from this one; the program starts by itself."""


def main(places: Mapping[str, str], program: Sequence[str]) -> NoReturn:
    """Run a program, given by its file and its arguments.

    Args:
        places: sockets of servers by the program's first argument; empty for all others.
    """
    place = places.get(program[1] if len(program) > 1 else "", places[""])
    with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as server:
        status = ask(server, place, program)
    if status is None:
        os.execv(program[0], list(program))  # noqa: S606 - the program that the launcher named
    if status < 0:
        signal.signal(-status, signal.SIG_DFL)
        os.kill(os.getpid(), -status)
    os._exit(status)


def ask(server: socket.socket, place: str, program: Sequence[str]) -> int | None:
    """Return the program's status as `Popen.wait` does; None if the server cannot run it."""
    mask = os.umask(0)
    os.umask(mask)
    request = {
        "words": program,
        "folder": os.getcwd(),  # noqa: PTH109 - pathlib would take longer than all the rest
        "environment": dict(os.environ),
        "mask": mask,
    }
    try:
        server.connect(place)
        socket.send_fds(server, [json.dumps(request).encode()], [0, 1, 2])
    except OSError:
        return None
    for number in PASSED_ON:
        if signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, lambda number, _: server.send(bytes([number])) and None)
    reply = server.recv(STATUS_BYTES)
    if reply == REFUSED:
        return None
    if not reply:
        print(f"{program[0]}: the warm server ended", file=sys.stderr)
        return 1
    return int(reply)
