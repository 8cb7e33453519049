"""What was heard and not acted on, gathered so that a flood of it becomes one event a second."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

EVERY_NS: Final = 1_000_000_000
"""Of one key and reason at most one note in this time."""
KEYS_MAX: Final = 64
"""Of a babbling node with ever new identifiers; the rest are counted under the last key."""

Key = tuple[int, str]
"""Identifier (0 where there is none) and reason."""
OTHERS: Final[Key] = (0, "of further kinds")


@dataclass(frozen=True, slots=True)
class Refusal:
    """Refused since the note before: how many, of what, why."""

    number: int
    """Identifier of the frames; 0 for messages and for what is too much to be told apart."""
    reason: str
    count: int
    detail: str
    """Of the last one, for a person to read."""


class Refusals:
    """Counts all of them; hands each key and reason out once a second at most."""

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
        """Cheap: whether there is anything that `due` might hand out."""
        return bool(self._waiting)

    def due(self, now_ns: int) -> Sequence[Refusal]:
        """What may be told now, in the order in which it was first refused."""
        found = []
        for key, (count, detail) in tuple(self._waiting.items()):
            told_ns = self._told_ns.get(key)
            if told_ns is not None and now_ns - told_ns < EVERY_NS:
                continue
            self._told_ns[key] = now_ns
            del self._waiting[key]
            found.append(Refusal(*key, count, detail))
        return found
