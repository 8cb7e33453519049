"""`canlog replay`: sends the frames of a log to a bus again, at their original times."""

import argparse
import sys
from collections.abc import Iterable
from pathlib import Path
from typing import Final

from canlog.damage import LogError
from canlog.frames import EXTENDED, FD, NOT_DATA, Frames
from canlog.reader import stream
from canlog.select import Selection, Selector, parse_keys
from canlog.table import Groups
from canlog.verbs.common import add_log, bus_asked, read_options
from firmware_py.buses import BusError, is_virtual, open_can
from firmware_py.clock.clock import Clock, WallClock
from firmware_py.ports import CanPort

SPIN_S: Final = 200e-6


def options(parser: argparse.ArgumentParser) -> None:
    add_log(parser, required=True)
    parser.add_argument("--bus", required=True, metavar="BUS", help="such as embedded:vcan0")
    parser.add_argument("--speed", type=float, default=1.0, help="2 is twice as fast")
    parser.add_argument("--message", action="append", default=[], metavar="PATTERN")
    parser.add_argument("--id", action="append", default=[], metavar="HEX")
    parser.add_argument("--node", action="append", default=[], metavar="SENDER")
    parser.add_argument("--real", action="store_true", help="allow a bus that a real train may use")


def run(given: argparse.Namespace) -> int:
    if not given.speed > 0.0:
        raise LogError(f"--speed {given.speed}: has to be positive")
    bus = bus_asked(given)
    clock = WallClock(SPIN_S)
    source = stream(Path(given.log), read_options(given))
    keys = tuple(parse_keys(text) for text in given.id)
    wanted = Selection(names=tuple(given.message), keys=keys, nodes=tuple(given.node))
    selector = Selector(wanted, bus)
    port = _open(given.bus, clock, real=given.real)
    player = Player(port, clock, given.speed)
    try:
        for frames in source:
            rows = selector.rows(frames, Groups(frames))
            player.play(frames[rows])
    finally:
        port.close()
        _report(player, port, source.warnings)
    return 0


def _report(player: "Player", port: CanPort, warnings: Iterable[object]) -> None:
    """Report what was sent, also if Ctrl-C ended the replay."""
    for each in warnings:
        print(f"canlog: warning: {each}", file=sys.stderr)
    if player.unsent:
        print(f"canlog: {player.unsent} frames that are no 11-bit data frames were left out",
              file=sys.stderr)  # fmt: skip
    print(
        f"{player.sent} frames sent, {port.counters.dropped_out} of them refused by the bus;"
        f" late by at most {player.late_ns_max / 1e6:.3f} ms"
    )


def _open(bus: str, clock: Clock, *, real: bool) -> CanPort:
    try:
        if not real and not is_virtual(bus):
            raise LogError(f"--bus {bus}: a real train may use it; --real sends nevertheless")
        return open_can(bus, clock=clock, node="canlog", accept_ids=())
    except BusError as error:
        raise LogError(str(error)) from error


class Player:
    """Sends frames when they are due; stamps of the log are shifted to the clock."""

    def __init__(self, port: CanPort, clock: Clock, speed: float = 1.0) -> None:
        self._port, self._clock, self._speed = port, clock, speed
        self._shift: tuple[int, int] | None = None
        """Stamp of the first frame in the log, and its instant on the clock."""
        self.sent = self.unsent = 0
        self.late_ns_max = 0
        """Greatest lateness: the frame before it, or the machine, delayed a frame this long."""

    def play(self, frames: Frames) -> None:
        """Send the next frames; a frame whose stamp runs backwards is sent at once."""
        odd = (frames.flags & (NOT_DATA | EXTENDED | FD)).tolist()
        identifiers, stamps = frames.identifier.tolist(), frames.at_ns.tolist()
        for row, (at_ns, can_id) in enumerate(zip(stamps, identifiers, strict=True)):
            if odd[row]:
                self.unsent += 1
                continue
            due_ns = self._due_ns(at_ns)
            self._clock.wait_until(due_ns)
            now_ns = self._clock.now_ns()
            self._port.send(now_ns, can_id, frames.payload(row))
            self.late_ns_max = max(self.late_ns_max, now_ns - due_ns)
            self.sent += 1

    def _due_ns(self, at_ns: int) -> int:
        if self._shift is None:
            self._shift = at_ns, self._clock.now_ns()
        first_ns, began_ns = self._shift
        return began_ns + round((at_ns - first_ns) / self._speed)
