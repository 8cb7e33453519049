"""A node of a bus in virtual time with error confinement: its mailboxes, counters and state."""

from dataclasses import dataclass, field
from heapq import heappop, heappush
from typing import NamedTuple

from firmware_py.buses.confinement import (
    RECOVERY_SEQUENCES,
    ErrorCounters,
    ErrorState,
    unacknowledged_bits,
)
from firmware_py.buses.inproc import Offer, VirtualPort


@dataclass(slots=True, eq=False)
class BusNode:
    """State of one node.

    Instants are those of the bus; `sequence_ns` is the time of eleven bits.
    """

    port: VirtualPort
    sequence_ns: int
    waiting: dict["BusNode", None]
    """All nodes of the bus that have frames in their mailboxes."""
    offers: list[Offer] = field(default_factory=list)
    """Frames in the mailboxes as a heap, the lowest identifier first."""
    errors: ErrorCounters = field(default_factory=ErrorCounters)
    state: ErrorState = ErrorState.ACTIVE
    """Last state of which there is an event; `present_state` is newer while the state changes."""
    ready_ns: int = 0
    """Earliest instant at which the node may start a frame."""
    cut_ns: int = -1
    """Instant at which the node was cut off; -1 if it is not cut off."""
    tries_ns: int = -1
    """Instant since which the cut-off node has had a frame to send; -1 while it has none."""
    tries_bits: int = 0
    """Length of the frame that the cut-off node repeats."""
    babble_gap_ns: int = -1
    """Gap between the end of a babbled frame and the next; -1 for a node that does not babble."""
    reported: ErrorState = ErrorState.ACTIVE
    """State that the node itself reports; the worse of this and that of `errors` holds."""
    restarting: bool = False
    sequences: int = 0
    """Number of sequences of eleven recessive bits since the restart."""
    idle_from_ns: int = 0
    """Start of the recessive bits that are not counted yet."""

    @property
    def there(self) -> bool:
        return not self.errors.off and self.cut_ns < 0 and self.reported is not ErrorState.OFF

    @property
    def present_state(self) -> ErrorState:
        """The error state that holds now."""
        own = self.errors.state
        if own is ErrorState.ACTIVE or self.reported is ErrorState.OFF:
            return self.reported
        return own

    def push(self, offer: Offer) -> None:
        heappush(self.offers, offer)
        self.waiting[self] = None
        self.port._waiting += 1

    def pop(self) -> Offer:
        """Take the frame that is sent next."""
        self.port._waiting -= 1
        offer = heappop(self.offers)
        if not self.offers:
            del self.waiting[self]
        return offer

    def drop_all(self) -> int:
        """Empty the mailboxes and return the number of dropped frames."""
        count = len(self.offers)
        self.offers.clear()
        self.waiting.pop(self, None)
        self.port._waiting -= count
        return count

    def begin_tries(self, now_ns: int, bits: int) -> None:
        """Record the first frame that the node has to send while it is cut off."""
        if self.tries_ns < 0:
            self.tries_ns, self.tries_bits = now_ns, bits

    def count_tries(self, now_ns: int, bit_ns: int) -> None:
        """Count the unacknowledged attempts made while the node was cut off, until it is error
        passive.
        """
        if self.tries_ns < 0:
            return
        tries = (now_ns - self.tries_ns) // (bit_ns * unacknowledged_bits(self.tries_bits))
        while tries > 0 and self.errors.state is ErrorState.ACTIVE:
            self.errors.nobody_acknowledged()
            tries -= 1

    def restart(self, now_ns: int, free_ns: int) -> None:
        """Start waiting for 128 times eleven recessive bits.

        `free_ns` is the end of the frame on the wire.
        """
        self.restarting, self.sequences, self.idle_from_ns = True, 0, now_ns
        if free_ns - self.sequence_ns >= now_ns and self.cut_ns < 0:
            # The frame on the wire, like any other, ends in eleven recessive bits.
            self.sequences, self.idle_from_ns = 1, free_ns

    def pass_frame(self, start_ns: int, free_ns: int) -> None:
        """Count the recessive bits up to this frame, and those at its end."""
        if self.restarting and self.cut_ns < 0:
            self.sequences += (start_ns - self.idle_from_ns) // self.sequence_ns + 1
            self.idle_from_ns = free_ns

    def recovered_ns(self, now_ns: int) -> int | None:
        """Return the instant at which a restarting node recovers, if that is not later than now."""
        if not self.restarting:
            return None
        left = max(0, RECOVERY_SEQUENCES - self.sequences)
        back_ns = self.idle_from_ns + left * self.sequence_ns
        return back_ns if back_ns <= now_ns else None


@dataclass(slots=True)
class Passing:
    """The frame on the wire."""

    offer: Offer
    node: BusNode
    start_ns: int
    end_ns: int
    bits: int
    """Length up to the earliest start of the next frame."""
    destroyed: bool = False
    acknowledged: bool = True
    gone: bool = False
    """The sender was cut off during the frame."""
    last_try: bool = False
    """The sender does not repeat this frame."""


class WireEvent(NamedTuple):
    """A node entered another error state."""

    at_ns: int
    node: str
    state: ErrorState
