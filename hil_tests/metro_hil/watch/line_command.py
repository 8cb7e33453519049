"""`vobc line`: the table of a line, or with `--web` its page in a browser."""

import argparse
import asyncio
import sys
import webbrowser
from collections.abc import Sequence

from canlog.damage import LogError
from canlog.live.options import can_show, warn_of
from firmware_py.clock.clock import WallClock
from firmware_py.radio.zenoh_radio import ZenohRadio
from firmware_py.trackdb import load_line
from metro_hil.model.run_options import EXIT_OK, EXIT_USAGE
from metro_hil.supervision import command
from metro_hil.supervision.view import LineView
from metro_hil.watch.line_picture import head_of


def main(words: Sequence[str]) -> int:
    """Show the line and return the exit code."""
    return command.main(words, serve)


def serve(options: argparse.Namespace, view: LineView, port: ZenohRadio, clock: WallClock) -> int:
    """Serve the page of a line until the user interrupts."""
    # A plain `vobc line` needs no web server, which takes a while to import.
    from metro_hil.watch.line_server import LineServer
    from metro_hil.watch.line_source import RadioSource

    try:
        server = LineServer(
            *(view, RadioSource(port, clock), head_of(load_line(options.line), view.areas)),
            command_line=_options_of(options) if options.commands else None,
            listen=options.listen,
            port_number=options.port,
        )
    except LogError as error:
        print(f"vobc: {error}", file=sys.stderr)
        return EXIT_USAGE
    warn_of(options.listen, "vobc line")
    may = "shows, and sends commands" if options.commands else "only shows; --commands lets it send"
    print(f"page: {server.address} (Ctrl-C ends; it {may})", flush=True)
    if not options.no_browser and can_show():
        webbrowser.open(server.address)
    asyncio.run(server.run())
    return EXIT_OK


def _options_of(options: argparse.Namespace) -> list[str]:
    """Return the options by which a command reaches the same line."""
    words = ["--line", options.line]
    if options.service_file is not None:
        words = ["--service", options.service_file, "--route", options.route]
    words += ["--line-radio", options.line_radio]
    words += [] if options.secure is None else ["--secure", options.secure]
    return [*words, *(["--insecure"] if options.insecure else [])]
