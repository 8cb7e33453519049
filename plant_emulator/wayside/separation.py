"""Keeps trains apart: the authority of each ends before the stretches of all others. Pure.

Each train keeps a stretch of its path from others: from the rear of the track reserved behind it to
the end of its authority. The stretches of two trains never share a piece of track. So a train
follows the reserved rear of the train ahead, and two trains that run towards each other keep apart
the ends of their authorities. A stretch over a crossing also bars the crossed track there.
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from math import inf
from typing import Final

from firmware_py.trackdb.network import Running
from firmware_py.trackdb.paths import Path

SPACE_M: Final = 10.0
"""Distance between the end of an authority and the stretch of another train, in case that train
rolls back."""

JOINT_M: Final = 1e-6
"""Rounding error between the ends of two tracks that join."""
REAR_M: Final = 12.0
"""Length of track reserved behind a train that has not reported yet."""


@dataclass(frozen=True, slots=True)
class Stretch:
    """A piece of a path, in the direction of running."""

    path: Path
    rear_m: float
    end_m: float

    def tracks(self) -> dict[str, Running]:
        """The tracks that the stretch touches, with its direction on each."""
        return {
            leg.track.name: leg.running
            for leg in self.path.legs
            if leg.from_m < self.end_m and self.rear_m < leg.to_m
        }

    def parts_on(self, path: Path) -> Iterator[tuple[float, float]]:
        """The parts that lie on another path, or bar it at a crossing, by that path's chainage."""
        for track, start_m, end_m in self._pieces():
            yield from _on(path, track, start_m, end_m)
            for crossing in self.path.crossings:
                barred = crossing.across(track, start_m, end_m)
                if barred is not None:
                    yield from _on(path, *barred)

    def pieces_on(self, path: Path) -> list[tuple[float, float]]:
        """The pieces that lie on another path, by that path's chainage, as few as possible."""
        found: list[tuple[float, float]] = []
        parts = [each for piece in self._pieces() for each in _on(path, *piece)]
        for low_m, high_m in sorted(parts):
            if found and low_m - found[-1][1] < JOINT_M:
                found[-1] = found[-1][0], high_m
            else:
                found.append((low_m, high_m))
        return found

    def _pieces(self) -> Iterator[tuple[str, float, float]]:
        """Each track of the stretch, with both ends by the chainage of the track."""
        for leg in self.path.legs:
            low_m, high_m = max(self.rear_m, leg.from_m), min(self.end_m, leg.to_m)
            if low_m < high_m:
                ends_m = leg.track_m(low_m), leg.track_m(high_m)
                yield leg.track.name, min(ends_m), max(ends_m)


def _on(path: Path, track: str, start_m: float, end_m: float) -> Iterator[tuple[float, float]]:
    for leg in path.legs:
        if leg.track.name == track:
            yield leg.section_m(start_m, end_m)


def limit_m(own: Stretch, others: Iterable[Stretch], *, space_m: float = SPACE_M) -> float:
    """Where an authority ends at most, so that it reaches into no other stretch; infinite without
    one ahead.

    A stretch is behind the train if all of it is behind the train's own rear. Of any other one the
    near end counts, even if it is behind the front: the authority then ends there.
    """
    near_m = inf
    for other in others:
        for low_m, high_m in other.parts_on(own.path):
            if high_m > own.rear_m:
                near_m = min(near_m, low_m - space_m)
    return near_m


def apart(one: Stretch, other: Stretch) -> bool:
    """Whether two stretches share no piece of track."""
    return all(
        high_m <= one.rear_m or low_m >= one.end_m for low_m, high_m in other.parts_on(one.path)
    )
