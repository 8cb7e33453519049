"""`vobc`: finds the program behind each verb and starts it."""

import importlib
import sys
from collections.abc import Sequence
from typing import Final

from firmware_py import __version__
from firmware_py.arguments import words_of
from firmware_py.assertions import require_assertions
from firmware_py.program import Program
from metro_hil.model.run_options import LINE_VERBS, SERVICE_VERBS, SHIPPED_VERBS, parse

VERBS: Final = {
    "check": "vobc.cli.check",
    "device": "vobc.cli.command",
    "export": "metro_hil.exchange.export_command",
    "import": "metro_hil.exchange.import_command",
    "host": "metro_hil.external_controller.realtime",
    "network": "metro_hil.report.network_command",
    "explain": "metro_hil.report.explain.command",
    "watch": "metro_hil.watch.command",
    "tune": "metro_hil.tuning.command",
    "design-curve": "metro_hil.energy.running_curve.command",
    "timetable": "metro_hil.energy.line.timetable_command",
    "line-log": "metro_hil.supervision.radio_log_command",
    "demo-ca": "metro_hil.supervision.demo_ca",
}
"""Module of each verb whose `main` takes the arguments after the verb."""
GROUPS: Final = {
    **dict.fromkeys(SHIPPED_VERBS, "metro_hil.cli.shipped_files"),
    **dict.fromkeys(LINE_VERBS, "metro_hil.supervision.command"),
    "line": "metro_hil.watch.line_command",
}
"""Module of each verb that shares its `main` with others; its arguments begin with the verb."""


VERBOSE: Final = frozenset({"-v", "--verbose"})


def main(argv: Sequence[str] | None = None) -> int:
    """The console script `vobc`. A user's mistake gives one line, never a traceback.

    Only the module of the verb is imported, so that `vobc device` loads no plots and no tables.
    """
    require_assertions("vobc")
    words = words_of("vobc", argv)
    if words[:1] == ["--completion"]:
        from metro_hil.cli.whole_parser import whole_parser

        whole_parser().parse_args(words)
    if "--version" in words and {*words} & VERBOSE:
        return _versions()
    if words[:1] == ["line"] and words[1:2] and words[1] in SERVICE_VERBS:
        from metro_hil.line.service import command as service

        return service.main(words[1:])
    verb = words[0] if words else ""
    module = VERBS.get(verb)
    if module is not None:
        del words[0]
    module = module or GROUPS.get(verb)
    if module is not None:
        code: int = importlib.import_module(module).main(words)
        return code
    # Help and mistakes need neither train nor controller, so these words are parsed first.
    options = parse(words)
    from metro_hil.cli.vobc_run import drive

    return drive(options)


def _versions() -> int:
    """Print the version, and how runs in virtual time execute wire and controller."""
    from metro_hil.model.native import use_native
    from metro_hil.model.native_copy import controller_text

    lack = use_native()
    print(f"vobc {__version__}")
    print(f"codec, bus and logs: {f'Python ({lack})' if lack else 'C'}")
    print(f"controller: {controller_text()}")
    return 0


if __name__ == "__main__":
    sys.exit(Program("vobc", lambda: main)())
