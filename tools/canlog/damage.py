"""What a reader could not take as it stood: counted, and located by line or byte."""

from dataclasses import dataclass
from typing import Final

import numpy as np

from canlog.frames import ERROR, EXTENDED, Frames

PLACES_MAX: Final = 20
"""So many places of one kind of damage are remembered; all are counted."""
SHOWN_MAX: Final = 60


class LogError(Exception):
    """A log, DBC file or request that cannot be used; the text names it and says why."""


@dataclass(frozen=True, slots=True)
class Damage:
    """One kind of trouble in one log."""

    kind: str
    """Such as `junk line` or `corrupt container`."""
    count: int
    unit: str
    """What `places` count: line (the first is 1), byte (the first is 0) or frame."""
    places: tuple[int, ...]
    """Of the first PLACES_MAX."""
    detail: str
    """Of the first one."""

    def __str__(self) -> str:
        shown = ", ".join(str(place) for place in self.places[:3])
        more = ", ..." if self.count > 3 else ""
        where = f" at {self.unit} {shown}{more}" if self.places else ""
        return f"{self.count} x {self.kind}{where}: {self.detail}"


class Damages:
    """Collects damage while a log is read."""

    def __init__(self) -> None:
        self._counts: dict[str, int] = {}
        self._places: dict[str, list[int]] = {}
        self._firsts: dict[str, tuple[str, str]] = {}

    def add(self, kind: str, unit: str, place: int | None, detail: str, count: int = 1) -> None:
        """`place` of the first of `count`; None where there is none, as with what a log lacks."""
        self._counts[kind] = self._counts.get(kind, 0) + count
        self._firsts.setdefault(kind, (unit, detail))
        places = self._places.setdefault(kind, [])
        if place is not None and len(places) < PLACES_MAX:
            places.append(place)

    def all(self) -> tuple[Damage, ...]:
        return tuple(
            Damage(
                kind, count, self._firsts[kind][0], tuple(self._places[kind]), self._firsts[kind][1]
            )
            for kind, count in self._counts.items()
        )


def possible(frames: Frames, damages: Damages, place: int | None = None) -> Frames:
    """Without frames whose identifier is longer than it says, which are counted."""
    short = (frames.flags & np.uint8(EXTENDED | ERROR)) == 0
    good = (frames.identifier <= 0x7FF) | ~short
    good &= frames.identifier <= 0x1FFF_FFFF
    if good.all():
        return frames
    count = int(len(good) - good.sum())
    damages.add("impossible identifier", "byte", place, "more than 11 bits; left out", count)
    return frames[good]


def shown(raw: bytes | str) -> str:
    """The beginning of a bad line for a person to read."""
    text = raw.decode("ascii", "backslashreplace") if isinstance(raw, bytes) else raw
    text = text.rstrip("\r\n")
    return repr(text if len(text) <= SHOWN_MAX else text[: SHOWN_MAX - 3] + "...")
