"""`vobc explain`: parses, reads, prints."""

import argparse
import json
import sys
from collections.abc import Sequence

from canlog.damage import LogError
from canlog.run_names import choose_run
from firmware_py.command_line import CommandParser
from firmware_py.settings import SettingsError
from metro_hil.model.run_options import EXIT_OK, EXIT_USAGE
from metro_hil.model.terminal import console_for
from metro_hil.report.explain.bus_log import located
from metro_hil.report.explain.choose import chosen, kinds_of
from metro_hil.report.explain.event_log import KINDS, RunEventsError, read_story
from metro_hil.report.explain.known import known_at
from metro_hil.report.explain.show import (
    document,
    known_document,
    show_answer,
    show_known,
    show_story,
)

DESCRIPTION = "Tell what the controller of a run decided, why, and from which frames."


def parser() -> argparse.ArgumentParser:
    """The command line of `vobc explain`."""
    top = CommandParser(
        prog="vobc explain",
        description=DESCRIPTION,
        epilog=f"kinds of events: {', '.join(KINDS)}",
    )
    top.add_argument(
        "run",
        nargs="?",
        metavar="RUN",
        help="folder of a run or part of its name, or of a campaign's case; default: the last run",
    )
    top.add_argument("--from", dest="from_s", type=float, metavar="SECONDS", help="tell from then")
    top.add_argument("--to", dest="to_s", type=float, metavar="SECONDS", help="tell up to then")
    top.add_argument("--only", default="", metavar="KIND,...", help="tell these kinds only")
    top.add_argument(
        "--at", dest="at_s", type=float, metavar="SECONDS", help="what it knew at that instant"
    )
    top.add_argument(
        "-v",
        "--verbose",
        action="store_true",
        help="all chosen events, each with the frames it was decided from",
    )
    top.add_argument("--json", action="store_true", help="one JSON object on standard output")
    return top


def main(argv: Sequence[str]) -> int:
    """A user's mistake gives one line, never a traceback."""
    options = parser().parse_args(argv)
    try:
        return _explain(options)
    except (LogError, RunEventsError, SettingsError) as error:
        print(f"vobc: {error}", file=sys.stderr)
        return EXIT_USAGE


def _explain(options: argparse.Namespace) -> int:
    only = kinds_of(options.only)
    story = located(read_story(choose_run(options.run, "vobc")))
    console = console_for()
    if options.at_s is not None:
        known = known_at(story.folder, options.at_s)
        if options.json:
            print(json.dumps(known_document(story, known), ensure_ascii=False))
        else:
            show_known(console, story, known, options.at_s)
        return EXIT_OK
    everything = options.from_s is None and options.to_s is None and not only
    if everything and not options.verbose and not options.json:
        show_answer(console, story)
        return EXIT_OK
    events = chosen(story.events, from_s=options.from_s, to_s=options.to_s, only=only)
    if options.json:
        print(json.dumps(document(story, events), ensure_ascii=False))
    else:
        show_story(console, story, events, frames=options.verbose)
    return EXIT_OK
