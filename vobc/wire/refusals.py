"""Collects refusals, so that a flood of them makes one event per second."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

EVERY_NS: Final = 1_000_000_000
"""Least interval between two reports of the same key and reason."""
KEYS_MAX: Final = 64
"""Greatest number of keys, against a node that floods the bus with new identifiers. More are
counted under one key."""

Key = tuple[int, str]
"""Identifier, or 0 if there is none, and reason."""
OTHERS: Final[Key] = (0, "of further kinds")


@dataclass(frozen=True, slots=True)
class Refusal:
    """Refusals since the last report: identifier, reason, number."""

    number: int
    """Identifier of the frames. 0 for messages and for refusals beyond the number of keys."""
    reason: str
    count: int
    detail: str
    """Detail of the last one as text."""


class Refusals:
    """Counts refusals and reports each key and reason at most once per second."""

    def __init__(self) -> None:
        self.totals: Counter[Key] = Counter()
        self._waiting: dict[Key, tuple[int, str]] = {}
        self._told_ns: dict[Key, int] = {}

    def note(self, number: int, reason: str, detail: str, count: int = 1) -> None:
        key = (number, reason)
        if key not in self.totals and len(self.totals) >= KEYS_MAX:
            key = OTHERS
        self.totals[key] += count
        before, _ = self._waiting.get(key, (0, ""))
        self._waiting[key] = (before + count, detail)

    @property
    def waiting(self) -> bool:
        """Whether `due` might have something to report. This check is cheap."""
        return bool(self._waiting)

    def due(self, now_ns: int) -> Sequence[Refusal]:
        """Refusals to report now, in the order of their first occurrence."""
        found = []
        for key, (count, detail) in tuple(self._waiting.items()):
            told_ns = self._told_ns.get(key)
            if told_ns is not None and now_ns - told_ns < EVERY_NS:
                continue
            self._told_ns[key] = now_ns
            del self._waiting[key]
            found.append(Refusal(*key, count, detail))
        return found
