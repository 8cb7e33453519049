"""Buses by name: `open_can("socketcan:vcan0", ...)`. Each kind is loaded when it is first used."""

import difflib
import enum
from collections.abc import Collection
from dataclasses import dataclass

from firmware_py.buses.errors import BusError
from firmware_py.buses.interfaces import BUS_NAME, VIRTUAL_KINDS, look_up
from firmware_py.clock.clock import Clock
from firmware_py.ports import CanPort

__all__ = [
    "BusChoice",
    "BusError",
    "BusKind",
    "BusSpec",
    "is_virtual",
    "open_can",
    "parse_spec",
    "resolve_auto",
]


class BusKind(enum.Enum):
    """Transport of frames between processes. A bus within one process is created, not opened."""

    SOCKETCAN = "socketcan"
    EMBEDDED = "embedded"


@dataclass(frozen=True, slots=True)
class BusSpec:
    """A bus as the user names it: `kind:name`."""

    kind: BusKind
    name: str

    def __str__(self) -> str:
        return f"{self.kind.value}:{self.name}"


@dataclass(frozen=True, slots=True)
class BusChoice:
    """The bus that `--bus auto` selects."""

    spec: str | None
    """The selected bus; None if neither kind exists, so that a hub must be started."""
    reason: str
    """Text for the user: why this bus and not one of higher preference."""


def parse_spec(spec: str) -> BusSpec:
    """Parse a bus name. Raises BusError that says what is wrong and what is valid."""
    kind_word, colon, name = spec.partition(":")
    kinds = {kind.value: kind for kind in BusKind}
    if not colon:
        raise BusError(f"bus {spec!r}: no kind; write {' or '.join(f'{k}:vcan0' for k in kinds)}")
    if kind_word not in kinds:
        close = difflib.get_close_matches(kind_word, kinds, n=1)
        hint = f"nearest valid: {close[0]}" if close else f"valid: {', '.join(kinds)}"
        raise BusError(f"bus {spec!r}: unknown kind; {hint}")
    if not BUS_NAME.fullmatch(name):
        raise BusError(
            f"bus {spec!r}: name {name!r}: 1 to 15 letters, digits, '_', '.' or '-' are needed"
        )
    return BusSpec(kinds[kind_word], name)


def open_can(
    spec: str, *, clock: Clock, node: str, accept_ids: Collection[int] | None = None
) -> CanPort:
    """Connect to a bus that other processes use.

    Args:
        spec: `socketcan:<interface>` or `embedded:<name of a hub>`.
        clock: stamps of received frames are instants of this clock, which must be the machine's.
        node: name of this node in the bus's status.
        accept_ids: 11-bit identifiers to receive; None receives all frames, including 29-bit and
            remote frames.

    Raises:
        BusError: if the bus does not exist, is down or may not be used.
    """
    bus = parse_spec(spec)
    if bus.kind is BusKind.SOCKETCAN:
        from firmware_py.buses.socketcan import open_socketcan

        return open_socketcan(bus.name, clock=clock, accept_ids=accept_ids)
    from firmware_py.buses.embedded import open_embedded

    return open_embedded(bus.name, node=node, accept_ids=accept_ids)


def resolve_auto(name: str = "vcan0") -> BusChoice:
    """Select the kernel's interface of that name if it is up, otherwise the hub of that name,
    otherwise none.
    """
    from firmware_py.buses.hub_control import hub_status

    interface = look_up(name)
    if interface is None:
        kernel = f"the kernel has no interface {name}"
    elif not interface.is_can:
        kernel = f"interface {name} is no CAN interface"
    elif not interface.is_up:
        kernel = f"interface {name} is down"
    else:
        return BusChoice(f"socketcan:{name}", f"interface {name} is up")
    try:
        status = hub_status(name)
    except BusError as error:
        return BusChoice(None, f"{kernel}, and {error}")
    if status is None:
        return BusChoice(None, f"{kernel}, and no hub of that name runs")
    return BusChoice(f"embedded:{name}", f"{kernel}, but hub {status.pid} runs")


def is_virtual(spec: str) -> bool:
    """Return whether no real train can be on this bus, so that an emulated one may be connected.

    A missing interface, or one whose driver does not report itself as virtual, counts as real.
    """
    bus = parse_spec(spec)
    if bus.kind is BusKind.EMBEDDED:
        return True
    interface = look_up(bus.name)
    return interface is not None and interface.kind in VIRTUAL_KINDS
