"""`vobc watch`: the page of a run that goes on or has ended, or of the bus of a train."""

import argparse
import asyncio
import sys
import webbrowser
from collections.abc import Sequence
from pathlib import Path
from typing import Final

from canlog.damage import LogError
from canlog.database import own_bus
from canlog.live.options import add_serving, can_show, warn_of
from canlog.live.page import serve_bus, serve_folder
from canlog.live.server import TokenServer
from canlog.run_names import choose_run
from firmware_py.command_line import CommandParser
from metro_hil.model.run_options import EXIT_OK, EXIT_USAGE
from metro_hil.watch.line_folder import is_line_run, serve_line_folder

BUSES: Final = ("socketcan:", "embedded:")


def parser() -> argparse.ArgumentParser:
    """The command line of `vobc watch`."""
    top = CommandParser(
        prog="vobc watch",
        description="Show a run in a browser: the driver's view, the line, signals, frames and "
        "events; of a run of several trains, their line. While the run goes on the page follows "
        "it; afterwards it is the report. Ctrl-C ends the server, never the run.",
    )
    top.add_argument(
        "run",
        nargs="?",
        metavar="RUN|BUS",
        help="the folder of a run or part of its name, or a bus such as socketcan:can0; default: "
        "the last run",
    )
    add_serving(top)
    return top


def main(argv: Sequence[str]) -> int:
    """Serve until the user interrupts."""
    given = parser().parse_args(argv)
    try:
        server = _server(given)
    except LogError as error:
        print(f"vobc watch: {error}", file=sys.stderr)
        return EXIT_USAGE
    warn_of(given.listen, "vobc watch")
    print(f"page: {server.address} (Ctrl-C ends)", flush=True)
    if not given.no_browser and can_show():
        webbrowser.open(server.address)
    asyncio.run(server.run())
    return EXIT_OK


def _server(given: argparse.Namespace) -> TokenServer:
    """Raises LogError."""
    if given.run is not None and given.run.startswith(BUSES):
        return serve_bus(
            given.run, own_bus(), events_on_bus=True, host=given.listen, port=given.port
        )
    folder: Path = choose_run(given.run, "vobc watch")
    if is_line_run(folder):
        return serve_line_folder(folder, host=given.listen, port=given.port)
    return serve_folder(folder, host=given.listen, port=given.port)
