"""What must hold between the trains of a network at every instant. Judged by true places."""

import itertools
from collections.abc import Mapping
from dataclasses import dataclass, replace
from math import inf
from typing import Final, NamedTuple

from plant_emulator.wayside.interlocking import Interlocking
from plant_emulator.wayside.separation import Stretch, apart

OVERLAP: Final = "two trains share a piece of track"
INTO_TRAIN: Final = "an authority reaches over the true rear or front of another train"
INTO_AUTHORITY: Final = "the authorities of two trains share a piece of track"
OVER_SWITCH: Final = "an authority reaches over a switch that is not locked for the train"
INTO_ROUTE: Final = "an authority reaches against the route of another train"
KNOWN_S: Final = 0.2
"""Time after which masters know that a switch has failed."""
KINDS: Final = (OVERLAP, INTO_TRAIN, INTO_AUTHORITY, OVER_SWITCH, INTO_ROUTE)


@dataclass(frozen=True, slots=True)
class PairViolation:
    """An invariant that does not hold, at the first instant for these trains."""

    kind: str
    at_s: float
    trains: tuple[str, ...]


class Observed(NamedTuple):
    """A train on the network."""

    routes: Interlocking
    authority_end_m: float | None
    authority_number: tuple[int, ...]
    """Changes with each authority that the train receives."""


class Between:
    """Checks all pairs of trains."""

    def __init__(self, known_s: float = 0.0) -> None:
        """Args:
        known_s: time after the failure of a switch in which authorities may still lead over it.
        """
        self._known_s = known_s
        self.violations: list[PairViolation] = []
        self.checked_count = 0
        """Number of checks of a pair."""
        self.least_gap_m = inf
        """Least distance from a front to the next train ahead on its path."""
        self._locked_m: dict[str, float] = {}
        """By train, where its authority was allowed to end at the check before."""
        self._failed_s: dict[str, float] = {}
        """By train, when a switch below its authority failed."""
        self._before_failure: dict[str, tuple[int, ...]] = {}
        """By train, the authority that was sent before a switch below it failed."""
        self._found: set[tuple[str, tuple[str, ...]]] = set()

    def look(self, at_s: float, present: Mapping[str, Observed]) -> None:
        """Check the trains on the network, by name."""
        permitted: dict[str, Stretch] = {}
        for name, (routes, end_m, number) in present.items():
            body = routes.body
            reach_m = body.end_m if end_m is None else max(body.end_m, end_m)
            permitted[name] = replace(body, end_m=reach_m)
            self._look_at_switches(at_s, name, routes, reach_m, number)
        for one, other in itertools.permutations(present, 2):
            self._check(
                at_s, (one, other), permitted, present[one].routes.body, present[other].routes
            )

    def _look_at_switches(
        self, at_s: float, name: str, routes: Interlocking, reach_m: float, number: tuple[int, ...]
    ) -> None:
        """A switch may fail below an authority. Only one that is sent later is a violation."""
        limit_m = max(routes.body.end_m, routes.unlocked_m)
        if reach_m > limit_m:
            if reach_m <= self._locked_m.get(name, -inf):
                self._failed_s[name] = at_s
            if at_s - self._failed_s.get(name, -inf) <= self._known_s:
                self._before_failure[name] = number
            if self._before_failure.get(name) != number:
                self._note(OVER_SWITCH, at_s, name)
        self._locked_m[name] = limit_m

    def _check(
        self,
        at_s: float,
        names: tuple[str, str],
        permitted: Mapping[str, Stretch],
        body: Stretch,
        ahead: Interlocking,
    ) -> None:
        self.checked_count += 1
        one, other = (permitted[name] for name in names)
        for low_m, _ in ahead.body.parts_on(body.path):
            if body.end_m <= low_m < body.end_m + self.least_gap_m:
                self.least_gap_m = low_m - body.end_m
        if not apart(one, other):
            if not apart(body, ahead.body):
                self._note(OVERLAP, at_s, *sorted(names))
            elif not apart(one, ahead.body):
                self._note(INTO_TRAIN, at_s, *names)
            elif apart(body, other):
                self._note(INTO_AUTHORITY, at_s, *sorted(names))
        against = {track: way.other for held in ahead.held for track, way in held.tracks.items()}
        if any(against.get(track) is way for track, way in one.tracks().items()):
            self._note(INTO_ROUTE, at_s, *names)

    def _note(self, kind: str, at_s: float, *trains: str) -> None:
        if (kind, trains) not in self._found:
            self._found.add((kind, trains))
            self.violations.append(PairViolation(kind, at_s, trains))
