"""What must hold between trains: each violation is found, once, and what is right is none."""

from dataclasses import replace
from math import inf
from pathlib import Path
from typing import Final

import pytest

from firmware_py.trackdb.circuit import load_network, load_path
from metro_hil.line.turning.invariants import (
    INTO_AUTHORITY,
    INTO_ROUTE,
    INTO_TRAIN,
    KNOWN_S,
    OVER_SWITCH,
    OVERLAP,
    Between,
    Observed,
)
from plant_emulator.wayside.interlocking import Interlocking, SharedNetwork, SignalBox

FERRY: Final = str(Path(__file__).resolve().parents[4] / "docs/examples/line/ferry.toml")
NETWORK: Final = load_network(FERRY)
PATHS: Final = {name: load_path(f"{FERRY}:{name}") for name in ("out", "back")}
NS: Final = 1_000_000_000
NAMES: Final = ("one", "two")


def on(box: SignalBox, name: str, route: str, front_m: float) -> Interlocking:
    path = PATHS[route]
    return Interlocking(
        NETWORK,
        path,
        to_m=path.line.stations[-1].stop_m,
        front_m=front_m,
        rear_m=front_m - 68.6,
        shared=SharedNetwork(box, name),
    )


def seen(
    one: Interlocking,
    one_m: float,
    two: Interlocking,
    two_m: float | None,
    *,
    number: int = 1,
) -> dict[str, Observed]:
    """Two trains, with the ends of their authorities and the number of those."""
    return {"one": Observed(one, one_m, (1, number)), "two": Observed(two, two_m, (1, number))}


@pytest.mark.parametrize(
    ("fronts_m", "ends_m", "found"),
    [
        ((600.0, 400.0), (610.0, 500.0), []),
        ((600.0, 400.0), (610.0, 531.0), []),
        ((600.0, 400.0), (610.0, 532.0), [(INTO_TRAIN, ("two", "one"))]),
        ((600.0, 532.0), (610.0, None), [(OVERLAP, ("one", "two"))]),
        # W2 lies at 800 m, and nothing is locked.
        ((600.0, 400.0), (801.0, 500.0), [(OVER_SWITCH, ("one",))]),
    ],
)
def test_of_two_trains_that_follow(
    fronts_m: tuple[float, float],
    ends_m: tuple[float | None, float | None],
    found: list[tuple[str, tuple[str, ...]]],
) -> None:
    box, between = SignalBox(NETWORK), Between()
    routes = [on(box, name, "out", at_m) for name, at_m in zip(NAMES, fronts_m, strict=True)]
    present = {
        name: Observed(route, end_m, (1, 1))
        for name, route, end_m in zip(NAMES, routes, ends_m, strict=True)
    }

    between.look(1.0, present)
    between.look(2.0, present)

    assert [(each.kind, each.trains) for each in between.violations] == found
    assert all(each.at_s == 1.0 for each in between.violations)
    assert between.checked_count == 4
    gap_m = fronts_m[0] - 68.6 - fronts_m[1]
    assert between.least_gap_m == (pytest.approx(gap_m) if gap_m >= 0.0 else inf)


def test_of_two_trains_that_run_towards_each_other() -> None:
    """`tail` is the last track of the path out and the first one of the path back."""
    box, between = SignalBox(NETWORK), Between()
    comes = on(box, "one", "out", 780.0)
    tail = PATHS["back"].legs[0]
    waits = on(box, "two", "back", tail.path_m(100.0))
    comes.step(NS, front_m=780.0, rear_m=711.4)
    # The dead end is taken, so the switch is not locked for the first one.
    between.look(1.0, seen(comes, 880.0, waits, tail.path_m(90.0)))
    between.look(2.0, seen(comes, 895.0, waits, tail.path_m(90.0), number=2))

    assert [each.kind for each in between.violations] == [OVER_SWITCH, INTO_AUTHORITY]


def test_an_authority_against_the_route_of_another_train() -> None:
    box, between = SignalBox(NETWORK), Between()
    leaves = on(box, "one", "out", 0.0)
    leaves.step(NS, front_m=0.0, rear_m=-68.6)
    assert [set(each.tracks) for each in leaves.held] == [{"east"}, {"tail"}]
    other = on(box, "two", "back", PATHS["back"].legs[1].from_m + 300.0)
    back = replace(PATHS["back"].legs[1], track=NETWORK.track("east"))
    wrong = replace(other.stretch.path, legs=(PATHS["back"].legs[0], back, PATHS["back"].legs[2]))
    other.stretch = replace(other.stretch, path=wrong)

    between.look(1.0, seen(leaves, 70.0, other, None))

    assert [(each.kind, each.trains) for each in between.violations] == [
        (INTO_ROUTE, ("two", "one"))
    ]


@pytest.mark.parametrize(("number", "found"), [(1, []), (2, [OVER_SWITCH])])
def test_a_switch_that_fails_below_an_authority_is_no_violation_until_the_next_one(
    number: int, found: list[str]
) -> None:
    box, between = SignalBox(NETWORK), Between()
    comes = on(box, "one", "out", 50.0)
    for second in range(10):
        comes.step(second * NS, front_m=50.0, rear_m=-18.6)
    assert comes.unlocked_m > 110.0
    between.look(10.0, {"one": Observed(comes, 110.0, (1, 1))})

    box.machines["W1"].lost = True
    for at_s in (10.05, 10.10):
        between.look(at_s, {"one": Observed(comes, 110.0, (1, 1))})
    between.look(10.15, {"one": Observed(comes, 110.0, (1, number))})

    assert [each.kind for each in between.violations] == found


@pytest.mark.parametrize(("later_s", "found"), [(0.2, []), (0.21, [OVER_SWITCH])])
def test_masters_learn_a_little_later_that_a_switch_failed(
    later_s: float, found: list[str]
) -> None:
    box, between = SignalBox(NETWORK), Between(KNOWN_S)
    comes = on(box, "one", "out", 50.0)
    for second in range(10):
        comes.step(second * NS, front_m=50.0, rear_m=-18.6)
    between.look(9.95, {"one": Observed(comes, 110.0, (1, 1))})

    box.machines["W1"].lost = True
    between.look(10.0, {"one": Observed(comes, 110.0, (1, 1))})
    between.look(10.0 + later_s, {"one": Observed(comes, 110.0, (1, 2))})

    assert [each.kind for each in between.violations] == found
    assert comes.has_failed(0)
    assert not comes.has_failed(1)
