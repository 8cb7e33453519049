"""`plant desk`: the driver's desk as a separate node, operated from keyboard, recording or driver
model.
"""

import argparse
import sys
from collections.abc import Callable, Iterable
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import Final, TextIO

from can_dbc.binding import can_id
from can_dbc.cab import CabMode, Desk
from can_dbc.codec import Decoder, Encoder, Rejected
from can_dbc.diagnostics import HEARTBEATS, NodeState
from can_dbc.nodes import Node
from firmware_py.buses import BusError, open_can
from firmware_py.clock.clock import Clock, WallClock
from firmware_py.clock.executive import Executive, Task, run
from firmware_py.clock.realtime import die_with_parent
from firmware_py.interrupts import Interrupts
from firmware_py.ports import CanPort
from firmware_py.settings import SettingsError
from firmware_py.storage.growing_file import GrowingFile
from plant_emulator.cli.bus_choice import chosen_bus
from plant_emulator.cli.terminal import TerminalArea, open_terminal
from plant_emulator.desk.attendant import Attendant, attendant
from plant_emulator.desk.display import SCREEN_KINDS, DeskDisplay
from plant_emulator.desk.hands import Hands, press, unattended
from plant_emulator.desk.recording import HEADER, change_line, load_recording
from plant_emulator.desk.screen import COLOURED, lines, status_colour

EXIT_OK: Final = 0
DESK_MS: Final = 100.0
LIFE_MS: Final = 1000.0
LISTEN_NS: Final = 250_000_000
"""Time to listen for another desk; longer than two of its periods."""
NS_PER_S: Final = 1_000_000_000


def attend(options: argparse.Namespace) -> int:
    """Run the command. Raises SettingsError, BusError or OSError."""
    mode = CabMode[options.mode.upper()]
    recording = None if options.play is None else load_recording(options.play)
    keys = None if options.keys is None else GrowingFile(Path(options.keys))
    by_hand = recording is None and options.driver is None and keys is None
    if by_hand and not (sys.stdin.isatty() and sys.stdout.isatty()):
        raise OSError("plant desk needs a terminal, or --play FILE, --driver NAME or --keys FILE")
    if options.parent is not None:
        die_with_parent(options.parent)
    ending = Interrupts()
    with ending.caught(), ExitStack() as stack:
        clock = WallClock()
        spec = chosen_bus(options.bus)
        _refuse_second_desk(spec, clock)
        can = open_can(
            spec,
            clock=clock,
            node="DESK",
            accept_ids=frozenset(can_id(kind) for kind in SCREEN_KINDS),
        )
        stack.callback(can.close)
        start_ns = clock.now_ns()
        terminal = stack.enter_context(open_terminal()) if by_hand else None
        pressed: Callable[[], Iterable[str]] | None = None if keys is None else keys.lines
        desk = DeskNode(
            can,
            who=attendant(options.driver, recording, mode=mode, start_ns=start_ns),
            mode=mode,
            terminal=terminal,
            pressed=pressed if terminal is None else terminal.pressed,
            record=_record(options.record, stack),
            start_ns=start_ns,
        )
        over = _over(options.duration_s, start_ns, ending, desk)
        if keys is not None:
            stack.callback(keys.close)
        if not by_hand:
            print(f"plant: desk on {spec}; Ctrl-C leaves it", flush=True)
        run([desk.executive], clock, over)
        desk.stop(clock.now_ns())
    return ending.exit_code


def _over(
    duration_s: float | None, start_ns: int, ending: Interrupts, desk: "DeskNode"
) -> Callable[[int], bool]:
    end_ns = None if duration_s is None else start_ns + round(duration_s * NS_PER_S)
    return lambda now_ns: ending.asked or desk.left or (end_ns is not None and now_ns >= end_ns)


def _refuse_second_desk(spec: str, clock: Clock) -> None:
    with ExitStack() as stack:
        probe = open_can(spec, clock=clock, node="DESK_PROBE", accept_ids=frozenset({can_id(Desk)}))
        stack.callback(probe.close)
        clock.wait_until(clock.now_ns() + LISTEN_NS)
        if probe.receive(clock.now_ns()):
            raise BusError(
                f"{spec}: another desk is already on the bus; run the plant with --desk external"
            )


def _record(name: str | None, stack: ExitStack) -> TextIO | None:
    if name is None:
        return None
    path = Path(name)
    if path.exists():
        raise SettingsError(f"--record {name}: the file exists and is not overwritten")
    record = stack.enter_context(path.open("x", encoding="utf-8"))
    record.write(HEADER)
    return record


class DeskNode:
    """The desk node on the bus. Run `executive`, and call `stop` at the end."""

    def __init__(
        self,
        can: CanPort,
        *,
        who: Attendant | None,
        mode: CabMode,
        terminal: TerminalArea | None,
        pressed: Callable[[], Iterable[str]] | None,
        record: TextIO | None,
        start_ns: int,
    ) -> None:
        """Args:
        who: recording or driver model; None: the keys.
        pressed: returns the names of the keys that were pressed since the last call.
        terminal: shows the desk.
        record: file that receives a line for each change.
        """
        self._can, self._driver, self._terminal, self._record = can, who, terminal, record
        self._pressed = pressed
        self._start_ns = start_ns
        self._decoder, self._encoder = Decoder(SCREEN_KINDS), Encoder()
        self._hands = Hands(unattended(mode))
        self._recorded: Desk | None = None
        self._life = NodeState.BOOT_UP
        self.display = DeskDisplay()
        self.executive = Executive(
            [Task("desk", DESK_MS, self.cycle), Task("life_sign", LIFE_MS, self.life_sign)],
            start_ns,
        )

    @property
    def left(self) -> bool:
        return self._hands.gone

    def cycle(self, now_ns: int) -> None:
        """Receive the display frames, send the desk, then record and show it."""
        self._look(now_ns)
        desk = self._desk(now_ns)
        for identifier, data in self._encoder.encode(desk):
            self._can.send(now_ns, identifier, data)
        if self._record is not None:
            self._record.write(
                change_line((now_ns - self._start_ns) / NS_PER_S, self._recorded, desk)
            )
            self._record.flush()
        self._recorded = desk
        if self._terminal is not None:
            self._terminal.show(
                lines(self.display, desk, now_ns),
                coloured=COLOURED,
                colour=status_colour(self.display, now_ns),
            )

    def _look(self, now_ns: int) -> None:
        for frame in self._can.receive(now_ns):
            heard = self._decoder.decode(frame.can_id, frame.data, frame.stamp_ns)
            if heard is not None and not isinstance(heard, Rejected):
                self.display.hear(heard, frame.stamp_ns)

    def _desk(self, now_ns: int) -> Desk:
        if self._driver is not None:
            return self._driver(self.display, now_ns)
        if self._pressed is not None:
            for key in self._pressed():
                self._hands = press(self._hands, key, now_ns)
        return self._hands.at(now_ns)

    def life_sign(self, now_ns: int) -> None:
        self._say_life(now_ns, self._life)
        self._life = NodeState.OPERATIONAL

    def stop(self, now_ns: int) -> None:
        """Announce on the bus that the node stops."""
        with suppress(BusError):
            self._say_life(now_ns, NodeState.STOPPED)

    def _say_life(self, now_ns: int, state: NodeState) -> None:
        for identifier, data in self._encoder.encode(HEARTBEATS[Node.DESK](state)):
            self._can.send(now_ns, identifier, data)
