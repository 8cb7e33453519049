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
    "bits": "canlog.verbs.bits",
    "browse": "canlog.verbs.browse",
    "convert": "canlog.verbs.convert",
    "diff": "canlog.verbs.diff",
    "extract": "canlog.verbs.extract",
    "find": "canlog.verbs.find",
    "open": "canlog.verbs.open",
    "plot": "canlog.verbs.plot",
    "replay": "canlog.verbs.replay",
    "report": "canlog.verbs.report",
    "show": "canlog.verbs.show",
    "stats": "canlog.verbs.stats",
    "transport": "canlog.verbs.transport",
}
"""Each module has SUMMARY, `options(parser)` and `run(options) -> exit code`."""


def main(argv: Sequence[str] | None = None) -> int:
    """The console script `canlog`."""
    require_assertions("canlog")
    # The usual allocator of Arrow keeps tens of megabytes for later.
    os.environ.setdefault("ARROW_DEFAULT_MEMORY_POOL", "system")
    words = words_of("canlog", argv)
    try:
        top = parser(words)
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


def parser(words: Sequence[str]) -> argparse.ArgumentParser:
    """Build the parser; it loads only the module of the given verb, or all modules for help."""
    top = CommandParser(
        prog="canlog", is_command=True, description="Inspect CAN logs frame by frame."
    )
    verbs = top.add_subparsers(dest="verb", required=True, metavar="VERB")
    wanted = words[0] if words and words[0] in VERBS else None
    for verb in VERBS:
        if wanted in (None, verb):
            module = _module(verb)
            module.options(verbs.add_parser(verb, help=module.SUMMARY, description=module.SUMMARY))
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
    return importlib.import_module(VERBS[verb])


if __name__ == "__main__":
    sys.exit(Program("canlog", lambda: main)())
