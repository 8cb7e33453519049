"""The page of a log in a real browser: what it decodes, plots and follows."""

import json
import shutil
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final
from urllib.request import Request, urlopen

import numpy as np
import pytest

from canlog import read
from canlog.bit_activity import ActivityView
from canlog.command import main as canlog
from canlog.database import parse_bus
from canlog.reader import Log
from canlog.views.answers import Answers
from canlog.views.packed import ordered
from canlog.views.page_data import PageData, page_data
from canlog.views.page_text import page_text
from canlog.views.row_filter import Subject, passing
from canlog.views.server import LogServer
from canlog.views.traces import trace_names, trace_of
from hil_tests.unit.canlog import canlog_rig as rig
from metro_hil.cli.vobc import main as vobc
from metro_tools.browser import Browser

HERE: Final = Path(__file__)
FRAMES: Final = 20_000
FILTERS: Final = (
    "",
    "PLAIN",
    "wide",
    "W*D",
    "-WIDE",
    "@TCMS",
    "0x101",
    "00000501",
    "signed_mps>10.05",
    "PLAIN.motorola<=250 signed_mps<0",
    "state=RUNNING",
    "-state!=OFF",
    "always>=128",
    "second<0",
    "-always>1 CHOSEN",
)


@pytest.fixture(scope="module")
def run_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of one hop in virtual time, with events and truth."""
    folder = tmp_path_factory.mktemp("page") / "hop"
    assert vobc(["run", "--lockstep", "--from", "II", "--to", "III", "--out", str(folder)]) == 0
    return folder


@pytest.fixture(scope="module")
def run_page(run_folder: Path) -> str:
    path = run_folder.with_suffix(".html")
    assert canlog(["report", str(run_folder), "-o", str(path)]) == 0
    return path.as_uri()


@pytest.fixture(scope="module")
def everything() -> Log:
    """Random frames of messages with every feature of a DBC file, partly out of order."""
    frames = rig.random_frames(FRAMES)
    frames.at_ns[100:120] = frames.at_ns[100:120][::-1].copy()
    return Log(Path("everything.log"), frames, rig.bus())


@pytest.fixture(scope="module")
def served(everything: Log) -> Iterator[tuple[str, PageData]]:
    data = page_data(everything, "everything", ["PLAIN.signed_mps,PLAIN.state"], with_frames=False)
    with LogServer(0, page_text(data), Answers(everything, data)) as server:
        thread = threading.Thread(target=server.serve_forever, daemon=True)
        thread.start()
        yield server.address, data
        server.shutdown()
        thread.join()


@pytest.fixture(scope="module")
def whole_page(everything: Log, tmp_path_factory: pytest.TempPathFactory) -> str:
    data = page_data(everything, "everything", ["PLAIN.signed_mps,PLAIN.state"], with_frames=True)
    path = tmp_path_factory.mktemp("page") / "everything.html"
    path.write_text(page_text(data), encoding="utf-8")
    return path.as_uri()


def numbers(browser: Browser, script: str) -> "np.ndarray[Any, Any]":
    """An array of the page; JSON has no NaN or infinity, so those come as strings."""
    plain = "v => Number.isFinite(v) ? v : String(v)"
    told = browser.run(f"JSON.stringify([...({script})].map({plain}))")
    return np.array([float(each) for each in json.loads(told)])


def test_the_page_decodes_every_signal_like_the_reader(
    browser: Browser, whole_page: str, everything: Log
) -> None:
    browser.open(whole_page)
    zero_ns = int(browser.run("canlog.view.head.zero"))

    for name in trace_names(everything):
        trace = trace_of(everything, name)
        shown = f"canlog.view.source.trace(canlog.view.byFull.get('{name}'))"
        np.testing.assert_array_equal(numbers(browser, f"{shown}.t"), trace.at_ns - zero_ns)
        np.testing.assert_array_equal(numbers(browser, f"{shown}.v"), trace.values, err_msg=name)


def test_the_table_shows_all_64_bits_of_integers(
    browser: Browser, whole_page: str, everything: Log
) -> None:
    browser.open(whole_page)

    for name in ("WIDE", "WIDE_SIGNED", "ODD"):
        table = everything.table(name)
        signal = table.names[0]
        told = browser.run(
            f"""(source => JSON.stringify(source.rows(source.select("{name}"), 0, 300)
              .filter(row => row.flags === 0 && row.message.name === "{name}")
              .map(row => [row.t, canlog.decodedTexts(row.message, row.data)[0]?.[1]])))
              (canlog.view.source)"""
        )
        exact = {
            int(at): str(value)
            for at, value, valid in zip(
                table.at_ns, table[signal].tolist(), table.valid(signal), strict=True
            )
            if valid
        }
        zero_ns = int(browser.run("canlog.view.head.zero"))
        shown = {int(t) + zero_ns: text for t, text in json.loads(told)}
        compared = [at for at in shown if at in exact]
        assert len(compared) > 100
        assert all(shown[at] == exact[at] for at in compared)


@pytest.mark.parametrize("text", FILTERS)
def test_page_and_server_filter_identically(
    browser: Browser, whole_page: str, served: tuple[str, PageData], everything: Log, text: str
) -> None:
    if browser.run("location.href").split("#")[0] != whole_page:
        browser.open(whole_page)
    data = served[1]
    heads, specs = data.head["messages"], everything.bus.by_key
    subjects = [
        Subject(group, head["name"], specs.get(group.key) if head["known"] else None)
        for group, head in zip(data.log.groups, heads, strict=True)
    ]

    rows = passing(everything, data.log, subjects, text)

    shown = browser.run(
        f"(found => JSON.stringify(found.rows ? [...found.rows] : null))"
        f"(canlog.view.source.select({json.dumps(text)}))"
    )
    if rows is None:
        assert json.loads(shown) is None
    else:
        assert json.loads(shown) == rows.tolist()
        assert 0 < len(rows) < FRAMES


def test_a_served_log_shows_the_same_windows_values_and_rows(
    browser: Browser, whole_page: str, served: tuple[str, PageData]
) -> None:
    asked = """(async source => {
      const view = canlog.view, out = [];
      for (const name of ["PLAIN.signed_mps", "CHOSEN.second", "FLOATS.single"]) {
        const spans = [[0, 2e10, 50], [4.1e9, 4.4e9, 300], [1.23e10, 1.29e10, 7]];
        for (const [from, to, columns] of spans) {
          const got = await source.window(view.byFull.get(name), from, to, columns);
          const seen = [...got.v].filter((v, i) => got.t[i] >= from && got.t[i] <= to);
          out.push([Math.min(...seen), Math.max(...seen)].map(String));
        }
      }
      out.push((await source.values([...view.signals], 7.5e9)).map(String));
      const selection = await source.select("PLAIN state=RUNNING");
      out.push(selection.count, await source.rowAt(selection, 9.87e9));
      for (const row of await source.rows(selection, 195, 12)) {
        const before = row.before && [...row.before];
        out.push([row.row, row.t, row.message.name, row.length, [...row.data], before]);
        out.push([String(row.gap), row.verdict, row.flags, row.channel]);
      }
      return JSON.stringify(out);
    })(canlog.view.source)"""

    browser.open(whole_page)
    of_file = json.loads(browser.run(asked))
    browser.open(served[0])
    of_server = json.loads(browser.run(asked))

    assert of_server[9:] == of_file[9:]
    assert all(np.isfinite([float(each) for each in pair]).all() for pair in of_file[:6])
    assert browser.log == []


def test_the_page_opens_alone_and_makes_no_request(browser: Browser, run_page: str) -> None:
    browser.asked.clear()

    browser.open(run_page)

    assert browser.run("document.documentElement.dataset.ready") == "yes"
    assert [each for each in browser.asked if not each.startswith(("data:", "file:"))] == []
    assert browser.log == []
    assert browser.run("document.querySelector('#journey').hidden") is False
    assert "frames" in browser.text("#facts")
    assert browser.run("document.querySelectorAll('#tab-events tbody tr').length") > 20
    assert browser.run("document.querySelectorAll('#tab-stats tbody tr').length") == 37


def coloured_pixels(browser: Browser) -> int:
    """The number of pixels of the first plot in the colour of its first line."""
    return int(
        browser.run(
            """(() => {
              const canvas = document.querySelector('#panels canvas');
              const chip = document.querySelector('#panels .chip i');
              const {data} = canvas.getContext('2d')
                .getImageData(0, 0, canvas.width, canvas.height);
              const wanted = getComputedStyle(chip).backgroundColor.match(/\\d+/g).map(Number);
              let count = 0;
              for (let i = 0; i < data.length; i += 4) {
                const away = [0, 1, 2].map(k => Math.abs(data[i + k] - wanted[k]));
                if (away[0] + away[1] + away[2] < 60) count++;
              }
              return count;
            })()"""
        )
    )


def margin(browser: Browser) -> float:
    """Left margin of the plots, which holds axes and band names."""
    style = "getComputedStyle(document.documentElement).getPropertyValue('--left')"
    return float(browser.run(f"parseFloat({style})"))


def test_band_names_are_shown_in_full(browser: Browser, run_page: str) -> None:
    browser.open(run_page)

    names = browser.run("canlog.view.panels.flat().map(name => name.split('.')[1])")
    widths = browser.run(
        """(() => {
          const context = document.querySelector('#panels canvas').getContext('2d');
          return canlog.view.panels.flat().filter(name => canlog.view.byFull.get(name).state)
            .map(name => context.measureText(name.split('.')[1]).width);
        })()"""
    )

    assert {"supervision", "ato_phase"} <= set(names)
    assert widths
    assert max(widths) + 10 <= margin(browser)


def span_s(browser: Browser) -> tuple[float, float]:
    return browser.run("canlog.view.from") / 1e9, browser.run("canlog.view.to") / 1e9


def test_wheel_drag_and_keys_move_all_plots_together(browser: Browser, run_page: str) -> None:
    browser.open(run_page)
    left, top, width, height = browser.box("#panels canvas")
    x, y = left + 0.5 * width, top + 0.5 * height
    whole = span_s(browser)
    assert coloured_pixels(browser) > 500

    browser.wheel(x, y, -500)
    near = span_s(browser)
    browser.drag([(x, y), (x - 60, y), (x - 120, y)])
    moved = span_s(browser)
    browser.drag([(left + 200, y), (left + 300, y), (left + 400, y)], shift=True)
    chosen = span_s(browser)
    browser.key("0")

    assert near[1] - near[0] < 0.6 * (whole[1] - whole[0])
    assert moved[1] - moved[0] == pytest.approx(near[1] - near[0])
    assert moved[0] > near[0]
    ratio = 200 / (width - margin(browser) - 10)
    assert chosen[1] - chosen[0] == pytest.approx(ratio * (moved[1] - moved[0]), rel=0.01)
    assert moved[0] < chosen[0] < chosen[1] < moved[1]
    assert span_s(browser) == pytest.approx(whole)
    assert coloured_pixels(browser) > 500
    assert browser.log == []


def test_cursor_table_and_events_follow_each_other(
    browser: Browser, run_page: str, run_folder: Path
) -> None:
    browser.open(run_page)
    browser.wait("document.querySelectorAll('#rows .row').length > 5")
    left, top, width, height = browser.box("#panels canvas")

    browser.click(left + 0.6 * width, top + 0.5 * height)
    at_s = browser.run("canlog.view.cursor") / 1e9
    row_s = float(browser.wait("document.querySelector('#rows .row.at .mono')?.innerText"))
    browser.key("f")
    browser.type("TACHO")
    browser.wait("document.querySelector('#filter-note').innerText.includes('%')")
    browser.key("Escape")
    browser.key("ArrowRight")
    next_row = browser.text("#rows .row.at")
    browser.key("]")
    event_s = browser.run("canlog.view.cursor") / 1e9

    log = read(run_folder)
    stamps = log.frames.at_ns / 1e9
    assert row_s == pytest.approx(stamps[stamps <= at_s].max(), abs=1e-6)
    tacho = log.table("TACHO").at_ns / 1e9
    assert "TACHO" in next_row
    first_after = tacho[tacho > tacho[tacho <= at_s].max()].min()
    assert float(next_row.split()[0]) == pytest.approx(first_after, abs=1e-6)
    assert log.run is not None
    later = [event.at_ns / 1e9 for event in log.run.events if event.at_ns / 1e9 > first_after]
    assert event_s == pytest.approx(min(later), abs=1e-6)
    assert browser.text("#panels .chip b") != ""


def test_added_signals_are_kept_in_the_address(browser: Browser, run_page: str) -> None:
    browser.open(run_page)
    before = browser.run("document.querySelectorAll('#panels .panel').length")

    browser.key("s")
    browser.type("cylinder")
    browser.key("Enter")
    browser.run("canlog.setSpan(10e9, 20e9)")
    browser.wait("location.hash.includes('cylinder_pressure_kpa')")
    address = browser.run("location.href")
    browser.call("Page.navigate", url="about:blank")
    browser.open(address)

    assert browser.run("document.querySelectorAll('#panels .panel').length") == before + 1
    assert span_s(browser) == pytest.approx((10.0, 20.0))


def test_lines_have_enough_contrast_in_both_themes(browser: Browser, run_page: str) -> None:
    browser.open(run_page)
    first = browser.run("document.documentElement.dataset.theme")

    seen = {first: coloured_pixels(browser)}
    browser.key("t")
    seen[browser.run("document.documentElement.dataset.theme")] = coloured_pixels(browser)
    browser.key("t")

    assert set(seen) == {"light", "dark"}
    assert min(seen.values()) > 500


def test_one_name_in_two_pages_is_read_from_the_page_of_the_frame(
    browser: Browser, tmp_path: Path
) -> None:
    dbc = (
        'VERSION ""\nBU_: A\nBO_ 256 M: 4 A\n SG_ Page M : 0|8@1+ (1,0) [0|0] "" A\n'
        ' SG_ V m1 : 8|8@1+ (1,0) [0|0] "" A\n SG_ V m2 : 16|16@1- (0.5,1) [0|0] "" A\n'
    )
    rows = [(at * rig.MS, 256, bytes([at % 4, at, at, 255 - at])) for at in range(12)]
    log = rig.log_of(rows, parse_bus(dbc))
    data = page_data(log, "pages", ["M.V"], with_frames=True)
    path = tmp_path / "pages.html"
    path.write_text(page_text(data), encoding="utf-8")
    trace = trace_of(log, "M.V")

    browser.open(path.as_uri())

    shown = "canlog.view.source.trace(canlog.view.byFull.get('M.V'))"
    assert numbers(browser, f"{shown}.v").tolist() == trace.values.tolist()
    assert (numbers(browser, f"{shown}.t") + trace.at_ns[0] - rig.MS).tolist() == (
        trace.at_ns.tolist()
    )
    texts = browser.run(
        "JSON.stringify(canlog.view.source.rows(canlog.view.source.select('M'), 0, 12)"
        ".map(row => canlog.decodedTexts(row.message, row.data)[1]?.[1] ?? null))"
    )
    carried = iter(trace.values.tolist())
    wanted = [next(carried) if at % 4 in (1, 2) else None for at in range(12)]
    assert [each and float(each) for each in json.loads(texts)] == wanted


def test_the_bits_that_change_are_shown_in_the_page_and_from_the_server(
    browser: Browser, whole_page: str, served: tuple[str, PageData], everything: Log
) -> None:
    activity = ActivityView()
    activity.feed(ordered(everything.frames).frames)
    one = activity.found[0x100, "can0"]

    for address in (whole_page, served[0]):
        browser.open(address)
        browser.key("4")
        assert not browser.run("document.getElementById('tab-bits').hidden")
        row = (
            "[...document.querySelectorAll('#tab-bits tbody tr')]"
            ".find(r => r.cells[0].textContent === '100')"
        )
        assert browser.run(f"{row}.cells[1].textContent") == "PLAIN"
        shown = json.loads(
            browser.run(
                f"JSON.stringify([...{row}.querySelectorAll('.byte')].map(b => b.textContent))"
            )
        )
        assert [float(each) for each in shown] == pytest.approx(one.entropy_bits, abs=0.011)
        title = browser.run(f"{row}.querySelectorAll('.byte')[1].title")
        lines = [f"bit {7 - bit}: " for bit in range(8)]
        assert [line[:7] for line in title.splitlines()[1:]] == lines
        counted = [int("".join(filter(str.isdigit, line.split(":")[1].split("changes")[0])))
                   for line in title.splitlines()[1:]]  # fmt: skip
        assert counted == one.flips[1].tolist()
        browser.run(f"{row}.click()")
        assert browser.run("document.getElementById('filter').value") == "0x100"


def test_the_server_answers_only_to_its_own_name(served: tuple[str, PageData]) -> None:
    address = served[0]

    def status(path: str, host: str | None = None) -> int:
        request = Request(address + path, headers={"Host": host} if host else {})  # noqa: S310
        try:
            with urlopen(request, timeout=20) as answer:  # noqa: S310
                return int(answer.status)
        except OSError as error:
            return int(getattr(error, "code", 0))

    assert address.startswith("http://127.0.0.1:")
    assert status("") == 200
    assert status("", host="evil.example") == 403
    assert status("nothing") == 404
    assert status("trace?name=PLAIN.nothing&from=0&to=1&columns=5") == 400
    assert status("trace?name=PLAIN.small&from=nan&to=1&columns=5") == 400
    assert status("rows?filter=&first=-5&count=99999999") == 200
    assert status("select?filter=no_such_thing%3E1") == 400


def test_a_name_with_markup_is_shown_as_text(
    browser: Browser, tmp_path: Path, everything: Log
) -> None:
    path = tmp_path / "odd.html"
    title = "</script><script>document.title='taken'</script><b>&"
    data = page_data(everything, title, ["PLAIN.small"], with_frames=True)
    path.write_text(page_text(data), encoding="utf-8")

    browser.open(path.as_uri())

    assert browser.run("document.title") == title
    assert browser.text("h1") == title
    shutil.rmtree(tmp_path, ignore_errors=True)
