"""One process of the simulated network, the state machine that it runs and the result of a step."""

from collections.abc import Callable, Collection, Sequence
from enum import Enum
from typing import Any, Final, NamedTuple, Protocol

from metro_hil.simulation.clocks import NodeClock
from metro_hil.simulation.links import SimulatedLink

NEVER: Final = 2**62


class QueuedMessage(NamedTuple):
    """A message and the nodes that receive it."""

    targets: Sequence[int]
    message: Any
    topic: int | None = None
    """Topic of the message; nodes tuned to other topics do not receive it."""


class NodeStep(NamedTuple):
    """Result of one step of a state machine."""

    letters: Sequence[QueuedMessage]
    keep: Any
    """What to store before the messages go out; the same object as before if nothing changed."""
    due_ns: int
    """When to step again if no message arrives, by the node's own clock."""
    apply: Callable[[], None] | None = None
    """What to do after storing and before sending."""


class NodeMachine(Protocol):
    """A state machine that runs on a node."""

    def step(self, now_ns: int, heard: Sequence[Any]) -> NodeStep: ...


class Doom(Enum):
    """Point within a step at which a node dies."""

    BEFORE_STORING = "before it stored"
    BEFORE_SENDING = "after it stored, before it sent"
    WHILE_SENDING = "after it sent half"


class SimulatedNode:
    """One process: its state machine while it runs, its disk, its clock and its inbox."""

    __slots__ = (
        *("address", "boots", "clock", "disk", "doom", "freeze_ns", "inbox", "links", "machine"),
        "minds",
        *("name", "slow_ns", "start", "stopped_until_ns", "tuned", "wake_ns"),
    )

    def __init__(
        self,
        address: int,
        name: str,
        start: Callable[["SimulatedNode", int], NodeMachine],
        clock: NodeClock,
    ) -> None:
        """`start` creates the state machine from the disk (None: empty) and the local time."""
        self.address, self.name, self.start, self.clock = address, name, start, clock
        self.machine: NodeMachine | None = None
        self.minds: Callable[[Any], bool] | None = None
        """Whether an arriving message wakes the node; other messages wait in the inbox for its next
        step. None: every message wakes it. Valid for the life of the state machine."""
        self.tuned: Collection[int] | None = None
        """Topics that the node receives; None: all."""
        self.disk: Any = None
        self.boots = 0
        self.inbox: list[Any] = []
        self.links: dict[int, SimulatedLink] = {}
        self.wake_ns = NEVER
        self.stopped_until_ns = 0
        self.slow_ns = 0
        self.doom: Doom | None = None
        self.freeze_ns = 0
        """Time for which the next step is held up between its decision and the sending."""
