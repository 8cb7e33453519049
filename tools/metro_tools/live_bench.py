"""Measures the live page and the page of all campaigns, for `make bench-page`."""

import asyncio
import json
import os
import subprocess
import sys
import tempfile
from contextlib import suppress
from pathlib import Path
from typing import Final

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

    def __init__(self, clock: WallClock) -> None:
        self._ids = sorted(key for key in own_bus().by_key if key < 1 << 11)
        self._last_ns = clock.epoch_ns()
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

    def __enter__(self) -> "ServedPage":
        self._process = subprocess.Popen(  # noqa: S603
            [sys.executable, "-m", MODULE, SERVE], stdout=subprocess.PIPE, text=True
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


def report() -> None:
    """Print the figures of the live page and of `hil serve`."""
    _latency()
    without_s = _cost_s(0)
    with_s = _cost_s(VIEWERS)
    share = (with_s - without_s) / VIEWERS / RUN_S
    print(
        f"  server without viewers {100 * without_s / RUN_S:.1f} % of a core; each of"
        f" {VIEWERS} viewers costs {100 * share:.1f} %"
    )
    _campaigns()


def _latency() -> None:
    with ServedPage() as page, Browser() as browser:
        browser.open(page.address)
        browser.wait("performance.getEntriesByName('first-contentful-paint').length")
        paint = browser.run("performance.getEntriesByName('first-contentful-paint')[0].startTime")
        late = np.array(browser.run(NOTED))
    print(
        f"live page: first paint after {paint:.0f} ms; {FRAMES_PER_S} frames a second, stamp to"
        f" picture {np.percentile(late, 50):.0f} ms, p95 {np.percentile(late, 95):.0f} ms"
        f" ({len(late)} updates)"
    )


def _cost_s(viewers: int) -> float:
    """Return the processor time of the server with viewers that only read."""
    with ServedPage() as page:
        before_s = page.used_s()
        asyncio.run(_look(page.address, viewers))
        return page.used_s() - before_s


async def _look(address: str, viewers: int) -> None:
    origin = Origin(address.rsplit("/", 2)[0])

    async def one() -> None:
        async with connect(address.replace("http", "ws") + "stream", origin=origin) as stream:
            async for _ in stream:
                pass

    looking = [asyncio.ensure_future(one()) for _ in range(viewers)]
    await asyncio.sleep(RUN_S)
    for each in looking:
        each.cancel()
    await asyncio.gather(*looking, return_exceptions=True)


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
    cases = sum(row["done"] for row in rows)
    words = f"{len(rows)} campaigns with {cases} cases"
    print(f"hil serve: {words} in {first_s:.2f} s, then {again_s:.2f} s")


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


def _serve() -> None:
    clock, bus = WallClock(), own_bus()
    history = History(bus)
    text = html_page(live_head(bus, "bench", LineFacts()) | {"messages": history.heads})
    feed = SteadyTrain(clock)
    server = LiveServer(feed, history, lambda: text, now_ns=clock.epoch_ns)
    print(server.address, flush=True)
    with suppress(KeyboardInterrupt):
        asyncio.run(server.run())


if __name__ == "__main__" and sys.argv[1:] == [SERVE]:
    _serve()
