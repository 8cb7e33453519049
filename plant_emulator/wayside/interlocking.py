"""An interlocking: sets routes over switches, locks them, and releases them behind the train.

A route leads from a signal over one switch, or over several without room for a signal between
them, to the next signal. A signal stands before each switch on every track that leads to it. The
module is pure: it receives time and place of the train.
"""

import enum
import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from math import inf
from typing import Final

from firmware_py.trackdb.network import Running, TrackNetwork, TrackSwitch
from firmware_py.trackdb.network_file import route_path
from firmware_py.trackdb.paths import Leg, Path

SIGNAL_M: Final = 20.0
"""Distance of a signal from its switch. A vehicle that stands there clears the other leg."""
SHORT_M: Final = 100.0
"""Length below which a track between two switches has no signals and belongs to the routes over
both."""
CLEAR_M: Final = 10.0
"""Distance of the rear beyond a switch at which the switch is released."""
LOOK_AHEAD_M: Final = 1200.0
"""Distance before a signal at which the route behind it is requested. It exceeds the braking
distance of every train, so that no train brakes for a signal that will clear."""
MOVE_S: Final = 4.0
"""Time in which a switch moves from one end position to the other."""
TRAIN: Final = "train"
NS_PER_S: Final = 1_000_000_000


class Lie(enum.Enum):
    """End position of a switch: the leg that it connects to its tip."""

    LEFT = "left"
    RIGHT = "right"

    @property
    def other(self) -> "Lie":
        return Lie.RIGHT if self is Lie.LEFT else Lie.LEFT


@dataclass(frozen=True, slots=True)
class SwitchOnPath:
    """A switch on a path, with the end position that the path needs."""

    switch: str
    lie: Lie
    at_m: float


@dataclass(frozen=True, slots=True)
class RouteSection:
    """The route from one signal of a path to the next."""

    signal_m: float
    crossings: tuple[SwitchOnPath, ...]
    tracks: tuple[Leg, ...]
    """Tracks behind the first switch, up to the next signal."""
    flank: tuple[tuple[str, Lie], ...]
    """Switches beside the route, with the end position that leads away from it."""

    @property
    def locks(self) -> tuple[tuple[str, Lie, bool], ...]:
        """Every switch that the route locks, its end position, and whether the route uses it."""
        used = tuple((each.switch, each.lie, True) for each in self.crossings)
        return used + tuple((switch, lie, False) for switch, lie in self.flank)


def sections_of(network: TrackNetwork, path: Path) -> tuple[RouteSection, ...]:
    """The routes along a path, in running order."""
    groups: list[tuple[float, list[SwitchOnPath], list[Leg]]] = []
    for leg, ahead in itertools.pairwise(path.legs):
        crossing = _crossing(network, leg, ahead)
        if crossing is None:
            if groups:
                groups[-1][2].append(ahead)
        elif groups and groups[-1][2] == [leg] and _is_short(leg):
            groups[-1][1].append(crossing)
            groups[-1][2].append(ahead)
        else:
            groups.append((leg.to_m - SIGNAL_M, [crossing], [ahead]))
    return tuple(
        RouteSection(
            signal_m,
            tuple(crossings),
            tuple(legs),
            tuple(each for crossing in crossings for each in _flank(network, crossing)),
        )
        for signal_m, crossings, legs in groups
    )


def _is_short(leg: Leg) -> bool:
    return leg.to_m - leg.from_m < SHORT_M


def _crossing(network: TrackNetwork, leg: Leg, ahead: Leg) -> SwitchOnPath | None:
    """The switch between two legs of a path; None for a plain join."""
    leaves = f"{leg.track.name}.{'end' if leg.running is Running.UP else 'start'}"
    enters = f"{ahead.track.name}.{'start' if ahead.running is Running.UP else 'end'}"
    for switch in network.switches:
        for lie, end in ((Lie.LEFT, switch.left), (Lie.RIGHT, switch.right)):
            if {leaves, enters} == {switch.tip, end}:
                return SwitchOnPath(switch.name, lie, leg.to_m)
    return None


def _flank(network: TrackNetwork, crossing: SwitchOnPath) -> Iterator[tuple[str, Lie]]:
    """The switch at the far end of a short track beside a crossing, turned away from it.

    A longer track has a signal, which shows stop because its route needs the same switch.
    """
    switch = _switch(network, crossing.switch)
    beside = switch.right if crossing.lie is Lie.LEFT else switch.left
    name, _, end = beside.rpartition(".")
    track = network.track(name)
    if track.end_m - track.start_m >= SHORT_M:
        return
    far = f"{name}.{'start' if end == 'end' else 'end'}"
    for other in network.switches:
        if far in (other.left, other.right):
            yield other.name, Lie.RIGHT if far == other.left else Lie.LEFT


def _switch(network: TrackNetwork, name: str) -> TrackSwitch:
    return next(switch for switch in network.switches if switch.name == name)


class SwitchMachine:
    """A switch with its motor and its detection."""

    def __init__(self, lie: Lie = Lie.LEFT) -> None:
        self.aim = lie
        """End position that the interlocking commands."""
        self.lost = False
        """A fault: the detection reports no end position."""
        self.stuck = False
        """A fault: the switch begins no movement."""
        self.strays = False
        """A fault: the switch moves to the other end position than commanded."""
        self._lie: Lie | None = lie
        self._goes_to = lie
        self._there_ns = 0

    @property
    def detected(self) -> Lie | None:
        """The end position that the detection proves; None while it proves none."""
        return None if self.lost else self._lie

    def place(self, lie: Lie) -> None:
        """Put the switch into an end position at once, before the start of a run."""
        self.aim = self._goes_to = self._lie = lie

    def step(self, now_ns: int) -> None:
        goal = self.aim.other if self.strays else self.aim
        if goal is not self._goes_to and not self.stuck:
            self._goes_to, self._lie = goal, None
            self._there_ns = now_ns + round(MOVE_S * NS_PER_S)
        if self._lie is None and now_ns >= self._there_ns:
            self._lie = self._goes_to


@dataclass(slots=True)
class _Held:
    """A route that is locked for a holder."""

    section: RouteSection
    switches: list[tuple[str, Lie, bool]] = field(default_factory=list)
    tracks: set[str] = field(default_factory=set)


class Interlocking:
    """The switches of a network, and the routes over them of one train and of the signaller."""

    def __init__(
        self, network: TrackNetwork, path: Path, *, to_m: float, front_m: float, rear_m: float
    ) -> None:
        """Args:
        path: of the train.
        to_m: last stopping point of the trip; no route over a switch beyond it is requested.
        front_m, rear_m: place of the train. A switch below it lies as the path needs it.
        """
        self.machines = {switch.name: SwitchMachine() for switch in network.switches}
        self.routes = {
            route.name: sections_of(network, route_path(network, route.name, network.name))
            for route in network.routes
        }
        """Routes of the network by name, as the signaller sets them."""
        self.departs_ns = 0
        """Until then, the train requests no route."""
        self._ahead = sections_of(network, path)
        self._legs = path.legs
        self._to_m, self._front_m, self._rear_m = to_m, front_m, rear_m
        self._held: dict[str, list[_Held]] = {}
        self._by_hand: tuple[str, ...] = ()
        self.closed: frozenset[str] = frozenset()
        """Tracks that are closed for work: no route leads into them."""
        self.refusals = 0
        """Number of requests that were refused."""
        for crossing in self._crossings():
            if rear_m - CLEAR_M < crossing.at_m < front_m:
                self.machines[crossing.switch].place(crossing.lie)

    def set_by_hand(self, routes: Sequence[str]) -> None:
        """Set these routes from now on as soon as nothing conflicts, and cancel all others."""
        for name in self._by_hand:
            if name not in routes:
                self._held.pop(name, None)
        self._by_hand = tuple(dict.fromkeys(routes))

    def is_set(self, route: str) -> bool:
        """Whether the signaller's route is locked."""
        return route in self._held

    def needs(self, track: str) -> bool:
        """Whether a route ahead of the train leads into a track."""
        return any(
            leg.track.name == track
            for section in self._ahead
            if section.crossings[0].at_m < self._to_m and not self._is_behind(section)
            for leg in section.tracks
        )

    def step(self, now_ns: int, *, front_m: float, rear_m: float) -> None:
        """Release what the train has left, request what it needs, and move switches."""
        self._front_m, self._rear_m = front_m, rear_m
        self._release()
        for name in self._by_hand:
            if name not in self._held:
                self._request(name, self.routes[name])
        if now_ns >= self.departs_ns:
            self._request_ahead()
        for machine in self.machines.values():
            machine.step(now_ns)

    @property
    def limit_m(self) -> float:
        """Signal on the train's path up to which all routes are proven; infinite without one."""
        for section in self._ahead:
            if not self._is_behind(section) and not self._is_proven(section):
                return section.signal_m
        return inf

    @property
    def unlocked_m(self) -> float:
        """Place of the first switch on the train's path that is not locked and proven; infinite
        without one. A switch is behind the train once it may be released."""
        for section in self._ahead:
            held = self._own(section)
            for crossing in section.crossings:
                if self._rear_m > crossing.at_m + CLEAR_M:
                    continue
                lies = self.machines[crossing.switch].detected is crossing.lie
                if held is None or not lies:
                    return crossing.at_m
        return inf

    def _crossings(self) -> Iterator[SwitchOnPath]:
        return (crossing for section in self._ahead for crossing in section.crossings)

    def _own(self, section: RouteSection) -> _Held | None:
        return next((each for each in self._held.get(TRAIN, ()) if each.section is section), None)

    def _is_behind(self, section: RouteSection) -> bool:
        return self._rear_m > section.crossings[-1].at_m + CLEAR_M

    def _is_proven(self, section: RouteSection) -> bool:
        held = self._own(section)
        return (
            held is not None
            and self.closed.isdisjoint(held.tracks)
            and all(self.machines[switch].detected is lie for switch, lie, _ in held.switches)
        )

    def _request_ahead(self) -> None:
        for section in self._ahead:
            first_m = section.crossings[0].at_m
            if self._is_behind(section) or self._own(section) is not None:
                continue
            if first_m >= self._to_m or section.signal_m - self._front_m > LOOK_AHEAD_M:
                return
            if not self._request(TRAIN, (section,)):
                return

    def _request(self, holder: str, sections: Sequence[RouteSection]) -> bool:
        """Lock all sections for a holder, or none."""
        if not all(self._is_free(holder, section) for section in sections):
            self.refusals += 1
            return False
        for section in sections:
            held = _Held(section, list(section.locks), {leg.track.name for leg in section.tracks})
            self._held.setdefault(holder, []).append(held)
            for switch, lie, _ in section.locks:
                self.machines[switch].aim = lie
        return True

    def _is_free(self, holder: str, section: RouteSection) -> bool:
        return self._tracks_are_free(holder, section) and self._switches_are_free(holder, section)

    def _tracks_are_free(self, holder: str, section: RouteSection) -> bool:
        tracks = {leg.track.name for leg in section.tracks}
        if not tracks.isdisjoint(self.closed):
            return False
        if holder != TRAIN and not tracks.isdisjoint(self._occupied()):
            return False
        others = [held for name, routes in self._held.items() if name != holder for held in routes]
        return all(tracks.isdisjoint(held.tracks) for held in others)

    def _switches_are_free(self, holder: str, section: RouteSection) -> bool:
        below = self._below_train()
        for switch, lie, used in section.locks:
            if switch in below and ((used and holder != TRAIN) or below[switch] is not lie):
                return False
            for held in self._all_held():
                for locked, locked_lie, locked_used in held.switches:
                    shared = locked_lie is lie and not (used and locked_used)
                    if locked == switch and not shared:
                        return False
        return True

    def _all_held(self) -> Iterator[_Held]:
        return (held for routes in self._held.values() for held in routes)

    def _below_train(self) -> dict[str, Lie]:
        """Switches that the train stands on, with the end position that it needs."""
        return {
            crossing.switch: crossing.lie
            for crossing in self._crossings()
            if self._rear_m - CLEAR_M <= crossing.at_m < self._front_m
        }

    def _occupied(self) -> set[str]:
        """Tracks on which any part of the train stands."""
        return {
            leg.track.name
            for leg in self._legs
            if leg.from_m < self._front_m and self._rear_m < leg.to_m
        }

    def _release(self) -> None:
        """Release switch by switch and track by track behind the train."""
        rear_m = self._rear_m
        for held in self._held.get(TRAIN, ()):
            crossings = held.section.crossings
            passed = {each.switch for each in crossings if rear_m > each.at_m + CLEAR_M}
            if self._is_behind(held.section):
                held.switches.clear()
            elif passed:
                held.switches = [each for each in held.switches if each[0] not in passed]
            held.tracks -= {leg.track.name for leg in held.section.tracks if rear_m > leg.to_m}
