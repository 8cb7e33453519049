"""`hil sensitivity`: checks whether a campaign detects mistakes in the controller."""

import argparse
import os
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from metro_hil.cli.hil.working import PROCESSES_MAX, number
from metro_hil.model.run_options import EXIT_FAILED, EXIT_INTERRUPTED, EXIT_OK

if TYPE_CHECKING:
    from metro_hil.campaign import Campaign
    from metro_hil.sensitivity.findings import MutantFinding
    from metro_hil.sensitivity.mutants import ControllerMutant

NAME_COLUMNS = 44


def _share(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is not a number") from None
    if not 0.0 < value <= 1.0:
        raise argparse.ArgumentTypeError(f"{text} is not more than 0 and at most 1")
    return value


def add(verbs: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    parser = verbs.add_parser(
        "sensitivity",
        help="run a campaign against mutated controllers: which scenario detects each mistake",
        description="Give the controller one mistake of the shipped lists at a time, and run cases "
        "of the campaign until one detects it. Exit code 0 if each mutant is detected or its list "
        "argues why no case can; 1 if not.",
    )
    parser.add_argument(
        "campaign",
        metavar="NAME",
        nargs="?",
        default="acceptance",
        help="shipped campaign or scenario, or a file; default: acceptance",
    )
    parser.add_argument(
        "--only",
        action="append",
        default=[],
        metavar="MUTANT",
        help="only this mutant, or a pattern such as 'doors-*'; may be given several times",
    )
    parser.add_argument(
        "--sample", type=_share, metavar="SHARE", help="only this share of them, such as 0.1"
    )
    parser.add_argument(
        "--seed",
        default="1",
        metavar="TEXT",
        help="seed of the sample, such as a commit; default: 1",
    )
    depth = parser.add_mutually_exclusive_group()
    depth.add_argument(
        "--quick",
        action="store_true",
        help="try each mutant only with the cases that its list names",
    )
    depth.add_argument(
        "--thorough",
        action="store_true",
        help="also try mutants whose list has an argument, with all cases",
    )
    parser.add_argument(
        "--workers",
        type=number(1, PROCESSES_MAX),
        metavar="N",
        help="default: one for each processor",
    )
    parser.add_argument(
        "--out",
        metavar="DIR",
        help="default: a new folder below runs/sensitivity, named by date and campaign",
    )
    parser.add_argument("--list", action="store_true", help="list the mutants and run nothing")
    parser.add_argument(
        "--json", action="store_true", help="one JSON object on standard output, all else on stderr"
    )
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Exit code 1 if a mutant is neither detected nor argued."""
    from metro_hil.sensitivity.mutants import chosen, sampled, shipped_mutants

    shipped = shipped_mutants()
    mutants = chosen(shipped, options.only)
    if options.sample is not None:
        mutants = sampled(mutants, options.sample, options.seed)
    if options.list:
        _list(mutants, as_json=options.json)
        return EXIT_OK
    return _try(mutants, len(shipped), options)


def _list(mutants: "Sequence[ControllerMutant]", *, as_json: bool) -> None:
    import dataclasses

    import msgspec

    if as_json:
        tables = [dataclasses.asdict(mutant) for mutant in mutants]
        print(msgspec.json.encode({"mutants": tables}).decode())
        return
    for mutant in mutants:
        argued = " [argued]" if mutant.argued else ""
        print(f"{mutant.name:{NAME_COLUMNS}} {mutant.file}: {mutant.rule}{argued}")
    print(f"{len(mutants)} mutants")


def _try(
    mutants: "Sequence[ControllerMutant]", of_mutants: int, options: argparse.Namespace
) -> int:
    import msgspec

    from metro_hil.campaign import plan_cases
    from metro_hil.campaign.scenarios import read_named
    from metro_hil.engine.errors import UsageError
    from metro_hil.engine.stopping import StopWish
    from metro_hil.sensitivity import report
    from metro_hil.sensitivity.session import (
        Depth,
        SensitivitySession,
        not_tried,
        usable_cases,
        with_difference,
    )

    told_to = sys.stderr if options.json else sys.stdout
    campaign = read_named(options.campaign)
    cases = usable_cases(plan_cases(campaign))
    if not cases:
        raise UsageError(
            f"{options.campaign}: no case runs the shipped controller on the bench lockstep"
        )

    def told(finding: "MutantFinding") -> None:
        line = f"{finding.mutant:{NAME_COLUMNS}} {finding.outcome.value}: {finding.by()}"
        print(line, file=told_to, flush=True)

    depth = Depth.USUAL
    if options.quick or options.thorough:
        depth = Depth.QUICK if options.quick else Depth.THOROUGH
    with tempfile.TemporaryDirectory(prefix="hil-sensitivity-") as scratch:
        session = SensitivitySession(
            cases,
            _written_files(campaign, Path(scratch) / "files"),
            Path(scratch) / "packages",
            workers=options.workers or os.cpu_count() or 1,
            depth=depth,
            told=told,
        )
        session.check(mutants)
        folder = report.new_folder(campaign.name, options.out)
        with StopWish() as stop:
            session.run(mutants, lambda: stop.count > 0)
        interrupted = stop.count > 0
        findings = [
            with_difference(session.findings.get(each.name) or not_tried(each), each, session.root)
            for each in mutants
        ]
    done = report.document(
        campaign.name,
        findings,
        cases=len(cases),
        of_mutants=of_mutants,
        interrupted=interrupted,
    )
    paths = report.write(folder, done)
    print("\n".join(report.summary(done)), file=told_to)
    for path in paths:
        print(f"report: {path}", file=told_to)
    if options.json:
        print(msgspec.json.encode(done).decode())
    if interrupted:
        return EXIT_INTERRUPTED
    return EXIT_OK if all(each.outcome.in_order for each in findings) else EXIT_FAILED


def _written_files(campaign: "Campaign", folder: Path) -> dict[str, Path]:
    """Write the campaign's files, and return their paths by the names that cases use."""
    paths = {}
    for place, (name, content) in enumerate(campaign.files.items()):
        paths[name] = folder / str(place) / Path(name).name
        paths[name].parent.mkdir(parents=True)
        paths[name].write_text(content, encoding="utf-8")
    return paths
