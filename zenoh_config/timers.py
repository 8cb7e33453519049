"""The times that trains and arbiters of one line have to agree on."""

from dataclasses import dataclass
from typing import Final

NS_PER_MS: Final = 1_000_000


@dataclass(frozen=True, slots=True)
class LineTimers:
    """All in whole milliseconds of monotonic clocks. Raises ValueError where they do not fit."""

    lease_ms: int = 300
    """An arbiter's grant lasts so long after the request was sent, and no longer."""
    renew_ms: int = 75
    cycle_ms: int = 100
    """A master issues authorities this often, and a train reports this often."""
    heartbeat_ms: int = 50
    silence_ms: int = 160
    """Heartbeats missing for so long let the standby apply for the lease."""
    rank_ms: int = 60
    """Each rank behind the standby waits so much longer."""
    authority_ms: int = 1000
    """An older authority is refused, and a held one has run out."""
    drift_ratio: float = 0.002
    """Two clocks run apart by no more than this, either way."""
    margin_ms: int = 10
    """From the last look at the clock to the message leaving, at most; nothing is issued later."""

    def __post_init__(self) -> None:
        for name in ("lease_ms", "renew_ms", "cycle_ms", "heartbeat_ms", "silence_ms", "rank_ms"):
            if getattr(self, name) <= 0:
                raise ValueError(f"{name} {getattr(self, name)} is not positive")
        if not 0.0 <= self.drift_ratio < 0.1:
            raise ValueError(f"drift_ratio {self.drift_ratio} is not in 0..0.1")
        if not self.lease_ms > 2 * self.renew_ms + self.margin_ms:
            raise ValueError(f"lease_ms {self.lease_ms} leaves no room for a lost renewal")
        if not self.silence_ms > 2 * self.heartbeat_ms:
            raise ValueError(f"silence_ms {self.silence_ms} leaves no room for a lost heartbeat")
        if not self.authority_ms > self.lease_ms + self.silence_ms:
            raise ValueError(
                f"authority_ms {self.authority_ms} does not outlast a change of master"
            )

    @property
    def holder_lease_ns(self) -> int:
        """What the holder may count on from the sending of its request, by its own clock."""
        return round(self.lease_ms * NS_PER_MS * (1.0 - self.drift_ratio))

    @property
    def arbiter_lease_ns(self) -> int:
        """What the arbiter waits out from the hearing of a request, by its own clock."""
        return round(self.lease_ms * NS_PER_MS * (1.0 + self.drift_ratio))


TIMERS_A: Final = LineTimers()
"""Default: any network."""
TIMERS_B: Final = LineTimers(
    lease_ms=120,
    renew_ms=30,
    cycle_ms=50,
    heartbeat_ms=20,
    silence_ms=70,
    rank_ms=30,
    authority_ms=600,
)
"""For a clean local network."""
TIMER_SETS: Final = {"A": TIMERS_A, "B": TIMERS_B}
