"""`canlog browse LOG` or `--follow BUS`: messages, signals and small plots in a terminal."""

import argparse
import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Final

from canlog.damage import LogError
from canlog.verbs.common import LOG_HELP, add_reading, bus_asked, seconds
from firmware_py.clock.clock import WallClock

if TYPE_CHECKING:
    from canlog.browse.state import BrowserState
    from firmware_py.ports import CanPort

WAIT_S: Final = 0.08
"""Longest time between two redraws while something changes."""
IDLE_WAIT_S: Final = 0.5
BEGIN_S: Final = 2


def options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("log", nargs="?", type=Path, metavar="LOG", help=LOG_HELP)
    parser.add_argument("--follow", metavar="BUS", help="a live bus, such as socketcan:can0")
    add_reading(parser)
    parser.add_argument("--at", type=seconds, metavar="S", help="begin at this second")
    parser.add_argument("--ascii", action="store_true", help="plain characters only")


def run(given: argparse.Namespace) -> int:
    """Browse until the user quits, then print the bookmarks. Raises LogError."""
    if given.log is not None and given.follow is not None:
        raise LogError(f"{given.log} and --follow {given.follow} exclude each other")
    if not (sys.stdin.isatty() and sys.stdout.isatty()):
        raise LogError("browse: needs a terminal; `canlog show` writes into files and pipes")
    clock = WallClock()
    port = None
    if given.follow:
        port, state = _live(given, clock)
    else:
        state = _recorded(given)
    try:
        _browse(given, state, clock, port)
    finally:
        if port is not None:
            port.close()
    for at_ns in state.bookmarks:
        print(f"bookmark {state.seconds(at_ns):.6f} s")
    return 0


def _recorded(given: argparse.Namespace) -> "BrowserState":
    from canlog.browse.lanes import lanes_of
    from canlog.browse.state import NS_PER_S, BrowserState
    from canlog.verbs.asked import name_asked, read_asked
    from canlog.views.happenings import happenings
    from canlog.views.span import zero_of

    log = read_asked(given)
    lanes = lanes_of(log.frames, log.bus)
    zero_ns = zero_of(log)
    state = BrowserState(
        name_asked(given), lanes, zero_ns, lanes.end_ns, happenings=happenings(log)
    )
    state.selected = min(lanes.lanes, default=None)
    # Do not start at the very first frame, before most messages have come.
    begin_ns = lanes.start_ns + BEGIN_S * NS_PER_S
    at_ns = begin_ns if given.at is None else zero_ns + round(given.at * NS_PER_S)
    state.go(at_ns)
    return state


def _live(given: argparse.Namespace, clock: WallClock) -> "tuple[CanPort, BrowserState]":
    from canlog.browse.lanes import Lanes
    from canlog.browse.state import BrowserState
    from firmware_py.buses import BusError, open_can

    try:
        port = open_can(given.follow, clock=clock, node="canlog")
    except BusError as error:
        raise LogError(str(error)) from error
    now_ns = clock.epoch_ns()
    lanes = Lanes(bus_asked(given), {})
    return port, BrowserState(given.follow, lanes, now_ns, now_ns, live=True, running=True)


def _browse(
    given: argparse.Namespace, state: "BrowserState", clock: WallClock, port: "CanPort | None"
) -> None:
    from canlog.browse.screen import screen
    from canlog.browse.state import advance, press
    from canlog.browse.terminal import RawTerminal

    ascii_only = given.ascii or "utf" not in (sys.stdout.encoding or "").lower()
    last_ns = clock.now_ns()
    with RawTerminal(colour="NO_COLOR" not in os.environ) as terminal:
        while not state.done:
            now_ns = clock.now_ns()
            if port is not None:
                _receive(state, port, now_ns, clock.epoch_offset_ns)
            advance(state, now_ns - last_ns)
            last_ns = now_ns
            terminal.show(screen(state, *terminal.size, ascii_only=ascii_only))
            moving = state.running or port is not None
            keys = terminal.keys(WAIT_S if moving else IDLE_WAIT_S)
            if keys is None:
                return
            for key in keys:
                press(state, key)


def _receive(state: "BrowserState", port: "CanPort", now_ns: int, offset_ns: int) -> None:
    from canlog.frames import ERROR, KEY_EXTENDED

    received = port.receive(now_ns)
    state.lanes.feed(
        (
            frame.stamp_ns + offset_ns,
            frame.can_id | KEY_EXTENDED * frame.extended,
            ERROR * frame.error,
            frame.data,
        )
        for frame in received
        if not frame.remote
    )
    if state.selected is None:
        state.selected = min(state.lanes.lanes, default=None)
