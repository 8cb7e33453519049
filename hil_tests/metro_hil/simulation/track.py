"""True state of the track: trains on it, occupied sections and locked objects."""

import itertools
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Final

from firmware_py.trackdb.areas import AreaMap
from metro_hil.simulation.true_train import TrueTrain

AXLE_INSET_M: Final = 2.0
"""Distance of the first and last axle from the ends of the train."""


@dataclass(slots=True)
class TrueObject:
    """True state of a switch, crossing or platform track."""

    number: int
    area: int
    start_m: float
    end_m: float
    locked: bool = False
    """An unlocked object may move or stand open at any moment."""
    release_wanted: bool = False


class TrueTrack:
    """Axle counters and objects of the line."""

    def __init__(self, line: AreaMap, trains: Sequence[TrueTrain]) -> None:
        self.line = line
        self.trains = trains
        self.objects = {
            site.number: TrueObject(
                site.number, line.area_at(site.start_m).number, site.start_m, site.end_m
            )
            for site in line.objects
        }
        self.disturbed: frozenset[int] = frozenset()
        """Numbers of sections whose axle counters are disturbed and cannot be trusted."""
        self._sections = [(s.number, s.start_m, s.end_m) for s in line.sections]

    def advance(self, now_ns: int) -> None:
        """Bring all trains to their position at this instant."""
        for train in self.trains:
            if train.on_line:
                train.motion.advance(now_ns)

    def axles(self) -> dict[int, int]:
        """Return the number of axles in each occupied section."""
        counts: dict[int, int] = {}
        for train in self.trains:
            if not train.on_line:
                continue
            rear_m, front_m = train.rear_m, train.front_m
            axles = train.axles
            pitch_m = (train.length_m - 2.0 * AXLE_INSET_M) / (axles - 1)
            for number, start_m, end_m in self._sections:
                if start_m < front_m and rear_m < end_m:
                    first_m = rear_m + AXLE_INSET_M
                    before = _axles_before(start_m, first_m, pitch_m, axles)
                    inside = _axles_before(end_m, first_m, pitch_m, axles) - before
                    if inside:
                        counts[number] = counts.get(number, 0) + inside
        return counts

    def joined_to(self, train: TrueTrain) -> list[TrueTrain]:
        """Return the trains that no empty section separates from this one, itself included."""
        axles = self.axles().keys() | self.disturbed
        for taken, sections in itertools.groupby(self._sections, lambda each: each[0] in axles):
            spans = [(start_m, end_m) for _, start_m, end_m in sections]
            joined = [e for e in self.trains if _has_axles(e, spans[0][0], spans[-1][1])]
            if taken and train in joined:
                return joined
        return []

    def occupied(self, thing: TrueObject) -> bool:
        return any(_touches(train, thing.start_m, thing.end_m) for train in self.trains)


def _axles_before(at_m: float, first_m: float, pitch_m: float, axles: int) -> int:
    return min(axles, max(0, -int((first_m - at_m) // pitch_m)))


def _has_axles(train: TrueTrain, start_m: float, end_m: float) -> bool:
    """Tell whether at least one axle of the train stands on this stretch."""
    first_m, last_m = train.rear_m + AXLE_INSET_M, train.front_m - AXLE_INSET_M
    return train.on_line and first_m < end_m and start_m <= last_m


def _touches(train: TrueTrain, start_m: float, end_m: float) -> bool:
    return train.on_line and train.rear_m < end_m and start_m < train.front_m


def stretch(start_m: float, length_m: float, pieces: int) -> Iterable[tuple[int, float, float]]:
    """Return number, start and end of equal pieces, numbered from 1."""
    each_m = length_m / pieces
    return [(n + 1, start_m + n * each_m, start_m + (n + 1) * each_m) for n in range(pieces)]
