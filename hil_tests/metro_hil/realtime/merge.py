"""Puts frames and truth, which come over different ways, back into the order of their instants."""

import heapq
from collections.abc import Iterator
from typing import Final, Generic, TypeVar

T = TypeVar("T")

HOLD_NS: Final = 30_000_000
"""So long everything is held, for something older that is still on its way."""


class Merge(Generic[T]):
    """Held until it is older than `HOLD_NS`; what comes later than that is not put back."""

    def __init__(self) -> None:
        self._heap: list[tuple[int, int, T]] = []
        self._number = 0
        self._last_ns: int | None = None
        self.late = 0
        """Things that came after something younger had been let go; they get its instant."""

    def add(self, stamp_ns: int, thing: T) -> None:
        if self._last_ns is not None and stamp_ns < self._last_ns:
            self.late += 1
            stamp_ns = self._last_ns
        self._number += 1
        heapq.heappush(self._heap, (stamp_ns, self._number, thing))

    def due(self, now_ns: int) -> Iterator[tuple[int, T]]:
        """What is old enough, oldest first; of one instant what was added first."""
        return self._until(now_ns - HOLD_NS)

    def rest(self) -> Iterator[tuple[int, T]]:
        """Everything that is left, when nothing more can come."""
        while self._heap:
            yield self._pop()

    def _until(self, limit_ns: int) -> Iterator[tuple[int, T]]:
        while self._heap and self._heap[0][0] <= limit_ns:
            yield self._pop()

    def _pop(self) -> tuple[int, T]:
        stamp_ns, _, thing = heapq.heappop(self._heap)
        self._last_ns = stamp_ns
        return stamp_ns, thing
