"""An interlocking: sets routes over switches, locks them, and releases them behind the train.

A route leads from a signal over one switch, or over several without room for a signal between
them, to the next signal. A signal stands before each switch on every track that leads to it. Trains
follow each other over one route, but only one at a time goes into a track that ends at a buffer
stop. Two tracks that cross are never taken by two of them. On a shared track, only trains of one
path follow each other. The module is pure: it receives time and places of the trains.
"""

import enum
import itertools
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from math import inf
from typing import Final

from firmware_py.trackdb.network import Running, TrackNetwork, TrackSwitch
from firmware_py.trackdb.network_file import route_path
from firmware_py.trackdb.paths import Leg, Path
from plant_emulator.wayside.separation import REAR_M, Stretch, limit_m

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
AT_STOP_M: Final = 5.0
"""Distance from a stop within which the train has arrived there."""
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
    """The route from one signal of a path to the next. It may lead over no switch, see `Shared`."""

    signal_m: float
    crossings: tuple[SwitchOnPath, ...]
    tracks: tuple[Leg, ...]
    """Tracks behind the first switch, up to the next signal."""
    flank: tuple[tuple[str, Lie], ...]
    """Switches beside the route, with the end position that leads away from it."""
    dead_end: bool
    """Whether the last track ends at a buffer stop."""

    @property
    def first_m(self) -> float:
        """Where the tracks of the route begin: at its first switch, if it has one."""
        return self.tracks[0].from_m

    @property
    def last_m(self) -> float:
        """Place of its last switch; without a switch, where its tracks begin."""
        return self.crossings[-1].at_m if self.crossings else self.first_m

    @property
    def locks(self) -> tuple[tuple[str, Lie, bool], ...]:
        """Every switch that the route locks, its end position, and whether the route uses it."""
        used = tuple((each.switch, each.lie, True) for each in self.crossings)
        return used + tuple((switch, lie, False) for switch, lie in self.flank)


Shared = Mapping[str, bool]
"""Tracks into which trains of one path at a time have a route, each with a signal before it.

The value says whether all paths run over the track in the same direction. A route leads over all
of a single line, so that no train waits within it for one that comes towards it.
"""
NOT_SHARED: Final[Shared] = {}


def sections_of(
    network: TrackNetwork, path: Path, shared: Shared = NOT_SHARED
) -> tuple[RouteSection, ...]:
    """The routes along a path, in running order."""
    groups: list[tuple[float, list[SwitchOnPath], list[Leg]]] = []
    for leg, ahead in itertools.pairwise(path.legs):
        crossing = _crossing(network, leg, ahead)
        within = groups and groups[-1][2] == [leg] and _is_short(leg)
        if crossing is None:
            one_way = shared.get(ahead.track.name)
            if one_way is not None and not within and (one_way or not groups):
                groups.append((leg.to_m - SIGNAL_M, [], [ahead]))
            elif groups:
                groups[-1][2].append(ahead)
        elif within:
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
            _far_end(legs[-1]) in network.buffer_stops,
        )
        for signal_m, crossings, legs in groups
    )


def _is_short(leg: Leg) -> bool:
    return leg.to_m - leg.from_m < SHORT_M


def _far_end(leg: Leg) -> str:
    return f"{leg.track.name}.{'end' if leg.running is Running.UP else 'start'}"


def _crossing(network: TrackNetwork, leg: Leg, ahead: Leg) -> SwitchOnPath | None:
    """The switch between two legs of a path; None for a plain join."""
    leaves = _far_end(leg)
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
        self.moves = 0
        """Number of movements that began."""
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
            self.moves += 1
            self._there_ns = now_ns + round(MOVE_S * NS_PER_S)
        if now_ns >= self._there_ns:
            self._lie = self._goes_to


@dataclass(slots=True)
class _Held:
    """A route that is locked for a holder."""

    section: RouteSection
    switches: list[tuple[str, Lie, bool]] = field(default_factory=list)
    tracks: dict[str, Running] = field(default_factory=dict)


class SignalBox:
    """The switches of a network, and the routes that are locked for its trains and by hand."""

    def __init__(self, network: TrackNetwork) -> None:
        self.network = network
        self.machines = {switch.name: SwitchMachine() for switch in network.switches}
        self.trains: dict[str, Interlocking] = {}
        """By name, each train on the network with the routes of its path."""
        self.held: dict[str, list[_Held]] = {}
        """Locked routes, by train or by the name of a route that is set by hand."""
        self.claimed: dict[str, frozenset[str]] = {}
        """Switches that are locked for the master of a path, by the path's name. They move
        neither for trains of other paths nor by hand."""
        self.shared: Shared = NOT_SHARED
        """Tracks of several paths, under masters that know the trains of their own path only."""
        self.entering: dict[str, Stretch] = {}
        """By name, each train that is due to enter and has no room yet, with its place."""

    def join(self, train: str, routes: "Interlocking") -> None:
        """Take in a train, or let it leave its path for another one."""
        if train not in self.trains:
            for switch, lie in routes.below_train().items():
                self.machines[switch].place(lie)
        self.held.pop(train, None)
        self.entering.pop(train, None)
        self.trains[train] = routes

    def leave(self, train: str) -> None:
        """Release everything of a train that leaves the network."""
        self.trains.pop(train, None)
        self.held.pop(train, None)

    def has_room(self, path: Path, *, front_m: float, rear_m: float) -> bool:
        """Whether a train can be put on the network without meeting another one or its route."""
        body = Stretch(path, rear_m, front_m)
        if limit_m(body, [each.stretch for each in self.trains.values()]) < front_m:
            return False
        ways = body.tracks()
        crossed = self.crossed_by(ways)
        for holder, taken in self.taken(""):
            if not crossed.isdisjoint(taken):
                return False
            for track, running in taken.items():
                may_follow = self.may_follow(path, holder, track)
                if track in ways and not (may_follow and running is ways[track]):
                    return False
        below = _below(sections_of(self.network, path), front_m=front_m, rear_m=rear_m)
        locked = {switch for held in self.locked() for switch, _, _ in held[1].switches}
        return locked.isdisjoint(below)

    def wait_to_enter(self, train: str, path: Path, *, front_m: float, rear_m: float) -> None:
        """Give a train that is due precedence over later routes into the tracks where it enters.

        A train on the first path of the entering one is excepted, because it may be in its way.
        """
        self.entering.setdefault(train, Stretch(path, rear_m, front_m))

    def kept_free(self, holder: str, tracks: Collection[str]) -> bool:
        """Whether tracks are kept free for a train that is due to enter, and not for the holder."""
        routes = self.trains.get(holder)
        if routes is None:
            return False
        stands_on = routes.occupied().keys()
        return any(
            not place.tracks().keys().isdisjoint(tracks)
            and stands_on.isdisjoint(leg.track.name for leg in place.path.legs)
            for place in self.entering.values()
        )

    def may_follow(self, path: Path, holder: str, track: str) -> bool:
        """Whether a train of a path may be on a track together with the holder."""
        if track not in self.shared:
            return True
        routes = self.trains.get(holder)
        return routes is not None and routes.stretch.path.line.name == path.line.name

    def crossed_by(self, tracks: Collection[str]) -> set[str]:
        """The tracks that cross any of these.

        No route leads into a track, and no train enters on it, while another holder has a route
        into a track that crosses it, or stands on one.
        """
        pairs = [(each.a, each.b) for each in self.network.crossings]
        return {two for one, two in (*pairs, *(pair[::-1] for pair in pairs)) if one in tracks}

    def taken(self, holder: str) -> Iterator[tuple[str, dict[str, Running]]]:
        """Tracks that others than the holder stand on or have a route into, by holder."""
        for train, routes in self.trains.items():
            if train != holder:
                yield train, routes.occupied()
        for name, held in self.locked():
            if name != holder:
                yield name, held.tracks

    def locked(self) -> Iterator[tuple[str, _Held]]:
        """All locked routes with their holders."""
        return ((name, each) for name, routes in self.held.items() for each in routes)


@dataclass(frozen=True, slots=True)
class SharedNetwork:
    """What a train needs to share a network with others."""

    box: SignalBox
    train: str = TRAIN
    began_ns: int = 0
    """Instant of the network at which the train's own time begins."""
    stops_m: tuple[float, ...] = ()
    """Where the train stops. It requests a route only after it arrived at the last stop before the
    signal, so that other trains can use the switch until then."""


class Interlocking:
    """The routes of one train over the switches of a network, and those of the signaller."""

    def __init__(
        self,
        network: TrackNetwork,
        path: Path,
        *,
        to_m: float,
        front_m: float,
        rear_m: float,
        shared: "SharedNetwork | None" = None,
    ) -> None:
        """Args:
        path: of the train.
        to_m: last stopping point of the trip; no route over a switch beyond it is requested.
        front_m, rear_m: place of the train. A switch below it lies as the path needs it.
        shared: with other trains; None: the train is alone.
        """
        shared = shared or SharedNetwork(SignalBox(network))
        self.box = shared.box
        self.machines = self.box.machines
        self.routes = {
            route.name: sections_of(network, route_path(network, route.name, network.name))
            for route in network.routes
        }
        """Routes of the network by name, as the signaller sets them."""
        self.departs_ns = 0
        """Until then, the train requests no route."""
        self._ahead = sections_of(network, path, self.box.shared)
        self._to_m, self._front_m, self._rear_m = to_m, front_m, rear_m
        self._train, self._began_ns = shared.train, shared.began_ns
        self._stops_m = shared.stops_m
        self._by_hand: tuple[str, ...] = ()
        self.closed: frozenset[str] = frozenset()
        """Tracks that are closed for work: no route leads into them."""
        self.refusals = 0
        """Number of routes that had to wait because something conflicted."""
        self._waiting: set[tuple[str, tuple[float, ...]]] = set()
        """Refused and not set since: the holder, and the signals of the routes."""
        self.stretch = Stretch(path, rear_m - REAR_M, front_m)
        """What the train keeps from others: from its reserved rear to the end of its authority."""
        self.box.join(shared.train, self)

    def set_by_hand(self, routes: Sequence[str]) -> None:
        """Set these routes from now on as soon as nothing conflicts, and cancel all others."""
        for name in self._by_hand:
            if name not in routes:
                self.box.held.pop(name, None)
        self._by_hand = tuple(dict.fromkeys(routes))

    def is_set(self, route: str) -> bool:
        """Whether the signaller's route is locked."""
        return route in self.box.held

    def needs(self, track: str) -> bool:
        """Whether a route ahead of the train leads into a track."""
        return any(
            leg.track.name == track
            for section in self._ahead
            if section.first_m < self._to_m and not self._is_behind(section)
            for leg in section.tracks
        )

    def step(self, now_ns: int, *, front_m: float, rear_m: float) -> None:
        """Release what the train has left, request what it needs, and move switches."""
        self._front_m, self._rear_m = front_m, rear_m
        self._release()
        for name in self._by_hand:
            if name not in self.box.held:
                self._request(name, self.routes[name])
        if now_ns >= self.departs_ns:
            self._request_ahead()
        for machine in self.machines.values():
            machine.step(now_ns + self._began_ns)

    def keep(self, *, rear_m: float, end_m: float) -> None:
        """Keep a stretch from all other trains from now on."""
        self.stretch = replace(self.stretch, rear_m=rear_m, end_m=end_m)

    @property
    def limit_m(self) -> float:
        """Where the train's authority ends at most: the signal on its path up to which all routes
        are proven, or before another train; infinite without one."""
        limits_m = [limit_m(self.stretch, self._others())]
        for section in self._ahead:
            if not self._is_behind(section) and not self._is_proven(section):
                limits_m.append(section.signal_m)
                break
        return min(limits_m)

    @property
    def behind_unknown(self) -> bool:
        """Whether a train of another path stands ahead, before the next signal.

        The masters of this path do not know it. That can only be where a train went on over this
        path in place; the train then waits until the other one has left.
        """
        own = self.stretch.path.line.name
        unknown = [
            each.body for each in self.box.trains.values() if each.stretch.path.line.name != own
        ]
        ahead_m = next((s.signal_m for s in self._ahead if s.signal_m >= self._front_m), inf)
        return bool(self.box.shared) and limit_m(self.body, unknown, space_m=0.0) < ahead_m

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

    def is_set_ahead(self, section: int) -> bool:
        """Whether a route of the path, by its number from 0, is ahead of the train and proven."""
        ahead = self._ahead[section]
        return self._front_m <= ahead.signal_m and self._is_proven(ahead)

    def has_failed(self, section: int) -> bool:
        """Whether a switch of a route that is locked for the train, by the number of the route on
        the path from 0, is not proven. Switches behind the train are released and do not count."""
        held = self._own(self._ahead[section])
        return held is not None and not self._lie_right(held)

    @property
    def held(self) -> Sequence[_Held]:
        """The routes that are locked for the train."""
        return self.box.held.get(self._train, ())

    @property
    def first_switch_m(self) -> float:
        """Place of the last switch of the first route on the path; infinite without one."""
        return next((each.last_m for each in self._ahead if each.crossings), inf)

    @property
    def body(self) -> Stretch:
        """The track on which the train stands."""
        return replace(self.stretch, rear_m=self._rear_m, end_m=self._front_m)

    def occupied(self) -> dict[str, Running]:
        """Tracks on which any part of the train stands, with its direction."""
        return self.body.tracks()

    def below_train(self) -> dict[str, Lie]:
        """Switches that the train stands on, with the end position that it needs."""
        return _below(self._ahead, front_m=self._front_m, rear_m=self._rear_m)

    def _others(self) -> list[Stretch]:
        return [each.stretch for name, each in self.box.trains.items() if name != self._train]

    def _own(self, section: RouteSection) -> _Held | None:
        return next((each for each in self.held if each.section is section), None)

    def _is_behind(self, section: RouteSection) -> bool:
        return self._rear_m > section.last_m + CLEAR_M

    def _is_proven(self, section: RouteSection) -> bool:
        held = self._own(section)
        return held is not None and self.closed.isdisjoint(held.tracks) and self._lie_right(held)

    def _lie_right(self, held: _Held) -> bool:
        return all(self.machines[switch].detected is lie for switch, lie, _ in held.switches)

    def _request_ahead(self) -> None:
        for section in self._ahead:
            if self._is_behind(section) or self._own(section) is not None:
                continue
            if section.first_m >= self._to_m or section.signal_m - self._front_m > LOOK_AHEAD_M:
                return
            if self._stops_before(section.signal_m) or self._is_behind_another(section.signal_m):
                return
            if not self._request(self._train, (section,)):
                return

    def _stops_before(self, signal_m: float) -> bool:
        return any(self._front_m + AT_STOP_M < stop_m < signal_m for stop_m in self._stops_m)

    def _is_behind_another(self, signal_m: float) -> bool:
        """Whether another train stands between this one and a signal ahead."""
        others = [each.body for name, each in self.box.trains.items() if name != self._train]
        return limit_m(self.body, others, space_m=0.0) < signal_m

    def _request(self, holder: str, sections: Sequence[RouteSection]) -> bool:
        """Lock all sections for a holder, or none."""
        wanted = (holder, tuple(section.signal_m for section in sections))
        if not all(self._is_free(holder, section) for section in sections):
            self.refusals += wanted not in self._waiting
            self._waiting.add(wanted)
            return False
        self._waiting.discard(wanted)
        for section in sections:
            tracks = {leg.track.name: leg.running for leg in section.tracks}
            held = _Held(section, list(section.locks), tracks)
            self.box.held.setdefault(holder, []).append(held)
            for switch, lie, _ in section.locks:
                self.machines[switch].aim = lie
        return True

    def _is_free(self, holder: str, section: RouteSection) -> bool:
        return self._tracks_are_free(holder, section) and self._switches_are_free(holder, section)

    def _tracks_are_free(self, holder: str, section: RouteSection) -> bool:
        ways = {leg.track.name: leg.running for leg in section.tracks}
        if not ways.keys().isdisjoint(self.closed) or self.box.kept_free(holder, ways):
            return False
        crossed, path = self.box.crossed_by(ways), self.stretch.path
        for other, taken in self.box.taken(holder):
            trains = self._are_trains(holder, other) and not section.dead_end
            if not crossed.isdisjoint(taken):
                return False
            for track, running in taken.items():
                follows = trains and self.box.may_follow(path, other, track)
                if track in ways and not (follows and running is ways[track]):
                    return False
        return True

    def _switches_are_free(self, holder: str, section: RouteSection) -> bool:
        own = self.stretch.path.line.name if self._are_trains(holder) else ""
        claimed = {each for path, held in self.box.claimed.items() if path != own for each in held}
        for switch, lie, used in section.locks:
            if switch in claimed:
                return False
            for train, other in self.box.trains.items():
                needs = other.below_train().get(switch)
                by_hand = used and not self._are_trains(holder, train)
                if needs is not None and (by_hand or needs is not lie):
                    return False
            for name, held in self.box.locked():
                follows = self._are_trains(holder, name)
                for locked, locked_lie, locked_used in held.switches:
                    shared = locked_lie is lie and (follows or not (used and locked_used))
                    if locked == switch and not shared:
                        return False
        return True

    def _are_trains(self, *holders: str) -> bool:
        """Whether all holders are trains, and none is a route that is set by hand."""
        return all(each in self.box.trains for each in holders)

    def _release(self) -> None:
        """Release switch by switch and track by track behind the train."""
        rear_m = self._rear_m
        for held in self.held:
            crossings = held.section.crossings
            passed = {each.switch for each in crossings if rear_m > each.at_m + CLEAR_M}
            if self._is_behind(held.section):
                held.switches.clear()
            elif passed:
                held.switches = [each for each in held.switches if each[0] not in passed]
            for leg in held.section.tracks:
                if rear_m > leg.to_m:
                    held.tracks.pop(leg.track.name, None)


def _below(sections: Sequence[RouteSection], *, front_m: float, rear_m: float) -> dict[str, Lie]:
    return {
        crossing.switch: crossing.lie
        for section in sections
        for crossing in section.crossings
        if rear_m - CLEAR_M <= crossing.at_m < front_m
    }
