"""Merges frames and truth, which arrive on different ways, in the order of their instants."""

import heapq
from collections.abc import Iterator
from typing import Final, Generic, TypeVar

T = TypeVar("T")

HOLD_NS: Final = 30_000_000
"""Time for which items are held, for an older one that is still on its way."""


class Merge(Generic[T]):
    """Holds each item until it is older than `HOLD_NS`; the order of later arrivals is lost."""

    def __init__(self) -> None:
        self._heap: list[tuple[int, int, T]] = []
        self._number = 0
        self._last_ns: int | None = None
        self.late = 0
        """Number of items that arrived after a younger one was released; they get its instant."""

    def add(self, stamp_ns: int, thing: T) -> None:
        if self._last_ns is not None and stamp_ns < self._last_ns:
            self.late += 1
            stamp_ns = self._last_ns
        self._number += 1
        heapq.heappush(self._heap, (stamp_ns, self._number, thing))

    def due(self, now_ns: int) -> Iterator[tuple[int, T]]:
        """Yield the items that are old enough, oldest first; equal instants keep their order."""
        return self._until(now_ns - HOLD_NS)

    def rest(self) -> Iterator[tuple[int, T]]:
        """Yield all remaining items when no more can arrive."""
        while self._heap:
            yield self._pop()

    def _until(self, limit_ns: int) -> Iterator[tuple[int, T]]:
        while self._heap and self._heap[0][0] <= limit_ns:
            yield self._pop()

    def _pop(self) -> tuple[int, T]:
        stamp_ns, _, thing = heapq.heappop(self._heap)
        self._last_ns = stamp_ns
        return stamp_ns, thing
