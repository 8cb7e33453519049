"""`make bench-scaling`: how processor time grows with run, trains, frames and cores.

Each row is a series of runs. Its exponent is the slope between its two largest points on a plot
with logarithmic axes: 1 says that twice as much takes twice as long. Start-up weighs less in the
larger points, so the slope there judges the work itself. The plot has all points.
"""

import argparse
import json
import math
import os
import resource
import subprocess
import sys
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Final, NamedTuple

import matplotlib as mpl
from rich.console import Console
from rich.table import Table

from firmware_py.clock.clock import WallClock
from hil_tests.log_benchmarks.traffic import write_logs
from metro_hil.benchmarks.campaigns import HOPS
from metro_hil.model.native_copy import SWITCH, Native, Part, ready_copy, worker_environment

EXPONENT_BAR: Final = 1.1
CORES_BAR: Final = 1.95
RUN_S: Final = (60, 240, 960)
TRAINS: Final = (1, 2, 4, 7)
TRAINS_S: Final = 300
FRAMES: Final = (100_000, 1_000_000, 4_000_000)
AREAS: Final = (2, 6, 18)
AREA_TRAINS: Final = 4
CASES: Final = 60
NS_PER_S: Final = 1e9
EXIT_MISSED: Final = 1
VOBC: Final = "import sys; from metro_hil.cli.entry import vobc; sys.exit(vobc())"
HIL: Final = "import sys; from metro_hil.cli.entry import hil; sys.exit(hil())"
CANLOG: Final = "import sys; from canlog.entry import canlog; sys.exit(canlog())"
LONG_LINE: Final = (
    f"from metro_hil.simulation.long_line import play; play({{areas}}, {AREA_TRAINS}, seconds=4.0)"
)


class Series(NamedTuple):
    """Points of one kind: how much, and what it took in seconds."""

    name: str
    unit: str
    points: Sequence[tuple[float, float]]

    @property
    def exponent(self) -> float:
        (less, less_s), (more, more_s) = self.points[-2:]
        return math.log(more_s / less_s) / math.log(more / less)


def processor_s(code: str, *words: str, library: Path | None = None) -> float:
    """Processor time of a Python program and its children, in seconds."""
    environment = worker_environment({**os.environ, SWITCH: Native.WIRE.value}, library)
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    done = subprocess.run(
        [sys.executable, "-c", code, *words],
        env=environment,
        capture_output=True,
        text=True,
    )
    if done.returncode != 0:
        raise SystemExit(f"{' '.join(words) or code} ended with {done.returncode}: {done.stderr}")
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def length_of_run(library: Path | None, scratch: Path) -> Series:
    points = []
    for seconds in RUN_S:
        # The line is driven from end to end in about 15 minutes.
        words = ["run", "--lockstep", "--line", "changping", "--duration", str(seconds)]
        words += ["--out", str(scratch / f"run{seconds}"), "--json"]
        points.append((float(seconds), processor_s(VOBC, *words, library=library)))
    return Series("one train, length of the run", "s", points)


def whole_trains(library: Path | None, scratch: Path) -> Series:
    points = []
    for trains in TRAINS:
        words = ["run", "--lockstep", "--trains", str(trains), "--duration", str(TRAINS_S)]
        words += ["--out", str(scratch / f"trains{trains}"), "--json"]
        points.append((float(trains), processor_s(VOBC, *words, library=library)))
    return Series(f"whole trains on one supply, {TRAINS_S} s", "trains", points)


def simulated_trains(library: Path | None, scratch: Path) -> Series:
    points = []
    for areas in AREAS:
        code = LONG_LINE.format(areas=areas)
        points.append((float(areas * AREA_TRAINS), processor_s(code, library=library)))
    return Series("trains that command themselves, simulated", "trains", points)


def frames(library: Path | None, scratch: Path) -> Series:
    points = []
    for count in FRAMES:
        folder = scratch / f"frames{count}"
        log = write_logs(folder, count, ("candump",))["candump"]
        words = ["stats", str(log), "--dbc", str(folder / "bench.dbc")]
        points.append((float(count), processor_s(CANLOG, *words)))
        log.unlink()
    return Series("`canlog stats`", "frames", points)


SERIES: Final[Sequence[tuple[Part, Callable[[Path | None, Path], Series]]]] = (
    (Part.TRAIN, length_of_run),
    (Part.TRAIN, whole_trains),
    (Part.SIMULATOR, simulated_trains),
    (Part.TRAIN, frames),
)


def two_cores(scratch: Path) -> float:
    """Speed of a campaign with two workers relative to one, on the clock."""
    campaign = scratch / "hops.toml"
    campaign.write_text(HOPS.format(count=CASES), encoding="utf-8")
    took_s = []
    for workers in (1, 2):
        clock = WallClock()
        began_ns = clock.now_ns()
        words = ["run", str(campaign), "--workers", str(workers), "--no-report", "--keep", "0"]
        processor_s(HIL, *words, "--out", str(scratch / f"hops{workers}"))
        took_s.append((clock.now_ns() - began_ns) / NS_PER_S)
    return took_s[0] / took_s[1]


def draw(series: Sequence[Series], path: Path) -> None:
    """Draw all series relative to their first point, on logarithmic axes."""
    mpl.use("Agg")
    from matplotlib import pyplot

    figure, axes = pyplot.subplots(figsize=(7.0, 4.5), layout="constrained")
    for each, mark in zip(series, "osD^", strict=True):
        (first, first_s), *_ = each.points
        amounts = [amount / first for amount, _ in each.points]
        times = [took_s / first_s for _, took_s in each.points]
        axes.loglog(amounts, times, marker=mark, label=each.name.replace("`", ""))
    last = max(each.points[-1][0] / each.points[0][0] for each in series)
    axes.loglog([1.0, last], [1.0, last], "k:", label="twice as much, twice as long")
    axes.set_xlabel("amount, relative to the smallest")
    axes.set_ylabel("processor time, relative to the smallest")
    axes.grid(visible=True, which="both", alpha=0.3)
    axes.legend()
    figure.savefig(path, dpi=120)


def main(argv: Sequence[str] | None = None) -> int:
    """Print the table; exit code 1 if a bar is missed."""
    parser = argparse.ArgumentParser(prog="python -m hil_tests.scaling_bench", description=__doc__)
    parser.add_argument("--plot", type=Path, metavar="FILE", help="draw the series, such as a.png")
    parser.add_argument("--json", action="store_true", help="print JSON on standard output")
    options = parser.parse_args(argv)
    found: list[Series] = []
    with tempfile.TemporaryDirectory() as folder:
        for part, measure in SERIES:
            found.append(measure(ready_copy(part), Path(folder)))
        ratio = two_cores(Path(folder))
    table = Table("series", "amount: processor time", "exponent", "bar", "met")
    for each in found:
        points = "; ".join(f"{amount:,.0f}: {took_s:.2f} s" for amount, took_s in each.points)
        met = "yes" if each.exponent <= EXPONENT_BAR else "no"
        table.add_row(each.name, points, f"{each.exponent:.2f}", f"≤ {EXPONENT_BAR:g}", met)
    met = "yes" if ratio >= CORES_BAR else "no"
    table.add_row(
        f"{CASES} cases, 2 cores against 1", f"{ratio:.2f} times", "", f"≥ {CORES_BAR:g}", met
    )
    Console(stderr=True).print(table)
    if options.plot is not None:
        draw(found, options.plot)
    if options.json:
        print(json.dumps({"series": [each._asdict() for each in found], "cores_ratio": ratio}))
    missed = ratio < CORES_BAR or any(each.exponent > EXPONENT_BAR for each in found)
    return EXIT_MISSED if missed else 0


if __name__ == "__main__":
    sys.exit(main())
