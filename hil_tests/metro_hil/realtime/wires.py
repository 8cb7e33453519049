"""The wires of a case in real time, and the programs or devices at their ends."""

import enum
from collections.abc import Collection
from dataclasses import dataclass
from typing import Final

from can_dbc.nodes import Node
from metro_hil.model.case import BenchKind

AUTO: Final = "auto"


class Blocked(Exception):  # noqa: N818 - a verdict of a case, no error
    """The bench cannot run the case; the text says why."""


class Presence(enum.Enum):
    """Where a device comes from."""

    AUTO = "auto"
    """On the bench's own buses the bench starts it; elsewhere only if it does not send yet."""
    OURS = "ours"
    """The bench starts it."""
    ELSEWHERE = "elsewhere"
    """It runs already, or is started outside the bench."""


@dataclass(frozen=True, slots=True)
class RealtimeWires:
    """The wires as the user names them; `auto` leaves the choice to the bench."""

    bus_a: str = AUTO
    """The controller's segment, such as `socketcan:can0`; auto: an embedded bus for each case."""
    bus_b: str = AUTO
    """The train's segment, used only by cases with bus faults. Auto: another embedded bus if
    `bus_a` is one, else none."""
    tags: str = AUTO
    """Serial line of the tag reader, such as `/dev/ttyUSB0`; auto: a pseudo-terminal."""
    radio: str = AUTO
    """Endpoint on which the wayside listens; auto: a free port of this machine."""
    plant: Presence = Presence.AUTO
    controller: Presence = Presence.AUTO
    controller_priority: int = 80
    """SCHED_FIFO priority if permitted; 0: none."""
    plant_priority: int = 70
    gateway_priority: int = 75
    bench_priority: int = 20
    """Priority of the bench's own threads; below that of all processes that it observes."""


@dataclass(frozen=True, slots=True)
class Parts:
    """Devices that the bench itself starts."""

    plant: bool
    controller: bool


def choose_parts(
    wires: RealtimeWires, *, bench: BenchKind, virtual: bool, heard: Collection[Node], where: str
) -> Parts:
    """Choose what the bench starts.

    Raises Blocked for a second device of a kind, or for none at all.

    Args:
        virtual: no real train can be connected to this bus.
        heard: the nodes that sent before the bench started anything.
    """
    controller_there = Node.VOBC in heard
    train_there = bool(set(heard) - {Node.VOBC})
    plant = _ours(wires.plant, train_there)
    controller = _ours(wires.controller, controller_there)
    if plant and train_there:
        names = ", ".join(sorted(node.name for node in heard if node is not Node.VOBC))
        raise Blocked(
            f"{where}: a train is there already ({names}); the bench cannot emulate a second one"
        )
    if controller and controller_there:
        raise Blocked(f"{where}: a controller is there already; two cannot drive one train")
    silent_train = plant and wires.plant is Presence.AUTO
    if silent_train and not virtual and not controller_there and bench is BenchKind.HARDWARE:
        raise Blocked(
            f"{where}: neither a train nor a controller sends; say which of them the bench "
            "shall start"
        )
    return Parts(plant, controller)


def _ours(presence: Presence, there: bool) -> bool:
    return not there if presence is Presence.AUTO else presence is Presence.OURS
