"""One process of the simulated network, what runs in it, and what a step of that comes to."""

from collections.abc import Callable, Collection, Sequence
from enum import Enum
from typing import Any, Final, NamedTuple, Protocol

from metro_hil.simulation.clocks import NodeClock
from metro_hil.simulation.links import SimulatedLink

NEVER: Final = 2**62


class QueuedMessage(NamedTuple):
    """A message and the nodes that hear it."""

    targets: Sequence[int]
    message: Any
    topic: int | None = None
    """Not for those who are tuned to other topics only."""


class NodeStep(NamedTuple):
    """What one step of a machine came to."""

    letters: Sequence[QueuedMessage]
    keep: Any
    """To be stored before the letters go out; the same object as before: nothing new."""
    due_ns: int
    """On the node's own clock: when to step again even if nothing is heard."""
    apply: Callable[[], None] | None = None
    """What is to be done after storing and before sending."""


class NodeMachine(Protocol):
    """Whatever runs on a node."""

    def step(self, now_ns: int, heard: Sequence[Any]) -> NodeStep: ...


class Doom(Enum):
    """Where in a step a node is to die."""

    BEFORE_STORING = "before it stored"
    BEFORE_SENDING = "after it stored, before it sent"
    WHILE_SENDING = "after it sent half"


class SimulatedNode:
    """One process: its machine while it runs, its disk, its clock, its inbox."""

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
        """`start` makes the machine from what is on the disk (None: empty), at a local instant."""
        self.address, self.name, self.start, self.clock = address, name, start, clock
        self.machine: NodeMachine | None = None
        self.minds: Callable[[Any], bool] | None = None
        """Whether it looks at once at a message that comes; the others wait in the inbox until it
        steps for another reason. None: at all. For the life of its machine."""
        self.tuned: Collection[int] | None = None
        """Topics that it wants to hear; None: all."""
        self.disk: Any = None
        self.boots = 0
        self.inbox: list[Any] = []
        self.links: dict[int, SimulatedLink] = {}
        self.wake_ns = NEVER
        self.stopped_until_ns = 0
        self.slow_ns = 0
        self.doom: Doom | None = None
        self.freeze_ns = 0
        """Its next step is held up for so long between deciding and sending."""
