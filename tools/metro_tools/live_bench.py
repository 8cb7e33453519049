"""Measures the live page and the page of all campaigns, for `make bench-page`."""

import asyncio
import csv
import json
import os
import signal
import subprocess
import sys
import tempfile
from collections.abc import Callable, Collection, Mapping
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import Any, Final

import numpy as np
from websockets.asyncio.client import connect
from websockets.typing import Origin

from canlog.database import own_bus
from canlog.frames import Frames, blank
from canlog.live.feeds import News
from canlog.live.page import live_head
from canlog.live.server import LiveServer
from canlog.live.stream import History
from canlog.views.page_text import html_page
from canlog.views.place import LineFacts
from firmware_py.clock.clock import NS_PER_S, WallClock
from metro_hil.watch.campaigns import Shelf
from metro_tools.browser import Browser

MODULE: Final = "metro_tools.live_bench"
SERVE: Final = "serve"
FRAMES_PER_S: Final = 345
"""Frames per second on the train's bus."""
RUN_S: Final = 8.0
VIEWERS: Final = 5
PAINTS: Final = 4
PAINTED: Final = "performance.getEntriesByName('first-contentful-paint')[0]"
LATENESS_ROUNDS: Final = 3
LATENESS_RUN_S: Final = 20.0
PAST_S: Final = 3600.0
"""Time for which the train has sent when memory is first measured: server and page keep less."""
MEMORY_SAMPLES: Final = 30
CAMPAIGNS: Final = 200
CASES: Final = 1000
SCENARIOS: Final = 50
MONITORS: Final = 60
NOTED: Final = """new Promise(done => {
  const late = [], end = performance.now() + 6000;
  let seen = 0;
  const look = () => {
    const { source } = canlog.view, drawn = Number(document.documentElement.dataset.drawn);
    if (drawn !== seen && drawn) {
      seen = drawn;
      const zero = Number(BigInt(canlog.view.head.zero) / 1000n) / 1000;
      late.push(performance.timeOrigin + performance.now() - zero - source.t[drawn - 1] / 1e6);
    }
    if (performance.now() > end) done(late); else requestAnimationFrame(look);
  };
  look();
})"""
"""Milliseconds from the newest drawn frame's stamp to the picture after it was drawn."""


class SteadyTrain:
    """Gives the frames of a train that are due, each with the stamp of its instant."""

    def __init__(self, clock: WallClock, past_s: float = 0.0) -> None:
        """Args:
        past_s: time for which the train has sent frames already.
        """
        self._ids = sorted(key for key in own_bus().by_key if key < 1 << 11)
        self._last_ns = clock.epoch_ns() - round(past_s * NS_PER_S)
        self._count = 0

    def poll(self, now_ns: int) -> News:
        step_ns = NS_PER_S // FRAMES_PER_S
        due = max(0, (now_ns - self._last_ns) // step_ns)
        frames: Frames = blank(due, channels=("vcan0",))
        frames.at_ns[:] = self._last_ns + step_ns * np.arange(1, due + 1)
        numbers = np.arange(self._count, self._count + due)
        frames.identifier[:] = np.array(self._ids)[numbers % len(self._ids)]
        frames.length[:] = 8
        frames.data[:] = np.random.default_rng(self._count).integers(0, 256, (due, 8), np.uint8)
        self._last_ns += step_ns * due
        self._count += due
        return News(frames)

    def close(self) -> None:
        """There is nothing to close."""


class ServedPage:
    """The server in a process of its own, as beside a run."""

    def __init__(self, past_s: float = 0.0) -> None:
        self._past_s = past_s

    def __enter__(self) -> "ServedPage":
        self._process = subprocess.Popen(  # noqa: S603
            [sys.executable, "-m", MODULE, SERVE, str(self._past_s)],
            stdout=subprocess.PIPE,
            text=True,
        )
        assert self._process.stdout is not None
        self.address = self._process.stdout.readline().strip()
        return self

    def __exit__(self, *_: object) -> None:
        self._process.terminate()
        self._process.wait()
        assert self._process.stdout is not None
        self._process.stdout.close()

    def used_s(self) -> float:
        """Return the processor time of the server until now."""
        fields = Path(f"/proc/{self._process.pid}/stat").read_text().rpartition(")")[2].split()
        return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")

    def memory_mb(self) -> float:
        return resident_mb(self._process.pid)


def resident_mb(pid: int) -> float:
    """Return the resident memory of a process in megabytes."""
    pages = int(Path(f"/proc/{pid}/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6


def report(parts: Collection[str], minutes: float) -> None:
    """Print the figures of the live page and of `hil serve`.

    Args:
        parts: those of PARTS to measure.
        minutes: duration of the live run whose memory is measured.
    """
    for name, measure in PARTS.items():
        if name in parts:
            measure(minutes) if measure is _memory else measure()


def _cost() -> None:
    without_s = _cost_s(0)
    with_s = _cost_s(VIEWERS)
    share = (with_s - without_s) / VIEWERS / RUN_S
    print(
        f"  server without viewers {100 * without_s / RUN_S:.1f} % of a core; each of"
        f" {VIEWERS} viewers costs {100 * share:.1f} %"
    )


def _latency() -> None:
    with ServedPage() as page, Browser() as browser:
        paints_ms = []
        for _ in range(PAINTS):
            browser.call("Page.navigate", url=page.address)
            browser.wait(PAINTED)
            paints_ms.append(browser.run(f"{PAINTED}.startTime"))
        late = np.array(browser.run(NOTED))
    print(
        f"live page: first paint after {paints_ms[0]:.0f} ms in a browser that has just started,"
        f" {np.median(paints_ms[1:]):.0f} ms in one that runs; {FRAMES_PER_S} frames a second,"
        f" stamp to picture {np.percentile(late, 50):.0f} ms, p95 {np.percentile(late, 95):.0f} ms"
        f" ({len(late)} updates)"
    )


def _cost_s(viewers: int) -> float:
    """Return the processor time of the server with viewers that only read."""
    with ServedPage() as page:
        before_s = page.used_s()
        asyncio.run(_look(page.address, viewers, RUN_S))
        return page.used_s() - before_s


async def _look(address: str, viewers: int, duration_s: float) -> None:
    origin = Origin(address.rsplit("/", 2)[0])

    async def one() -> None:
        async with connect(address.replace("http", "ws") + "stream", origin=origin) as stream:
            async for _ in stream:
                pass

    looking = [asyncio.ensure_future(one()) for _ in range(viewers)]
    await asyncio.sleep(duration_s)
    for each in looking:
        each.cancel()
    await asyncio.gather(*looking, return_exceptions=True)


def _lateness() -> None:
    """Print how late cycles of the controller begin, with viewers and without, in turn."""
    found: dict[int, list[str]] = {0: [], VIEWERS: []}
    bus = f"page{os.getpid()}"
    with tempfile.TemporaryDirectory() as root, ExitStack() as stack:
        _vcan("up", bus)
        stack.callback(_vcan, "down", bus)
        for turn in range(LATENESS_ROUNDS):
            for viewers, texts in found.items():
                late_us, slips = _watched_run(Path(root) / f"{turn}-{viewers}", bus, viewers)
                p99_us, worst_us = np.percentile(late_us, 99), late_us.max()
                texts.append(f"{p99_us:.0f} (worst {worst_us:.0f}, {slips} slips)")
    for viewers, texts in found.items():
        print(f"controller's lateness p99 in µs with {viewers} viewers: {', '.join(texts)}")


def _vcan(verb: str, bus: str) -> None:
    program = Path(sys.executable).with_name("vcan")
    subprocess.run([program, verb, bus], capture_output=True, check=True)  # noqa: S603


def _watched_run(folder: Path, bus: str, viewers: int) -> "tuple[np.ndarray[Any, Any], int]":
    """Drive in real time with a page; return the lateness of all cycles, and the cycles lost."""
    program = Path(sys.executable).with_name("vobc")
    words = ["run", "--watch", "--from", "II", "--to", "III", "--duration", str(LATENESS_RUN_S)]
    run = subprocess.Popen(  # noqa: S603
        [program, *words, "--bus", f"embedded:{bus}", "--no-plot", "--out", folder],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        text=True,
    )
    assert run.stdout is not None
    address = next(line.split()[1] for line in run.stdout if line.startswith("page: http"))
    asyncio.run(_look(address, viewers, LATENESS_RUN_S))
    run.communicate()
    with (folder / "cycles.csv").open(newline="") as log:
        rows = list(csv.DictReader(log))
    late_us = np.array([float(row["lateness_us"]) for row in rows])
    return late_us, sum(int(row["slips"]) for row in rows)


def _memory(minutes: float) -> None:
    """Print the memory of server and page while frames come, after both have all that they keep."""
    with ServedPage(past_s=PAST_S) as page, Browser() as browser:
        browser.open(page.address)
        browser.wait("Number(document.documentElement.dataset.drawn) > 100000")
        browser.call("Performance.enable")
        clock, found = WallClock(), []
        begin_ns = clock.now_ns()
        for sample in range(1, MEMORY_SAMPLES + 1):
            clock.wait_until(begin_ns + round(minutes * 60 / MEMORY_SAMPLES * sample * NS_PER_S))
            browser.call("HeapProfiler.collectGarbage")
            told = {each["name"]: each["value"] for each in _metrics(browser)}
            found.append((page.memory_mb(), told["JSHeapUsedSize"] / 1e6, browser.memory_mb()))
    names = ("server", "script of the page", "browser")
    third = MEMORY_SAMPLES // 3
    texts = []
    for name, column in zip(names, np.array(found).T, strict=True):
        first, last = column[:third], column[-third:]
        texts.append(
            f"{name} {first.min():.0f} to {first.max():.0f} MB in the first third, "
            f"{last.min():.0f} to {last.max():.0f} MB in the last"
        )
    frames = round(minutes * 60 * FRAMES_PER_S)
    print(f"live run of {minutes:g} minutes, {frames} frames: {'; '.join(texts)}")


def _metrics(browser: Browser) -> list[dict[str, Any]]:
    metrics: list[dict[str, Any]] = browser.call("Performance.getMetrics")["metrics"]
    return metrics


def _campaigns() -> None:
    """Print the time to read many campaigns, whose cases stand in summaries only."""
    with tempfile.TemporaryDirectory() as root:
        for number in range(CAMPAIGNS):
            _campaign(Path(root) / f"{number:03d}", number)
        clock = WallClock()
        shelf = Shelf(Path(root))
        begin_ns = clock.now_ns()
        rows = shelf.look(clock.epoch_ns())
        first_s = (clock.now_ns() - begin_ns) / NS_PER_S
        begin_ns = clock.now_ns()
        shelf.look(clock.epoch_ns())
        again_s = (clock.now_ns() - begin_ns) / NS_PER_S
        shown_s = _opened_s(Path(root))
    cases = sum(row["done"] for row in rows)
    words = f"{len(rows)} campaigns with {cases} cases"
    print(
        f"hil serve: {words} read in {first_s:.2f} s, then {again_s:.2f} s; the page shows them"
        f" {shown_s:.2f} s after it is opened"
    )


def _opened_s(root: Path) -> float:
    """Return the time from opening the page of `hil serve` until it shows all campaigns."""
    program = Path(sys.executable).with_name("hil")
    process = subprocess.Popen(  # noqa: S603
        [program, "serve", root, "--no-browser"],
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
    )
    assert process.stdout is not None
    address = process.stdout.readline().split()[1]
    with Browser() as browser:
        browser.call("Page.navigate", url=address)
        shown_ms = browser.wait(
            "document.documentElement.dataset.ready"
            " && document.querySelectorAll('tbody tr').length && performance.now()"
        )
    process.send_signal(signal.SIGINT)
    process.communicate()
    return float(shown_ms) / 1e3


def _campaign(folder: Path, number: int) -> None:
    folder.mkdir()
    manifest = {
        "name": "bench",
        "fingerprint": f"{number:016x}",
        "cases": CASES,
        "cases_sha256": "",
        "started": f"2026-01-01T00:{number // 60:02d}:{number % 60:02d}Z",
        "program": "0",
        "versions": {},
    }
    totals = {"cases": CASES, "done": CASES, "as_expected": CASES, "counts": {"pass": CASES}}
    scenario = {"cases": CASES // SCENARIOS, "as_expected": CASES // SCENARIOS}
    least = {"margin": 1.0 + number, "case_id": "s/1", "at_s": 1.0}
    monitors = [
        {"name": f"m{each}", "unit": "m", "requirements": [], "failed": 0, "margin_least": least}
        for each in range(MONITORS)
    ]
    summary = {
        "campaign": {"name": "bench", "fingerprint": f"{number:016x}"},
        "passed": True,
        "totals": totals,
        "scenarios": {f"scenario {each}": scenario for each in range(SCENARIOS)},
        "monitors": monitors,
    }
    (folder / "campaign.json").write_text(json.dumps(manifest))
    (folder / "journal.jsonl").touch()
    (folder / "summary.json").write_text(json.dumps(summary, indent=1))


PARTS: Final[Mapping[str, Callable[..., None]]] = {
    "latency": _latency,
    "cost": _cost,
    "lateness": _lateness,
    "campaigns": _campaigns,
    "memory": _memory,
}


def _serve(past_s: float) -> None:
    clock, bus = WallClock(), own_bus()
    history = History(bus)
    text = html_page(live_head(bus, "bench", LineFacts()) | {"messages": history.heads})
    feed = SteadyTrain(clock, past_s)
    server = LiveServer(feed, history, lambda: text, now_ns=clock.epoch_ns)
    print(server.address, flush=True)
    with suppress(KeyboardInterrupt):
        asyncio.run(server.run())


if __name__ == "__main__" and sys.argv[1:2] == [SERVE]:
    _serve(float(sys.argv[2]))
