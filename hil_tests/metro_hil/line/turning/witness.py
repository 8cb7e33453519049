"""Judges trains on a network in real time, by the true places that they report to the wayside."""

import itertools
from collections.abc import Iterable, Mapping
from math import inf
from typing import Final

from firmware_py.ports import RadioMessage
from firmware_py.trackdb.paths import Path
from metro_hil.line.turning.invariants import INTO_AUTHORITY, INTO_TRAIN, OVERLAP, PairViolation
from plant_emulator.wayside.network_places import TrainPlace, TrainPresence, read_place, train_of
from plant_emulator.wayside.separation import Stretch, apart

SKEW_S: Final = 1.0
"""Greatest difference between the instants of two places that are judged together. In that time an
authority grows by less than the distance that it keeps from a train."""


class NetworkWitness:
    """Checks all pairs of trains. Pure: it receives messages."""

    def __init__(self, paths: Iterable[Path]) -> None:
        self.violations: list[PairViolation] = []
        self.checked_count = 0
        """Number of checks of a pair."""
        self.skewed_count = 0
        """Number of pairs that were not checked, because their places are of different instants."""
        self.least_gap_m = inf
        """Least distance from a front to the next train ahead on its path."""
        self.places: dict[int, TrainPlace] = {}
        """The newest place of each train on the network."""
        self.gone: set[int] = set()
        """Trains that have made their last trip."""
        self._paths: Mapping[str, Path] = {path.line.name: path for path in paths}
        self._found: set[tuple[str, tuple[int, int]]] = set()

    def on_message(self, message: RadioMessage) -> None:
        """Take a place, and check its train against all others."""
        train, place = train_of(message.key), read_place(message)
        if train is None or place is None or place.path not in self._paths:
            return
        if place.presence is TrainPresence.PRESENT:
            self.places[train] = place
            for other in [each for each in self.places if each != train]:
                self._check(train, other)
        elif place.presence is TrainPresence.GONE:
            self.places.pop(train, None)
            self.gone.add(train)

    def _check(self, train: int, other: int) -> None:
        pair = self.places[train], self.places[other]
        if abs(pair[0].at_s - pair[1].at_s) > SKEW_S:
            self.skewed_count += 1
            return
        self.checked_count += 1
        for (one, one_place), (two, two_place) in itertools.permutations(
            zip((train, other), pair, strict=True)
        ):
            body, ahead = self._body(one_place), self._body(two_place)
            for low_m, _ in ahead.parts_on(body.path):
                if body.end_m <= low_m:
                    self.least_gap_m = min(self.least_gap_m, low_m - body.end_m)
            permitted, other_permitted = self._permitted(one_place), self._permitted(two_place)
            if apart(permitted, other_permitted):
                continue
            if not apart(body, ahead):
                self._note(OVERLAP, pair[0].at_s, min(one, two), max(one, two))
            elif not apart(permitted, ahead):
                self._note(INTO_TRAIN, pair[0].at_s, one, two)
            elif apart(body, other_permitted):
                self._note(INTO_AUTHORITY, pair[0].at_s, min(one, two), max(one, two))

    def _body(self, place: TrainPlace) -> Stretch:
        return Stretch(self._paths[place.path], place.rear_m, place.front_m)

    def _permitted(self, place: TrainPlace) -> Stretch:
        end_m = max(place.front_m, place.end_m)
        return Stretch(self._paths[place.path], place.rear_m, end_m)

    def _note(self, kind: str, at_s: float, one: int, other: int) -> None:
        """Note a violation at the first instant for these trains."""
        if (kind, (one, other)) not in self._found:
            self._found.add((kind, (one, other)))
            self.violations.append(PairViolation(kind, at_s, (f"train {one}", f"train {other}")))
