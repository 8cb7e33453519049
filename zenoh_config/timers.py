"""Times that trains and arbiters of one line must agree on."""

from dataclasses import dataclass
from typing import Final

NS_PER_MS: Final = 1_000_000


@dataclass(frozen=True, slots=True)
class LineTimers:
    """All times in whole milliseconds of monotonic clocks.

    Raises ValueError for contradictory times.
    """

    lease_ms: int = 300
    """Duration of an arbiter's grant, counted from the sending of the request."""
    renew_ms: int = 75
    cycle_ms: int = 100
    """Period of a master's authorities and of a train's reports."""
    heartbeat_ms: int = 50
    silence_ms: int = 160
    """Time without heartbeats after which the standby applies for the lease."""
    rank_ms: int = 60
    """Additional wait for each rank behind the standby."""
    authority_ms: int = 1000
    """Age at which an authority is refused, and at which a held one expires."""
    drift_ratio: float = 0.002
    """Largest relative rate error between two clocks."""
    margin_ms: int = 10
    """Maximum time from the last reading of the clock to the departure of a message; later nothing
    is issued."""

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
    def round_trip_max_ms(self) -> int:
        """Network budget: time within which a majority of arbiters must answer.

        One renewal of the lease may then be lost. A train still commands in a slower network, but
        its lease ends with the first lost message.
        """
        return self.lease_ms - 2 * self.renew_ms - self.margin_ms

    @property
    def holder_lease_ns(self) -> int:
        """Lease time that the holder may rely on from sending its request, by its own clock."""
        return round(self.lease_ms * NS_PER_MS * (1.0 - self.drift_ratio))

    @property
    def arbiter_lease_ns(self) -> int:
        """Time that the arbiter waits from receiving a request, by its own clock."""
        return round(self.lease_ms * NS_PER_MS * (1.0 + self.drift_ratio))


TIMERS_A: Final = LineTimers()
"""Default, for a local or metropolitan network."""
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
TIMERS_C: Final = LineTimers(
    lease_ms=800,
    renew_ms=200,
    cycle_ms=200,
    heartbeat_ms=100,
    silence_ms=500,
    rank_ms=150,
    authority_ms=5000,
)
"""For a public radio network (LTE, 5G) with 40 to 150 ms one way."""
TIMER_SETS: Final = {"A": TIMERS_A, "B": TIMERS_B, "C": TIMERS_C}
