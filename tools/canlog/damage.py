"""Damage in a log: what a reader could not use, counted and located by line or byte."""

from dataclasses import dataclass
from typing import Final

STANDARD_MAX: Final = 0x7FF
EXTENDED_MAX: Final = 0x1FFF_FFFF
PLACES_MAX: Final = 20
"""Places remembered per kind of damage; the count covers all of them."""
SHOWN_MAX: Final = 60


class LogError(Exception):
    """A log, DBC file or request that cannot be used; the text names it and says why."""


@dataclass(frozen=True, slots=True)
class Damage:
    """All damage of one kind in one log."""

    kind: str
    """Kind of damage, such as `junk line` or `corrupt container`."""
    count: int
    unit: str
    """What `places` count: lines from 1, bytes from 0, or frames."""
    places: tuple[int, ...]
    """Places of the first PLACES_MAX cases."""
    detail: str
    """Description of the first case."""

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
        self.skipped: dict[str, int] = {}
        """Counts of what a format contains besides CAN frames; this is not damage."""

    def skip(self, kind: str, count: int = 1) -> None:
        self.skipped[kind] = self.skipped.get(kind, 0) + count

    def add(self, kind: str, unit: str, place: int | None, detail: str, count: int = 1) -> None:
        """Count damage.

        Args:
            place: place of the first of `count` cases; None without one, as for a missing date.
        """
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


def shown(raw: bytes | str) -> str:
    """Return the beginning of a bad line as text for people."""
    text = raw.decode("ascii", "backslashreplace") if isinstance(raw, bytes) else raw
    text = text.rstrip("\r\n")
    return repr(text if len(text) <= SHOWN_MAX else text[: SHOWN_MAX - 3] + "...")
