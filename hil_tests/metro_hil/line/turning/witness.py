"""Judges trains on a network in real time, by the true places that they report to the wayside."""

from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import Final

from firmware_py.ports import RadioMessage
from firmware_py.trackdb.paths import Path
from metro_hil.line.turning.invariants import Occupied, PairChecks
from plant_emulator.wayside.network_places import TrainPlace, TrainPresence, read_place, train_of
from plant_emulator.wayside.separation import Stretch

SKEW_S: Final = 1.0
"""Greatest difference between the instants of two places that are judged together. In that time an
authority grows by less than the distance that it keeps from a train."""


class NetworkWitness(PairChecks):
    """Checks all pairs of trains. Pure: it receives messages."""

    def __init__(self, paths: Iterable[Path]) -> None:
        super().__init__()
        self.skewed_count = 0
        """Number of pairs that were not checked, because their places are of different instants."""
        self.places: dict[int, TrainPlace] = {}
        """The newest place of each train on the network."""
        self.gone: set[int] = set()
        """Trains that have made their last trip."""
        self._paths: Mapping[str, Path] = {path.line.name: path for path in paths}

    def on_message(self, message: RadioMessage) -> tuple[int, TrainPlace] | None:
        """Take a place, and check its train against all others. Return both, or None for what is
        no place.
        """
        train, place = train_of(message.key), read_place(message)
        if train is None or place is None or place.path not in self._paths:
            return None
        if place.presence is TrainPresence.PRESENT:
            self.places[train] = place
            for other in [each for each in self.places if each != train]:
                self._compare(train, other)
        elif place.presence is TrainPresence.GONE:
            self.places.pop(train, None)
            self.gone.add(train)
        return train, place

    def _compare(self, train: int, other: int) -> None:
        at_s = self.places[train].at_s
        if abs(at_s - self.places[other].at_s) > SKEW_S:
            self.skewed_count += 1
            return
        self.checked_count += 1
        for one, two in ((train, other), (other, train)):
            names = f"train {one}", f"train {two}"
            self.check(at_s, names, self._occupied(one), self._occupied(two))

    def _occupied(self, train: int) -> Occupied:
        place = self.places[train]
        body = Stretch(self._paths[place.path], place.rear_m, place.front_m)
        return Occupied(body, replace(body, end_m=max(place.front_m, place.end_m)))
