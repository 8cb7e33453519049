"""Which wires a case in real time uses, and who sits at their ends."""

import enum
from collections.abc import Collection
from dataclasses import dataclass
from typing import Final

from can_dbc.nodes import Node
from metro_hil.model.case import BenchKind

AUTO: Final = "auto"


class Blocked(Exception):  # noqa: N818 - no mistake of anybody's: the verdict of a case
    """What the case needs cannot come about on this bench; the text says why."""


class Presence(enum.Enum):
    """Who brings a device along."""

    AUTO = "auto"
    """On buses of the bench's own: the bench. Elsewhere: the bench, unless it is heard there."""
    OURS = "ours"
    """The bench starts it."""
    ELSEWHERE = "elsewhere"
    """It is there already, or comes by itself."""


@dataclass(frozen=True, slots=True)
class RealtimeWires:
    """As the user names them; `auto` leaves the choice to the bench."""

    bus_a: str = AUTO
    """The controller's segment, such as `socketcan:can0`; auto: an embedded bus for each case."""
    bus_b: str = AUTO
    """The train's segment, used only by cases with faults of the bus. Auto: another embedded bus
    where `bus_a` is one, else none."""
    tags: str = AUTO
    """Serial line of the tag reader, such as `/dev/ttyUSB0`; auto: a pseudo-terminal."""
    radio: str = AUTO
    """Where the wayside listens; auto: a free port of this machine."""
    plant: Presence = Presence.AUTO
    controller: Presence = Presence.AUTO
    controller_priority: int = 80
    """Of SCHED_FIFO, where the rights allow it; 0: none."""
    plant_priority: int = 70
    gateway_priority: int = 75
    bench_priority: int = 20
    """Of the bench's own listening; below all that it listens to."""


@dataclass(frozen=True, slots=True)
class Parts:
    """What the bench itself starts."""

    plant: bool
    controller: bool


def choose_parts(
    wires: RealtimeWires, *, bench: BenchKind, virtual: bool, heard: Collection[Node], where: str
) -> Parts:
    """Raises Blocked when two of a kind would meet, or nobody would be there at all.

    Args:
        virtual: no train can hang on this bus.
        heard: the nodes that spoke on it before anything was started.
    """
    controller_there = Node.VOBC in heard
    train_there = bool(set(heard) - {Node.VOBC})
    plant = _ours(wires.plant, train_there)
    controller = _ours(wires.controller, controller_there)
    if plant and train_there:
        names = ", ".join(sorted(node.name for node in heard if node is not Node.VOBC))
        raise Blocked(f"{where}: a train is there already ({names}); none can be emulated beside")
    if controller and controller_there:
        raise Blocked(f"{where}: a controller is there already; two cannot drive one train")
    silent_train = plant and wires.plant is Presence.AUTO
    if silent_train and not virtual and not controller_there and bench is BenchKind.HARDWARE:
        raise Blocked(
            f"{where}: neither a train nor a controller is heard; say which of them the bench "
            "shall bring along"
        )
    return Parts(plant, controller)


def _ours(presence: Presence, there: bool) -> bool:
    return not there if presence is Presence.AUTO else presence is Presence.OURS
