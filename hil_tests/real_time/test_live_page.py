"""The live page in a real browser: it decodes what comes, pauses, forgets, becomes the report."""

import json
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any, Final

import numpy as np
import pytest

from canlog.database import own_bus
from canlog.frames import Frames
from canlog.live.feeds import News
from canlog.live.page import live_head, serve_folder
from canlog.live.server import LiveServer
from canlog.live.stream import History
from canlog.reader import Log
from canlog.views.page_text import html_page
from canlog.views.place import LineFacts
from canlog.views.traces import trace_names, trace_of
from hil_tests.serving_rig import served
from hil_tests.unit.canlog import canlog_rig as rig
from metro_hil.cli.vobc import main as vobc
from metro_hil.watch.fault_acts import open_fault_acts
from metro_tools.browser import Browser, BrowserError
from plant_emulator.cli.by_hand import FAULT_ACTS, FAULT_RECORD

FRAMES: Final = 2_000
DRAWN: Final = "Number(document.documentElement.dataset.drawn)"
VIEWS: Final = ("drive", "journey", "overview", "panels", "dock", "follow")


class Script:
    """A feed that gives what the test hands it."""

    def __init__(self) -> None:
        self.waiting: list[News] = []

    def poll(self, now_ns: int) -> News:
        return self.waiting.pop(0) if self.waiting else News(rig.random_frames(1)[:0])

    def close(self) -> None:
        self.waiting.clear()


def pieces(frames: Frames, size: int) -> list[News]:
    return [News(frames[at : at + size]) for at in range(0, len(frames), size)]


def numbers(browser: Browser, script: str) -> "np.ndarray[Any, Any]":
    told = browser.run(
        f"JSON.stringify([...({script})].map(v => Number.isFinite(v) ? v : `${{v}}`))"
    )
    return np.array([float(each) for each in json.loads(told)])


def test_the_live_page_decodes_pauses_and_forgets(browser: Browser) -> None:
    frames, bus, feed = rig.random_frames(FRAMES), rig.bus(), Script()
    history = History(bus)
    head = live_head(bus, "made up", LineFacts(), ["PLAIN.signed_mps,PLAIN.state"])
    text = html_page(head | {"messages": history.heads, "eventsOnBus": False})
    server = LiveServer(feed, history, lambda: text, now_ns=lambda: 0)
    log = Log(Path("made_up.log"), frames, bus)
    with served(server) as address:
        feed.waiting += pieces(frames[: FRAMES // 2], 500)
        browser.open(address)
        browser.wait(f"{DRAWN} === {FRAMES // 2}")
        half = browser.run("canlog.view.to")
        feed.waiting += pieces(frames[FRAMES // 2 :], 500)
        browser.wait(f"{DRAWN} === {FRAMES}")

        for name in trace_names(log):
            trace = trace_of(log, name)
            shown = f"canlog.view.source.trace(canlog.view.byFull.get('{name}'))"
            np.testing.assert_array_equal(numbers(browser, f"{shown}.t"), trace.at_ns)
            np.testing.assert_array_equal(
                numbers(browser, f"{shown}.v"), trace.values, err_msg=name
            )
        followed = browser.run("canlog.view.to")

        browser.key(" ")
        browser.run("canlog.live.most = 2200")
        feed.waiting += pieces(rig.random_frames(FRAMES + 500)[FRAMES:], 500)
        browser.wait(f"{DRAWN} === {(FRAMES + 500) // 2}")
        paused = browser.run("canlog.view.to")
        kept = numbers(browser, "canlog.view.source.t")
        browser.key(" ")
        browser.wait("canlog.view.to === canlog.view.last")

        assert half < followed == paused
        assert kept.tolist() == rig.random_frames(FRAMES + 500).at_ns[-1250:].tolist()
        assert not browser.log


def test_a_run_becomes_its_report_at_the_same_address(
    browser: Browser, tmp_path: Path, shown_at: Callable[[int, str], None]
) -> None:
    whole, grows = tmp_path / "whole", tmp_path / "grows"
    words = ["run", "--lockstep", "--from", "II", "--to", "III", "--duration", "20", "--no-plot"]
    assert vobc([*words, "--out", str(whole)]) == 0
    lines = (whole / "bus.log").read_text().splitlines(keepends=True)
    grows.mkdir()
    for name in ("run.toml", "events.jsonl"):
        (grows / name).write_bytes((whole / name).read_bytes())
    (grows / "bus.log").write_text("".join(lines[:-100]))
    with served(serve_folder(grows, host="127.0.0.1", port=0)) as address:
        for width in (320, 1600):
            shown_at(width, address)
            browser.wait(f"{DRAWN} === {len(lines) - 100}")
            browser.wait("!document.getElementById('journey').hidden")
            assert browser.run("document.documentElement.scrollWidth") == width
            for view in VIEWS:
                left, _, size, height = browser.box(f"#{view}")
                assert left >= 0
                assert left + size <= width
                assert min(size, height) > 15, view
        speed_kmh = float(browser.run("canlog.view.drive.speed")) * 3.6
        front_m = float(browser.run("canlog.view.drive.front"))
        (grows / "bus.log").write_text("".join(lines))
        (grows / "results.json").write_text("{}")
        report = "canlog.view.head.live === undefined && document.documentElement.dataset.ready"
        with suppress(BrowserError):
            # The page loads itself again while the browser evaluates this.
            browser.wait(report)
        browser.wait(report)

        assert 20.0 < speed_kmh < 60.0
        assert 3000.0 < front_m < 3100.0
        assert browser.run("canlog.view.source.count") == len(lines)
        assert "authorised" in browser.text("#drive dl")
        assert not browser.log


@pytest.fixture
def shown_at(browser: Browser) -> Iterator[Callable[[int, str], None]]:
    """Opens an address in a window of a width."""

    def resized(width: int) -> None:
        browser.call(
            "Emulation.setDeviceMetricsOverride",
            width=width,
            height=900,
            deviceScaleFactor=1,
            mobile=False,
        )

    def show(width: int, address: str) -> None:
        resized(width)
        browser.open(address)

    yield show
    resized(1440)


def test_a_bus_without_the_project_s_messages_has_no_driver_s_view() -> None:
    known = live_head(own_bus(), "can0", LineFacts())["journey"]

    assert known is not None
    assert live_head(rig.bus(), "can0", LineFacts())["journey"] is None


def test_a_viewer_starts_sets_and_stops_faults_by_keyboard(
    browser: Browser, tmp_path: Path, shown_at: Callable[[int, str], None]
) -> None:
    (tmp_path / "run.toml").write_text('[options]\nconsist = "florence4"\nlockstep = false\n')
    (tmp_path / "bus.log").write_text("(0000000001.000000) vcan0 0A0#0102\n")
    record, acts = tmp_path / FAULT_RECORD, tmp_path / FAULT_ACTS
    server = serve_folder(tmp_path, faults=open_fault_acts(tmp_path), host="127.0.0.1", port=0)
    entry = "[...document.querySelectorAll('#fault-kinds details')].find(each => !each.hidden)"
    with served(server) as address:
        for width in (320, 1600):
            shown_at(width, address)
            browser.wait("!document.getElementById('tab-faults').hidden")
            assert browser.run("document.documentElement.scrollWidth") == width
        assert "frame_drop" in browser.text("#fault-kinds")
        assert "Not in real time" in browser.run(f"{entry}.textContent")
        browser.key("1")
        assert browser.run("document.getElementById('tab-faults').hidden")
        browser.key("5")
        browser.run("document.getElementById('take').click()")
        browser.wait("canlog.live.holder === 'you'")
        browser.run("document.getElementById('fault-search').focus()")
        browser.type("brake gives share")
        browser.run(f"{entry}.querySelector('summary').focus()")
        browser.key("Enter")
        browser.wait(f"{entry}.open")
        assert "gain_ratio" in browser.run(f"{entry}.textContent")
        browser.run(f"{entry}.querySelector('input').focus()")
        browser.run("document.activeElement.select()")
        browser.type("0.3")
        browser.key("Enter")
        browser.wait("canlog.live.socket.bufferedAmount === 0")
        record.write_text('fault = [{ kind = "brake_weak", start_s = 1.5, gain_ratio = 0.3 }]')
        browser.wait("document.getElementById('faults-count').textContent === '1 active'")
        assert "since 1.50 s" in browser.text("#faults-begun")
        browser.run("document.querySelector('#faults-begun .stop').focus()")
        browser.key("Enter")
        browser.wait("canlog.live.socket.bufferedAmount === 0")
        record.write_text(
            'fault = [{ kind = "brake_weak", start_s = 1.5, end_s = 2.0, gain_ratio = 0.3 }]'
        )
        browser.wait("document.getElementById('faults-count').textContent === ''")

        assert "from 1.50 s to 2.00 s" in browser.text("#faults-begun")
        told = browser.run("JSON.stringify(canlog.view.head.events.map(e => [e.t / 1e9, e.words]))")
        assert json.loads(told) == [
            [1.5, "brake_weak begins by hand"],
            [2.0, "brake_weak ends by hand"],
        ]
        assert not browser.log
    assert [json.loads(line) for line in acts.read_text().splitlines()] == [
        {"start": {"kind": "brake_weak", "gain_ratio": 0.3}},
        {"stop": 0},
    ]
