"""`make bench`: every figure that the README publishes, with a peer or limit in the same run.

Machines differ and are shared, so a figure is a ratio or the median of several runs.
"""

import argparse
import json
import os
import shutil
import statistics
import subprocess
import sys
import tempfile
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from firmware_py.clock.clock import REALTIME_SPIN_S
from metro_hil.benchmarks.profile import where_the_time_goes
from metro_hil.model.native_copy import SWITCH, Native

LOCKSTEP_RUNS = 5
LOCKSTEP_BAR = 200.0
ERRORS_RATIO = (-0.01, 0.0, 0.01, 0.02, 0.03, 0.04, 0.05)
LOADS_RATIO = (0.0, 0.5, 1.0)
BRAKES = ("florence4_fixed_delay", "florence4")
STOP_BAR_M = 0.10
PRIORITY = 80
PERIOD_MS = 50
LATENESS_ROUNDS = 3
LATENESS_S = 10
LATENESS_BAR_RATIO = 2.0
WORK_BAR_MS = 2.0
EXIT_MISSED = 1


@dataclass(frozen=True, slots=True)
class Figure:
    """One row of the table."""

    name: str
    value: str
    bar: str
    met: bool | None
    """None without a bar or a comparison."""


PROGRAM = (
    *(sys.executable, "-c"),
    "import sys; from metro_hil.cli.entry import vobc; sys.exit(vobc())",
)
WAYS = {
    "plain Python": Native.OFF,
    "C for codec, bus and logs": Native.WIRE,
    "with compiled controller": Native.WAIT,
}
"""How the same run is executed; the last is what a user gets once the background build is done."""


def vobc_run(*arguments: str, native: Native = Native.WIRE) -> dict[str, Any]:
    """Run `vobc run` in a fresh process and return its JSON results."""
    with tempfile.TemporaryDirectory() as scratch:
        command = [*PROGRAM, "run", "--json", "--out", str(Path(scratch) / "run"), *arguments]
        environment = {**os.environ, SWITCH: native.value}
        done = subprocess.run(command, capture_output=True, text=True, check=False, env=environment)
    if done.returncode != 0:
        raise RuntimeError(f"{' '.join(command)} ended with {done.returncode}:\n{done.stderr}")
    results: dict[str, Any] = json.loads(done.stdout)
    return results


def lockstep_speed() -> list[Figure]:
    """Measure the whole Florence line on one core, with every frame through bus and log."""
    runs: dict[str, list[dict[str, Any]]] = {name: [] for name in WAYS}
    # All run in turn, so that a change of the machine's speed affects them alike.
    for _ in range(LOCKSTEP_RUNS):
        for name, native in WAYS.items():
            runs[name].append(vobc_run("--lockstep", native=native))
    hashes = {run["frame_log_sha256"] for each in runs.values() for run in each}
    same, count = len(hashes) == 1, len(WAYS) * LOCKSTEP_RUNS
    *others, last = WAYS
    return [
        *(_speed(f"lockstep, whole line, {name}", runs[name], bar=None) for name in others),
        _speed(f"lockstep, whole line, {last}", runs[last], bar=LOCKSTEP_BAR),
        Figure(
            "same seed, same frame log",
            f"{'identical' if same else 'DIFFERENT'} in {count} processes, all ways",
            "identical",
            same,
        ),
    ]


def _speed(name: str, runs: Sequence[dict[str, Any]], *, bar: float | None) -> Figure:
    factors = [run["real_time_factor"] for run in runs]
    median = statistics.median(factors)
    value = f"{median:.0f} × real time ({min(factors):.0f} to {max(factors):.0f})"
    if bar is None:
        return Figure(name, value, "", None)
    return Figure(name, value, f"≥ {bar:.0f} ×", median >= bar)


def where_time_goes() -> list[Figure]:
    """Measure each part's share of the processor time of a lockstep run with a profiler."""
    return [
        Figure(f"  of which {room}", f"{share * 100.0:4.1f} %", "", None)
        for room, share in where_the_time_goes()
    ]


def _stop_run(case: tuple[str, float, float]) -> list[float]:
    brake, error_ratio, load_ratio = case
    seed = 1 + int((error_ratio + 0.01) * 1000.0) + int(load_ratio * 10.0)
    run = vobc_run(
        "--lockstep",
        "--consist",
        brake,
        "--odometer-error",
        str(error_ratio),
        "--load-ratio",
        str(load_ratio),
        "--seed",
        str(seed),
    )
    return [
        stop["error_m"] if stop["error_m"] is not None else float("inf") for stop in run["stops"]
    ]


def stop_accuracy() -> list[Figure]:
    """Measure all stops under the odometer errors and loads of [Allotta 2013], with both brakes."""
    figures = []
    for brake in BRAKES:
        cases = [(brake, error, load) for error in ERRORS_RATIO for load in LOADS_RATIO]
        with ProcessPoolExecutor() as pool:
            errors_m = [abs(e) for run in pool.map(_stop_run, cases) for e in run]
        worst_m, mean_m = max(errors_m), statistics.fmean(errors_m)
        figures.append(
            Figure(
                f"stops, {brake}",
                f"mean {mean_m * 100.0:.2f} cm, worst {worst_m * 100.0:.2f} cm of {len(errors_m)}",
                f"≤ {STOP_BAR_M * 100.0:.0f} cm each",
                worst_m <= STOP_BAR_M,
            )
        )
    return figures


def real_time() -> list[Figure]:
    """Run one hop as processes on a bus of this machine, with a cycle of 50 ms."""
    run = vobc_run("--from", "II", "--to", "III", "--priority", str(PRIORITY))
    cycles, stop = run["cycles"], run["stops"][0]
    work_ms = cycles["work_us_p50"] / 1000.0
    return [
        Figure(
            "controller's work per cycle, real time",
            f"p50 {work_ms:.2f} ms, max {cycles['work_us_max'] / 1000.0:.2f} ms",
            f"p50 < {WORK_BAR_MS:.0f} ms",
            work_ms < WORK_BAR_MS,
        ),
        Figure(
            "cycle lateness in that run",
            f"p50 {cycles['lateness_us_p50']:.0f} µs, p99 {cycles['lateness_us_p99']:.0f} µs, "
            f"{cycles['slips']} slips",
            "",
            None,
        ),
        Figure("stop in that run", f"{stop['error_m'] * 100.0:+.1f} cm", "", None),
    ]


def lateness() -> list[Figure]:
    """Compare the release lateness of an empty 50 ms task with that of cyclictest.

    Both run in turn at one priority.
    """
    name = f"release lateness p99, {PERIOD_MS} ms, priority {PRIORITY}"
    cyclictest = shutil.which("cyclictest")
    if cyclictest is None:
        return [Figure(name, "not measured: no cyclictest (Debian: rt-tests)", "", None)]
    ours, theirs = [], []
    for _ in range(LATENESS_ROUNDS):
        theirs.append(_cyclictest_p99_us(cyclictest))
        ours.append(_our_p99_us())
    our_us, their_us = statistics.median(ours), statistics.median(theirs)
    ratio = our_us / their_us
    return [
        Figure(
            name,
            f"{our_us:.0f} µs, cyclictest {their_us:.0f} µs: {ratio:.2f} ×",
            f"≤ {LATENESS_BAR_RATIO:.0f} ×",
            ratio <= LATENESS_BAR_RATIO,
        )
    ]


def _our_p99_us() -> float:
    command = [sys.executable, "-m", "metro_tools.cyclic_lateness", "--json"]
    command += ["--period-ms", str(PERIOD_MS), "--seconds", str(LATENESS_S)]
    command += ["--priority", str(PRIORITY), "--spin-us", str(REALTIME_SPIN_S * 1e6)]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    return float(json.loads(done.stdout)["lateness_us_p99"])


def _cyclictest_p99_us(program: str) -> float:
    """Return the 99th percentile of its histogram, for the same number of releases."""
    loops = LATENESS_S * 1000 // PERIOD_MS
    command = [program, "-q", "-m", "-p", str(PRIORITY), "-i", str(PERIOD_MS * 1000)]
    command += ["-l", str(loops), "-h", "20000"]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    samples: list[int] = []
    for row in done.stdout.splitlines():
        fields = row.split()
        if len(fields) == 2 and fields[0].isdigit():
            samples += [int(fields[0])] * int(fields[1])
    samples.sort()
    return float(max(1, samples[min(len(samples) - 1, int(len(samples) * 0.99))]))


MEASURES: dict[str, Callable[[], list[Figure]]] = {
    "lockstep": lockstep_speed,
    "profile": where_time_goes,
    "stops": stop_accuracy,
    "realtime": real_time,
    "lateness": lateness,
}


def main(argv: Sequence[str] | None = None) -> int:
    """Print the table; exit code 1 if a bar is missed."""
    return run_measures(MEASURES, "python -m metro_hil.benchmarks.bench", str(__doc__), argv)


def run_measures(
    measures: Mapping[str, Callable[[], list[Figure]]],
    program: str,
    description: str,
    argv: Sequence[str] | None,
) -> int:
    """Run the requested measures, by default all; return exit code 1 if a bar is missed."""
    parser = argparse.ArgumentParser(prog=program, description=description)
    parser.add_argument("measures", nargs="*", metavar="MEASURE", help=", ".join(measures))
    parser.add_argument("--json", action="store_true", help="print JSON on standard output")
    options = parser.parse_args(argv)
    unknown = [name for name in options.measures if name not in measures]
    if unknown:
        parser.error(f"unknown measure {unknown[0]}; choose from {', '.join(measures)}")
    console = Console(stderr=True)
    figures = []
    for name in options.measures or measures:
        console.print(f"measuring {name} ...", style="dim")
        figures += measures[name]()
    _print(console, figures)
    if options.json:
        print(json.dumps([asdict(figure) for figure in figures], indent=2))
    return EXIT_MISSED if any(figure.met is False for figure in figures) else 0


def _print(console: Console, figures: Sequence[Figure]) -> None:
    table = Table("figure", "measured", "bar", "")
    words = {True: "[green]met[/]", False: "[red]missed[/]", None: ""}
    for figure in figures:
        table.add_row(figure.name, figure.value, figure.bar, words[figure.met])
    console.print(table)


if __name__ == "__main__":
    sys.exit(main())
