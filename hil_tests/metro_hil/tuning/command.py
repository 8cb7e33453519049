"""`vobc tune`: tunes with a progress bar, shows before and after, writes the parameters."""

import argparse
import json
import os
import sys
from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Final

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Table

from firmware_py.command_line import CommandParser
from firmware_py.settings import SettingsError
from metro_hil.model.run_options import EXIT_ENVIRONMENT, EXIT_INTERRUPTED, EXIT_OK, EXIT_USAGE
from metro_hil.model.terminal import console_for
from metro_hil.search.local import local_crew
from metro_hil.tuning.leave import as_document, parameter_file, write_parameters
from metro_hil.tuning.objective import CM_PER_M, RunFigures
from metro_hil.tuning.parameters import PARAMETERS, chosen_parameters, value_of
from metro_hil.tuning.training import TRAINING, VALIDATION, Ground
from metro_hil.tuning.tuner import METHODS, Tuned, Tuner, runs_in_all
from vobc.config import load_config

DESCRIPTION: Final = (
    "Re-tune a control law on the bench: many short runs with loads, odometer errors, brake delays "
    "and seeds; the best settings are judged on other seeds and written as a "
    "parameter file for `vobc run --params`. The same options give the same file."
)
EPILOG: Final = (
    "exit codes: 0 done; 2 wrong usage or configuration; 3 a process that ran cases was ended; "
    "130 ended by Ctrl-C (the best so far is still written)"
)


def parser() -> argparse.ArgumentParser:
    """The command line of `vobc tune`."""
    top = CommandParser(prog="vobc tune", description=DESCRIPTION, epilog=EPILOG)
    top.add_argument("--law", default="pid", metavar="LAW", help=f"{', '.join(sorted(PARAMETERS))}")
    top.add_argument("--line", default="florence", metavar="NAME|FILE", help="default: florence")
    top.add_argument("--consist", default="florence4", metavar="NAME|FILE", help="the real train")
    top.add_argument(
        "--params",
        default="florence4",
        metavar="NAME|FILE",
        help="start with these parameters; default: florence4",
    )
    top.add_argument(
        "--parameters", nargs="+", default=[], metavar="KEY", help="tune these; default: the law's"
    )
    top.add_argument(
        "--budget", type=_positive, default=300, metavar="N", help="training runs; default: 300"
    )
    top.add_argument("--seed", type=_positive, default=1, metavar="N", help="default: 1")
    top.add_argument("--method", choices=METHODS, default=METHODS[0], help="default: nelder-mead")
    top.add_argument(
        "--workers", type=_positive, metavar="N", help="processes; default: one for each core"
    )
    top.add_argument("--out", default="tuned.toml", metavar="FILE", help="default: tuned.toml")
    top.add_argument("--json", action="store_true", help="one JSON object on standard output")
    return top


def main(argv: Sequence[str]) -> int:
    """A user's mistake gives one line, never a traceback."""
    from concurrent.futures import BrokenExecutor

    options = parser().parse_args(argv)
    try:
        return _tune(options)
    except SettingsError as error:
        print(f"vobc: {error}", file=sys.stderr)
        return EXIT_USAGE
    except BrokenExecutor as error:
        print(f"vobc: a process that ran cases was ended: {error}", file=sys.stderr)
        return EXIT_ENVIRONMENT


def _tune(options: argparse.Namespace) -> int:
    parameters = chosen_parameters(options.law, options.parameters)
    ground = Ground(options.law, options.line, options.consist, options.params)
    ground.check()
    out = Path(options.out)
    if out.exists():
        raise SettingsError(f"--out {out}: is there already; nothing is overwritten")
    config = load_config(options.params)
    before = {parameter.key: value_of(config, parameter.key) for parameter in parameters}
    console = console_for(json=options.json)
    workers = options.workers or len(os.sched_getaffinity(0))
    with ExitStack() as stack:
        evaluate = stack.enter_context(local_crew(workers, {}))
        tuner = Tuner(
            ground,
            parameters,
            before,
            evaluate,
            budget=options.budget,
            seed=options.seed,
            method=options.method,
        )
        interrupted = _run(tuner, console)
    if not tuner.begun:
        print("vobc: ended before the first result; no file is written", file=sys.stderr)
        return EXIT_INTERRUPTED
    tuned = tuner.tuned
    head = {"seed": options.seed, "budget": options.budget, "method": options.method}
    if interrupted:
        head["ended early"] = "by Ctrl-C"
    _show(console, tuned)
    write_parameters(out, parameter_file(ground, tuned, head))
    console.print(f"parameters: {out}", highlight=False, soft_wrap=True)
    console.print(f"to run them: vobc run --lockstep --params {out}", soft_wrap=True)
    if options.json:
        print(json.dumps({"file": str(out), "interrupted": interrupted, **as_document(tuned)}))
    return EXIT_INTERRUPTED if interrupted else EXIT_OK


def _run(tuner: Tuner, console: Console) -> bool:
    """Train and judge with a progress bar; True if Ctrl-C ended it."""
    progress = Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("left"),
        TimeRemainingColumn(compact=True),
        TextColumn("{task.fields[best]}"),
        console=console,
    )
    task = progress.add_task("training", total=runs_in_all(tuner.points_max), best="")

    def trained(points: int, cost: float) -> None:
        progress.update(task, completed=points * TRAINING, best=f"least cost {cost:.2f} cm")

    def judged(which: str) -> None:
        progress.advance(task, VALIDATION)

    try:
        with progress:
            tuner.train(trained)
            progress.update(task, description="judging")
            tuner.judge(judged)
    except KeyboardInterrupt:
        return True
    return False


def _show(console: Console, tuned: Tuned) -> None:
    table = Table("", "before", "after", title="tuned, judged on other seeds")
    for key in tuned.after:
        table.add_row(key, f"{tuned.before[key]:g}", f"{tuned.after[key]:g}")
    table.add_section()
    table.add_row("cost in training", _cm(tuned.cost_before_m), _cm(tuned.cost_after_m))
    before, after = tuned.figures_before, tuned.figures_after
    if before is not None and after is not None:
        for name, one, other in zip(NAMES, _cells(before), _cells(after), strict=True):
            if (one, other) != ("", ""):
                table.add_row(name, one, other)
    console.print(table)


NAMES: Final = (
    "mean stop error",
    "worst stop error",
    "stops missed or with doors shut",
    "mean running time",
    "greatest acceleration felt",
    "greatest jerk felt",
    "emergency brakes",
    "most notch changes in a braking",
)


def _cells(figures: RunFigures) -> tuple[str, ...]:
    return (
        _cm(figures.error_mean_m),
        _cm(figures.error_worst_m),
        f"{figures.stops_missed} of {figures.runs}",
        "" if figures.run_time_mean_s is None else f"{figures.run_time_mean_s:.1f} s",
        f"{figures.accel_max_mps2:.2f} m/s²",
        f"{figures.jerk_max_mps3:.2f} m/s³",
        str(figures.emergencies),
        "" if figures.notch_changes is None else str(figures.notch_changes),
    )


def _cm(value_m: float | None) -> str:
    return "" if value_m is None else f"{value_m * CM_PER_M:.2f} cm"


def _positive(text: str) -> int:
    try:
        value = int(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is not a whole number") from None
    if not 1 <= value < 2**31:
        raise argparse.ArgumentTypeError(f"{text} is not within 1..{2**31 - 1}")
    return value
