"""The monotonic clock of one node: it starts anywhere, drifts, and may be stepped."""

from typing import Final

MILLION: Final = 1_000_000


class NodeClock:
    """Local nanoseconds as a function of true ones; between two changes it is a straight line."""

    __slots__ = ("_local_ns", "_rate", "_true_ns")

    def __init__(self, true_ns: int, local_ns: int, drift_ppm: int = 0) -> None:
        self._true_ns, self._local_ns = true_ns, local_ns
        self._rate = MILLION + drift_ppm

    def local_ns(self, true_ns: int) -> int:
        """What the node reads at a true instant."""
        return self._local_ns + (true_ns - self._true_ns) * self._rate // MILLION

    def true_ns(self, local_ns: int) -> int:
        """The first true instant at which the node reads so much or more."""
        return self._true_ns + -((self._local_ns - local_ns) * MILLION // self._rate)

    def drift(self, true_ns: int, drift_ppm: int) -> None:
        """From now on it gains so many parts in a million; what it reads now stays."""
        self._local_ns, self._true_ns = self.local_ns(true_ns), true_ns
        self._rate = MILLION + drift_ppm

    def step(self, true_ns: int, by_ns: int) -> None:
        """It jumps, forwards or (which no sound monotonic clock does) backwards."""
        self._local_ns, self._true_ns = self.local_ns(true_ns) + by_ns, true_ns

    @property
    def drift_ppm(self) -> int:
        return self._rate - MILLION
