"""`hil attack`: attacks the protection by chance."""

import argparse
import os
import sys
from typing import TYPE_CHECKING

from metro_hil.cli.hil.working import (
    add_work_options,
    check_on,
    kept_options,
    number,
    work_on,
)
from metro_hil.model.run_options import EXIT_FAILED, EXIT_OK

if TYPE_CHECKING:
    from collections.abc import Sequence

    from metro_hil.attack.curves import CurveFinding

CURVES = 1000
RUNS = 20
SHOWN_MAX = 10
CHUNK = 50
"""Situations that a process takes at a time."""


def add(verbs: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    parser = verbs.add_parser(
        "attack",
        help="attack the protection by chance",
        description="Compare the four limits of protection with the worst declared motion, in "
        "situations by chance: limits and gradients that change every metre to every 200 m, up "
        "to 60 per mille, trains of 1 to 400 m. The judge shares no code with protection. Then "
        "run pairs and triples of faults at conditions, each on a line by chance, under all "
        "invariants; with --networks also services over networks by chance, with faults of their "
        "switches. Situation, run or network K of a seed S is the first one of the seed S + K.",
    )
    parser.add_argument(
        "--curves",
        type=number(0),
        metavar="N",
        help=f"number of situations; default: {CURVES}, with --controller 0",
    )
    parser.add_argument(
        "--runs", type=number(0), default=RUNS, metavar="N", help=f"number of runs; default: {RUNS}"
    )
    parser.add_argument(
        "--networks",
        type=number(0),
        default=0,
        metavar="N",
        help="number of networks, each with a service; default: 0",
    )
    parser.add_argument(
        "--seed", type=number(0), default=1, metavar="S", help="the first seed; default: 1"
    )
    parser.add_argument(
        "--controller",
        metavar="DEVICE",
        help="of the runs: shipped, checkout:PATH or command:WORDS; default: shipped",
    )
    parser.add_argument(
        "--out", metavar="DIR", help="of the runs; default: a new folder below runs/hil"
    )
    add_work_options(parser)
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Exit code 0 only if every situation is safe and every run as expected.

    Raises SettingsError, UsageError or EngineError.
    """
    from metro_hil.engine.choosing import read_controller
    from metro_hil.engine.errors import UsageError

    foreign = options.controller not in (None, "shipped")
    if options.curves is None:
        options.curves = 0 if foreign else CURVES
    if options.curves and foreign:
        raise UsageError(
            f"--curves {options.curves}: judges the shipped protection, not --controller "
            f"{options.controller}; leave it out"
        )
    if options.controller is not None:
        read_controller(options.controller)
    if not options.curves and not options.runs and not options.networks:
        raise UsageError("--curves 0 --runs 0: nothing to try; raise one of them")
    if options.networks and options.runs:
        raise UsageError(
            f"--networks {options.networks}: makes a campaign of its own; add --runs 0"
        )
    if options.networks and foreign:
        raise UsageError(
            f"--networks {options.networks}: needs the shipped controller, which changes ends"
        )
    code = _attack_curves(options) if options.curves else EXIT_OK
    if (options.runs or options.networks) and not (code and options.fail_fast):
        code = max(code, _attack_runs(options))
    return code


def _attack_runs(options: argparse.Namespace) -> int:
    """Write the campaign of the runs and run it like `hil run`."""
    import tempfile
    from pathlib import Path

    from metro_hil.attack.networks import write_networks
    from metro_hil.attack.runs import write_attack
    from metro_hil.campaign import plan_cases, read_campaign
    from metro_hil.engine.choosing import choose
    from metro_hil.engine.folder import CampaignPlan, make_folder

    write, count = (
        (write_networks, options.networks) if options.networks else (write_attack, options.runs)
    )
    with tempfile.TemporaryDirectory() as folder:
        campaign = read_campaign(str(write(Path(folder), options.seed, count)))
    cases = choose(plan_cases(campaign), controller=options.controller)
    check_on(options.on, [case.bench.value for case in cases])
    plan = CampaignPlan(
        name=campaign.name,
        title=campaign.title,
        description=campaign.description,
        layout=campaign.layout,
        cases=cases,
        planned_cases=len(cases),
        files=campaign.files,
        options=kept_options(options),
    )
    made = make_folder(plan, options.out)
    print(f"campaign folder: {made.path}", file=sys.stderr if options.json else sys.stdout)
    return work_on(made, options, {})


def _attack_curves(options: argparse.Namespace) -> int:
    """Exit code 0 only if every situation is safe and at least one permits a movement."""
    findings = _findings(options)
    broken = [finding for finding in findings if finding.problem]
    moving = sum(finding.moves for finding in findings)
    if options.json:
        _print_json(options, findings)
    else:
        print(
            f"curves: {len(findings)} situations from seed {options.seed}, "
            f"{moving} with a movement: {len(broken)} unsafe"
        )
    for finding in broken[:SHOWN_MAX]:
        print(f"hil attack: {finding.problem}", file=sys.stderr)
        print(f"  repeat: hil attack --curves 1 --runs 0 --seed {finding.seed}", file=sys.stderr)
    if len(broken) > SHOWN_MAX:
        print(f"hil attack: {len(broken) - SHOWN_MAX} more", file=sys.stderr)
    if not moving:
        print(
            "hil attack: no situation permits a movement, so nothing was tried; raise --curves",
            file=sys.stderr,
        )
    return EXIT_FAILED if broken or not moving else EXIT_OK


def _findings(options: argparse.Namespace) -> "Sequence[CurveFinding]":
    from concurrent.futures import ProcessPoolExecutor

    from metro_hil.attack.curves import attack_curve

    seeds = range(options.seed, options.seed + options.curves)
    workers = min(options.workers or len(os.sched_getaffinity(0)), -(-options.curves // CHUNK))
    if workers == 1:
        return [attack_curve(seed) for seed in seeds]
    with ProcessPoolExecutor(workers) as pool:
        return list(pool.map(attack_curve, seeds, chunksize=CHUNK))


def _print_json(options: argparse.Namespace, findings: "Sequence[CurveFinding]") -> None:
    import json

    unsafe = [
        {"seed": finding.seed, "problem": finding.problem}
        for finding in findings
        if finding.problem
    ]
    moving = sum(finding.moves for finding in findings)
    print(
        json.dumps(
            {
                "seed": options.seed,
                "situations": len(findings),
                "with_movement": moving,
                "unsafe": unsafe,
            }
        )
    )
