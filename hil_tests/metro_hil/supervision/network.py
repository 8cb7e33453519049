"""Supervision of trains on a network: each path of a service is a line of masters.

A command to a train goes to the path on which the train is now. A command for a stretch of track
goes to each path that runs over a piece of it.
"""

from collections.abc import Callable, Collection, Sequence
from typing import Final, NamedTuple

from firmware_py.clock.clock import WallClock
from firmware_py.ports import LinkCounters, RadioMessage, RadioPort
from firmware_py.settings import SettingsError
from firmware_py.trackdb.areas import AreaMap
from firmware_py.trackdb.circuit import load_network, split_route
from firmware_py.trackdb.paths import Path
from firmware_py.trackdb.version import database_version
from metro_hil.model.run_options import EXIT_OK
from metro_hil.model.service import line_of_service, load_service
from metro_hil.supervision.console import SupervisionConsole
from metro_hil.supervision.view import LineView
from plant_emulator.wayside.route_objects import divided, shared_tracks
from plant_emulator.wayside.separation import Stretch
from zenoh_config.codec import SafetyKey
from zenoh_config.keys import line_chunk

LOOK_S: Final = 0.05
"""Time for which one path is listened to before the next."""


class SupervisedPath(NamedTuple):
    """One path of a service."""

    route: str
    path: Path
    areas: AreaMap

    @property
    def name(self) -> str:
        return self.areas.name


def paths_of(service: str) -> tuple[SupervisedPath, ...]:
    """The paths of all trips of a service file. Raises SettingsError."""
    trips = load_service(service)
    routes = {str(split_route(each.line)[1]): each.path for each in trips}
    network, shared = load_network(line_of_service(service)), shared_tracks(routes.values())
    return tuple(
        SupervisedPath(route, path, divided(network, path, shared))
        for route, path in routes.items()
    )


def chosen_path(paths: Sequence[SupervisedPath], route: str | None, service: str) -> SupervisedPath:
    """The path of a route. Raises SettingsError."""
    known = ", ".join(each.route for each in paths)
    if route is None and len(paths) > 1:
        raise SettingsError(f"--route: is missing; {service} has {known}")
    found = next((each for each in paths if route in (None, each.route)), None)
    if found is None:
        raise SettingsError(f"--route {route}: not a route of {service}, which has {known}")
    return found


class PathPort:
    """The messages of one path in a session of all."""

    def __init__(self, session: "PathSessions") -> None:
        self.waiting: list[RadioMessage] = []
        self.counters: LinkCounters = session.radio.counters
        self._session = session

    def send(self, now_ns: int, key: str, payload: bytes) -> None:
        self._session.radio.send(now_ns, key, payload)

    def receive(self, now_ns: int) -> Sequence[RadioMessage]:
        self._session.take(now_ns)
        found, self.waiting = self.waiting, []
        return found

    def close(self) -> None:
        """Do nothing: the session of all paths is closed at the end."""


class PathSessions:
    """Divides the messages of one session among the paths."""

    def __init__(self, radio: RadioPort, names: Collection[str]) -> None:
        self.radio = radio
        self.ports = {line_chunk(name): PathPort(self) for name in names}

    def take(self, now_ns: int) -> None:
        for message in self.radio.receive(now_ns):
            port = self.ports.get(message.key.split("/")[1])
            if port is not None:
                port.waiting.append(message)


class PathDesk(NamedTuple):
    """The console of one path with what it has received."""

    of: SupervisedPath
    view: LineView
    console: SupervisionConsole


class NetworkDesk:
    """The consoles of all paths."""

    def __init__(
        self,
        paths: Sequence[SupervisedPath],
        radio: RadioPort,
        clock: WallClock,
        key: SafetyKey,
    ) -> None:
        sessions = PathSessions(radio, [each.name for each in paths])
        self.desks = [
            PathDesk(
                each,
                view := LineView(each.areas, key),
                SupervisionConsole(
                    *(clock, view, sessions.ports[line_chunk(each.name)], key),
                    database_version(each.path.line),
                ),
            )
            for each in paths
        ]

    def listen(self, duration_s: float, until: Callable[[], bool] = lambda: False) -> bool:
        """Receive on all paths for a while, or until the condition holds; return whether it did."""
        for _ in range(max(1, round(duration_s / (LOOK_S * len(self.desks))))):
            for desk in self.desks:
                desk.console.listen(LOOK_S)
            if until():
                return True
        return False

    def of_train(self, train: int) -> PathDesk | None:
        """The path from which a train sent its newest report; None without one."""
        found = [desk for desk in self.desks if train in desk.view.reports]
        return max(found, key=lambda desk: desk.view.reports[train][1], default=None)

    def only(self, path: SupervisedPath | None) -> list[PathDesk]:
        """The console of one path, or of all without one."""
        return [desk for desk in self.desks if path in (None, desk.of)]

    def on_stretch(
        self, stretch: Stretch, act: Callable[[SupervisionConsole, float, float], int]
    ) -> int:
        """Act on each path that runs over a piece of a stretch, until one fails.

        Args:
            act: receives start and end by the chainage of the path, and returns an exit code.
        """
        for desk in self.desks:
            for start_m, end_m in stretch.pieces_on(desk.of.path):
                print(f"{desk.of.name}, {start_m:g} to {end_m:g} m:", flush=True)
                code = act(desk.console, start_m, end_m)
                if code != EXIT_OK:
                    return code
        return EXIT_OK


def text_of(desks: Sequence[PathDesk], lines: Callable[[LineView], Sequence[str]]) -> list[str]:
    """Text of each path below its name."""
    return [line for desk in desks for line in (f"{desk.of.name}:", *lines(desk.view))]
