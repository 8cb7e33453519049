"""Measures the pages of logs, of live runs and of campaigns. `make bench-page` prints it."""

import argparse
import resource
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Final

import numpy as np

from canlog.damage import LogError
from canlog.database import load_bus
from canlog.frames import Frames
from canlog.reader import Log, read
from canlog.views.page_data import page_data
from canlog.views.page_text import page_text
from canlog.views.traces import default_words
from firmware_py.assertions import require_assertions
from firmware_py.clock.clock import NS_PER_S, WallClock
from metro_tools.browser import Browser, browser_path
from metro_tools.live_bench import PARTS
from metro_tools.live_bench import report as report_live

LOGS: Final = "logs"
"""The part that measures the page of a log; all others are in `live_bench`."""
ROUNDS: Final = 3
MANY: Final = 1_000_000
MANY_ID: Final = 0x385
"""Identifier of IMU, which carries one noisy number."""
SMOOTH: Final = """new Promise(done => {
  const took = [];
  const step = at => {
    if (took.length === 60) { done(took.sort((a, b) => a - b)); return; }
    const whole = canlog.view.last - canlog.view.first;
    const from = canlog.view.first + whole * 0.004 * took.length;
    const before = performance.now();
    canlog.setSpan(from, from + whole * (0.9 - 0.014 * took.length), false);
    requestAnimationFrame(() => { took.push(performance.now() - before); step(); });
  };
  step();
})"""
"""Sixty steps of panning and zooming with all drawing; sorted durations in milliseconds."""


def main(argv: Sequence[str] | None = None) -> int:
    """Print the figures of a run folder, of a signal with a million frames, and of live pages."""
    require_assertions("page_bench")
    parser = argparse.ArgumentParser(prog="page_bench", description=__doc__)
    parser.add_argument(
        "run", nargs="?", type=Path, help="folder of a run; default: run a whole line first"
    )
    parser.add_argument("--only", nargs="+", choices=(LOGS, *PARTS), metavar="PART", default=None)
    parser.add_argument(
        "--minutes", type=float, default=1.0, help="duration of the live run; default: %(default)g"
    )
    given = parser.parse_args(argv)
    if browser_path() is None:
        print("page_bench: no browser is installed", file=sys.stderr)
        return 2
    parts = given.only or (LOGS, *PARTS)
    if LOGS in parts:
        try:
            _logs(given.run)
        except LogError as error:
            print(f"page_bench: {error}", file=sys.stderr)
            return 2
    report_live(parts, given.minutes)
    return 0


def _logs(given: Path | None) -> None:
    """Print the figures of the page of a log. Raises LogError."""
    with tempfile.TemporaryDirectory() as folder:
        run = given or _whole_line(Path(folder) / "line")
        _report(run, read(run), Path(folder) / "run.html", read_again=True)
        _report(run, _many(), Path(folder) / "many.html", read_again=False)


def _whole_line(folder: Path) -> Path:
    """Run eight minutes of the whole Florence line. Raises LogError."""
    words = ["vobc", "run", "--lockstep", "--out", str(folder)]
    program = Path(sys.executable).with_name(words[0])
    done = subprocess.run([program, *words[1:]], capture_output=True, check=False)  # noqa: S603
    if done.returncode != 0:
        raise LogError(f"{' '.join(words)}: {done.stderr.decode(errors='replace').strip()}")
    return folder


def _report(run: Path, log: Log, path: Path, *, read_again: bool) -> None:
    clock, best_s, best_cpu_s = WallClock(), float("inf"), float("inf")
    for _ in range(ROUNDS):
        begin_ns, cpu_s = clock.now_ns(), _cpu_s()
        source = read(run) if read_again else log
        words = default_words(source)
        text = page_text(page_data(source, path.stem, words, with_frames=True))
        path.write_text(text, encoding="utf-8")
        best_s = min(best_s, (clock.now_ns() - begin_ns) / NS_PER_S)
        best_cpu_s = min(best_cpu_s, _cpu_s() - cpu_s)
    size_mb = path.stat().st_size / 1e6
    what = "read and written" if read_again else "written"
    print(
        f"{len(log)} frames over {(log.end_ns - log.start_ns) / NS_PER_S:.0f} s, {what} in"
        f" {best_s:.2f} s ({best_cpu_s:.2f} s of processor time), {size_mb:.1f} MB"
    )
    shown = []
    for _ in range(ROUNDS):
        with Browser() as browser:
            browser.open(path.as_uri())
            # A busy browser may be ready before its first paint.
            browser.wait("performance.getEntriesByName('first-contentful-paint').length")
            shown.append(
                browser.run(
                    "['first-contentful-paint', 'drawn', 'ready']"
                    ".map(name => performance.getEntriesByName(name)[0].startTime)"
                )
            )
            took = browser.run(SMOOTH)
    paint, drawn, ready = np.median(np.array(shown), axis=0)
    print(
        f"  first paint after {paint:.0f} ms, plots after {drawn:.0f} ms, all after {ready:.0f} ms;"
        f" a step of the view {took[len(took) // 2]:.1f} ms, the worst of 60 {took[-1]:.1f} ms"
    )


def _cpu_s() -> float:
    used = resource.getrusage(resource.RUSAGE_SELF)
    return used.ru_utime + used.ru_stime


def _many() -> Log:
    """Create a million frames of one message, a millisecond apart, with a peak of one frame."""
    noise = np.random.default_rng(1)
    data = np.zeros((MANY, 8), np.uint8)
    data[:, :5] = noise.integers(0, 256, (MANY, 5), np.uint8)
    zeros = np.zeros(MANY, np.uint8)
    at_ns = np.arange(MANY, dtype=np.int64) * 1_000_000
    identifier = np.full(MANY, MANY_ID, np.uint32)
    frames = Frames(at_ns, identifier, zeros, zeros, np.full(MANY, 5, np.uint8), data, ("can0",))
    return Log(Path("many.log"), frames, load_bus())


if __name__ == "__main__":
    sys.exit(main())
