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
from metro_hil.model.run_options import EXIT_ENVIRONMENT, EXIT_USAGE

VERBS: Final = {
    "init": "write a scenario, a line, a train and a controller to start from",
    "new-controller": "write a project for a controller of your own, which drives as written",
    "check": "check a campaign file and show what it would run",
    "run": "run a campaign, or one scenario by its name",
    "resume": "continue a campaign",
    "list": "list the campaigns that were run here",
    "show": "show the outcome of a campaign, or the event log of a case",
    "rerun": "repeat one case with all logs",
    "compare": "compare two campaigns: what got worse, by how much",
    "serve": "show all campaigns of a folder in a browser, with their history",
    "report": "write the reports of a campaign again",
    "from-log": "make a scenario of a recorded ride, and compare the simulation with the record",
    "from-run": "make a scenario of a run that a person acted on, and replay it",
    "replay": "feed a recorded run to a controller again and compare its outputs",
    "verify": "run a sample of a campaign again and require the same bytes",
    "sensitivity": (
        "run a campaign against mutated controllers: which scenario detects each mistake"
    ),
    "search": "search for the worst case of a scenario",
    "attack": "attack the protection by chance",
    "scenarios": "list the shipped scenarios, which can be run by name",
    "faults": "show the catalogue of faults",
    "monitors": "show the invariants and the signals of expressions",
    "requirements": "show each requirement with its scenarios, tests and last results",
    "laws": "show how each control law came out",
    "export": "write the train or the controller as an FMU with CAN",
    "bus": "run FMUs with CAN as the nodes of a bus",
    "line": "run several trains that command themselves; the same as `hil run line`",
    "simulate": "simulate trains that command themselves, in virtual time, under random faults",
}
"""Verbs in the order of the help, with their help texts.

Each is a module of this package with `add` and `run`; its name has _ for -. Only that of the typed
verb is imported."""
WORKING: Final = frozenset(
    {
        *("attack", "run", "resume", "rerun", "from-log", "from-run", "replay", "verify"),
        *("search", "line", "simulate"),
    }
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
    typed = words[0] if words else ""
    options = parser(None if typed == "--completion" else typed).parse_args(words)
    options.typed = words
    from metro_hil.engine.errors import EngineError, UsageError
    from metro_hil.model.run_folder import RunFolderError

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


def parser(verb: str | None = None) -> argparse.ArgumentParser:
    """The command line.

    Args:
        verb: the verb that gets its options; None: all verbs.
    """
    top = CommandParser(
        prog="hil",
        is_command=True,
        description=__doc__,
        epilog=EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    verbs = top.add_subparsers(dest="verb", required=True, metavar="VERB")
    for name, text in VERBS.items():
        module = f"{__name__}.{name.replace('-', '_')}"
        if importlib.util.find_spec(module) is None:
            continue
        if verb in (None, name):
            importlib.import_module(module).add(verbs)
        else:
            verbs.add_parser(name, help=text, add_help=False)
    return top
