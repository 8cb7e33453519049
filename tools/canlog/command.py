"""The console script `canlog`: a table of subcommands, each in a module of its own."""

import argparse
import importlib
import os
import sys
from collections.abc import Sequence
from typing import Any, Final

from canlog.damage import LogError
from canlog.run_names import choose_run
from firmware_py.arguments import DISK_FAULTS, of_file, words_of
from firmware_py.assertions import require_assertions
from firmware_py.command_line import CommandParser
from firmware_py.output import EXIT_ENVIRONMENT
from firmware_py.program import Program

EXIT_FOUND: Final = 1
"""Exit code when something was found that should be absent, or two things differ."""
EXIT_USAGE: Final = 2

VERBS: Final = {
    "bits": "which bits of each identifier change, how often, and the entropy of each byte",
    "browse": "browse a log or a live bus in a terminal",
    "convert": "write a log in another format, and list what that format cannot hold",
    "diff": "compare two logs signal by signal, or two DBC files",
    "extract": "write a table of physical values for each message, with exact time and units",
    "find": "search a bus for bit fields that follow a sketch, a signal or a CSV file",
    "open": "show a log of any size, or a live bus, in a browser on this machine",
    "plot": "draw signals over time or distance as PNG or SVG",
    "replay": "send the frames of a log to a bus again, at their original times",
    "report": "write one self-contained HTML page with plots, frames, events and statistics",
    "show": "show frame by frame, decoded, with control cycles and reasons of rejection",
    "stats": "statistics of messages and bus: cycle times, gaps, errors, load, latency",
    "transport": "reassemble messages of J1939 transport and ISO-TP, and name UDS services",
}
"""Verbs with their help texts.

Each is a module of `canlog.verbs` with `options(parser)` and `run(options) -> exit code`. Only that
of the typed verb is imported.
"""


def main(argv: Sequence[str] | None = None) -> int:
    """The console script `canlog`."""
    require_assertions("canlog")
    # The usual allocator of Arrow keeps tens of megabytes for later.
    os.environ.setdefault("ARROW_DEFAULT_MEMORY_POOL", "system")
    words = words_of("canlog", argv)
    try:
        typed = words[0] if words else ""
        top = parser(None if typed == "--completion" else typed)
        options = top.parse_args(options_first(top, words))
        _choose_runs(options)
        code: int = _module(options.verb).run(options)
    except LogError as error:
        print(f"canlog: {error}", file=sys.stderr)
        full = isinstance(error.__cause__, OSError) and error.__cause__.errno in DISK_FAULTS
        return EXIT_ENVIRONMENT if full else EXIT_USAGE
    except OSError as error:
        if error.errno in DISK_FAULTS:
            raise
        print(f"canlog: {of_file(error)}", file=sys.stderr)
        return EXIT_USAGE
    return code


def parser(verb: str | None = None) -> argparse.ArgumentParser:
    """Build the parser.

    Args:
        verb: the verb that gets its options; None: all verbs.
    """
    top = CommandParser(
        prog="canlog", is_command=True, description="Inspect CAN logs frame by frame."
    )
    verbs = top.add_subparsers(dest="verb", required=True, metavar="VERB")
    for name, text in VERBS.items():
        if verb in (None, name):
            _module(name).options(verbs.add_parser(name, help=text, description=text))
        else:
            verbs.add_parser(name, help=text, add_help=False)
    return top


def options_first(parser: argparse.ArgumentParser, words: Sequence[str]) -> list[str]:
    """Move the options of a subcommand and their values before all other words.

    argparse accepts a list of positional words, such as the signals of `plot`, only in one piece.
    """
    verbs = next(
        (each for each in parser._actions if isinstance(each, argparse._SubParsersAction)), None
    )
    if not words or verbs is None or words[0] not in verbs.choices:
        return list(words)
    known = verbs.choices[words[0]]._option_string_actions
    front, back, rest = [words[0]], list[str](), iter(words[1:])
    for word in rest:
        if word == "--":
            return [*front, word, *back, *rest]
        if not word.startswith("-") or word == "-":
            back.append(word)
            continue
        front.append(word)
        near = {id(known[name]): known[name] for name in known if name.startswith(word)}
        action = known.get(word) or (next(iter(near.values())) if len(near) == 1 else None)
        if action is not None and action.nargs is None:
            front += [value for value in [next(rest, None)] if value is not None]
    return [*front, *back]


def _choose_runs(options: argparse.Namespace) -> None:
    """Replace run names by their folders, and use the last run if no log is given."""
    if getattr(options, "follow", None) is not None:
        return
    for name in ("log", "a", "b"):
        if hasattr(options, name):
            setattr(options, name, choose_run(getattr(options, name), "canlog"))


def _module(verb: str) -> Any:
    return importlib.import_module(f"canlog.verbs.{verb}")


if __name__ == "__main__":
    sys.exit(Program("canlog", lambda: main)())
