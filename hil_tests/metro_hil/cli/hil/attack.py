"""`hil attack`: attacks the protection by chance."""

import argparse
import os
import sys
from typing import TYPE_CHECKING

from metro_hil.cli.hil.working import PROCESSES_MAX, number
from metro_hil.model.run_options import EXIT_FAILED, EXIT_OK

if TYPE_CHECKING:
    from collections.abc import Sequence

    from metro_hil.attack.curves import CurveFinding

CURVES = 1000
SHOWN_MAX = 10
CHUNK = 50
"""Situations that a process takes at a time."""


def add(verbs: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    parser = verbs.add_parser(
        "attack",
        help="attack the protection by chance",
        description="Compare the four limits of protection with the worst declared motion, in "
        "situations by chance: limits and gradients that change every metre to every 200 m, up "
        "to 60 per mille, trains of 1 to 400 m. The judge shares no code with protection. "
        "Situation K of a seed S is the first one of the seed S + K.",
    )
    parser.add_argument(
        "--curves",
        type=number(1),
        default=CURVES,
        metavar="N",
        help=f"number of situations; default: {CURVES}",
    )
    parser.add_argument(
        "--seed", type=number(0), default=1, metavar="S", help="the first seed; default: 1"
    )
    parser.add_argument(
        "--workers",
        type=number(1, PROCESSES_MAX),
        metavar="N",
        help="number of processes; default: one for each core",
    )
    parser.add_argument("--json", action="store_true", help="one JSON object on standard output")
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
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
        print(f"  repeat: hil attack --curves 1 --seed {finding.seed}", file=sys.stderr)
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
