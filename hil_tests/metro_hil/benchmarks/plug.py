"""Measures controllers, plants and FMUs of one's own: time to a hop, speed, cost of a frame."""

import os
import shutil
import statistics
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Final

from can_dbc import c_source
from firmware_py.clock.clock import NS_PER_S, WallClock
from firmware_py.native.build import compiler
from metro_hil.benchmarks.bench import Figure, run_measures
from metro_hil.engine.journal import read_journal
from metro_hil.external_controller.project import HOST, project_files
from metro_hil.fmi_export.export import write_fmu
from metro_hil.model.native_copy import SWITCH, Native

PROJECT: Final = "mine"
PLANT: Final = Path(__file__).parents[3] / "docs/examples/plant/point_mass.py"
START_BAR_S: Final = 60.0
SPEED_BAR: Final = 150.0
SHARE_BAR_RATIO: Final = 0.9
FRAME_BAR_NS: Final = 150.0
FRAMES: Final = 5_000_000
NODE_BAR_RATIO: Final = 0.5
NODE_ROUNDS: Final = 3
ROUNDS: Final = 5
PROGRAM: Final = (
    *(sys.executable, "-c"),
    "import sys; from metro_hil.cli.entry import hil; sys.exit(hil())",
)
HOP: Final = """
title = "One station hop"
invariants = "none"
seeds = 6

[train]
start = "II"
end = "III"
duration_s = 600.0

[[monitor]]
name = "arrives"
measure = "arrived_count"
min = 1.0
"""
FRAME_PROGRAM: Final = """
#include <stdio.h>
#include <stdlib.h>
#include <time.h>
#include "wire.h"

int main(int count, char **words)
{
    const long frames = atol(words[count - 1]);
    static struct wire_sender sender;
    static struct wire_receiver receiver;
    struct VOBC_MOTION sent = {0}, received = {0};
    struct wire_frame frame[WIRE_FRAMES_MAX];
    struct timespec begin, end;
    double sum = 0.0;
    clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &begin);
    for (long at = 0; at < frames; at++) {
        sent.speed_mps = (double)(at % 4000) * 0.01;
        wire_send_VOBC_MOTION(&sender, &sent, frame);
        wire_receive_VOBC_MOTION(&receiver, frame, at * 100000000, &received);
        sum += received.speed_mps;
    }
    clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &end);
    printf("%.1f %.0f\\n", ((double)(end.tv_sec - begin.tv_sec) * 1e9 +
                           (double)(end.tv_nsec - begin.tv_nsec)) / (double)frames, sum);
    return 0;
}
"""
"""Sends and receives a protected frame with three numbers; prints the nanoseconds for both."""
NODE_PROGRAM: Final = """
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

int main(void)
{
    static char line[1 << 20];
    while (fgets(line, sizeof line, stdin)) {
        const char *now = strstr(line, "\\"now_ns\\":");
        long long now_ns = now ? atoll(now + 9) : 0;
        if (strstr(line, "\\"hello\\""))
            printf("{\\"type\\":\\"ready\\",\\"version\\":1,\\"next_wakeup_ns\\":100000000}\\n");
        else
            printf("{\\"type\\":\\"yield\\",\\"now_ns\\":%lld,\\"next_wakeup_ns\\":%lld,"
                   "\\"frames\\":[[1952,\\"00\\"]]}\\n", now_ns, now_ns + 100000000);
        fflush(stdout);
    }
    return 0;
}
"""
"""Sends a frame every 100 ms by the lockstep protocol."""
NODE_FILE: Final = '[[node]]\nfmu = "sender.fmu"\nreceives = [0x101]\n'


def time_to_first_hop() -> list[Figure]:
    """Measure `hil new-controller` and `make test`, with build and campaign."""
    with tempfile.TemporaryDirectory() as scratch:
        clock = WallClock()
        begin_ns = clock.now_ns()
        _hil(scratch, Native.WIRE, "new-controller", PROJECT)
        path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
        subprocess.run(
            ["make", "-s", "-C", f"{scratch}/{PROJECT}", "test"],
            check=True,
            capture_output=True,
            env={**os.environ, SWITCH: Native.WIRE.value, "PATH": path},
        )
        took_s = (clock.now_ns() - begin_ns) / NS_PER_S
    bar = f"≤ {START_BAR_S:.0f} s"
    name = "from `hil new-controller --lang c` to a passed hop"
    return [Figure(name, f"{took_s:.0f} s", bar, took_s <= START_BAR_S)]


def speed_in_lockstep() -> list[Figure]:
    """Measure processor time of hops: the shipped controller in the process, and one in C."""
    with tempfile.TemporaryDirectory() as scratch:
        program = _built(Path(scratch))
        (Path(scratch) / "hop.toml").write_text(HOP, encoding="utf-8")
        inside, outside = [], []
        for turn in range(ROUNDS):
            inside += _factors(scratch, f"inside{turn}")
            command = ("--controller", f"command:{program}")
            outside += _factors(scratch, f"outside{turn}", *command)
    ours, theirs = statistics.median(inside), statistics.median(outside)
    spread = f"({min(outside):.0f} to {max(outside):.0f})"
    share_ratio = theirs / ours
    return [
        Figure("shipped controller in the process, one hop", f"{ours:.0f} × real time", "", None),
        Figure(
            "controller in C in a process of its own, one hop",
            f"{theirs:.0f} × real time {spread}",
            f"≥ {SPEED_BAR:.0f} ×",
            theirs >= SPEED_BAR,
        ),
        Figure(
            "the latter by the former",
            f"{share_ratio * 100.0:.0f} %",
            f"≥ {SHARE_BAR_RATIO * 100.0:.0f} %",
            share_ratio >= SHARE_BAR_RATIO,
        ),
    ]


def speed_of_fmus() -> list[Figure]:
    """Measure processor time of two hops with an LS-BUS node, and with the train as an FMU.

    Controller and train run as Python, with codec, bus and logs in C.
    """
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        ride = HOP.replace('end = "III"', 'end = "IV"').replace("seeds = 6", "seeds = 1")
        (folder / "hop.toml").write_text(ride, encoding="utf-8")
        (folder / "sender.c").write_text(NODE_PROGRAM, encoding="utf-8")
        _compile(folder, ["sender.c"], "sender")
        write_fmu(folder / "sender.fmu", "sender", (str(folder / "sender"),), {})
        (folder / "bus.toml").write_text(NODE_FILE, encoding="utf-8")
        _hil(scratch, Native.WIRE, "export", "train", "--from", "II", "--to", "IV")
        plants = {"alone": "auto", "node": "nodes:bus.toml", "train": "fmu:train.toml"}
        found: dict[str, list[float]] = {name: [] for name in plants}
        for turn in range(NODE_ROUNDS):
            for name, plant in plants.items():
                found[name] += _factors(
                    scratch, f"{name}{turn}", "--plant", plant, native=Native.WIRE
                )
    alone = statistics.median(found["alone"])
    rows = {
        "node": "with an LS-BUS node on the bus of the train",
        "train": "with the train as an FMU",
    }
    figures = [
        Figure("shipped controller and train, two hops", f"{alone:.0f} × real time", "", None)
    ]
    for name, text in rows.items():
        factor = statistics.median(found[name])
        share = f"{factor:.0f} × real time, {factor / alone * 100.0:.0f} % of it"
        bar = f"≥ {NODE_BAR_RATIO * 100.0:.0f} %"
        figures.append(Figure(text, share, bar, factor >= NODE_BAR_RATIO * alone))
    return figures


def speed_as_firmware() -> list[Figure]:
    """Measure processor time of hops with the controller in C on an emulated Cortex-M3."""
    name = "controller in C as firmware on an emulated Cortex-M3, one hop"
    for tool in ("arm-none-eabi-gcc", "qemu-system-arm"):
        if shutil.which(tool) is None:
            return [Figure(name, f"not measured: there is no {tool}", "", None)]
    with tempfile.TemporaryDirectory() as scratch:
        folder = _written(Path(scratch), "c", "cortex-m")
        subprocess.run(["make", "-s", "-C", folder], check=True)
        (Path(scratch) / "hop.toml").write_text(HOP, encoding="utf-8")
        factors = _factors(
            scratch,
            "out",
            *("--limit", "2", "--controller", f"command:{folder / PROJECT}"),
            native=Native.WIRE,
        )
    return [Figure(name, f"{statistics.median(factors):.1f} × real time", "", None)]


def speed_of_a_plant() -> list[Figure]:
    """Measure processor time of hops with the shipped train, and with the documented plant."""
    with tempfile.TemporaryDirectory() as scratch:
        (Path(scratch) / "hop.toml").write_text(HOP, encoding="utf-8")
        plants = {"shipped train": "auto", "plant in Python": f"command:{sys.executable} {PLANT}"}
        factors = {
            name: statistics.median(
                _factors(scratch, name, "--limit", "3", "--plant", plant, native=Native.WIRE)
            )
            for name, plant in plants.items()
        }
    return [
        Figure(f"{name}, one hop", f"{factor:.0f} × real time", "", None)
        for name, factor in factors.items()
    ]


def cost_of_a_frame() -> list[Figure]:
    """Measure sending and receiving a protected frame in the generated C."""
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        for name, text in c_source.wire_files(c_source.shipped_bindings()).items():
            (folder / name).write_text(text, encoding="utf-8")
        (folder / "frames.c").write_text(FRAME_PROGRAM, encoding="utf-8")
        _compile(folder, ["frames.c", "wire.c"], "frames")
        runs_ns = []
        for _ in range(ROUNDS):
            done = subprocess.run(
                [folder / "frames", str(FRAMES)], check=True, capture_output=True, text=True
            )
            runs_ns.append(float(done.stdout.split()[0]))
    cost_ns = statistics.median(runs_ns)
    return [
        Figure(
            "generated C: encode and decode of a protected frame",
            f"{cost_ns:.0f} ns ({min(runs_ns):.0f} to {max(runs_ns):.0f})",
            f"≤ {FRAME_BAR_NS:.0f} ns",
            cost_ns <= FRAME_BAR_NS,
        )
    ]


def _written(folder: Path, lang: str, target: str = HOST) -> Path:
    """Write a project and return its folder."""
    for name, text in project_files(PROJECT, lang, target).items():
        (folder / PROJECT / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / PROJECT / name).write_text(text, encoding="utf-8")
    return folder / PROJECT


def _built(scratch: Path) -> Path:
    folder = _written(scratch, "c")
    _compile(folder, [path.name for path in folder.glob("*.c")], PROJECT)
    return folder / PROJECT


def _compile(folder: Path, sources: Sequence[str], program: str) -> None:
    command = compiler()
    if command is None:
        raise RuntimeError("no C compiler; install gcc or clang, or `pip install ziglang`")
    flags = ("-std=c99", "-D_POSIX_C_SOURCE=200809L", "-O2", "-ffp-contract=off")
    subprocess.run([*command, *flags, *sources, "-lm", "-o", program], cwd=folder, check=True)


def _factors(scratch: str, out: str, *words: str, native: Native = Native.WAIT) -> list[float]:
    """Run the hops, by default on the compiled bench; return simulated by processor time."""
    _hil(
        scratch,
        native,
        "run",
        "hop.toml",
        "--workers",
        "1",
        "--no-report",
        "--out",
        out,
        *words,
    )
    journal = read_journal(Path(scratch) / out / "journal.jsonl")
    return [result.sim_s / result.host.processor_s for result in journal.results]


def _hil(folder: str, native: Native, *words: str) -> None:
    subprocess.run(
        [*PROGRAM, *words],
        cwd=folder,
        check=True,
        capture_output=True,
        env={**os.environ, SWITCH: native.value},
    )


MEASURES: Final = {
    "start": time_to_first_hop,
    "lockstep": speed_in_lockstep,
    "frame": cost_of_a_frame,
    "fmus": speed_of_fmus,
    "firmware": speed_as_firmware,
    "plant": speed_of_a_plant,
}


def main(argv: Sequence[str] | None = None) -> int:
    """Print the table; exit code 1 if a bar is missed."""
    return run_measures(MEASURES, "python -m metro_hil.benchmarks.plug", str(__doc__), argv)


if __name__ == "__main__":
    sys.exit(main())
