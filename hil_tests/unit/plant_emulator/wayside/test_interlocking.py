"""The interlocking: routes of one train and of the signaller never use a switch at one time."""

from pathlib import Path
from typing import Final

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from firmware_py.trackdb.circuit import load_network, load_path
from plant_emulator.wayside.interlocking import (
    CLEAR_M,
    MOVE_S,
    Interlocking,
    Lie,
    SwitchMachine,
    sections_of,
)

EXAMPLES: Final = Path(__file__).resolve().parents[4] / "docs/examples/line"
FERRY: Final = f"{EXAMPLES}/ferry.toml"
JUNCTION: Final = f"{EXAMPLES}/junction.toml"
NS: Final = 1_000_000_000
LENGTH_M: Final = 68.6
CROSSOVER: Final = """
name = "crossover"
buffer_stops = ["a.start", "c.end", "b.start", "d.end"]
tracks = [TRACKS]
switches = [
    { name = "W1", tip = "a.end", left = "c.start", right = "x.start" },
    { name = "W2", tip = "d.start", left = "b.end", right = "x.end" },
]
routes = [
    { name = "main", legs = ["a up", "c up"] },
    { name = "side", legs = ["b up", "d up"] },
    { name = "over", legs = ["a up", "x up", "d up"] },
    { name = "return", legs = ["c down", "a down"] },
    { name = "spur", legs = ["x up", "d up"] },
    { name = "meet", legs = ["d down", "x down"] },
]
"""


def crossover(folder: Path, length_m: float = 60.0, main_m: float = 300.0, more: str = "") -> str:
    ends_m = dict.fromkeys("bcd", (0.0, 300.0)) | {"a": (0.0, main_m)}
    ends_m |= dict.fromkeys(more, (0.0, length_m))
    # Its own chainage does not begin at 0.
    ends_m["x"] = (500.0, 500.0 + length_m)
    tracks = ",\n    ".join(
        f'{{ name = "{name}", start_m = {start_m}, end_m = {end_m}, limits = [{{ start_m = '
        f"{start_m}, end_m = {end_m}, limit_mps = 10.0 }}], platforms = [{{ station = "
        f'"{name}", start_m = {start_m}, end_m = {end_m}, stop_up_m = {end_m - 30.0}, '
        f"stop_down_m = {start_m + 30.0} }}] }}"
        for name, (start_m, end_m) in ends_m.items()
    )
    path = folder / "crossover.toml"
    path.write_text(CROSSOVER.replace("TRACKS", tracks), encoding="utf-8")
    return str(path)


class Bench:
    """An interlocking with a train, stepped by tenths of a second."""

    def __init__(self, line: str, *, to_m: float, front_m: float) -> None:
        network, path = load_network(line.rpartition(":")[0]), load_path(line)
        self.now_ns = 0
        self.front_m = front_m
        self.inner = Interlocking(
            network, path, to_m=to_m, front_m=front_m, rear_m=front_m - LENGTH_M
        )

    def run(self, duration_s: float, front_m: float | None = None) -> None:
        self.front_m = self.front_m if front_m is None else front_m
        for _ in range(round(duration_s * 10)):
            self.now_ns += NS // 10
            rear_m = self.front_m - LENGTH_M
            self.inner.step(self.now_ns, front_m=self.front_m, rear_m=rear_m)

    @property
    def limit_m(self) -> float:
        return self.inner.limit_m


def test_a_path_has_a_signal_before_each_switch() -> None:
    network, path = load_network(FERRY), load_path(f"{FERRY}:out")

    first, second = sections_of(network, path)

    # Mill ends at 100 m, and 700 m of the east track follow.
    assert (first.signal_m, second.signal_m) == (80.0, 780.0)
    assert [(each.switch, each.lie) for each in first.crossings] == [("W1", Lie.RIGHT)]
    assert [(each.switch, each.lie) for each in second.crossings] == [("W2", Lie.LEFT)]
    assert [leg.track.name for leg in first.tracks] == ["east"]


def test_the_authority_follows_the_route_once_the_switch_has_moved() -> None:
    bench = Bench(f"{FERRY}:out", to_m=700.0, front_m=0.0)
    assert bench.limit_m == 80.0
    assert bench.inner.first_switch_m == 100.0

    # It begins to move with the first step and takes 4 s.
    bench.inner.step(0, front_m=0.0, rear_m=-LENGTH_M)
    bench.run(3.9)
    assert bench.limit_m == 80.0
    bench.run(0.1)
    # The trip ends at Pier, so the route over the switch behind it is not requested.
    assert bench.limit_m == 780.0
    assert bench.inner.unlocked_m == 800.0


def test_until_the_departure_no_route_is_set() -> None:
    bench = Bench(f"{FERRY}:out", to_m=700.0, front_m=0.0)
    bench.inner.departs_ns = 20 * NS

    bench.run(19.9 + MOVE_S)
    assert bench.limit_m == 80.0
    bench.run(0.1)
    assert bench.limit_m == 780.0


def test_a_switch_that_strays_moves_to_the_other_end_position() -> None:
    machine = SwitchMachine()
    machine.strays = True
    detected = []
    for now_ns, aim in ((0, Lie.RIGHT), (1, Lie.LEFT), (round(MOVE_S * NS) + 1, Lie.LEFT)):
        machine.aim = aim
        machine.step(now_ns)
        detected.append(machine.detected)

    assert detected == [Lie.LEFT, None, Lie.RIGHT]


@pytest.mark.parametrize("fault", ["lost", "strays"])
@pytest.mark.parametrize(("front_m", "concerned"), [(50.0, True), (178.6, True), (178.7, False)])
def test_a_switch_that_fails_takes_the_authority_until_the_rear_is_clear(
    front_m: float, concerned: bool, fault: str
) -> None:
    """W1 is at 100 m: with the front at 178.6 m, the rear of 68.6 m is clear of it by 10 m."""
    bench = Bench(f"{FERRY}:out", to_m=700.0, front_m=0.0)
    bench.run(10.0)
    bench.run(1.0, front_m)

    setattr(bench.inner.machines["W1"], fault, True)
    bench.run(0.1)

    assert bench.limit_m == (80.0 if concerned else 780.0)
    assert bench.inner.unlocked_m == (100.0 if concerned else 800.0)
    setattr(bench.inner.machines["W1"], fault, False)
    bench.run(MOVE_S + 0.2)
    assert bench.limit_m == 780.0


def test_a_stuck_switch_that_lies_wrong_keeps_the_train_before_its_signal() -> None:
    bench = Bench(f"{FERRY}:out", to_m=700.0, front_m=0.0)
    bench.inner.machines["W1"].stuck = True

    bench.run(30.0)
    assert bench.limit_m == 80.0
    bench.inner.machines["W1"].stuck = False
    bench.run(MOVE_S + 0.2)
    assert bench.limit_m == 780.0


def test_a_conflicting_route_of_the_signaller_is_refused_until_the_train_is_clear() -> None:
    bench = Bench(f"{JUNCTION}:out", to_m=1145.0, front_m=0.0)
    bench.run(10.0)
    assert bench.inner.refusals == 0

    bench.inner.set_by_hand(["back"])
    bench.run(1.0, 900.0 + CLEAR_M + LENGTH_M - 1.0)
    assert not bench.inner.is_set("back")
    assert bench.inner.refusals == 1
    assert bench.inner.machines["W1"].moves == 1
    bench.run(1.0, 900.0 + CLEAR_M + LENGTH_M + 1.0)
    assert bench.inner.is_set("back")
    assert bench.inner.machines["W1"].aim is Lie.LEFT


def test_a_route_set_by_hand_goes_first_and_keeps_the_train_waiting() -> None:
    bench = Bench(f"{JUNCTION}:out", to_m=1145.0, front_m=0.0)
    bench.inner.set_by_hand(["back"])

    bench.run(10.0)
    assert bench.limit_m == 880.0
    bench.inner.set_by_hand([])
    bench.run(MOVE_S + 0.3)
    assert bench.limit_m > 1145.0


def test_a_closed_track_keeps_the_train_out_and_does_not_stop_one_that_is_in_it() -> None:
    bench = Bench(f"{FERRY}:out", to_m=700.0, front_m=0.0)
    bench.inner.closed = frozenset({"east"})
    bench.run(10.0)
    assert bench.limit_m == 80.0
    assert bench.inner.machines["W1"].aim is Lie.LEFT
    bench.inner.closed = frozenset()
    bench.run(MOVE_S + 0.3)
    assert bench.limit_m == 780.0

    bench.inner.closed = frozenset({"east"})
    bench.run(0.1, 70.0)
    assert bench.limit_m == 80.0
    assert bench.inner.needs("east")
    bench.run(0.1, 100.0 + CLEAR_M + LENGTH_M + 1.0)
    assert bench.limit_m == 780.0
    assert not bench.inner.needs("east")
    # The trip ends at Pier, before the tail.
    assert not bench.inner.needs("tail")


def test_flank_protection_turns_the_far_switch_of_a_crossover_away(tmp_path: Path) -> None:
    """Straight routes on both tracks go together; one over the crossover excludes both."""
    name = crossover(tmp_path)
    bench = Bench(f"{name}:main", to_m=570.0, front_m=100.0)
    bench.inner.machines["W2"].place(Lie.RIGHT)
    bench.run(10.0)
    assert bench.inner.machines["W2"].detected is Lie.LEFT
    assert bench.limit_m == float("inf")
    bench.inner.machines["W2"].lost = True
    assert bench.limit_m == 280.0

    # The spur runs over the flank switch in its other end position.
    bench.inner.set_by_hand(["side", "over", "spur"])
    bench.run(10.0)
    assert bench.inner.is_set("side")
    assert not bench.inner.is_set("over")
    assert not bench.inner.is_set("spur")


def test_flank_protection_knows_both_legs(tmp_path: Path) -> None:
    text = Path(crossover(tmp_path)).read_text(encoding="utf-8")
    swapped = text.replace('left = "b.end", right = "x.end"', 'left = "x.end", right = "b.end"')
    (tmp_path / "crossover.toml").write_text(swapped, encoding="utf-8")
    network = load_network(str(tmp_path / "crossover.toml"))

    flanks = [
        sections_of(network, load_path(f"{tmp_path}/crossover.toml:{name}"))[0].flank
        for name in ("main", "side", "over")
    ]

    assert flanks == [(("W2", Lie.RIGHT),), (("W1", Lie.LEFT),), ()]


def joined(text: str) -> str:
    """Tracks c and d end at a join instead of buffer stops."""
    text = text.replace('"c.end", "b.start", "d.end"', '"b.start"').replace(
        "switches = [", 'joins = [{ a = "c.end", b = "d.end" }]\nswitches = ['
    )
    text = text.replace('["a up", "c up"]', '["a up", "c up", "d down"]')
    text = text.replace('"b up", "d up"', '"b up", "d up", "c down"')
    text = text.replace('["a up", "x up", "d up"]', '["a up", "x up", "d up", "c down"]')
    return text.replace(
        '"return", legs = ["c down", "a down"]', '"short", legs = ["a up", "c up"]'
    ).replace('"meet", legs = ["d down", "x down"]', '"end", legs = ["b up", "d up"]')


def test_tracks_that_are_joined_behind_a_switch_belong_to_its_route(tmp_path: Path) -> None:
    text = joined(Path(crossover(tmp_path)).read_text(encoding="utf-8"))
    (tmp_path / "crossover.toml").write_text(text, encoding="utf-8")
    name = str(tmp_path / "crossover.toml")
    network = load_network(name)

    tracks = {
        route: [
            leg.track.name for leg in sections_of(network, load_path(f"{name}:{route}"))[0].tracks
        ]
        for route in ("main", "side", "over")
    }

    assert tracks == {"main": ["c", "d"], "side": ["d", "c"], "over": ["x", "d", "c"]}


def test_a_route_over_a_crossover_has_one_signal_for_both_switches(tmp_path: Path) -> None:
    name = crossover(tmp_path)

    (section,) = sections_of(load_network(name), load_path(f"{name}:over"))

    assert section.signal_m == 280.0
    assert [(each.switch, each.lie) for each in section.crossings] == [
        ("W1", Lie.RIGHT),
        ("W2", Lie.RIGHT),
    ]


@pytest.mark.parametrize(("length_m", "signals"), [(99.9, 1), (100.0, 2)])
def test_a_track_of_100_m_between_switches_has_a_signal(
    tmp_path: Path, length_m: float, signals: int
) -> None:
    name = crossover(tmp_path, length_m)

    sections = sections_of(load_network(name), load_path(f"{name}:over"))

    assert len(sections) == signals
    flank = sections_of(load_network(name), load_path(f"{name}:main"))[0].flank
    # The signal of a longer track shows stop instead.
    assert flank == ((("W2", Lie.LEFT),) if signals == 1 else ())


def test_two_joined_tracks_between_two_switches_have_a_signal(tmp_path: Path) -> None:
    """Track y of 60 m continues the crossover."""
    name = crossover(tmp_path, more="y")
    text = Path(name).read_text(encoding="utf-8")
    text = text.replace("switches = [", 'joins = [{ a = "x.end", b = "y.start" }]\nswitches = [')
    text = text.replace('right = "x.end"', 'right = "y.end"')
    text = text.replace('["a up", "x up", "d up"]', '["a up", "x up", "y up", "d up"]')
    text = "\n".join(
        line for line in text.splitlines() if "spur" not in line and "meet" not in line
    )
    Path(name).write_text(text, encoding="utf-8")

    sections = sections_of(load_network(name), load_path(f"{name}:over"))

    assert [section.signal_m for section in sections] == [280.0, 400.0]


def departed_late(line: str, *, front_m: float) -> Bench:
    """A train that has no route yet."""
    bench = Bench(line, to_m=900.0, front_m=front_m)
    bench.inner.departs_ns = 1000 * NS
    return bench


@pytest.mark.parametrize(
    ("route", "path", "front_m", "granted"),
    [
        # The route and the train run over W1 at 300 m in the same end position.
        ("return", "main", 378.6, False),
        ("return", "main", 378.7, True),
        ("main", "main", 300.0, True),
        # The side route needs W1 left for its flank.
        ("side", "main", 320.0, True),
        ("side", "over", 320.0, False),
        # The train stands in track c, or still in front of it.
        ("main", "main", 500.0, False),
    ],
)
def test_a_route_over_a_switch_below_the_train_is_refused(
    tmp_path: Path, route: str, path: str, front_m: float, granted: bool
) -> None:
    bench = departed_late(f"{crossover(tmp_path)}:{path}", front_m=front_m)
    bench.inner.set_by_hand([route])
    bench.run(0.1)

    assert bench.inner.is_set(route) is granted


@pytest.mark.parametrize(
    ("front_m", "lie"),
    [
        (300.0, Lie.LEFT),
        (300.1, Lie.RIGHT),
        (378.6, Lie.RIGHT),
        (378.7, Lie.LEFT),
    ],
)
def test_a_switch_below_the_train_lies_as_its_path_needs_it(
    tmp_path: Path, front_m: float, lie: Lie
) -> None:
    bench = Bench(f"{crossover(tmp_path)}:over", to_m=600.0, front_m=front_m)

    assert bench.inner.machines["W1"].detected is lie


@pytest.mark.parametrize(
    ("front_m", "free"),
    [(600.0, ["end"]), (600.1, []), (668.5, []), (668.6, ["short"])],
)
def test_a_track_is_occupied_by_any_part_of_the_train(
    tmp_path: Path, front_m: float, free: list[str]
) -> None:
    """The train runs from track c over the join at 600 m into track d."""
    text = joined(Path(crossover(tmp_path)).read_text(encoding="utf-8"))
    (tmp_path / "crossover.toml").write_text(text, encoding="utf-8")
    bench = departed_late(f"{tmp_path}/crossover.toml:main", front_m=front_m)

    bench.inner.set_by_hand(["short", "end"])
    bench.run(0.1)

    assert [route for route in ("short", "end") if bench.inner.is_set(route)] == free


def test_two_routes_over_one_switch_exclude_each_other(tmp_path: Path) -> None:
    """Both run over W1 in the same end position, in opposite directions."""
    bench = departed_late(f"{crossover(tmp_path)}:side", front_m=100.0)
    bench.inner.set_by_hand(["main", "return"])
    bench.run(0.1)

    assert bench.inner.is_set("main")
    assert not bench.inner.is_set("return")


def test_two_routes_into_one_track_exclude_each_other(tmp_path: Path) -> None:
    """The train and the signaller enter the crossover over different switches."""
    bench = Bench(f"{crossover(tmp_path, 100.0)}:over", to_m=350.0, front_m=100.0)
    bench.run(0.1)
    bench.inner.set_by_hand(["meet"])
    bench.run(0.1)

    assert bench.inner.machines["W1"].aim is Lie.RIGHT
    assert not bench.inner.is_set("meet")


def test_a_route_of_the_signaller_is_locked_whole_or_not_at_all(tmp_path: Path) -> None:
    """The train's route takes the first switch of the two, and the second one is free."""
    bench = Bench(f"{crossover(tmp_path, 100.0)}:main", to_m=600.0, front_m=100.0)
    bench.run(0.1)
    bench.inner.set_by_hand(["over"])
    bench.run(0.1)

    assert not bench.inner.is_set("over")


@pytest.mark.parametrize(("closed", "second"), [(set(), Lie.RIGHT), ({"x"}, Lie.LEFT)])
def test_routes_are_requested_in_one_step_up_to_the_first_that_is_refused(
    tmp_path: Path, closed: set[str], second: Lie
) -> None:
    bench = Bench(f"{crossover(tmp_path, 100.0)}:over", to_m=600.0, front_m=100.0)
    bench.inner.closed = frozenset(closed)
    bench.run(0.1)

    assert bench.inner.machines["W2"].aim is second


def test_a_route_behind_the_train_is_not_requested(tmp_path: Path) -> None:
    bench = Bench(f"{crossover(tmp_path)}:main", to_m=600.0, front_m=400.0)
    bench.inner.set_by_hand(["return"])
    bench.run(0.1)

    assert bench.inner.is_set("return")
    assert bench.inner.refusals == 0


@pytest.mark.parametrize(("front_m", "free"), [(378.6, False), (378.7, True)])
def test_the_flank_is_released_with_the_last_switch_of_its_route(
    tmp_path: Path, front_m: float, free: bool
) -> None:
    bench = Bench(f"{crossover(tmp_path)}:main", to_m=600.0, front_m=100.0)
    bench.run(0.1)
    bench.inner.set_by_hand(["spur"])
    bench.run(0.1, front_m)

    assert bench.inner.is_set("spur") is free


@pytest.mark.parametrize(("front_m", "left"), [(428.6, False), (428.7, True)])
def test_a_track_that_the_train_has_left_may_be_closed(
    tmp_path: Path, front_m: float, left: bool
) -> None:
    """The crossover ends at 360 m, and its second switch is released 10 m beyond."""
    bench = Bench(f"{crossover(tmp_path)}:over", to_m=600.0, front_m=100.0)
    bench.run(10.0)
    bench.run(0.1, front_m)
    bench.inner.closed = frozenset({"x"})

    assert bench.limit_m == (float("inf") if left else 280.0)


@pytest.mark.parametrize(("front_m", "free"), [(378.6, False), (378.7, True)])
def test_the_first_switch_of_a_route_is_released_before_the_second(
    tmp_path: Path, front_m: float, free: bool
) -> None:
    """W2 has its tip at the crossover here, so it protects no flank."""
    name = crossover(tmp_path)
    text = Path(name).read_text(encoding="utf-8")
    text = text.replace(
        'tip = "d.start", left = "b.end", right = "x.end"',
        'tip = "x.end", left = "b.end", right = "d.start"',
    )
    text = "\n".join(line for line in text.splitlines() if '"side"' not in line)
    Path(name).write_text(text, encoding="utf-8")
    bench = Bench(f"{name}:over", to_m=600.0, front_m=100.0)
    bench.run(10.0)
    bench.inner.set_by_hand(["main"])
    bench.run(0.1, front_m)

    assert bench.inner.is_set("main") is free


@pytest.mark.parametrize(("front_m", "asked"), [(79.9, False), (80.0, True)])
def test_the_route_is_requested_1200_m_before_its_signal(
    tmp_path: Path, front_m: float, asked: bool
) -> None:
    """The first track ends at 1300 m, so its signal is at 1280 m."""
    name = crossover(tmp_path, main_m=1300.0)
    bench = Bench(f"{name}:over", to_m=1600.0, front_m=front_m)

    bench.run(10.0)

    assert (bench.inner.machines["W1"].detected is Lie.RIGHT) is asked


def test_a_route_of_the_train_over_a_switch_behind_its_last_stop_is_not_requested() -> None:
    for to_m, limit_m in ((800.0, 780.0), (801.0, float("inf"))):
        bench = Bench(f"{FERRY}:out", to_m=to_m, front_m=0.0)
        bench.run(10.0)
        assert bench.limit_m == limit_m
        assert bench.inner.needs("tail") is (to_m > 800.0)


def test_each_track_and_switch_is_released_behind_the_train(tmp_path: Path) -> None:
    """W1 is at 300 m and W2 at 360 m; the train of 68.6 m stands beyond the first alone."""
    name = crossover(tmp_path)
    bench = Bench(f"{name}:over", to_m=600.0, front_m=100.0)
    bench.run(10.0)
    bench.inner.set_by_hand(["main"])

    bench.run(1.0, 378.5)
    assert not bench.inner.is_set("main")
    bench.run(1.0, 378.7)
    # W1 is free, but W2 below the train must lie away from the straight route.
    assert not bench.inner.is_set("main")
    bench.run(1.0, 438.7)
    assert bench.inner.is_set("main")


def test_a_switch_below_the_train_lies_right_from_the_start(tmp_path: Path) -> None:
    bench = Bench(f"{crossover(tmp_path)}:over", to_m=600.0, front_m=320.0)

    assert bench.inner.machines["W1"].detected is Lie.RIGHT
    bench.run(4.2)
    assert bench.limit_m == float("inf")
    assert bench.inner.unlocked_m == float("inf")


@settings(max_examples=10, deadline=None)
@given(data=st.data())
def test_no_switch_moves_below_the_train_or_under_two_routes(data: st.DataObject) -> None:
    """The signaller sets and cancels at random while the train runs up to its limit."""
    line = f"{FERRY}:{data.draw(st.sampled_from(['out', 'back']))}"
    crossings = [
        each
        for section in sections_of(load_network(FERRY), load_path(line))
        for each in section.crossings
    ]
    start_m = load_path(line).line.stations[0].stop_m
    bench = Bench(line, to_m=1600.0, front_m=start_m)
    for _ in range(40):
        bench.inner.set_by_hand(data.draw(st.lists(st.sampled_from(["out", "back"]), max_size=2)))
        step_m = data.draw(st.sampled_from([0.0, 5.0, 30.0, 90.0]))
        reach_m = max(bench.front_m, min(bench.limit_m, load_path(line).line.end_m))
        bench.run(0.5, min(bench.front_m + step_m, reach_m))

        for each in crossings:
            if bench.front_m - LENGTH_M < each.at_m < bench.front_m:
                assert bench.inner.machines[each.switch].detected is each.lie
        assert not (bench.inner.is_set("out") and bench.inner.is_set("back"))
