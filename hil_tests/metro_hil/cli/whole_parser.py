"""The command line of `vobc` with the options of all verbs, for completion and for documents.

`vobc` itself loads only the verb that it runs, as loading all takes a second.
"""

import argparse

from metro_hil.cli import shipped_files
from metro_hil.energy.line import timetable_command
from metro_hil.energy.running_curve import command as design_curve_command
from metro_hil.exchange import export_command, import_command
from metro_hil.external_controller import realtime
from metro_hil.line.service import command as service_command
from metro_hil.model import run_options
from metro_hil.model.run_options import LINE_VERBS, SHIPPED_VERBS
from metro_hil.report import network_command
from metro_hil.report.explain import command as explain_command
from metro_hil.supervision import command as supervision_command
from metro_hil.supervision import demo_ca, radio_log_command
from metro_hil.tuning import command as tuning_command
from metro_hil.watch import command as watch_command
from vobc.cli import check
from vobc.cli import options as device_options


def whole_parser() -> argparse.ArgumentParser:
    """`vobc` and every verb."""
    top = run_options.parser()
    verbs = verbs_of(top)
    operator = verbs_of(supervision_command.parser())
    verbs |= {verb: operator[verb] for verb in LINE_VERBS}
    operator_line = verbs_of(verbs["line"])
    operator_line |= verbs_of(service_command.parser())
    shipped = verbs_of(shipped_files.parser())
    verbs |= {verb: shipped[verb] for verb in SHIPPED_VERBS}
    verbs["check"] = check.parser()
    verbs["device"] = device_options.parser()
    verbs["network"] = network_command.parser()
    verbs["export"] = export_command.parser()
    verbs["import"] = import_command.parser()
    verbs["host"] = realtime.parser()
    verbs["explain"] = explain_command.parser()
    verbs["watch"] = watch_command.parser()
    verbs["tune"] = tuning_command.parser()
    verbs["timetable"] = timetable_command.parser()
    verbs["design-curve"] = design_curve_command.parser()
    verbs["line-log"] = radio_log_command.parser()
    verbs["demo-ca"] = demo_ca.parser()
    return top


def verbs_of(parser: argparse.ArgumentParser) -> dict[str, argparse.ArgumentParser]:
    """The parsers of a command's verbs by name, as a mapping that can be changed."""
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            verbs: dict[str, argparse.ArgumentParser] = action.choices
            return verbs
    return {}
