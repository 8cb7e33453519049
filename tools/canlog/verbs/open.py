"""`canlog open LOG`, or `--follow BUS`: serves the page of a log or of a live bus to a browser."""

import argparse
import asyncio
import webbrowser

from canlog.damage import LogError
from canlog.live.options import add_serving, can_show, warn_of
from canlog.verbs.asked import log_options, name_asked, read_asked
from canlog.verbs.common import bus_asked
from canlog.views.serving import LOOPBACK


def options(parser: argparse.ArgumentParser) -> None:
    log_options(parser, span=False)
    parser.add_argument("signals", nargs="*", metavar="SIGNAL", help="panels, as in canlog plot")
    parser.add_argument(
        "--follow", metavar="BUS", help="a live bus instead of a log, such as socketcan:can0"
    )
    add_serving(parser)


def run(given: argparse.Namespace) -> int:
    """Serve until the user interrupts. Raises LogError."""
    if given.follow is not None:
        return _follow(given)
    if given.listen != LOOPBACK:
        raise LogError(f"--listen {given.listen}: only with --follow; a log is shown here only")
    log = read_asked(given, on_disk=True)
    from canlog.views.answers import Answers
    from canlog.views.page_data import page_data
    from canlog.views.page_text import page_text
    from canlog.views.server import LogServer
    from canlog.views.traces import default_words, trace_names

    words = given.signals or (default_words(log) if trace_names(log) else [])
    data = page_data(log, name_asked(given), words, with_frames=False)
    with LogServer(given.port, page_text(data), Answers(log, data)) as server:
        print(f"{len(log)} frames at {server.address} (Ctrl-C ends)", flush=True)
        if not given.no_browser:
            webbrowser.open(server.address)
        server.serve_forever()
    return 0


def _follow(given: argparse.Namespace) -> int:
    """Serve the page of a live bus. Raises LogError."""
    from canlog.live.page import serve_bus

    # The first word was taken for the log, which a live bus does not have.
    words = [str(word) for word in (given.log, *given.signals) if word is not None]
    given.log = None
    server = serve_bus(
        given.follow,
        bus_asked(given),
        words,
        events_on_bus=given.dbc is None and not given.no_dbc,
        host=given.listen,
        port=given.port,
    )
    warn_of(given.listen, "canlog")
    print(f"{given.follow} at {server.address} (Ctrl-C ends)", flush=True)
    if not given.no_browser and can_show():
        webbrowser.open(server.address)
    asyncio.run(server.run())
    return 0
