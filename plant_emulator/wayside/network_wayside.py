"""The wayside of trains on a network that command themselves, on the radio: one interlocking, and
arbiters, objects and track for each path.
"""

from collections.abc import Mapping, Sequence
from functools import partial
from typing import Final, NamedTuple

import msgspec

from firmware_py.ports import RadioMessage
from firmware_py.trackdb.areas import AreaMap
from firmware_py.trackdb.network import TrackNetwork
from firmware_py.trackdb.paths import Path
from plant_emulator.wayside.departed_trains import DepartedTrains
from plant_emulator.wayside.interlocking import (
    Interlocking,
    Lie,
    SharedNetwork,
    SignalBox,
    sections_of,
)
from plant_emulator.wayside.line_wayside import LineWayside, WaysideTruth
from plant_emulator.wayside.network_places import (
    TrainPlace,
    TrainPresence,
    WaysideAnswer,
    key_of_answer,
    places,
    read_place,
    train_of,
)
from plant_emulator.wayside.railway import ROUTE_AHEAD_NS
from plant_emulator.wayside.route_objects import claimed, shared_tracks, truth_of
from plant_emulator.wayside.separation import REAR_M
from zenoh_config.keys import matches
from zenoh_config.t2t import ObjectState
from zenoh_config.t2t_supervision import TrainDecree

ROUTES_NS: Final = 50_000_000
"""Period in which routes are set and released, as in a run in virtual time."""
NS_PER_S: Final = 1_000_000_000
NOTHING_KNOWN: Final = WaysideTruth({})


class PathWayside(NamedTuple):
    """The wayside of one path."""

    path: Path
    areas: AreaMap
    wayside: LineWayside
    departed: DepartedTrains

    @property
    def name(self) -> str:
        return self.areas.name

    @property
    def subscriptions(self) -> tuple[str, ...]:
        return *self.wayside.subscriptions, *self.departed.subscriptions

    def own(self, messages: Sequence[RadioMessage]) -> list[RadioMessage]:
        """The messages for arbiters, objects and track of this path."""
        return [each for each in messages if _is_for(self.wayside.subscriptions, each)]


class NetworkWayside:
    """All paths with their interlocking. Pure: it receives time and messages."""

    def __init__(
        self,
        network: TrackNetwork,
        paths: Sequence[PathWayside],
        *,
        start_ns: int,
        lies: Mapping[str, Lie] | None = None,
    ) -> None:
        """Args:
        lies: end positions in which switches lie at the start; others lie to the left.
        """
        self.box = SignalBox(network)
        self.box.shared = shared_tracks(each.path for each in paths)
        for switch, lie in (lies or {}).items():
            self.box.machines[switch].place(lie)
        self.places: dict[int, TrainPlace] = {}
        """The newest place of each train on the network. A silent train stays there."""
        self.refused = 0
        """Number of messages that are no place of a train on one of the paths."""
        self._paths = {each.name: each for each in paths}
        self._truths = dict.fromkeys(self._paths, NOTHING_KNOWN)
        self._routes = {
            each.name: sections_of(network, each.path, self.box.shared) for each in paths
        }
        self._ordered: tuple[TrainDecree, ...] = ()
        """Commands to trains, which hold on all paths."""
        self._network, self._start_ns = network, start_ns
        self._due_ns = start_ns
        self.subscriptions = (
            places(network.name),
            *dict.fromkeys(key for each in paths for key in each.subscriptions),
        )

    def step(self, now_ns: int, messages: Sequence[RadioMessage]) -> list[tuple[str, bytes]]:
        """Return key and payload of all messages to send."""
        out: list[tuple[str, bytes]] = []
        for message in messages:
            if matches(self.subscriptions[0], message.key):
                out += self._on_place(now_ns, message)
        if now_ns >= self._due_ns:
            self._due_ns = now_ns + ROUTES_NS
            self._set_routes(now_ns)
        for name, each in self._paths.items():
            out += each.wayside.step(now_ns, each.own(messages), self._truths[name])
            heard = [m for m in messages if _is_for(each.departed.subscriptions, m)]
            out += each.departed.step(now_ns, heard, partial(self._is_clear, each))
        self._share_orders()
        return out

    def _share_orders(self) -> None:
        """Let a command to a train hold on all paths, whichever it was given on."""
        centres = [path.wayside.centre for path in self._paths.values()]
        for centre in centres:
            if centre is not None and centre.lasting != self._ordered:
                self._ordered = centre.lasting
                for path in self._paths.values():
                    path.wayside.take_orders(self._ordered)

    @property
    def lies(self) -> dict[str, Lie]:
        """The end position that the interlocking commands, by switch."""
        return {name: machine.aim for name, machine in self.box.machines.items()}

    def _on_place(self, now_ns: int, message: RadioMessage) -> list[tuple[str, bytes]]:
        train, place = train_of(message.key), read_place(message)
        if train is None or place is None or place.path not in self._paths:
            self.refused += 1
            return []
        if place.presence is TrainPresence.PRESENT:
            self._moves(train, place)
        elif place.presence is TrainPresence.GONE:
            self._leaves(train)
        known = self.places.get(train)
        if place.presence is TrainPresence.DUE and known is None and self._has_room(train, place):
            self._joins(train, place)
            known = place
        # A train that is on the network already does not enter again after a restart.
        enters = known is not None and known.presence is TrainPresence.DUE
        answer = WaysideAnswer(
            now_ns - self._start_ns,
            place.trip,
            is_known=known is not None,
            enters=enters,
            waits=known is not None and self.box.trains[_name(train)].behind_unknown,
        )
        return [(key_of_answer(self._network.name, train), msgspec.json.encode(answer))]

    def _has_room(self, train: int, place: TrainPlace) -> bool:
        path = self._paths[place.path].path
        if self.box.has_room(path, front_m=place.front_m, rear_m=place.rear_m):
            return True
        self.box.wait_to_enter(_name(train), path, front_m=place.front_m, rear_m=place.rear_m)
        return False

    def _moves(self, train: int, place: TrainPlace) -> None:
        known = self.places.get(train)
        if known is None or (known.trip, known.path) != (place.trip, place.path):
            self._joins(train, place)
        self.places[train] = place
        self.box.trains[_name(train)].keep(
            rear_m=place.rear_m - REAR_M, end_m=max(place.front_m, place.end_m)
        )

    def _joins(self, train: int, place: TrainPlace) -> None:
        """Put a train on the path of a trip."""
        self._departs(train)
        each = self._paths[place.path]
        each.departed.enters(train)
        if each.wayside.centre is not None:
            each.wayside.centre.starts_again(train)
        Interlocking(
            self._network,
            each.path,
            to_m=place.to_m,
            front_m=place.front_m,
            rear_m=place.rear_m,
            shared=SharedNetwork(self.box, _name(train), 0, place.stops_m),
        )
        self.places[train] = place

    def _leaves(self, train: int) -> None:
        self._departs(train)
        self.box.entering.pop(_name(train), None)
        self.box.leave(_name(train))
        self.places.pop(train, None)

    def _departs(self, train: int) -> None:
        """Note that a train leaves the path of its trip."""
        known = self.places.get(train)
        if known is not None:
            left = self._paths[known.path]
            left.departed.leaves(train, [area.number for area in left.areas.areas])

    def _set_routes(self, now_ns: int) -> None:
        for name, each in self._paths.items():
            states = _states_of(each)
            self.box.claimed[name] = claimed(self._routes[name], each.areas, states)
        for train, place in sorted(self.places.items()):
            routes = self.box.trains[_name(train)]
            wait_ns = round(place.wait_s * NS_PER_S)
            routes.departs_ns = now_ns + wait_ns - ROUTE_AHEAD_NS if wait_ns > 0 else 0
            routes.step(now_ns, front_m=place.front_m, rear_m=place.rear_m)
        for name, each in self._paths.items():
            self._truths[name] = truth_of(each.areas, each.path, self.box.trains.values())

    def _is_clear(self, each: PathWayside, train: int, area: int) -> bool:
        """Whether no part of a train stands in an area of a path."""
        routes, within = self.box.trains.get(_name(train)), each.areas.area(area)
        return routes is None or not any(
            low_m < within.end_m and within.start_m < high_m
            for low_m, high_m in routes.body.parts_on(each.path)
        )


def _states_of(each: PathWayside) -> dict[int, ObjectState]:
    """State of each object. One whose memory could not be stored stays locked."""
    objects = each.wayside.objects
    return {
        site.number: objects[site.number].memory.state
        if site.number in objects
        else ObjectState.LOCKED
        for site in each.areas.objects
    }


def _is_for(subscriptions: Sequence[str], message: RadioMessage) -> bool:
    return any(matches(each, message.key) for each in subscriptions)


def _name(train: int) -> str:
    return f"train {train}"
