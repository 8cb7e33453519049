"""`canlog open LOG`: serves the page of a log of any size to a browser on this machine."""

import argparse
import webbrowser
from typing import Final

from canlog.verbs.asked import log_options, name_asked, read_asked

SUMMARY: Final = "show a log of any size in a browser on this machine"


def options(parser: argparse.ArgumentParser) -> None:
    log_options(parser, span=False)
    parser.add_argument("signals", nargs="*", metavar="SIGNAL", help="panels, as in canlog plot")
    parser.add_argument("--port", type=int, default=0, help="default: a free one")
    parser.add_argument("--no-browser", action="store_true", help="only print the address")


def run(given: argparse.Namespace) -> int:
    """Serve until the user interrupts. Raises LogError."""
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
