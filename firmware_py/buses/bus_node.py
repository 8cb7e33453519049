"""A node of a bus in virtual time for error confinement: its mailboxes, counters and state."""

from dataclasses import dataclass, field
from heapq import heappush
from typing import NamedTuple

from firmware_py.buses.confinement import (
    RECOVERY_SEQUENCES,
    ErrorCounters,
    ErrorState,
    unacknowledged_bits,
)
from firmware_py.buses.inproc import InprocPort, Offer


@dataclass(slots=True, eq=False)
class BusNode:
    """Instants are those of the bus; `sequence_ns` is the time of eleven bits on it."""

    port: InprocPort
    sequence_ns: int
    offers: list[Offer] = field(default_factory=list)
    """A heap: the lowest identifier first."""
    errors: ErrorCounters = field(default_factory=ErrorCounters)
    state: ErrorState = ErrorState.ACTIVE
    """As last told; `errors.state` is ahead of it while the state is being entered."""
    ready_ns: int = 0
    """Before that it starts no frame."""
    cut_ns: int = -1
    """Since when it is cut off; -1 for a node that is not."""
    tries_ns: int = -1
    """Since when it has had something to say while cut off; -1 as long as it has not."""
    tries_bits: int = 0
    """Of the frame that it then says over and over."""
    babble_gap_ns: int = -1
    """From the end of a frame to the next; -1 for a node that says only what it is given."""
    restarting: bool = False
    sequences: int = 0
    """Of eleven recessive bits, seen since the restart."""
    idle_from_ns: int = 0
    """Not counted yet, but recessive from here on."""

    @property
    def there(self) -> bool:
        return not self.errors.off and self.cut_ns < 0

    def push(self, offer: Offer) -> None:
        heappush(self.offers, offer)
        self.port._waiting += 1

    def drop_all(self) -> int:
        """Empty its mailboxes; says how many frames there were."""
        count = len(self.offers)
        self.offers.clear()
        self.port._waiting -= count
        return count

    def begin_tries(self, now_ns: int, bits: int) -> None:
        """It is given a frame of this length while it is cut off."""
        if self.tries_ns < 0:
            self.tries_ns, self.tries_bits = now_ns, bits

    def count_tries(self, now_ns: int, bit_ns: int) -> None:
        """Cut off, it has heard no acknowledgement, and so becomes passive; mended now."""
        if self.tries_ns < 0:
            return
        tries = (now_ns - self.tries_ns) // (bit_ns * unacknowledged_bits(self.tries_bits))
        while tries > 0 and self.errors.state is ErrorState.ACTIVE:
            self.errors.nobody_acknowledged()
            tries -= 1

    def restart(self, now_ns: int, free_ns: int) -> None:
        """Wait for 128 times eleven recessive bits. `free_ns`: end of what is on the wire."""
        self.restarting, self.sequences, self.idle_from_ns = True, 0, now_ns
        if free_ns - self.sequence_ns >= now_ns and self.cut_ns < 0:
            # The frame that is on the wire, like any other, ends in eleven recessive bits.
            self.sequences, self.idle_from_ns = 1, free_ns

    def pass_frame(self, start_ns: int, free_ns: int) -> None:
        """Count the recessive bits up to this frame, and those at its end."""
        if self.restarting and self.cut_ns < 0:
            self.sequences += (start_ns - self.idle_from_ns) // self.sequence_ns + 1
            self.idle_from_ns = free_ns

    def recovered_ns(self, now_ns: int) -> int | None:
        """When a node that waits for it has come back, if that is not later than now."""
        if not self.restarting:
            return None
        left = max(0, RECOVERY_SEQUENCES - self.sequences)
        back_ns = self.idle_from_ns + left * self.sequence_ns
        return back_ns if back_ns <= now_ns else None


@dataclass(slots=True)
class Passing:
    """What is on the wire."""

    offer: Offer
    node: BusNode
    start_ns: int
    end_ns: int
    bits: int
    """Up to where the next frame may start."""
    destroyed: bool = False
    acknowledged: bool = True
    gone: bool = False
    """The sender was cut off meanwhile."""
    last_try: bool = False
    """The sender has nothing more to say."""


class WireEvent(NamedTuple):
    """A node that entered another state."""

    at_ns: int
    node: str
    state: ErrorState
