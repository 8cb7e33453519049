"""The events of trains on a network in real time: those of the line of each path, and the checks of
all pairs of trains. Pure.
"""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Final

from firmware_py.ports import RadioMessage
from firmware_py.trackdb.areas import AreaMap
from firmware_py.trackdb.paths import Path
from metro_hil.line.exercise.event_log import LineEvents
from metro_hil.line.turning.witness import NetworkWitness
from plant_emulator.wayside.detection import Place
from plant_emulator.wayside.network_places import TrainPlace, TrainPresence
from plant_emulator.wayside.route_objects import AXLES
from zenoh_config.codec import BENCH_KEY, SafetyKey
from zenoh_config.keys import line_chunk

FRESH_NS: Final = 500_000_000
"""Greatest age of the heartbeat of a train that commands."""
TAKEOVER_S: Final = 10.0
"""Time after a strike beyond which a change of command has other reasons."""
NS_PER_S: Final = 1_000_000_000
MS_PER_S: Final = 1e3


@dataclass(frozen=True, slots=True)
class NetworkStrike:
    """A train that was struck while it commanded. Times are those of the network."""

    at_s: float
    fault: str
    train: int
    areas: tuple[tuple[str, int], ...]
    """Path and number of each area that it commanded where another train was."""


@dataclass(frozen=True, slots=True)
class NetworkTakeover:
    """The first other train that commanded an area within `TAKEOVER_S` of the strike at its master;
    None without one, as after a cut that is shorter than a lease.
    """

    path: str
    area: int
    struck: int
    train: int | None
    after_s: float | None


class NetworkEvents:
    """Receives all messages in their order."""

    def __init__(
        self,
        network: str,
        paths: Iterable[Path],
        areas: Mapping[str, AreaMap],
        say: Callable[[int, str], None],
        key: SafetyKey = BENCH_KEY,
    ) -> None:
        """Args:
        network: its name.
        areas: by the name of the path.
        say: receives an instant and a line of text about what happens.
        """
        by_name = {path.line.name: path for path in paths}
        self.witness = NetworkWitness(by_name.values())
        self.lines = {
            name: LineEvents(
                path.line, areas[name], partial(_tell, say, name), key, own_clocks=True
            )
            for name, path in by_name.items()
        }
        self.zero_ns: int | None = None
        """Instant at which the time of the network was 0; None before a train is on it."""
        self.began_ns: int | None = None
        """Instant at which the first train was on the network."""
        self.strikes: list[NetworkStrike] = []
        self._network = line_chunk(network)
        self._lines = {line_chunk(name): line for name, line in self.lines.items()}
        self._trips: dict[int, tuple[int, str]] = {}
        """Trip and path of each train on the network."""

    def on_message(self, messages: Iterable[RadioMessage]) -> None:
        for message in messages:
            chunk = message.key.split("/")[1]
            if chunk == self._network:
                found = self.witness.on_message(message)
                if found is not None:
                    self._on_place(*found, message.stamp_ns)
            elif chunk in self._lines:
                self._lines[chunk].on_message([message])

    def second_of(self, at_ns: int) -> float:
        """Time of the network at an instant; 0 before a train is on it."""
        return 0.0 if self.zero_ns is None else (at_ns - self.zero_ns) / NS_PER_S

    def strike(self, fault: str, now_ns: int) -> NetworkStrike | None:
        """Choose the train to strike: the first one that commands an area with another train in it.
        None if no train does.
        """
        commanding = [
            (events.heartbeat.source, name, number)
            for name, line in self.lines.items()
            for number, events in sorted(line.areas.items())
            if now_ns - events.heard_ns <= FRESH_NS
            and line.has_others(number, events.heartbeat.source)
        ]
        if not commanding:
            return None
        train = commanding[0][0]
        areas = tuple((name, area) for source, name, area in commanding if source == train)
        struck = NetworkStrike(self.second_of(now_ns), fault, train, areas)
        self.strikes.append(struck)
        for line in self.lines.values():
            line.strikes(train)
        for name, area in areas:
            self.lines[name].orders_takeover(area, train)
        return struck

    def takeovers(self) -> list[NetworkTakeover]:
        """What followed each strike, by area."""
        return [
            self._takeover(struck, name, area)
            for struck in self.strikes
            for name, area in struck.areas
        ]

    def _takeover(self, struck: NetworkStrike, name: str, area: int) -> NetworkTakeover:
        for term in self.lines[name].areas[area].terms:
            after_s = self.second_of(term.at_ns) - struck.at_s
            if 0.0 < after_s <= TAKEOVER_S and term.train != struck.train:
                return NetworkTakeover(name, area, struck.train, term.train, after_s)
        return NetworkTakeover(name, area, struck.train, None, None)

    def doubts(self) -> list[str]:
        """Why the run proves nothing about a takeover; empty if it does."""
        return [
            f"{name}, area {each.area}: train {each.train} was struck in term {each.term}, but no "
            "later term was received; use a longer --for or --down-for"
            for name, line in self.lines.items()
            for each in line.unseen_takeovers()
        ]

    def authority_oldest_s(self) -> float:
        """Greatest age of an authority of a train that was not struck."""
        return max(
            (t.oldest_ms / MS_PER_S for line in self.lines.values() for t in line.trains.values()),
            default=0.0,
        )

    def _on_place(self, train: int, place: TrainPlace, now_ns: int) -> None:
        before = self._trips.get(train)
        if place.presence is TrainPresence.PRESENT:
            self.began_ns = now_ns if self.began_ns is None else self.began_ns
            zero_ns = now_ns - round(place.at_s * NS_PER_S)
            self.zero_ns = zero_ns if self.zero_ns is None else min(self.zero_ns, zero_ns)
            trip = place.trip, place.path
            if before is not None and before != trip:
                self.lines[before[1]].leaves(train)
            self._trips[train] = trip
            at = Place(place.front_m, place.rear_m, AXLES, now_ns)
            self.lines[place.path].stands(train, at)
        elif place.presence is TrainPresence.GONE and before is not None:
            self.lines[before[1]].leaves(train)
            del self._trips[train]


def _tell(say: Callable[[int, str], None], path: str, now_ns: int, text: str) -> None:
    say(now_ns, f"{path}, {text}")
