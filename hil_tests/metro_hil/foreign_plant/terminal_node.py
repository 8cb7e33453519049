"""An FMU with a network terminal of FMI-LS-BUS 1.0: its clocks, and the operations at them."""

import ctypes
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Final
from xml.etree import ElementTree

from firmware_py.settings import SettingsError, nearest
from metro_hil.foreign_plant.fmu import Fmu, FmuError

NS_PER_S: Final = 1_000_000_000
TERMINALS: Final = "terminalsAndIcons/terminalsAndIcons.xml"
KIND: Final = "org.fmi-ls-bus.network-terminal"
MEMBERS: Final = ("Rx_Data", "Rx_Clock", "Tx_Data", "Tx_Clock")
NOTIFICATIONS: Final = "BusNotifications"
"""Name of the member whose parameter lets a node wait for Confirm and the like."""
CHANGED: Final = 2
"""Qualifier of an interval that is new."""
EVENTS_MAX: Final = 1000
"""Number of ticks at one instant after which the FMU counts as hanging."""
FAR_NS: Final = 1 << 62
"""Instant that no run reaches; longer intervals count as this one."""


def terminal_of(fmu: Fmu, terminal: str, source: str) -> str:
    """Return the terminal, or the only one of the FMU if it is empty. Raises SettingsError."""
    found = _terminals(fmu, source)
    if not terminal and len(found) == 1:
        return next(iter(found))
    if not terminal:
        raise SettingsError(f"{source}: terminal: missing; the FMU has {', '.join(found)}")
    return terminal


def members_of(fmu: Fmu, terminal: str, source: str) -> Mapping[str, str]:
    """Return the variable of each member of a network terminal. Raises SettingsError."""
    found = _terminals(fmu, source)
    if terminal not in found:
        hint = nearest(terminal, list(found), "terminal")
        raise SettingsError(f"{source}: terminal: {terminal!r}: {hint}")
    members = found[terminal]
    for name in MEMBERS:
        if members.get(name) not in fmu.variables:
            raise SettingsError(f"{source}: terminal: {terminal!r} has no member {name}")
    return members


def _terminals(fmu: Fmu, source: str) -> dict[str, dict[str, str]]:
    path = fmu.folder / TERMINALS
    found = _read_terminals(path) if path.is_file() else {}
    if not found:
        raise SettingsError(f"{source}: terminal: the FMU has no network terminal of FMI-LS-BUS")
    return found


def _read_terminals(path: Path) -> dict[str, dict[str, str]]:
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


def notify(fmu: Fmu, members: Mapping[str, str]) -> bool:
    """Let the node wait for Confirm, Arbitration Lost and Bus Error; return whether it can."""
    member = members.get(NOTIFICATIONS)
    # Nodes of the standard's drafts have the parameter outside of the terminal.
    names = [name for name in fmu.variables if name == member or name.endswith(NOTIFICATIONS)]
    for name in names:
        structural = fmu.variables[name].causality == "structuralParameter"
        if structural:
            fmu.call("enterConfigurationMode")
        fmu.set(name, 1.0)
        if structural:
            fmu.call("exitConfigurationMode")
    return bool(names)


class TerminalNode:
    """Steps an FMU from event to event.

    Its transmit clock is a countdown clock, or a triggered output. A triggered clock ticks without
    notice, so that FMU advances by steps of at most `step_ns`.
    """

    def __init__(
        self, fmu: Fmu, members: Mapping[str, str], also: Sequence[str] = (), step_ns: int = FAR_NS
    ) -> None:
        """Args:
        also: further binary outputs that are read at each tick.
        step_ns: greatest step of a node whose transmit clock is an output.
        """
        self._fmu = fmu
        self._rx, self._rx_clock, self._tx, self._tx_clock = (
            fmu.reference(members[name]) for name in MEMBERS
        )
        self._triggered = fmu.variables[members["Tx_Clock"]].causality == "output"
        self._step_ns = step_ns
        self._also = [fmu.reference(name) for name in also]
        self._interval = (
            (ctypes.c_uint32 * 1)(self._tx_clock),
            (ctypes.c_uint64 * 1)(),
            (ctypes.c_uint64 * 1)(),
            (ctypes.c_int * 1)(),
        )
        self.now_ns = 0
        self.due_ns = FAR_NS
        """Instant of the next tick, to which the FMU must advance without a step beyond it."""
        self.sent = b""
        """Operations that the node sent in the last call."""
        self.texts: list[bytes] = []
        """Contents of the further outputs in the last call."""

    def begin(self, now_ns: int) -> None:
        """Handle the events at the start; the FMU has just left its initialisation."""
        self.now_ns = now_ns
        self.sent, self.texts = b"", []
        self._plan()
        self._events(b"")

    def go(self, at_ns: int, received: bytes = b"") -> None:
        """Advance to `at_ns`, at most `due_ns`, and hand over operations. Raises FmuError."""
        self.sent, self.texts = b"", []
        event = bool(received)
        if at_ns > self.now_ns:
            event |= self._fmu.step(self.now_ns / NS_PER_S, (at_ns - self.now_ns) / NS_PER_S)
            self.now_ns = at_ns
        if self._triggered:
            self._plan()
        if event or (not self._triggered and self.due_ns <= at_ns):
            self._fmu.call("enterEventMode")
            self._events(received)

    def _events(self, received: bytes) -> None:
        """Handle all events of the present instant, in event mode, and leave it."""
        for _ in range(EVENTS_MAX):
            if received:
                self._fmu.call("setClock", [self._rx_clock], [True])
                self._fmu.call("setBinary", [self._rx], [received])
            ticks = self._ticks()
            if ticks:
                sent, *texts = self._fmu.call("getBinary", [self._tx, *self._also])
                self.sent += sent or b""
                self.texts += [text or b"" for text in texts]
            again, ends, *_ = self._fmu.call("updateDiscreteStates")
            if ends:
                raise FmuError(f"ends the simulation at {self.now_ns / NS_PER_S:g} s")
            received = b""
            if not self._triggered:
                self._plan()
                again |= self.due_ns <= self.now_ns
            elif ticks:
                again = True
            if not again:
                self._fmu.call("enterStepMode")
                return
        raise FmuError(f"hangs: {EVENTS_MAX} ticks of its clock at {self.now_ns / NS_PER_S:g} s")

    def _ticks(self) -> bool:
        """Return whether the transmit clock ticks now."""
        if self._triggered:
            return bool(self._fmu.call("getClock", [self._tx_clock])[0])
        if self.due_ns > self.now_ns:
            return False
        self._fmu.call("setClock", [self._tx_clock], [True])
        self.due_ns = FAR_NS
        return True

    def _plan(self) -> None:
        """Find out when the clock ticks next."""
        if self._triggered:
            self.due_ns = (self.now_ns // self._step_ns + 1) * self._step_ns
            return
        _, counter, resolution, qualifier = self._interval
        self._fmu.call("getIntervalFraction", *self._interval)
        if qualifier[0] == CHANGED and resolution[0] > 0:
            due_ns = self.now_ns + counter[0] * NS_PER_S // resolution[0]
            self.due_ns = min(FAR_NS, due_ns)
