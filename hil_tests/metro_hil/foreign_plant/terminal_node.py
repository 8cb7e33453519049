"""An FMU with a network terminal of FMI-LS-BUS 1.0: its clocks, and the frames at them."""

import ctypes
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Final
from xml.etree import ElementTree

from firmware_py.settings import SettingsError, nearest
from metro_hil.foreign_plant.fmu import Fmu, FmuError
from metro_hil.foreign_plant.ls_bus import (
    CAN_TRANSMIT,
    FORMAT_ERROR,
    LsBusError,
    frame_of,
    operations,
    transmit,
)

NS_PER_S: Final = 1_000_000_000
TERMINALS: Final = "terminalsAndIcons/terminalsAndIcons.xml"
KIND: Final = "org.fmi-ls-bus.network-terminal"
MEMBERS: Final = ("Rx_Data", "Rx_Clock", "Tx_Data", "Tx_Clock")
CHANGED: Final = 2
"""Qualifier of an interval that is new."""
EVENTS_MAX: Final = 1000
"""Number of ticks at one instant after which the FMU counts as hanging."""

Arrival = tuple[int, int, bytes]
"""Instant of a frame's end, identifier, data."""


def members_of(fmu: Fmu, terminal: str, source: str) -> Mapping[str, str]:
    """Return the variable of each member of a network terminal. Raises SettingsError."""
    path = fmu.folder / TERMINALS
    found = _terminals(path) if path.is_file() else {}
    if not found:
        raise SettingsError(f"{source}: terminal: the FMU has no network terminal of FMI-LS-BUS")
    if terminal not in found:
        hint = nearest(terminal, list(found), "terminal")
        raise SettingsError(f"{source}: terminal: {terminal!r}: {hint}")
    members = found[terminal]
    for name in MEMBERS:
        if members.get(name) not in fmu.variables:
            raise SettingsError(f"{source}: terminal: {terminal!r} has no member {name}")
    return members


def _terminals(path: Path) -> dict[str, dict[str, str]]:
    try:
        root = ElementTree.parse(path).getroot()  # noqa: S314 - no entity is resolved
    except ElementTree.ParseError as error:
        raise SettingsError(f"{path.name}: {error}") from error
    return {
        str(each.get("name")): {
            str(member.get("memberName")): str(member.get("variableName"))
            for member in each.iter("TerminalMemberVariable")
        }
        for each in root.iter("Terminal")
        if each.get("terminalKind") == KIND
    }


class TerminalNode:
    """Steps an FMU from event to event.

    Its transmit clock must be a countdown clock. The FMU receives each frame at the instant at
    which it ended on the bus.
    """

    def __init__(self, fmu: Fmu, members: Mapping[str, str], also: Sequence[str] = ()) -> None:
        """Args:
        also: further binary outputs that are read at each tick.
        """
        self._fmu = fmu
        self._rx, self._rx_clock, self._tx, self._tx_clock = (
            fmu.reference(members[name]) for name in MEMBERS
        )
        self._also = [fmu.reference(name) for name in also]
        self._now_ns = 0
        self._due_ns: int | None = None
        self.frames: list[tuple[int, bytes]] = []
        """Frames that the node sent in the last call."""
        self.texts: list[bytes] = []
        """Contents of the further outputs in the last call."""
        self.refused = 0
        """Number of operations that the node refused with Format Error."""

    def begin(self, now_ns: int) -> None:
        """Handle the events at the start; the FMU has just left its initialisation."""
        self._now_ns = now_ns
        self.frames, self.texts = [], []
        self._read_interval()
        self._events(b"")
        self._fmu.call("enterStepMode")

    def receive(self, content: bytes) -> None:
        """Let the node receive these bytes at the present instant. Raises FmuError."""
        self._fmu.call("enterEventMode")
        self._events(content)
        self._fmu.call("enterStepMode")

    def advance(self, until_ns: int, arrivals: Sequence[Arrival]) -> None:
        """Step to `until_ns` with all events on the way. Raises FmuError."""
        self.frames, self.texts = [], []
        waiting = list(arrivals)
        while True:
            at_ns = until_ns if not waiting else min(until_ns, max(self._now_ns, waiting[0][0]))
            if self._due_ns is not None:
                at_ns = min(at_ns, self._due_ns)
            if at_ns > self._now_ns:
                self._fmu.step(self._now_ns / NS_PER_S, (at_ns - self._now_ns) / NS_PER_S)
                self._now_ns = at_ns
            received = b""
            while waiting and waiting[0][0] <= at_ns:
                _, can_id, data = waiting.pop(0)
                received += transmit(can_id, data)
            if received or self._due_ns == at_ns:
                self.receive(received)
            if at_ns >= until_ns and not waiting:
                return

    def _events(self, received: bytes) -> None:
        """Handle all events of the present instant, in event mode."""
        for _ in range(EVENTS_MAX):
            if received:
                self._fmu.call("setClock", [self._rx_clock], [True])
                self._fmu.call("setBinary", [self._rx], [received])
            ticks = self._due_ns is not None and self._due_ns <= self._now_ns
            if ticks:
                self._fmu.call("setClock", [self._tx_clock], [True])
                sent, *texts = self._fmu.call("getBinary", [self._tx, *self._also])
                self._take(sent or b"")
                self.texts += [text or b"" for text in texts]
                self._due_ns = None
            self._fmu.call("updateDiscreteStates")
            self._read_interval()
            received = b""
            if self._due_ns is None or self._due_ns > self._now_ns:
                return
        raise FmuError(f"hangs: {EVENTS_MAX} ticks of its clock at {self._now_ns / NS_PER_S:g} s")

    def _read_interval(self) -> None:
        references = (ctypes.c_uint32 * 1)(self._tx_clock)
        counter, resolution = (ctypes.c_uint64 * 1)(), (ctypes.c_uint64 * 1)()
        qualifier = (ctypes.c_int * 1)()
        self._fmu.call("getIntervalFraction", references, counter, resolution, qualifier)
        if qualifier[0] == CHANGED and resolution[0] > 0:
            self._due_ns = self._now_ns + counter[0] * NS_PER_S // resolution[0]

    def _take(self, sent: bytes) -> None:
        try:
            for operation in operations(sent):
                if operation.code == CAN_TRANSMIT:
                    self.frames.append(frame_of(operation))
                elif operation.code == FORMAT_ERROR:
                    self.refused += 1
        except LsBusError as error:
            raise FmuError(f"LS-BUS: {error}") from error
