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


class Occupied(NamedTuple):
    """A train's own track, and that up to the end of its authority."""

    body: Stretch
    permitted: Stretch


class PairChecks:
    """What was found between pairs of trains, each violation at its first instant."""

    def __init__(self) -> None:
        self.violations: list[PairViolation] = []
        self.checked_count = 0
        """Number of checks of a pair."""
        self.least_gap_m = inf
        """Least distance from a front to the next train ahead on its path."""
        self._found: set[tuple[str, tuple[str, ...]]] = set()

    def check(self, at_s: float, names: tuple[str, str], one: Occupied, other: Occupied) -> None:
        """Check a train against another one; call it for both orders."""
        for low_m, _ in other.body.parts_on(one.body.path):
            if one.body.end_m <= low_m:
                self.least_gap_m = min(self.least_gap_m, low_m - one.body.end_m)
        if apart(one.permitted, other.permitted):
            return
        if not apart(one.body, other.body):
            self.note(OVERLAP, at_s, *sorted(names))
        elif not apart(one.permitted, other.body):
            self.note(INTO_TRAIN, at_s, *names)
        elif apart(one.body, other.permitted):
            self.note(INTO_AUTHORITY, at_s, *sorted(names))

    def note(self, kind: str, at_s: float, *trains: str) -> None:
        """Keep a violation unless these trains had it before."""
        if (kind, trains) not in self._found:
            self._found.add((kind, trains))
            self.violations.append(PairViolation(kind, at_s, trains))


class Between(PairChecks):
    """Checks all pairs of trains, and the routes below their authorities."""

    def __init__(self, known_s: float = 0.0) -> None:
        """Args:
        known_s: time after the failure of a switch in which authorities may still lead over it.
        """
        super().__init__()
        self._known_s = known_s
        self._locked_m: dict[str, float] = {}
        """By train, where its authority was allowed to end at the check before."""
        self._failed_s: dict[str, float] = {}
        """By train, when a switch below its authority failed."""
        self._before_failure: dict[str, tuple[int, ...]] = {}
        """By train, the authority that was sent before a switch below it failed."""

    def look(self, at_s: float, present: Mapping[str, Observed]) -> None:
        """Check the trains on the network, by name."""
        seen: dict[str, Occupied] = {}
        for name, (routes, end_m, number) in present.items():
            body = routes.body
            reach_m = body.end_m if end_m is None else max(body.end_m, end_m)
            seen[name] = Occupied(body, replace(body, end_m=reach_m))
            self._look_at_switches(at_s, name, routes, reach_m, number)
        for one, other in itertools.permutations(present, 2):
            self.checked_count += 1
            self.check(at_s, (one, other), seen[one], seen[other])
            self._look_at_routes(at_s, (one, other), seen[one].permitted, present[other].routes)

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
                self.note(OVER_SWITCH, at_s, name)
        self._locked_m[name] = limit_m

    def _look_at_routes(
        self, at_s: float, names: tuple[str, str], permitted: Stretch, ahead: Interlocking
    ) -> None:
        against = {track: way.other for held in ahead.held for track, way in held.tracks.items()}
        if any(against.get(track) is way for track, way in permitted.tracks().items()):
            self.note(INTO_ROUTE, at_s, *names)
