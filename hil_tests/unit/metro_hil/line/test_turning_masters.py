"""Trains on a network under masters, with the real cores, wayside and interlocking.

The trains are points of mass: they run up to the authority that they hold, and stop there.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import sqrt
from pathlib import Path
from typing import Final

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from firmware_py.ports import TunableRadioPort
from firmware_py.settings import SettingsError
from firmware_py.trackdb.circuit import load_network, load_path
from firmware_py.trackdb.network import Running
from firmware_py.trackdb.paths import Path as Way
from metro_hil.line.turning.invariants import Between, Observed
from metro_hil.line.turning.masters import ARBITERS, NS_PER_S, Masters, StruckMaster
from plant_emulator.wayside.interlocking import (
    AT_STOP_M,
    Interlocking,
    SharedNetwork,
    SignalBox,
    sections_of,
)
from plant_emulator.wayside.line_object import LineObject
from plant_emulator.wayside.route_objects import (
    AXLES,
    check_masters,
    claimed,
    divided,
    shared_tracks,
    truth_of,
)
from plant_emulator.wayside.t2t_vocabulary import ObjectMemory
from vobc.train_to_train.vocabulary import OwnTrain, T2tConfig
from vobc.wire.line_radio import LineRadio
from zenoh_config.messages import WAYSIDE
from zenoh_config.t2t import ClaimKind, ObjectClaim, ObjectState

SHORT: Final = """
name = "short"
buffer_stops = ["south.start", "north.end"]
routes = [
    { name = "out", legs = ["south up", "east up", "north up"] },
    { name = "back", legs = ["north down", "west down", "south down"] },
]
switches = [
    { name = "W1", tip = "south.end", left = "west.start", right = "east.start" },
    { name = "W2", tip = "north.start", left = "east.end", right = "west.end" },
]
"""
SHORT_TRACKS: Final = {
    "south": (100.0, "stop_up_m = 50.0\nstop_down_m = 20.0"),
    "east": (170.0, "stop_up_m = 60.0"),
    "west": (170.0, "stop_down_m = 60.0"),
    "north": (100.0, "stop_up_m = 80.0\nstop_down_m = 50.0"),
}
"""Length of each track and stopping points of its station: a siding at each end of a double track
of 370 m."""
BRANCH: Final = """
name = "branch"
buffer_stops = ["hill.start", "dale.start", "port.end"]
joins = [{ a = "up1.end", b = "up2.start" }]
routes = [
    { name = "hill_port", legs = ["hill up", "neck up", "up1 up", "up2 up", "port up"] },
    { name = "dale_port", legs = ["dale up", "neck up", "up1 up", "up2 up", "port up"] },
    { name = "port_hill", legs = ["port down", "down down", "neck down", "hill down"] },
    { name = "port_dale", legs = ["port down", "down down", "neck down", "dale down"] },
]
switches = [
    { name = "W1", tip = "neck.start", left = "hill.end", right = "dale.end" },
    { name = "W2", tip = "neck.end", left = "up1.start", right = "down.start" },
    { name = "W3", tip = "port.start", left = "up2.end", right = "down.end" },
]
"""
BRANCH_TRACKS: Final = {
    **dict.fromkeys(("hill", "dale"), (100.0, "stop_up_m = 50.0\nstop_down_m = 20.0")),
    "neck": (60.0, "stop_up_m = 30.0\nstop_down_m = 30.0"),
    **dict.fromkeys(("up1", "up2"), (100.0, "stop_up_m = 60.0")),
    "down": (200.0, "stop_down_m = 60.0"),
    "port": (100.0, "stop_up_m = 80.0\nstop_down_m = 50.0"),
}
"""Two branches that join before a double track to one terminal."""
SCISSORS: Final = """
name = "scissors"
buffer_stops = ["p1.end", "p2.end", "arrive.start", "depart.start"]
routes = [
    { name = "in2", legs = ["arrive up", "across1 up", "p2 up"] },
    { name = "out1", legs = ["p1 down", "across2 down", "depart down"] },
]
switches = [
    { name = "W1", tip = "arrive.end", left = "straight1.start", right = "across1.start" },
    { name = "W2", tip = "depart.end", left = "across2.start", right = "straight2.start" },
    { name = "W3", tip = "p1.start", left = "across2.end", right = "straight1.end" },
    { name = "W4", tip = "p2.start", left = "straight2.end", right = "across1.end" },
]
crossings = [{ name = "K1", a = "across1", a_m = 30.0, b = "across2", b_m = 30.0 }]
"""
SCISSORS_TRACKS: Final = {
    "arrive": (100.0, "stop_up_m = 50.0"),
    "depart": (100.0, "stop_down_m = 20.0"),
    **dict.fromkeys(("straight1", "straight2", "across1", "across2"), (60.0, "stop_up_m = 50.0")),
    **dict.fromkeys(("p1", "p2"), (100.0, "stop_up_m = 80.0\nstop_down_m = 50.0")),
}
"""A scissors crossover between two tracks and two platforms."""
TRACK: Final = """[[tracks]]
name = "{name}"
start_m = 0.0
end_m = {end_m}
limits = [{{ start_m = 0.0, end_m = {end_m}, limit_mps = 15.0 }}]
[[tracks.platforms]]
station = "{name}"
start_m = 10.0
end_m = {platform_m}
side = "none"
dwell_s = 0.0
{stops}
"""
Tracks = Mapping[str, tuple[float, str]]


def written(folder: Path, head: str, tracks: Tracks) -> str:
    text = head + "".join(
        TRACK.format(name=name, stops=stops, end_m=end_m, platform_m=min(90.0, end_m))
        for name, (end_m, stops) in tracks.items()
    )
    path = folder / "network.toml"
    path.write_text(text, encoding="utf-8")
    return str(path)


LENGTH_M: Final = 30.0
UNSURE_M: Final = 1.0
CYCLE_NS: Final = 50_000_000
CYCLE_S: Final = 0.05
TURN_CYCLES: Final = 10
SPEED_MPS, ACCEL_MPS2, BRAKE_MPS2 = 14.0, 2.0, 1.5
T2T: Final = T2tConfig(arbiters=ARBITERS)


@dataclass
class Puppet:
    """A train that runs to the end of its authority, and changes ends at the end of its path."""

    number: int
    shuttle: "Shuttle"
    service: tuple[str, ...]
    due_ns: int = 0
    trips: int = 0
    front_m: float = 0.0
    speed_mps: float = 0.0
    stood_cycles: int = 0
    brakes: int = 0
    routes: Interlocking | None = None
    radio: LineRadio | None = None
    port: TunableRadioPort | None = None
    began_ns: int = 0
    dead: bool = False

    @property
    def way(self) -> Way:
        return self.shuttle.ways[self.service[self.trips % len(self.service)]]

    @property
    def stop_m(self) -> float:
        return self.way.line.stations[-1].stop_m

    def begin(self, now_ns: int) -> None:
        shuttle, way = self.shuttle, self.way
        self.front_m, self.speed_mps = way.line.stations[0].stop_m, 0.0
        self.stood_cycles, self.began_ns = 0, now_ns
        self.radio, self.port = shuttle.masters.paths[way.line.name].enter(self.number, T2T, now_ns)
        self.routes = Interlocking(
            shuttle.network,
            way,
            to_m=self.stop_m,
            front_m=self.front_m,
            rear_m=self.front_m - LENGTH_M,
            shared=SharedNetwork(shuttle.box, f"train {self.number}", now_ns),
        )

    def end_m(self) -> float | None:
        held = None if self.radio is None else self.radio.authority
        return None if held is None else held.end_m

    def step(self, now_ns: int) -> None:
        if self.routes is None:
            way = self.way
            stop_m = way.line.stations[0].stop_m
            if now_ns < self.due_ns or not self.shuttle.box.has_room(
                way, front_m=stop_m, rear_m=stop_m - LENGTH_M
            ):
                return
            self.begin(now_ns)
        assert self.routes is not None
        assert self.radio is not None
        assert self.port is not None
        own_ns = now_ns - self.began_ns
        if not self.dead:
            self.radio.takes(self.port.receive(own_ns))
            for key, payload in self.radio.step(own_ns, self.own(), apply=True):
                self.port.send(own_ns, key, payload)
            self.radio.tune(self.port)
        self.move()
        self.routes.step(own_ns, front_m=self.front_m, rear_m=self.front_m - LENGTH_M)
        end_m = self.end_m()
        self.routes.keep(
            rear_m=self.front_m - LENGTH_M - 12.0, end_m=max(self.front_m, end_m or self.front_m)
        )
        self.turn(now_ns)

    def own(self) -> OwnTrain:
        front_max_m, rear_m = self.front_m + UNSURE_M, self.front_m - UNSURE_M - LENGTH_M
        reach_m = front_max_m + self.speed_mps**2 / (2.0 * 2.0)
        easy_m = front_max_m + self.speed_mps + self.speed_mps**2 / 2.0
        away = self.speed_mps == 0.0 and abs(self.front_m - self.stop_m) < AT_STOP_M
        return OwnTrain(
            *(True, self.front_m - UNSURE_M, front_max_m, rear_m, rear_m, self.speed_mps),
            *(self.speed_mps == 0.0, reach_m, max(reach_m, easy_m), AXLES, away),
        )

    def move(self) -> None:
        end_m = self.end_m()
        goal_m = self.front_m if end_m is None else min(end_m - UNSURE_M - 2.0, self.stop_m)
        left_m = max(0.0, goal_m - self.front_m)
        wish_mps = min(SPEED_MPS, sqrt(2.0 * BRAKE_MPS2 * left_m))
        # An authority that shrinks under a running train makes it brake harder than it planned.
        self.brakes += self.speed_mps > 0.5 and wish_mps < self.speed_mps - 0.2
        self.speed_mps = min(wish_mps, self.speed_mps + ACCEL_MPS2 * CYCLE_S)
        if left_m < 0.3:
            self.speed_mps = 0.0
        self.front_m += self.speed_mps * CYCLE_S

    def turn(self, now_ns: int) -> None:
        if abs(self.front_m - self.stop_m) > 1.0 or self.speed_mps or self.dead:
            return
        self.stood_cycles += 1
        if self.stood_cycles == TURN_CYCLES and len(self.service) > 1:
            self.shuttle.masters.leave(self.way.line.name, self.number)
            self.trips += 1
            self.begin(now_ns)


class Shuttle:
    """Trains that run round and round on a network."""

    def __init__(
        self,
        file: str,
        dues_s: Sequence[float],
        services: Sequence[tuple[str, ...]] = (("out", "back"),),
    ) -> None:
        """Args:
        services: routes of each train; a last one counts for all further trains.
        """
        self.network = load_network(file)
        self.ways = {each.name: load_path(f"{file}:{each.name}") for each in self.network.routes}
        self.box, self.between, self.now_ns = SignalBox(self.network), Between(), 0
        self.masters = Masters(self.network, self.ways.values(), self.box)
        self.trains = [
            Puppet(
                *(number, self, services[min(number, len(services)) - 1]),
                due_ns=round(due_s * NS_PER_S),
            )
            for number, due_s in enumerate(dues_s, start=1)
        ]

    def run(self, duration_s: float) -> "Shuttle":
        end_ns = self.now_ns + round(duration_s * NS_PER_S)
        while self.now_ns < end_ns:
            self.now_ns += CYCLE_NS
            for train in self.trains:
                train.step(self.now_ns)
            self.masters.step(self.now_ns)
            present = {
                f"train {each.number}": Observed(each.routes, each.end_m(), (self.now_ns,))
                for each in self.trains
                if each.routes is not None
            }
            self.between.look(self.now_ns / NS_PER_S, present)
            self.check_switches()
            self.check_tracks()
        return self

    def strike(self, duration_s: float = 0.4) -> StruckMaster | None:
        """Cut the radio of a master for a while."""
        struck = self.masters.choose(self.now_ns)
        if struck is not None:
            self.masters.cut(struck.train)
        self.run(duration_s)
        self.masters.heal()
        return struck

    def check_tracks(self) -> None:
        """Trains of one path at a time run over a track in one direction."""
        owners: dict[tuple[str, Running], str] = {}
        for each in self.trains:
            if each.routes is not None:
                for taken in each.routes.occupied().items():
                    # A train that went on over another path in place waits for the one behind it.
                    assert owners.setdefault(taken, each.way.line.name) == each.way.line.name, taken

    def check_switches(self) -> None:
        """A switch is locked for the master of one path at most, and does not move then."""
        owners: dict[str, str] = {}
        for name, path in self.masters.paths.items():
            for switch in path.claimed():
                assert owners.setdefault(switch, name) == name, switch
                assert self.box.machines[switch].detected is not None


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> str:
    return written(tmp_path_factory.mktemp("short"), SHORT, SHORT_TRACKS)


@pytest.fixture(scope="module")
def branch(tmp_path_factory: pytest.TempPathFactory) -> str:
    return written(tmp_path_factory.mktemp("branch"), BRANCH, BRANCH_TRACKS)


def test_areas_end_at_switches(file: str) -> None:
    areas = divided(load_network(file), load_path(f"{file}:back"))

    assert [(each.start_m, each.end_m) for each in areas.areas] == [
        (0.0, 100.0),
        (100.0, 270.0),
        (270.0, 370.0),
    ]
    assert [(each.start_m, each.end_m) for each in areas.objects] == [(80.0, 100.0), (250.0, 270.0)]
    assert {100.0, 270.0} <= {each.start_m for each in areas.sections}


def test_a_shared_track_begins_with_an_object(branch: str) -> None:
    network = load_network(branch)
    paths = [load_path(f"{branch}:{each.name}") for each in network.routes]
    shared = shared_tracks(paths)

    areas = divided(network, paths[0], shared)

    assert shared == {
        "hill": False,
        "dale": False,
        "neck": False,
        "up1": True,
        "up2": True,
        "down": True,
        "port": False,
    }
    # Over W1 and W2, from `up1` to `up2`, and over W3.
    assert [(each.start_m, each.end_m) for each in areas.objects] == [
        (80.0, 160.0),
        (240.0, 260.0),
        (340.0, 360.0),
    ]
    assert {100.0, 160.0, 260.0, 360.0} <= {each.start_m for each in areas.sections}


@pytest.mark.parametrize(
    ("east_m", "areas"),
    [
        (60.0, [0.0, 100.0, 160.0, 270.0, 370.0]),
        (25.0, [0.0, 100.0, 125.0, 270.0, 370.0]),
        (24.9, None),
        # The signal before W2 stands at 150 m.
        (149.9, None),
        (150.1, None),
    ],
)
def test_tracks_name_borders_of_areas(
    tmp_path: Path, east_m: float, areas: list[float] | None
) -> None:
    file = written(tmp_path, SHORT, SHORT_TRACKS)
    network = Path(file).read_text(encoding="utf-8")
    head = 'name = "east"\n'
    Path(file).write_text(
        network.replace(head, f"{head}area_borders_m = [{east_m}]\n"), encoding="utf-8"
    )
    trips = [(load_path(f"{file}:out"), "south")]

    if areas is None:
        with pytest.raises(SettingsError, match=r"^s.toml: track east: area_borders_m [0-9.]+ is"):
            check_masters(load_network(file), trips, "s.toml")
        return
    check_masters(load_network(file), trips, "s.toml")
    made = divided(load_network(file), trips[0][0])
    assert [each.start_m for each in made.areas] + [made.end_m] == areas
    assert set(areas[:-1]) <= {each.start_m for each in made.sections}


def test_tracks_that_cross_are_shared(tmp_path: Path) -> None:
    file = written(tmp_path, SCISSORS, SCISSORS_TRACKS)

    assert shared_tracks([load_path(f"{file}:in2")]) == {"across1": True}


@pytest.mark.parametrize(("stop_m", "fits"), [(75.0, True), (75.1, False), (89.9, False)])
def test_a_trip_begins_before_the_signal(tmp_path: Path, stop_m: float, fits: bool) -> None:
    stops = f"stop_up_m = {stop_m}\nstop_down_m = 20.0"
    file = written(tmp_path, SHORT, {**SHORT_TRACKS, "south": (100.0, stops)})
    network, trips = load_network(file), [(load_path(f"{file}:out"), "south")]

    if fits:
        check_masters(network, trips, "service.toml")
        return
    with pytest.raises(SettingsError, match=r"^service.toml: the trip over short-out begins at so"):
        check_masters(network, trips, "service.toml")


def test_trains_leave_and_enter_while_a_master_is_cut_off(file: str) -> None:
    shuttle = Shuttle(file, (0.0, 8.0))
    first, second = shuttle.trains

    shuttle.run(14.0)
    struck = shuttle.strike()
    assert struck is not None
    shuttle.run(17.0)
    # The first one has changed ends, and still stands in the siding.
    departed = shuttle.masters.paths["short-out"].departed
    assert (1, 3) in departed.left
    shuttle.run(25.0)
    # The masters of its former path have taken it off their rosters.
    assert departed.left == set()
    shuttle.run(6.0)

    assert struck.is_followed
    # The trains answer every 50 ms here, which is what the timers allow for a message one way.
    assert struck.oldest_s < T2T.timers.authority_ms * 1e-3
    # Each holds an authority of the path that it entered: the first one on its former path.
    assert (first.trips, second.trips) == (2, 1)
    assert None not in (first.end_m(), second.end_m())
    assert shuttle.between.violations == []
    assert shuttle.between.checked_count > 1000
    assert first.brakes == second.brakes == 0


def test_two_branches_join_one_after_the_other(branch: str) -> None:
    shuttle = Shuttle(branch, (0.0, 0.0), (("hill_port",), ("dale_port",)))
    first, second = shuttle.trains

    # Both want the first track behind the junction, from 160 m to 260 m.
    while first.front_m - LENGTH_M <= 260.0:
        shuttle.run(0.5)
        assert second.front_m < 80.0
    shuttle.run(0.5)
    assert second.routes is not None
    assert second.routes.held
    assert shuttle.between.violations == []
    assert first.brakes == second.brakes == 0


SERVICES: Final = (
    ("hill_port", "port_hill"),
    ("hill_port", "port_dale", "dale_port", "port_hill"),
    ("dale_port", "port_dale"),
    ("dale_port", "port_hill", "hill_port", "port_dale"),
)


@settings(max_examples=2, deadline=None)
@given(
    st.lists(st.sampled_from(SERVICES), min_size=2, max_size=2),
    st.floats(0.0, 4.0),
    st.floats(1.0, 8.0),
)
def test_no_two_trains_meet_whenever_a_master_is_cut_off(
    branch: str, services: list[tuple[str, ...]], due_s: float, cut_s: float
) -> None:
    shuttle = Shuttle(branch, (0.0, due_s), services)
    shuttle.run(cut_s)
    shuttle.strike()
    shuttle.run(3.0)

    assert shuttle.between.violations == []
    assert shuttle.trains[0].front_m > 50.0


def test_trains_pass_a_crossing_one_after_the_other(tmp_path: Path) -> None:
    file = written(tmp_path, SCISSORS, SCISSORS_TRACKS)
    shuttle = Shuttle(file, (0.0, 0.0), (("in2",), ("out1",)))
    first, second = shuttle.trains

    shuttle.run(22.0)

    # The rear of the first one has left the crossing track at 160 m, and the other one follows.
    assert first.front_m - LENGTH_M > 160.0
    assert second.front_m > 80.0
    assert shuttle.between.violations == []
    assert first.brakes == second.brakes == 0


class Claims:
    """The objects of both paths, and two trains that pass them only while they are locked."""

    def __init__(self, file: str) -> None:
        self.network = load_network(file)
        self.ways = tuple(load_path(f"{file}:{name}") for name in ("out", "back"))
        self.areas = tuple(divided(self.network, way) for way in self.ways)
        self.box, self.now_ns, self.nonce = SignalBox(self.network), 0, 0
        self.objects = tuple(
            {
                site.number: LineObject(T2T.timers, site, 1, memory=ObjectMemory(), start_ns=0)
                for site in areas.objects
            }
            for areas in self.areas
        )
        self.on, self.fronts_m = [0, 1], [50.0, 50.0]
        self.routes = [self.enter(train) for train in (0, 1)]

    def enter(self, train: int) -> Interlocking:
        way, front_m = self.ways[self.on[train]], self.fronts_m[train]
        return Interlocking(
            self.network,
            way,
            to_m=way.line.stations[-1].stop_m,
            front_m=front_m,
            rear_m=front_m - LENGTH_M,
            shared=SharedNetwork(self.box, f"train {train}"),
        )

    def move(self, train: int, by_m: float) -> None:
        """Run on, but not into an object that is not locked for this path."""
        way = self.on[train]
        goal_m = min(self.fronts_m[train] + by_m, self.ways[way].line.stations[-1].stop_m)
        for each in self.objects[way].values():
            locked = each.memory.state is ObjectState.LOCKED
            if self.fronts_m[train] <= each.site.start_m and not (
                locked and self.routes[train].is_set_ahead(each.site.number - 1)
            ):
                goal_m = min(goal_m, each.site.start_m)
        self.fronts_m[train] = goal_m
        if goal_m == self.ways[way].line.stations[-1].stop_m:
            self.on[train] = 1 - way
            self.fronts_m[train] = 50.0
            self.routes[train] = self.enter(train)

    def locked(self) -> list[str]:
        """The switch of each locked object."""
        names = ({1: "W1", 2: "W2"}, {1: "W2", 2: "W1"})
        return [
            names[way][number]
            for way, objects in enumerate(self.objects)
            for number, each in objects.items()
            if each.memory.state is ObjectState.LOCKED
        ]

    def step(self, *, acts: bool) -> None:
        """Let masters claim what is offered and release what is wanted back, or do nothing."""
        self.now_ns += NS_PER_S_INT
        for train, routes in enumerate(self.routes):
            front_m = self.fronts_m[train]
            routes.step(self.now_ns, front_m=front_m, rear_m=front_m - LENGTH_M)
        for number, (way, areas) in enumerate(zip(self.ways, self.areas, strict=True)):
            truth = truth_of(areas, way, self.box.trains.values())
            for each in self.objects[number].values():
                wanted = each.site.number in truth.release_wanted
                kind = ClaimKind.RELEASE if wanted else ClaimKind.CLAIM
                self.nonce += 1
                head = (1, WAYSIDE, 1, 1, 1, self.nonce, self.now_ns)
                claim = ObjectClaim(*head, each.site.number, kind, self.nonce)
                each.step(
                    self.now_ns,
                    (claim,) if acts else (),
                    release_wanted=wanted,
                    occupied=each.site.number in truth.occupied,
                )
                inside = any(
                    on == number and each.site.start_m < front_m < each.site.end_m
                    for on, front_m in zip(self.on, self.fronts_m, strict=True)
                )
                assert each.memory.state is ObjectState.LOCKED or not inside
            self.box.claimed[way.line.name] = claimed(
                sections_of(self.network, way),
                areas,
                {n: e.memory.state for n, e in self.objects[number].items()},
            )


NS_PER_S_INT: Final = 1_000_000_000


Moves = list[tuple[int, float, bool]]


@settings(max_examples=10, deadline=None)
@given(
    st.lists(
        st.tuples(st.sampled_from((0, 1)), st.floats(10.0, 60.0), st.booleans()),
        min_size=60,
        max_size=60,
    )
)
def test_no_switch_moves_while_it_is_locked_for_a_master(file: str, moves: Moves) -> None:
    claims = Claims(file)
    for train, by_m, acts in moves:
        aims = {name: each.aim for name, each in claims.box.machines.items()}
        before = claims.locked()
        claims.move(train, by_m)
        claims.step(acts=acts)
        assert all(claims.box.machines[switch].aim is aims[switch] for switch in before)
        assert len(set(claims.locked())) == len(claims.locked())
