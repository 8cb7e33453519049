"""`hil simulate`: simulates trains that command themselves in virtual time under random faults."""

import argparse
import contextlib
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Final

from firmware_py.settings import nearest
from metro_hil.cli.hil.working import PROCESSES_MAX, number
from metro_hil.engine.errors import EngineError, UsageError
from metro_hil.model.run_options import EXIT_FAILED, EXIT_INTERRUPTED, EXIT_OK
from zenoh_config.timers import TIMER_SETS

if TYPE_CHECKING:
    from collections import Counter

    from metro_hil.simulation.batch import SeedJournal, Total
    from metro_hil.simulation.run import RunResult
    from metro_hil.simulation.simulate import SeedJob

SEEDS: Final = "1..20"
S_PER_H: Final = 3600.0


def add(verbs: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    parser = verbs.add_parser(
        "simulate",
        help="simulate trains that command themselves, in virtual time, under random faults",
        description="Each seed gives a line with its own trains, network and faults. The true "
        "places of the trains decide whether an invariant is broken. `hil simulate --seed N "
        "--trace` repeats a failed seed with its event log.",
    )
    which = parser.add_mutually_exclusive_group()
    which.add_argument("--seed", type=number(0), metavar="N", help="run only this seed")
    which.add_argument(
        "--seeds", type=seeds, metavar="A..B", help=f"from A to B, both included; default: {SEEDS}"
    )
    parser.add_argument(
        "--hours",
        type=_hours,
        metavar="H",
        help="run seeds from the first on until H train hours are simulated",
    )
    parser.add_argument(
        "--minutes",
        type=_hours,
        default=5.0,
        metavar="M",
        help="minutes of faults in each seed; default: 5",
    )
    parser.add_argument(
        "--protocol",
        choices=("line", "paper"),
        default="line",
        help="paper: the literal rules of [Xu], to show their consequences",
    )
    parser.add_argument(
        "--timers", choices=sorted(TIMER_SETS), help="run only seeds that use these timers"
    )
    parser.add_argument(
        "--bytes", action="store_true", help="encode messages with the real codec in every seed"
    )
    parser.add_argument(
        "--profile",
        metavar="NAME",
        help="features of all seeds: even, varied, ordered, choosy, sidings, by-hand, disturbed, "
        "dense, distant or insider, each with those before it; default: by the number of the seed",
    )
    parser.add_argument("--trace", action="store_true", help="print every event")
    parser.add_argument(
        "--workers",
        type=number(1, PROCESSES_MAX),
        default=1,
        metavar="N",
        help="number of processes; default: 1",
    )
    parser.add_argument(
        "--journal", metavar="FILE", help="append results to this file; its seeds are not run again"
    )
    parser.add_argument("--json", action="store_true", help="one JSON object on standard output")
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Exit code 1 if an invariant was broken. Raises UsageError."""
    from metro_hil.simulation.batch import Total
    from metro_hil.simulation.run import Phases
    from metro_hil.simulation.simulate import SeedJob

    if options.trace and options.workers > 1:
        raise UsageError("--trace prints one event log: it needs one worker")
    if options.timers and options.protocol == "paper":
        raise UsageError("--timers: the paper's rules have no timers")
    _check_profile(options)
    job = SeedJob(
        protocol=options.protocol,
        phases=Phases(trouble_s=60.0 * options.minutes),
        bytes_always=options.bytes,
        told=options.trace,
        profile=options.profile,
    )
    journal = _journal(options)
    total = Total()
    known = set()
    for result in journal.results if journal else ():
        known.add(result.seed)
        total.add(result)
    todo = (seed for seed in _wanted(options, total, job) if seed not in known)
    interrupted = False
    try:
        _run(todo, job, options, total, journal)
    except KeyboardInterrupt:
        interrupted = True
    finally:
        print(_json(total) if options.json else "\n".join(lines(total)))
    if interrupted:
        more = f"; the same command goes on from {options.journal}" if journal else ""
        print(f"hil: interrupted, this is what was run until then{more}", file=sys.stderr)
        return EXIT_INTERRUPTED
    return EXIT_FAILED if total.broken else EXIT_OK


def _run(
    todo: Iterator[int],
    job: "SeedJob",
    options: argparse.Namespace,
    total: "Total",
    journal: "SeedJournal | None",
) -> None:
    """Add the result of each seed to total and journal, as soon as it is known."""
    from metro_hil.simulation.batch import run_many

    with contextlib.closing(run_many(todo, job, workers=options.workers)) as results:
        for result in results:
            total.add(result)
            if journal:
                _keep(result, journal)
            if not options.json:
                _tell_broken(result, job)
            if sys.stderr.isatty():
                hours = total.train_s / S_PER_H
                print(f"\r{total.runs} seeds, {hours:.1f} train hours", end="", file=sys.stderr)


def _keep(result: "RunResult", journal: "SeedJournal") -> None:
    try:
        journal.append(result)
    except OSError as error:
        raise EngineError(f"seed {result.seed}: --journal: {error.strerror}") from error


def _journal(options: argparse.Namespace) -> "SeedJournal | None":
    from metro_hil.simulation.batch import SeedJournal

    if options.journal is None:
        return None
    try:
        return SeedJournal(Path(options.journal))
    except OSError as error:
        raise UsageError(f"--journal {options.journal}: {error.strerror}") from error
    except ValueError as error:
        raise UsageError(f"--journal {error}") from error


def _check_profile(options: argparse.Namespace) -> None:
    """Raises UsageError."""
    from metro_hil.simulation.generate import PROFILES

    if options.profile is None:
        return
    if options.profile not in PROFILES:
        hint = nearest(options.profile, list(PROFILES), "profile")
        raise UsageError(f"--profile {options.profile}: unknown; {hint}")
    if options.protocol == "paper":
        raise UsageError("--profile: the paper's rules have none of them")
    if options.journal is not None:
        raise UsageError("--profile: not with --journal, which tells seeds apart by their number")


def _wanted(options: argparse.Namespace, total: "Total", job: "SeedJob") -> Iterator[int]:
    every = _in_turn(options, total)
    if options.timers is None:
        return every
    if options.seed is not None:
        timers = job.sampled(options.seed).timers
        if timers != options.timers:
            raise UsageError(f"--timers {options.timers}: seed {options.seed} uses {timers}")
    return (seed for seed in every if job.sampled(seed).timers == options.timers)


def _in_turn(options: argparse.Namespace, total: "Total") -> Iterator[int]:
    if options.seed is not None:
        yield options.seed
        return
    first, last = options.seeds or seeds(SEEDS)
    if options.hours is None:
        yield from range(first, last + 1)
        return
    seed = first
    while total.train_s < options.hours * S_PER_H:
        yield seed
        seed += 1


def _tell_broken(result: "RunResult", job: "SeedJob") -> None:
    from metro_hil.simulation.batch import repeat_with

    if not result.invariant:
        return
    print(f"seed {result.seed}, {result.simulated_s:.3f} s: {result.invariant}: {result.what}")
    print(f"  to repeat it: {repeat_with(result, job.options())}")


def lines(total: "Total") -> list[str]:
    """The totals as lines of text for a person."""
    rate = total.events / total.cpu_s if total.cpu_s else 0.0
    text = [
        f"{total.runs} seeds: {total.simulated_s / S_PER_H:.2f} h of lines, "
        f"{total.train_s / S_PER_H:.2f} h of trains, {total.events} protocol events",
        f"{rate:,.0f} events a CPU second; {total.emergencies} emergency brakes; last authority "
        f"back {total.recovery_s_max:.1f} s after the last fault, at most",
        f"faults: {_counted(total.faults)}",
        f"messages: {_counted(total.messages)}",
        f"looked at: {_counted(total.looked)}",
    ]
    if total.covered:
        from metro_hil.simulation.coverage import never

        text.append(f"gone through: {_counted(total.covered)}")
        text.append(f"never gone through: {', '.join(never(total.covered)) or 'nothing'}")
    broken = len(total.broken)
    return [*text, f"broken: {broken} seeds" if broken else "nothing broken"]


def _counted(counts: "Counter[str]") -> str:
    return ", ".join(f"{name} {count}" for name, count in sorted(counts.items())) or "none"


def _json(total: "Total") -> str:
    import json

    from metro_hil.simulation.batch import as_table

    return json.dumps(as_table(total))


def seeds(text: str) -> tuple[int, int]:
    """Parse `A..B` as two numbers."""
    first, dots, last = text.partition("..")
    try:
        low, high = int(first), int(last if dots else first)
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is not A..B, two whole numbers") from None
    if not 0 <= low <= high:
        raise argparse.ArgumentTypeError(f"{text}: from 0 on, and the first is not beyond the last")
    return low, high


def _hours(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is not a number") from None
    if not 0.0 < value < 1e7:
        raise argparse.ArgumentTypeError(f"{text} is not more than 0")
    return value
