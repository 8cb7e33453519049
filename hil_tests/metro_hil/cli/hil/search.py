"""`hil search`: searches for the worst case of a scenario."""

import argparse
import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from metro_hil.cli.hil.working import PROCESSES_MAX, number
from metro_hil.engine.errors import EngineError
from metro_hil.model.case import BenchKind
from metro_hil.model.run_options import EXIT_INTERRUPTED, EXIT_OK

if TYPE_CHECKING:
    from collections.abc import Sequence

    from metro_hil.search import SearchSpace, Sought, WorstCaseSearch

WORST = 5
METHODS = ("cma", "random")


def add(verbs: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    parser = verbs.add_parser(
        "search",
        help="search for the worst case of a scenario",
        description="Vary the swept keys of a scenario to minimise the margin of a monitor. "
        "The worst cases found are written as a campaign file, which `hil run` repeats.",
    )
    parser.add_argument("campaign", metavar="CAMPAIGN", help="a shipped name, or a file")
    parser.add_argument("--scenario", metavar="NAME", help="default: the only one with a sweep")
    parser.add_argument(
        "--factors", nargs="+", default=[], metavar="KEY", help="vary these only; default: all"
    )
    parser.add_argument(
        "--budget", type=number(1), default=200, metavar="N", help="number of runs; default: 200"
    )
    parser.add_argument(
        "--monitor",
        metavar="NAME",
        help="monitor whose margin counts; default: the least of all, each over its usual size",
    )
    parser.add_argument(
        "--seed", type=number(0), default=1, metavar="S", help="seed of the search; default: 1"
    )
    parser.add_argument("--method", choices=METHODS, default="cma", help="default: cma")
    parser.add_argument(
        "--workers",
        type=number(1, PROCESSES_MAX),
        metavar="N",
        help="number of processes; default: one for each core",
    )
    parser.add_argument("--out", metavar="DIR", help="default: a new folder below runs/")
    parser.add_argument("--json", action="store_true", help="one JSON object on standard output")
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Exit code 0 if the search reached its end, whatever it found.

    Raises SettingsError, RunFolderError or EngineError.
    """
    from concurrent.futures import BrokenExecutor

    from firmware_py.clock.clock import WallClock
    from metro_hil.campaign import read_definition
    from metro_hil.model.run_folder import make_run_folder
    from metro_hil.search import WorstCaseSearch
    from metro_hil.search.leave import append_history
    from metro_hil.search.local import local_crew
    from metro_hil.search.space import space_of

    definition = read_definition(options.campaign)
    space = space_of(definition, options.scenario, options.factors)
    words = f"search-{space.plan.name}"
    folder = make_run_folder(options.out, WallClock().epoch_ns(), words)
    workers = _workers(options, space)
    files = space.body.sources.paths
    with local_crew(workers, files) as evaluate:
        search = WorstCaseSearch(
            space,
            evaluate,
            monitor=options.monitor,
            budget=options.budget,
            seed=options.seed,
            method=options.method,
        )

        def heard(new: "Sequence[Sought]") -> None:
            append_history(folder.path, new)
            worst = search.worst(1)
            least = f"least {worst[0].value:.4g}" if worst else "no margin so far"
            _say(f"{len(search.history)} points, {least}")

        interrupted, refused = False, None
        try:
            search.run(heard)
        except KeyboardInterrupt:
            interrupted = True
        except OSError as error:
            refused = error
        except BrokenExecutor as error:
            raise EngineError(f"a process that ran cases was ended: {error}") from error
        finally:
            if not search.history:
                folder.path.rmdir()
    if search.history:
        _tell(options, search, space, folder.path)
    if refused is not None:
        raise refused
    return EXIT_INTERRUPTED if interrupted else EXIT_OK


def _workers(options: argparse.Namespace, space: "SearchSpace") -> int:
    """One worker if runs share a bus and the processor's time."""
    if space.plan.bench is not BenchKind.LOCKSTEP:
        return 1
    return options.workers or len(os.sched_getaffinity(0))


def _tell(
    options: argparse.Namespace, search: "WorstCaseSearch", space: "SearchSpace", folder: Path
) -> None:
    import msgspec

    from metro_hil.search.leave import HISTORY, write_worst

    worst = search.worst(WORST)
    if not options.json:
        _show(worst)
    path = write_worst(folder, space, worst, space.body.sources.files) if worst else None
    if options.json:
        found = {
            "scenario": space.plan.name,
            "monitor": options.monitor,
            "points": len(search.history),
            "worst": worst,
            "campaign": None if path is None else str(path),
            "history": str(folder / HISTORY),
        }
        print(msgspec.json.encode(found).decode())
        return
    print(f"all {len(search.history)} points: {folder / HISTORY}")
    if path is not None:
        print(f"to repeat the worst: hil run {path}")


def _show(worst: "Sequence[Sought]") -> None:
    for sought in worst:
        values = ", ".join(f"{key} = {value}" for key, value in sought.values.items())
        margins = sorted(sought.margins.items(), key=lambda item: item[1])
        margin = f"; least margin {margins[0][1]:.4g} of {margins[0][0]}" if margins else ""
        print(f"{sought.value:.4g}: {sought.verdict}, seed {sought.seed}: {values}{margin}")


def _say(text: str) -> None:
    print(f"hil search: {text}", file=sys.stderr)
