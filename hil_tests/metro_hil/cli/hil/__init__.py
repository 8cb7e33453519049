"""`hil`: test campaigns on the bench, from one scenario to a hundred thousand cases."""

import argparse
import importlib
import importlib.util
import sys
from collections.abc import Sequence
from typing import Final

from firmware_py import output
from firmware_py.arguments import words_of
from firmware_py.assertions import require_assertions
from firmware_py.command_line import CommandParser
from firmware_py.settings import SettingsError
from metro_hil.engine.errors import EngineError, UsageError
from metro_hil.model.run_folder import RunFolderError
from metro_hil.model.run_options import EXIT_ENVIRONMENT, EXIT_USAGE

VERBS: Final = (
    *("init", "check", "run", "resume", "list", "show", "rerun"),
    *(
        "compare",
        "report",
        "replay",
        "verify",
        "sensitivity",
        "search",
        "scenarios",
        "faults",
        "monitors",
    ),
    *("requirements", "laws", "line", "simulate"),
)
"""Verbs in the order of the help; each is a module of this package with `add` and `run`."""
WORKING: Final = frozenset(
    {"run", "resume", "rerun", "replay", "verify", "search", "line", "simulate"}
)
"""Verbs that leave results. They continue when standard output is closed."""
EPILOG: Final = """\
exit codes: 0 every expected case passed; 1 some did not, or are missing; 2 wrong usage or
configuration; 3 disk, workers, bus or rights missing; 130 ended by Ctrl-C (`hil resume` continues)
"""


def main(argv: Sequence[str] | None = None) -> int:
    """The console script `hil`. A user's mistake gives one line, never a traceback."""
    require_assertions("hil")
    words = words_of("hil", argv)
    if words[:2] == ["run", "line"]:
        # A line is not a campaign and has its own options.
        del words[0]
    options = parser().parse_args(words)
    options.typed = words
    try:
        with output.working(options.verb in WORKING):
            code: int = options.run(options)
        return code
    except (UsageError, SettingsError, RunFolderError) as error:
        return _complain(error, EXIT_USAGE)
    except EngineError as error:
        return _complain(error, EXIT_ENVIRONMENT)


def _complain(error: Exception, code: int) -> int:
    for line in str(error).splitlines():
        print(f"hil: {line}", file=sys.stderr)
    return code


def parser() -> argparse.ArgumentParser:
    """The command line with all its verbs."""
    top = CommandParser(
        prog="hil",
        is_command=True,
        description=__doc__,
        epilog=EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    verbs = top.add_subparsers(dest="verb", required=True, metavar="VERB")
    for name in VERBS:
        module = f"{__name__}.{name}"
        if importlib.util.find_spec(module) is not None:
            importlib.import_module(module).add(verbs)
    return top
