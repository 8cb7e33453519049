"""`make bench-logs`: canlog against python-can + cantools, asammdf and hilspy on one log.

Each figure is frames per second of processor time, from the file to the physical values of all
signals. It is the best of a few runs. Machines differ, so the required figures are ratios.
"""

import argparse
import contextlib
import io
import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import cantools.database
from rich.console import Console
from rich.table import Table

from canlog import Bus, ReadOptions, kernel, load_bus, read
from canlog.transport.reassembly import Reassembler
from hil_tests.log_benchmarks import peers, traffic

FORMS = ("candump", "blf", "asc", "trc", "mf4")
PLAIN = "mf4, not compressed"
TEXT_BAR = 2.5
ASAMMDF_BAR = 3.0
TRANSPORT_BAR = 1.0
TRANSPORT_MESSAGES = 40_000
START_BAR_S = 0.35
START_MESSAGES = 331
PEER_FRAMES = 40_000
ROUNDS, ROUNDS_MAX, ROUNDS_S = 3, 15, 4.0
LONG_TIMES = 5
LONG_BAR_S, MEMORY_BAR_MB = 10.0, 150.0
PEER_BAR = 50.0
HILSPY_BARS = {"candump": 10.0, "blf": 10.0, "asc": 5.0}
MILLION = 1e6
MEASURED = """
import re, sys, time
from pathlib import Path
from canlog.command import main
main(sys.argv[1:])
# Peak memory of this program alone: getrusage also counts the process that forked it.
most_kb = int(re.search(r"VmHWM:\\s+(\\d+)", Path("/proc/self/status").read_text())[1])
print(time.process_time(), most_kb / 1024, file=sys.stderr)
"""


def canlog(path: Path, bus: Bus, **options: Any) -> int:
    """Read every signal of every message. The DBC file is loaded before."""
    log = read(path, bus, ReadOptions(**options))
    for name in log.messages:
        table = log.table(name)
        for signal in table.names:
            assert len(table[signal]) == len(table)
    assert {each.kind for each in log.warnings} <= {"local time"}
    return len(log)


def rate(work: Callable[[], int]) -> float:
    """Millions of frames per second of processor time of this process and its threads.

    It is the best of the runs that fit into a few seconds, because short runs are disturbed more.
    """
    best, rounds, spent_s = 0.0, 0, 0.0
    while rounds < ROUNDS or (spent_s < ROUNDS_S and rounds < ROUNDS_MAX):
        began_s = time.process_time()
        frames = work()
        took_s = time.process_time() - began_s
        best = max(best, frames / took_s / MILLION)
        rounds, spent_s = rounds + 1, spent_s + took_s
    return best


def reading(folder: Path, count: int) -> list[tuple[str, float, str, bool | None]]:
    """Reading speeds with their required ratios, and whether they are met."""
    paths, dbc = traffic.write_logs(folder, count, FORMS), folder / "bench.dbc"
    bus, database = load_bus(dbc), cantools.database.load_file(dbc)
    rows: list[tuple[str, float, str, bool | None]] = []
    usual, rival, ours = dict[str, float](), dict[str, float](), dict[str, float]()
    asammdf = dict[str, float]()
    for form, path in paths.items():
        usual[form] = rate(partial(peers.python_can_and_cantools, path, database, PEER_FRAMES))
        rows.append((f"{form}: python-can + cantools", usual[form], "", None))
        if form in peers.HILSPY_FORMS:
            rival[form] = rate(partial(peers.hilspy_channel, path, dbc, 5 * PEER_FRAMES))
            rows.append((f"{form}: hilspy", rival[form], "", None))
    paths[PLAIN] = peers.without_compression(paths["mf4"])
    for form in ("mf4", PLAIN):
        asammdf[form] = rate(partial(peers.asammdf_extract, paths[form], dbc, 0))
        rows.append((f"{form}: asammdf extract", asammdf[form], "", None))
    has_kernel = kernel.library() is not None
    ways: list[tuple[str, str, dict[str, Any], float | None]] = [
        ("candump", "canlog", {}, 6.0 if has_kernel else None),
        ("candump", "canlog, numpy alone", {"compiled": False}, None),
        ("blf", "canlog, libdeflate", {"inflater": "libdeflate"}, 8.0),
        ("blf", "canlog, isal", {"inflater": "isal"}, None),
        ("blf", "canlog, zlib", {"inflater": "zlib"}, 5.0),
        ("asc", "canlog", {}, TEXT_BAR if has_kernel else None),
        ("trc", "canlog", {}, TEXT_BAR if has_kernel else None),
        ("mf4", "canlog", {}, 3.0),
        (PLAIN, "canlog", {}, 3.0),
    ]
    for form, name, options, bar in ways:
        found = rate(partial(canlog, paths[form], bus, **options))
        ours[form] = max(found, ours.get(form, 0.0))
        met = None if bar is None else found >= bar
        rows.append((f"{form}: {name}", found, "" if bar is None else f">= {bar:g} M/s", met))
    for form, found in asammdf.items():
        ratio = ours[form] / found
        met = ratio >= ASAMMDF_BAR
        rows.append((f"{form}: canlog / asammdf", ratio, f">= {ASAMMDF_BAR:g} x", met))
    for form in ("candump", "blf", "mf4"):
        ratio = ours[form] / usual[form]
        met = ratio >= PEER_BAR
        rows.append((f"{form}: canlog / python-can + cantools", ratio, f">= {PEER_BAR:g} x", met))
    for form, found in rival.items():
        ratio, bar = ours[form] / found, HILSPY_BARS[form]
        rows.append((f"{form}: canlog / hilspy", ratio, f">= {bar:g} x", ratio >= bar))
    return rows


def transport() -> list[tuple[str, float, str, bool | None]]:
    """Measure a log that contains only J1939 transport and ISO-TP, reassembled block by block."""
    frames = traffic.transport_frames(TRANSPORT_MESSAGES)

    def work() -> int:
        reassembler = Reassembler()
        found = reassembler.feed(frames) + reassembler.finish()
        assert sum(map(len, found)) == TRANSPORT_MESSAGES
        return len(frames)

    found = rate(work)
    bar = f">= {TRANSPORT_BAR:g} M/s"
    return [("transport: canlog", found, bar, found >= TRANSPORT_BAR)]


def start_of(folder: Path) -> list[tuple[str, float, str, bool | None]]:
    """Measure `canlog show` of ten lines in its own process, and take the best of a few runs."""
    dbc = folder / "many.dbc"
    dbc.write_text(traffic.many_messages(START_MESSAGES))
    words = ["show", str(folder / "bench.log"), "--dbc", str(dbc), "--limit", "10", "--no-pager"]
    runs = [
        subprocess.run(
            [sys.executable, "-c", MEASURED, *words], capture_output=True, text=True, check=True
        )
        for _ in range(ROUNDS)
    ]
    best_s = min(float(run.stderr.split()[-2]) for run in runs)
    name = f"show of 10 lines, DBC of {START_MESSAGES} messages: processor s"
    return [(name, best_s, f"<= {START_BAR_S:g} s", best_s <= START_BAR_S)]


def whole_logs(folder: Path, count: int) -> list[tuple[str, float, str, bool | None]]:
    """Measure `canlog stats` and `extract`, each in its own process, on logs of all formats.

    The candump log is `LONG_TIMES` times as long.
    """
    path, one = folder / "long.log", folder / "bench.log"
    with path.open("wb") as out:
        for _ in range(LONG_TIMES):
            out.write(one.read_bytes())
    rows: list[tuple[str, float, str, bool | None]] = []
    for log, frames in (
        (path, LONG_TIMES * count),
        *((folder / name, count) for name in ("bench.blf", "bench.mf4")),
    ):
        for verb, more in (("stats", ["--as", "json"]), ("extract", ["-o", str(folder / "out")])):
            words = [verb, str(log), "--dbc", str(folder / "bench.dbc"), *more]
            done = subprocess.run(
                [sys.executable, "-c", MEASURED, *words], capture_output=True, text=True, check=True
            )
            if verb == "stats":
                told = json.loads(done.stdout)
                assert sum(bus["bus_frames"] for bus in told["buses"]) == frames
            cpu_s, most_mb = (float(word) for word in done.stderr.split()[-2:])
            name = f"{verb} of {frames / MILLION:g} M frames, {log.suffix}"
            rows += [
                (f"{name}: processor s", cpu_s, f"< {LONG_BAR_S:g} s", cpu_s < LONG_BAR_S),
                (f"{name}: MB", most_mb, f"< {MEMORY_BAR_MB:g} MB", most_mb < MEMORY_BAR_MB),
            ]
    return rows


def main() -> int:
    parser = argparse.ArgumentParser(prog="make bench-logs", description=__doc__)
    parser.add_argument("--frames", type=int, default=2_000_000)
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as scratch, contextlib.redirect_stderr(io.StringIO()):
        rows = reading(Path(scratch), given.frames)
        rows += transport() + start_of(Path(scratch))
        rows += whole_logs(Path(scratch), given.frames)
    table = Table("figure", "value", "bar", "met", title=f"{given.frames:,} frames, 79 signals")
    for name, value, bar, met in rows:
        table.add_row(name, f"{value:.3g}", bar, {True: "yes", False: "NO", None: ""}[met])
    Console().print(table)
    return int(any(met is False for *_, met in rows))


if __name__ == "__main__":
    sys.exit(main())
