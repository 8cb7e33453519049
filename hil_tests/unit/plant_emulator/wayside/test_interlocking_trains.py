"""The interlocking with several trains: they follow, wait, turn round, and never meet."""

import itertools
from dataclasses import replace
from math import inf
from pathlib import Path
from typing import Final

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from firmware_py.trackdb.circuit import load_network, load_path
from firmware_py.trackdb.network import Join, Running
from firmware_py.trackdb.paths import Path as TrackPath
from firmware_py.trackdb.paths import make_path
from plant_emulator.wayside.interlocking import (
    MOVE_S,
    Interlocking,
    Lie,
    SharedNetwork,
    SignalBox,
)
from plant_emulator.wayside.route_objects import shared_tracks
from plant_emulator.wayside.separation import REAR_M, apart

FERRY: Final = str(Path(__file__).resolve().parents[4] / "docs/examples/line/ferry.toml")
NETWORK: Final = load_network(FERRY)
PATHS: Final = {name: load_path(f"{FERRY}:{name}") for name in ("out", "back")}
STOPS: Final = {"out": ("Mill", "Siding"), "back": ("Siding", "Mill")}
NS: Final = 1_000_000_000
LENGTH_M: Final = 68.6


class Train:
    """A train of the model: it moves within its authority, and turns at the end of a trip."""

    def __init__(self, box: SignalBox, name: str, route: str, front_m: float | None = None) -> None:
        self.box, self.name = box, name
        self.turns = 0
        self.begin(route, front_m)

    def begin(self, route: str, front_m: float | None) -> None:
        self.route, self.path = route, PATHS[route]
        start, end = STOPS[route]
        line = self.path.line
        self.front_m = line.station(start).stop_m if front_m is None else front_m
        self.to_m = line.station(end).stop_m
        self.inner = Interlocking(
            NETWORK,
            self.path,
            to_m=self.to_m,
            front_m=self.front_m,
            rear_m=self.front_m - LENGTH_M,
            shared=SharedNetwork(self.box, self.name),
        )

    def step(self, now_ns: int, by_m: float) -> None:
        self.inner.step(now_ns, front_m=self.front_m, rear_m=self.front_m - LENGTH_M)
        end_m = max(self.inner.stretch.end_m, min(self.inner.limit_m, self.to_m))
        self.inner.keep(rear_m=self.front_m - LENGTH_M - REAR_M, end_m=end_m)
        self.front_m = max(self.front_m, min(self.front_m + by_m, end_m))
        if self.front_m == self.to_m:
            rear = self.path.to_track(self.front_m - LENGTH_M)
            other = "back" if self.route == "out" else "out"
            self.turns += 1
            self.begin(other, PATHS[other].to_path(rear))


def run(trains: list[Train], duration_s: float, *, by_m: float = 1.0, now_ns: int = 0) -> int:
    for _ in range(round(duration_s * 10)):
        now_ns += NS // 10
        for train in trains:
            train.step(now_ns, by_m)
    return now_ns


def test_a_train_follows_over_the_same_route_up_to_the_rear_ahead() -> None:
    box = SignalBox(NETWORK)
    first = Train(box, "one", "out", 200.0)
    run([first], 10.0, by_m=0.0)
    second = Train(box, "two", "out", 80.0)
    run([second], MOVE_S + 0.2, by_m=0.0)

    # The route over W1 is locked for both, and the rear of the first is at 131.4 m.
    assert {each for each, _ in box.locked()} == {"one", "two"}
    assert second.inner.limit_m == 200.0 - LENGTH_M - REAR_M - 10.0


JUNCTION: Final = str(Path(FERRY).parent / "branch.toml")


def at_junction(box: SignalBox, name: str, route: str, front_m: float) -> Interlocking:
    """A train on the branch line: the track `up1` lies from 300 m to 720 m."""
    path = load_path(f"{JUNCTION}:{route}")
    stretch = {"front_m": front_m, "rear_m": front_m - LENGTH_M}
    routes = Interlocking(
        box.network, path, to_m=1230.0, shared=SharedNetwork(box, name), **stretch
    )
    routes.keep(rear_m=front_m - LENGTH_M - REAR_M, end_m=front_m)
    return routes


@pytest.mark.parametrize(
    ("ahead", "rear_m", "under_masters", "goes"),
    [
        ("hill_port", 719.9, True, False),
        ("hill_port", 720.0, True, True),
        ("hill_port", 719.9, False, True),
        ("dale_port", 719.9, True, True),
    ],
)
def test_trains_of_two_paths_are_never_on_one_shared_track(
    ahead: str, rear_m: float, under_masters: bool, goes: bool
) -> None:
    box = SignalBox(load_network(JUNCTION))
    if under_masters:
        paths = [load_path(f"{JUNCTION}:{each.name}") for each in box.network.routes]
        box.shared = shared_tracks(paths)
    at_junction(box, "one", ahead, rear_m + LENGTH_M)
    follows = at_junction(box, "two", "dale_port", 200.0)

    follows.step(0, front_m=200.0, rear_m=200.0 - LENGTH_M)

    assert bool(follows.held) is goes
    # The first one is on `up2` in any case, which is a block of its own under masters.
    tracks = {track for held in follows.held for track in held.tracks}
    assert ("up2" in tracks) is (goes and (ahead == "dale_port" or not under_masters))


@pytest.mark.parametrize(
    ("other", "front_m", "waits"),
    [
        ("hill_port", 550.0, True),
        ("dale_port", 550.0, False),
        ("hill_port", 400.0, False),
        # Its rear is just before or behind the signal at 700 m.
        ("hill_port", 699.9 + LENGTH_M, True),
        ("hill_port", 700.0 + LENGTH_M, False),
    ],
)
def test_a_train_waits_behind_one_that_its_masters_do_not_know(
    other: str, front_m: float, waits: bool
) -> None:
    box = SignalBox(load_network(JUNCTION))
    box.shared = shared_tracks(load_path(f"{JUNCTION}:{each.name}") for each in box.network.routes)
    at_junction(box, "one", other, front_m)
    own = at_junction(box, "two", "dale_port", 470.0)

    assert own.behind_unknown is waits
    box.shared = {}
    assert not own.behind_unknown


def test_no_train_enters_on_a_shared_track_with_one_of_another_path() -> None:
    box = SignalBox(load_network(JUNCTION))
    path = load_path(f"{JUNCTION}:dale_port")
    box.shared = shared_tracks([path, load_path(f"{JUNCTION}:hill_port")])
    at_junction(box, "one", "hill_port", 700.0)

    assert not box.has_room(path, front_m=450.0, rear_m=380.0)
    box.shared = {}
    assert box.has_room(path, front_m=450.0, rear_m=380.0)


def test_only_one_train_goes_into_a_dead_end() -> None:
    box = SignalBox(NETWORK)
    first = Train(box, "one", "out", 930.0)
    second = Train(box, "two", "out", 600.0)
    run([second], 10.0, by_m=0.0)
    assert second.inner.limit_m == 780.0
    assert second.inner.refusals > 0

    now_ns = run([first], 3.0, by_m=10.0)
    assert first.route == "back"
    # It leaves over W2 into the west track, and the second train enters when it is clear.
    now_ns = run([first], 10.0, by_m=0.0, now_ns=now_ns)
    assert first.inner.machines["W2"].detected is Lie.RIGHT
    now_ns = run([first], 40.0, now_ns=now_ns)
    run([second], MOVE_S + 0.2, by_m=0.0, now_ns=now_ns)
    assert second.inner.limit_m > 780.0


def test_a_train_behind_another_one_does_not_take_its_route() -> None:
    """The second would lock W2 for itself and stand behind the first for ever."""
    box = SignalBox(NETWORK)
    first = Train(box, "one", "out", 600.0)
    second = Train(box, "two", "out", 400.0)

    run([second], 1.0, by_m=0.0)
    assert [name for name, held in box.locked() if held.section.signal_m == 780.0] == []
    run([second, first], 1.0, by_m=0.0)
    assert [name for name, held in box.locked() if held.section.signal_m == 780.0] == ["one"]


def test_a_train_requests_a_route_when_it_has_arrived_at_the_stop_before() -> None:
    box = SignalBox(NETWORK)
    train = Train(box, "one", "out", 300.0)
    shared = SharedNetwork(box, "one", stops_m=(700.0, train.to_m))
    inner = Interlocking(
        NETWORK, train.path, to_m=train.to_m, front_m=694.0, rear_m=620.0, shared=shared
    )
    inner.step(NS, front_m=694.9, rear_m=626.0)
    assert not inner.held
    inner.step(2 * NS, front_m=695.1, rear_m=626.2)
    assert len(inner.held) == 1


def placed(box: SignalBox, name: str, path: TrackPath, front_m: float) -> Interlocking:
    return Interlocking(
        box.network,
        path,
        to_m=path.legs[-1].to_m - 20.0,
        front_m=front_m,
        rear_m=front_m - LENGTH_M,
        shared=SharedNetwork(box, name),
    )


def test_no_route_leads_towards_a_train_on_the_same_track() -> None:
    box = SignalBox(NETWORK)
    west = PATHS["back"].legs[1]
    comes = placed(box, "one", PATHS["back"], west.from_m + 300.0)
    way = make_path(NETWORK, "against", [("mill", Running.UP), ("west", Running.UP)])
    against = placed(box, "two", way, 0.0)

    against.step(NS, front_m=0.0, rear_m=-LENGTH_M)

    assert not against.held
    assert against.refusals == 1
    assert comes.body.tracks() == {"west": Running.DOWN}


def test_two_trains_that_come_together_at_a_switch_take_it_one_after_the_other() -> None:
    """`mill` and `west` lead over W1, which lies only one way at a time."""
    ends = tuple(end for end in NETWORK.buffer_stops if end != "mill.start")
    beyond = replace(NETWORK.track("tail"), name="beyond", tags=())
    open_end = replace(
        NETWORK,
        tracks=(*NETWORK.tracks, beyond),
        buffer_stops=(*ends, "beyond.start"),
        joins=(Join("mill.start", "beyond.end"),),
    )
    box = SignalBox(open_end)
    one = placed(
        box,
        "one",
        make_path(open_end, "one", [("west", Running.DOWN), ("mill", Running.DOWN)]),
        400.0,
    )
    other = placed(
        box,
        "two",
        make_path(open_end, "two", [("east", Running.DOWN), ("mill", Running.DOWN)]),
        400.0,
    )

    for each in (one, other):
        each.step(NS, front_m=400.0, rear_m=400.0 - LENGTH_M)
    assert one.held
    assert not other.held

    box.leave("one")
    other.step(2 * NS, front_m=400.0, rear_m=400.0 - LENGTH_M)
    assert other.held


def test_there_is_room_for_a_train_only_away_from_others_and_their_routes() -> None:
    box = SignalBox(NETWORK)
    mill, out = PATHS["out"].line.station("Mill").stop_m, PATHS["out"]
    assert box.has_room(out, front_m=mill, rear_m=mill - LENGTH_M)
    train = Train(box, "one", "back", PATHS["back"].line.station("Siding").stop_m + 500.0)
    assert box.has_room(out, front_m=mill, rear_m=mill - LENGTH_M)

    # Its route leads into Mill now.
    run([train], 5.0)
    assert not box.has_room(out, front_m=mill, rear_m=mill - LENGTH_M)
    box.leave("one")
    assert box.has_room(out, front_m=mill, rear_m=mill - LENGTH_M)
    assert not list(box.locked())


def test_a_train_enters_neither_on_another_one_nor_over_its_locked_switch() -> None:
    box, out = SignalBox(NETWORK), PATHS["out"]
    placed(box, "one", out, 300.0)
    assert box.has_room(out, front_m=200.0, rear_m=200.0 - LENGTH_M)
    # Less 68.6 m and 12 m, and 10 m for the end of the authority.
    assert not box.has_room(out, front_m=210.0, rear_m=210.0 - LENGTH_M)

    box = SignalBox(NETWORK)
    locks = placed(box, "one", PATHS["back"], PATHS["back"].legs[1].from_m + 600.0)
    locks.step(NS, front_m=locks.body.end_m, rear_m=locks.body.rear_m)
    assert [each.switch for each in locks.held[0].section.crossings] == ["W1"]
    # W1 is at 100 m. The rear of a train beyond it would be within 10 m.
    east_m = 100.0 + LENGTH_M
    assert not box.has_room(out, front_m=east_m + 9.0, rear_m=109.0)
    assert box.has_room(out, front_m=east_m + 11.0, rear_m=111.0)


def test_a_train_enters_no_track_into_which_another_one_has_a_route_the_other_way() -> None:
    box = SignalBox(NETWORK)
    west = make_path(NETWORK, "west", [("mill", Running.UP), ("west", Running.UP)])
    back = placed(box, "one", PATHS["back"], PATHS["back"].line.station("Siding").stop_m)
    assert box.has_room(west, front_m=400.0, rear_m=400.0 - LENGTH_M)
    back.step(NS, front_m=back.body.end_m, rear_m=back.body.rear_m)

    assert back.held[0].tracks == {"west": Running.DOWN}
    assert not box.has_room(west, front_m=400.0, rear_m=400.0 - LENGTH_M)


def returned(box: SignalBox, *, enters: bool) -> bool:
    """Whether a train that returns to Mill gets its route there before the next one enters."""
    out, mill_m = PATHS["out"], PATHS["out"].line.station("Mill").stop_m
    place = {"front_m": mill_m, "rear_m": mill_m - LENGTH_M}
    leaves = Train(box, "one", "out", mill_m)
    returns = placed(box, "two", PATHS["back"], PATHS["back"].legs[1].from_m + 600.0)
    now_ns = 0
    while not returns.held:
        if enters and box.has_room(out, **place):
            return False
        if enters:
            box.wait_to_enter("three", out, **place)
        now_ns = run([leaves], 0.1, now_ns=now_ns)
        returns.step(now_ns, front_m=returns.body.end_m, rear_m=returns.body.rear_m)
    return True


def test_a_train_that_is_due_enters_before_one_returns_to_its_track() -> None:
    """Otherwise trains that return could keep it out for ever, because they need less room."""
    assert returned(SignalBox(NETWORK), enters=False)

    box = SignalBox(NETWORK)
    assert not returned(box, enters=True)
    Train(box, "three", "out")
    assert not box.entering


def test_a_train_in_the_way_of_one_that_enters_may_return_first() -> None:
    box, out = SignalBox(NETWORK), PATHS["out"]
    placed(box, "one", out, 400.0)
    placed(box, "two", PATHS["back"], PATHS["back"].legs[1].from_m + 600.0)
    box.wait_to_enter("three", out, front_m=0.0, rear_m=-LENGTH_M)

    assert box.kept_free("two", {"mill"})
    assert not box.kept_free("two", {"west"})
    assert not box.kept_free("one", {"mill"})
    # A route by hand goes first, as before every train.
    assert not box.kept_free("back", {"mill"})


def test_a_switch_below_a_train_does_not_move_for_a_train_behind_it() -> None:
    box = SignalBox(NETWORK)
    placed(box, "one", PATHS["out"], 100.0 + LENGTH_M - 5.0)
    way = make_path(NETWORK, "west", [("mill", Running.UP), ("west", Running.UP)])
    behind = placed(box, "two", way, 0.0)

    behind.step(NS, front_m=0.0, rear_m=-LENGTH_M)

    assert behind.refusals == 1
    assert box.machines["W1"].aim is Lie.RIGHT


@settings(max_examples=4, deadline=None)
@given(
    moves=st.lists(
        st.lists(st.sampled_from((0.0, 4.0, 15.0)), min_size=3, max_size=3),
        min_size=10,
        max_size=40,
    )
)
def test_no_two_trains_ever_share_track_and_all_come_through(moves: list[list[float]]) -> None:
    box = SignalBox(NETWORK)
    trains = [
        Train(box, "one", "out", 700.0),
        Train(box, "two", "out", 250.0),
        Train(box, "three", "back", PATHS["back"].line.station("Pier").stop_m),
    ]
    now_ns = 0
    for each in moves + [[15.0, 15.0, 15.0]] * 120:
        now_ns += NS
        for train, by_m in zip(trains, each, strict=True):
            train.step(now_ns, by_m)
            _check(trains)
    assert min(train.turns for train in trains) >= 2


def _check(trains: list[Train]) -> None:
    for train in trains:
        body = train.inner.body
        permitted = replace(body, end_m=max(body.end_m, train.inner.stretch.end_m))
        assert permitted.end_m <= max(train.inner.unlocked_m, body.end_m)
        for other in trains:
            assert train is other or apart(permitted, other.inner.body)
    for one, other in itertools.combinations(trains, 2):
        assert apart(one.inner.stretch, other.inner.stretch)
        assert apart(one.inner.body, other.inner.body)


def test_two_tracks_that_cross_are_never_taken_by_two_trains() -> None:
    """`in2` leads over the crossing from W1 to W4, `out1` from W3 to W2: no switch in common."""
    scissors = FERRY.replace("ferry", "scissors")
    network = load_network(scissors)
    box = SignalBox(network)

    def train(name: str, route: str, front_m: float) -> Interlocking:
        path = load_path(f"{scissors}:{route}")
        to_m = path.line.end_m
        shared = SharedNetwork(box, name)
        return Interlocking(
            network, path, to_m=to_m, front_m=front_m, rear_m=front_m - LENGTH_M, shared=shared
        )

    leaves, comes = train("leaves", "out1", 120.0), train("comes", "in2", 900.0)
    leaves.step(0, front_m=120.0, rear_m=120.0 - LENGTH_M)
    for now_ns in (NS, 10 * NS):
        comes.step(now_ns, front_m=900.0, rear_m=900.0 - LENGTH_M)
    assert leaves.limit_m == inf
    assert comes.limit_m == load_path(f"{scissors}:in2").legs[1].to_m - 20.0
    assert comes.refusals == 1

    # Meanwhile nothing enters on the crossed track, not even between the crossing and W4.
    enters = make_path(network, "enters", (("across1", Running.UP), ("p2", Running.UP)))
    place = {"front_m": enters.legs[0].to_m, "rear_m": enters.legs[0].to_m - 8.0}
    assert not box.has_room(enters, **place)
    assert SignalBox(network).has_room(enters, **place)

    # Its rear is on the crossing track still, and then behind it.
    leaves.step(11 * NS, front_m=290.0 + LENGTH_M, rear_m=290.0)
    comes.step(12 * NS, front_m=900.0, rear_m=900.0 - LENGTH_M)
    assert {each for each, _ in box.locked()} == {"leaves"}
    leaves.step(13 * NS, front_m=301.0 + LENGTH_M, rear_m=301.0)
    comes.step(14 * NS, front_m=900.0, rear_m=900.0 - LENGTH_M)
    assert {each for each, _ in box.locked()} == {"leaves", "comes"}
