"""The terminal browser without a terminal: effects of keys, contents of the screen, live frames."""

from typing import Final

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from canlog.browse.lanes import KEPT_MAX, Lanes, lanes_of
from canlog.browse.screen import ScreenStyle, screen
from canlog.browse.spark import BLOCKS, BRAILLE, field, line, spans
from canlog.browse.state import ACTIONS, BrowserState, ListOrder, advance, press, shown
from canlog.browse.terminal import key_names, styled
from canlog.views.happenings import Happening
from hil_tests.unit.canlog import canlog_rig as rig

MS: Final = 1_000_000
SECOND: Final = 1_000 * MS


def state_of(count: int = 5_000) -> BrowserState:
    """Return the state at the end of a log of random frames with the first message selected."""
    lanes = lanes_of(rig.random_frames(count), rig.bus())
    events = (Happening(SECOND, "EMERGENCY_APPLIED", "too fast"), Happening(2 * SECOND, "MODE", ""))
    state = BrowserState("log", lanes, 0, lanes.end_ns, happenings=events)
    state.selected = 256
    return state


def text_of(state: BrowserState, width: int = 120, height: int = 40) -> list[str]:
    return ["".join(words for _, words in row) for row in screen(state, width, height)]


def row_of(state: BrowserState, name: str) -> list[tuple[ScreenStyle, str]]:
    return next(row for row in screen(state, 120, 40) if row and name in row[0][1])


def test_the_list_tells_the_last_frame_its_age_and_its_rate() -> None:
    state = state_of()
    frames = rig.random_frames(5_000)
    state.go(3 * SECOND)

    row = "".join(words for _, words in row_of(state, "WIDE_SIGNED"))

    mine = np.flatnonzero((frames.identifier == 258) & (frames.flags == 0))
    last = mine[frames.at_ns[mine] <= 3 * SECOND][-1]
    assert frames.payload(last).hex(" ").upper() in row
    assert str(np.count_nonzero(frames.at_ns[mine] <= 3 * SECOND)) in row.split()
    assert f"{(3 * SECOND - frames.at_ns[last]) / MS:.0f} ms" in row
    # One of seven frames is of this message; a few of them are remote or error frames.
    assert 130 < float(row.split()[2 if row.startswith(" ") else 3]) < 144


def test_only_bytes_that_changed_are_marked() -> None:
    rows = [(0, 256, bytes([1, 2, 3, 4, 5, 6, 7, 8])), (MS, 256, bytes([1, 9, 3, 4, 5, 6, 7, 0]))]
    log = rig.log_of(rows)
    state = BrowserState("log", lanes_of(log.frames, log.bus), 0, MS, selected=256)

    marked = [words for style, words in row_of(state, "PLAIN") if style is ScreenStyle.CHANGED]

    assert marked == ["09", "00"]


def test_a_message_that_is_overdue_is_red() -> None:
    """PLAIN comes every 10 ms and is stale after three periods."""
    log = rig.log_of([(0, 256, bytes(8)), (100 * MS, 257, bytes(8))])
    state = BrowserState("log", lanes_of(log.frames, log.bus), 0, 100 * MS, selected=256)

    def red(at_ns: int) -> bool:
        state.go(at_ns)
        return any(style is ScreenStyle.BAD for style, _ in row_of(state, "PLAIN"))

    assert [red(at * MS) for at in (0, 29, 31, 100)] == [False, False, True, True]


@pytest.mark.parametrize(("width", "height"), [(60, 14), (80, 24), (200, 60), (61, 15), (40, 10)])
@pytest.mark.parametrize("keys", ["", "?", "\r", "/wide\r", "/nothing here\r"])
def test_nothing_is_wider_or_longer_than_the_terminal(width: int, height: int, keys: str) -> None:
    state = state_of()
    for key in key_names(keys):
        press(state, key)

    for ascii_only in (False, True):
        lines = screen(state, width, height, ascii_only=ascii_only)
        assert len(lines) <= height
        assert max(sum(len(words) for _, words in row) for row in lines) <= width
        if ascii_only:
            assert "".join(words for row in lines for _, words in row).isascii()


def test_arrows_go_from_frame_to_frame_of_the_message() -> None:
    state = state_of()
    stamps = state.lanes.lanes[256].at_ns
    state.go(int(stamps[50]) + 10)

    seen = []
    for key in ("right", "right", "left", "left", "left"):
        press(state, key)
        seen.append(int(np.flatnonzero(stamps == state.at_ns)[0]))

    assert seen == [51, 52, 51, 50, 49]


def test_search_finds_messages_by_name_identifier_and_signal() -> None:
    state = state_of()

    def found(text: str) -> list[str]:
        press(state, "escape")
        for key in ("/", *text, "enter"):
            press(state, key)
        return [lane.name for lane in shown(state)]

    assert found("wide") == ["WIDE", "WIDE_SIGNED"]
    assert found("0x103") == ["FLOATS"]
    assert found("crooked") == ["ODD"]
    assert state.lane is not None
    assert state.lane.name == "ODD"
    assert found("no such") == []
    press(state, "escape")
    assert len(shown(state)) == 8


def test_events_and_bookmarks_are_gone_to_and_come_back_to() -> None:
    state = state_of()
    state.go(0)

    press(state, "e")
    assert (state.at_ns, "emergency applied: too fast") == (SECOND, state.note)
    press(state, "b")
    press(state, "e")
    press(state, "b")
    assert state.bookmarks == [SECOND, 2 * SECOND]
    press(state, "e")
    assert (state.at_ns, state.note) == (2 * SECOND, "no event there")
    press(state, "'")
    assert state.at_ns == SECOND
    press(state, "b")
    assert state.bookmarks == [2 * SECOND]
    press(state, "x")
    assert any("1.000 s emergency applied: too fast" in row for row in text_of(state))


def test_a_log_plays_at_its_speed_and_stops_at_its_end() -> None:
    state = state_of()
    state.go(0)
    press(state, "space")
    press(state, "+")

    advance(state, SECOND)
    assert state.at_ns == state.lanes.start_ns + 2 * SECOND
    advance(state, 5 * SECOND)
    assert (state.at_ns, state.running) == (state.lanes.end_ns, False)
    press(state, "space")
    assert (state.at_ns, state.running) == (state.lanes.start_ns, True)


def test_the_order_of_the_list_is_by_identifier_name_rate_or_age() -> None:
    log = rig.log_of(
        [(n * MS, 257, bytes(8)) for n in range(100)] + [(99 * MS, 256, bytes(8)), (MS, 262, b"")]
    )
    state = BrowserState("log", lanes_of(log.frames, log.bus), 0, 99 * MS, selected=256)

    orders = {}
    for _ in ListOrder:
        orders[state.order] = [lane.name for lane in shown(state)]
        press(state, "s")

    assert orders[ListOrder.IDENTIFIER] == ["PLAIN", "WIDE", "ODD"]
    assert orders[ListOrder.NAME] == ["ODD", "PLAIN", "WIDE"]
    assert orders[ListOrder.RATE][0] == "WIDE"
    assert orders[ListOrder.AGE][-1] == "ODD"


def test_the_help_names_every_key_and_every_key_does_something() -> None:
    press(state := state_of(), "?")
    text = "\n".join(text_of(state))

    assert all(words in text for words, _ in ACTIONS.values())
    press(state, "x")
    assert not state.help


def test_a_live_bus_forgets_the_oldest_and_counts_them() -> None:
    lanes = Lanes(rig.bus(), {})
    total = 3 * KEPT_MAX

    count = lanes.feed((n * MS, 256, 0, n.to_bytes(8, "little")) for n in range(total))

    lane = lanes.lanes[256]
    assert count == total
    assert len(lane) + lane.dropped == total
    assert len(lane) <= KEPT_MAX
    assert lane.payload(len(lane) - 1) == (total - 1).to_bytes(8, "little")
    assert lane.rate_hz(lanes.end_ns) == pytest.approx(1_000.0)
    lanes.feed([(total * MS, 256, 0, bytes(range(64))), (total * MS, 0, 4, bytes(8))])
    assert lane.payload(len(lane) - 1) == bytes(range(64))
    assert lanes.lanes[-1].name == "error frames"


def test_a_frozen_bus_goes_on_hearing_and_shows_the_instant_it_was_frozen_at() -> None:
    lanes = Lanes(rig.bus(), {})
    state = BrowserState("bus", lanes, 0, 0, live=True, running=True)
    lanes.feed([(MS, 256, 0, bytes(8))])
    advance(state, MS)
    press(state, "space")

    lanes.feed([(2 * MS, 256, 0, bytes(8))])
    advance(state, MS)
    assert (state.at_ns, len(lanes.lanes[256])) == (MS, 2)
    press(state, "space")
    advance(state, MS)
    assert state.at_ns == 2 * MS


@given(st.lists(st.floats(-1e3, 1e3), min_size=1, max_size=200), st.integers(1, 40))
def test_a_small_plot_shows_the_least_and_the_greatest(values: list[float], count: int) -> None:
    at_ns = np.arange(1, len(values) + 1, dtype=np.int64)
    found = spans(at_ns, np.array(values), 0, len(values), count)

    text = line(found)
    rows = field(found, 4)

    assert len(text) == count
    there = [each for each in found if each is not None]
    assert min(each[0] for each in there) == min(values)
    assert max(each[1] for each in there) == max(values)
    if max(values) > min(values):
        assert any(ord(sign) > BRAILLE for sign in rows[0])
        assert any(ord(sign) > BRAILLE for sign in rows[-1])
    assert set(text) <= {*BLOCKS, " "}


def test_a_peak_of_one_sample_is_seen() -> None:
    values = np.zeros(10_000)
    values[4_321] = 7.0
    found = spans(np.arange(10_000, dtype=np.int64), values, -1, 9_999, 50)

    assert line(found).count("█") == 1
    assert line(found).index("█") == 4_321 * 50 // 10_000


def test_keys_of_a_terminal_have_names_and_unknown_ones_none() -> None:
    sent = "j\x1b[A\x1bOB\x1b[5~\x1b[1;5C\x1b[15~\t\r \x7f/\x1b"

    assert list(key_names(sent)) == [
        *("j", "up", "down", "pageup", "tab", "enter", "space", "backspace", "/", "escape")
    ]


def test_without_colour_changes_are_still_to_be_seen() -> None:
    row = [(ScreenStyle.CHANGED, "09"), (ScreenStyle.BAD, "late"), (ScreenStyle.BOLD, "x")]

    assert styled(row, colour=False) == "\x1b[7m09\x1b[0mlate\x1b[1mx\x1b[0m"
