"""The monotonic clock of one node.

It starts at any value, drifts, and may be stepped.

Factors stay below 2**31, because compiled code stores larger products as objects.
"""

from typing import Final

MILLION: Final = 1_000_000


class NodeClock:
    """Local time as a function of true time, linear between two changes."""

    __slots__ = ("_local_ns", "_rate", "_true_ns")

    def __init__(self, true_ns: int, local_ns: int, drift_ppm: int = 0) -> None:
        self._true_ns, self._local_ns = true_ns, local_ns
        self._rate = MILLION + drift_ppm

    def local_ns(self, true_ns: int) -> int:
        """Return the node's clock reading at a true instant."""
        since_ns = true_ns - self._true_ns
        whole, rest = since_ns // MILLION, since_ns % MILLION
        return self._local_ns + whole * self._rate + rest * self._rate // MILLION

    def true_ns(self, local_ns: int) -> int:
        """Return the first true instant at which the node's clock has reached `local_ns`."""
        until_ns = self._local_ns - local_ns
        whole, rest = until_ns // self._rate, until_ns % self._rate
        return self._true_ns - (whole * MILLION + rest * MILLION // self._rate)

    def drift(self, true_ns: int, drift_ppm: int) -> None:
        """Change the drift, in parts per million fast, without a step of the reading."""
        self._local_ns, self._true_ns = self.local_ns(true_ns), true_ns
        self._rate = MILLION + drift_ppm

    def step(self, true_ns: int, by_ns: int) -> None:
        """Step the clock forwards or, as no sound monotonic clock does, backwards."""
        self._local_ns, self._true_ns = self.local_ns(true_ns) + by_ns, true_ns

    @property
    def drift_ppm(self) -> int:
        return self._rate - MILLION
