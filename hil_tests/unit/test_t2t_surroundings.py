"""Whose axles explain what was counted: of trains that stood there already when it was."""

from typing import Any

import pytest

from hil_tests.unit.t2t_chair import MS, Chair, entry

STRANGER = 3


def sieved(chair: Chair, train: int = STRANGER) -> bool | None:
    """None: it is not on the roster."""
    return next((e.sieved for e in chair.master.roster.proposed if e.train == train), None)


def cycle(chair: Chair, *, axles: dict[int, int], seen_ms: int | None = None) -> None:
    chair.track(axles=axles, seen_ms=seen_ms)
    chair.step(0)
    chair.keeps()


def test_a_count_from_before_a_train_stood_there_shows_nothing_of_who_else_does() -> None:
    """The one that hides was counted, and the newcomer not yet: so many axles as it has itself."""
    chair = Chair((), sections=True, now_ms=1000)
    chair.now_ns += 30 * MS
    chair.reports(STRANGER, 300.0)
    cycle(chair, axles={1: 16}, seen_ms=1029)
    assert sieved(chair) is False

    chair.now_ns += 200 * MS
    chair.reports(STRANGER, 300.0)
    cycle(chair, axles={1: 32})
    assert sieved(chair) is False


@pytest.mark.parametrize("later_ms", [0, 200])
def test_a_count_from_when_it_stood_shows_that_nobody_else_does(later_ms: int) -> None:
    chair = Chair((), sections=True, now_ms=1000)
    chair.reports(STRANGER, 300.0)
    chair.now_ns += later_ms * MS
    chair.reports(STRANGER, 300.0)
    cycle(chair, axles={1: 16}, seen_ms=1000)

    assert sieved(chair) is True


@pytest.mark.parametrize(
    "between",
    [
        {"standstill": False, "speed_mps": 0.2},
        {"localised": False},
        {"boot": 2},
    ],
)
def test_it_has_to_have_stood_all_the_time_and_in_one_life(between: dict[str, Any]) -> None:
    chair = Chair((), sections=True, now_ms=1000)
    chair.reports(STRANGER, 300.0)
    chair.now_ns += 50 * MS
    chair.reports(STRANGER, 300.0, **between)
    chair.now_ns += 50 * MS
    chair.reports(STRANGER, 300.0, boot=between.get("boot", 1))
    cycle(chair, axles={1: 16}, seen_ms=1049)

    assert sieved(chair) is False


def test_a_train_of_the_roster_is_sieved_by_the_same_measure() -> None:
    chair = Chair((entry(1, 300.0, sieved=False),), sections=True, now_ms=1000)
    chair.reports(1, 300.0)
    cycle(chair, axles={1: 16}, seen_ms=999)
    assert sieved(chair, 1) is False

    chair.now_ns += 200 * MS
    chair.reports(1, 300.0)
    cycle(chair, axles={1: 16}, seen_ms=1000)
    assert sieved(chair, 1) is True


def test_as_long_as_nothing_was_counted_nothing_is_shown() -> None:
    chair = Chair((), sections=True, now_ms=1000)
    told = chair.reports(STRANGER, 300.0)
    around, strangers = chair.master._around, [(told, chair.now_ns)]

    scene = around.scene(STRANGER, (), strangers, None, chair.now_ns)
    assert (scene.counted, scene.stood) == ((), False)
    assert around.sight(strangers, None, chair.now_ns).standing == ()
