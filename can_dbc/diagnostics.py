"""Time, heartbeats and emergency messages of CANopen (CiA 301), and the train's load."""

import enum
from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar, Final, TypeVar

from can_dbc.binding import Frame, complete, frame
from can_dbc.nodes import Node

F = TypeVar("F", bound=Frame)


class NodeState(enum.IntEnum):
    """CANopen NMT states in heartbeats."""

    BOOT_UP = 0
    STOPPED = 4
    OPERATIONAL = 5
    PRE_OPERATIONAL = 127


@dataclass(frozen=True, slots=True)
class NodeHeartbeat:
    """Heartbeat that every node sends every second; `HEARTBEATS` has the class of each node."""

    node: ClassVar[Node]
    state: NodeState


@dataclass(frozen=True, slots=True)
class Emergency:
    """Emergency message, sent once when an error appears and once, with code 0, when it is gone.

    `EMERGENCIES` has the class of each node.
    """

    node: ClassVar[Node]
    error_code: int
    """Code of CiA 301 table 26, or a manufacturer's code from 0xFF00 on."""
    error_register: int
    detail: int
    """The manufacturer's 40 bits; their meaning depends on the code."""


def _one_for_each_node(base: type[F], prefix: str) -> Mapping[Node, type[F]]:
    """Create a subclass of `base` for every node, bound to the message PREFIX_NODE."""
    return {
        node: frame("diagnostics.dbc", f"{prefix}_{node.name}")(
            type(f"{base.__name__}{node.name.capitalize()}", (base,), _members(node))
        )
        for node in Node
    }


def _members(node: Node) -> dict[str, object]:
    return {"__slots__": (), "__module__": __name__, "node": node}


HEARTBEATS: Final = _one_for_each_node(NodeHeartbeat, "HEARTBEAT")
"""Heartbeat class of each node: `HEARTBEATS[Node.BCU](NodeState.OPERATIONAL)` is a heartbeat of the
brake control unit."""
EMERGENCIES: Final = _one_for_each_node(Emergency, "EMCY")


@frame("diagnostics.dbc", "TCMS_STATUS")
@dataclass(frozen=True, slots=True)
class TcmsStatus:
    load_kg: float
    """Mass of all passengers, measured by the air springs."""
    cars: int


@frame("diagnostics.dbc", "TIME_OF_DAY")
@dataclass(frozen=True, slots=True)
class TimeOfDay:
    since_midnight_ms: float
    days_since_1984: int


complete("diagnostics.dbc")
