"""`plant wayside --routes A,B`: the wayside of trains on a network that command themselves."""

import argparse
from contextlib import ExitStack
from pathlib import Path
from typing import Final, NamedTuple

from firmware_py.clock.clock import WallClock
from firmware_py.radio.line_keys import line_keys
from firmware_py.radio.zenoh_radio import SessionRole, open_radio
from firmware_py.storage.checked_store import CheckedStore
from firmware_py.trackdb.circuit import load_network, load_path, with_route
from firmware_py.trackdb.network import TrackNetwork
from firmware_py.trackdb.paths import Path as TrackPath
from firmware_py.trackdb.version import database_version
from plant_emulator.cli.wayside_parts import ALL, ROUTER, TRACK, LineParts, credentials_of, readable
from plant_emulator.cli.words import say
from plant_emulator.wayside.departed_trains import DepartedTrains
from plant_emulator.wayside.interlocking import Lie
from plant_emulator.wayside.line_wayside import WaysideTruth
from plant_emulator.wayside.network_wayside import NetworkWayside, PathWayside
from plant_emulator.wayside.route_objects import divided, shared_tracks

INBOX_MESSAGES: Final = 8192
"""Maximum number of messages between two steps: each train reports its place 50 times a second."""
NOTHING_KNOWN: Final = WaysideTruth({})


class NetworkPlan(NamedTuple):
    """A network, and the paths on which masters command trains."""

    network: TrackNetwork
    paths: tuple[TrackPath, ...]


def plan_network(options: argparse.Namespace) -> NetworkPlan:
    """Load the network and its routes. Raises SettingsError."""
    network = load_network(options.line)
    paths = tuple(load_path(with_route(options.line, route)) for route in options.routes)
    return NetworkPlan(network, paths)


class NetworkPrograms:
    """The wayside of a network, or the part of it that this program serves."""

    def __init__(
        self, options: argparse.Namespace, plan: NetworkPlan, clock: WallClock, stack: ExitStack
    ) -> None:
        folder = None if options.memory is None else Path(options.memory)
        if folder is not None:
            folder.mkdir(parents=True, exist_ok=True)
        self._parts: dict[str, LineParts] = {}
        """Parts of the wayside by path."""
        ways: list[PathWayside] = []
        shared, secure = shared_tracks(plan.paths), credentials_of(options, clock)
        key = line_keys(secure)
        for path in plan.paths:
            name, areas = path.line.name, divided(plan.network, path, shared)
            parts = LineParts(options, areas, path.line, folder and folder / name, clock, secure)
            departed = DepartedTrains(name, key=key, database=database_version(path.line))
            self._parts[name] = parts
            ways.append(PathWayside(path, areas, parts.wayside, departed))
        self._switches = CheckedStore(folder and folder / "switches", dict[str, Lie])
        self._network: NetworkWayside | None = None
        topics = [each for way in ways for each in way.wayside.subscriptions]
        if options.part in (ALL, TRACK):
            lies = readable(self._switches, {})
            start_ns = clock.now_ns()
            self._network = NetworkWayside(plan.network, ways, start_ns=start_ns, lies=lies)
            topics = [*self._network.subscriptions]
        self._ways = ways
        counts = ", ".join(f"{len(way.areas.areas)} areas on {way.name}" for way in ways)
        self.text = f"{plan.network.name}: {counts}"
        self._port = open_radio(
            SessionRole.WAYSIDE if options.part in (ALL, ROUTER) else SessionRole.TRAIN,
            *(options.line_radio, topics, clock),
            inbox_messages=INBOX_MESSAGES,
            secure=secure,
        )
        stack.callback(self._port.close)

    def beat(self, now_ns: int) -> None:
        heard = self._port.receive(now_ns)
        if self._network is None:
            for way in self._ways:
                for key, payload in way.wayside.step(now_ns, way.own(heard), NOTHING_KNOWN):
                    self._port.send(now_ns, key, payload)
        else:
            for key, payload in self._network.step(now_ns, heard):
                self._port.send(now_ns, key, payload)
            self._store_switches(self._network)
        for name, parts in self._parts.items():
            parts.print_grants(f"{name} ")

    def refused(self, now_ns: int) -> None:
        """Report refused messages, so that a wrongly configured line becomes visible."""
        for name, parts in self._parts.items():
            parts.print_refused(f"{name}: ")

    def _store_switches(self, network: NetworkWayside) -> None:
        """Store where each switch lies, so that it lies there after a restart."""
        if network.lies != self._switches.value and not self._switches.put(network.lies):
            say(f"switches: {self._switches.detail}")
