"""`canlog report LOG -o report.html`: the whole log as one page that needs no network."""

import argparse
from typing import Final

from canlog.damage import LogError
from canlog.verbs.asked import log_options, name_asked, output_path, read_asked
from firmware_py.storage.whole_file import write_whole

FRAMES_MAX: Final = 8_000_000
"""Maximum frames of a page; a browser takes too long to open a larger one."""


def options(parser: argparse.ArgumentParser) -> None:
    log_options(parser, span=False)
    parser.add_argument("signals", nargs="*", metavar="SIGNAL", help="panels, as in canlog plot")
    parser.add_argument("-o", "--out", default="canlog.html", help=".html; default: %(default)s")
    parser.add_argument("--title", help="default: the name of the log")


def run(given: argparse.Namespace) -> int:
    """Write the page. Raises LogError, also for a log so large that `canlog open` must serve it."""
    path = output_path(given.out, (".html", ".htm"))
    log = read_asked(given)
    if len(log) > FRAMES_MAX:
        raise LogError(
            f"{log.path}: {len(log)} frames are too many for one page; `canlog open` serves them"
        )
    from canlog.views.page_data import page_data
    from canlog.views.page_text import page_text
    from canlog.views.traces import default_words, trace_names

    words = given.signals or (default_words(log) if trace_names(log) else [])
    data = page_data(log, given.title or name_asked(given), words, with_frames=True)
    write_whole(path, page_text(data))
    print(f"{path}: {len(log)} frames, {path.stat().st_size / 1e6:.1f} MB")
    return 0
