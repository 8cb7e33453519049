"""Whose axles explain what was counted: of trains that stood there already when it was."""

from dataclasses import replace
from typing import Any

import pytest

from hil_tests.unit.vobc.train_to_train.t2t_chair import MS, TERM, Chair, entry
from vobc.train_to_train.authority import StandingTrain

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


@pytest.mark.parametrize(
    ("told", "shown"),
    [
        ({"echo_ns": 500 * MS}, True),
        ({"echo_ns": 500 * MS - 1}, False),
        ({"echo_ns": 1001 * MS}, False),
        ({"echo_ns": 0}, False),
    ],
)
def test_what_was_long_on_its_way_does_not_say_that_a_train_stands_there_now(
    told: dict[str, Any], *, shown: bool
) -> None:
    chair = Chair((entry(1, 220.0, sieved=False),), sections=True, now_ms=1000)
    chair.reports(1, 300.0, **told)
    cycle(chair, axles={1: 16}, seen_ms=1000)
    assert sieved(chair, 1) is shown

    chair = Chair((), sections=True, now_ms=1000)
    chair.reports(STRANGER, 300.0, **told)
    cycle(chair, axles={1: 16}, seen_ms=1000)
    assert sieved(chair) is (True if shown else None)


def test_what_a_train_says_to_the_master_before_is_of_no_known_age() -> None:
    chair = Chair((), sections=True, now_ms=1000)
    told = chair.reports(STRANGER, 300.0, term=TERM - 1)
    chair.track(axles={1: 16}, seen_ms=1000)

    around, view = chair.master._around, chair.master._track
    scene = around.scene(STRANGER, around.look((), [(told, chair.now_ns)], view, chair.now_ns))
    assert scene.stood is False


@pytest.mark.parametrize(
    ("told", "shown"),
    [
        ({}, True),
        ({"echo_ns": 499 * MS, "latent_m": 1900.0}, False),
    ],
)
def test_a_train_that_may_have_run_on_since_its_last_word_explains_no_axles(
    told: dict[str, Any], *, shown: bool
) -> None:
    """Its word has only just come: how old it is shows by what it echoes."""
    chair = Chair((entry(1, 320.0),), sections=True, now_ms=1000)
    chair.reports(1, 400.0, **told)
    chair.reports(STRANGER, 300.0)
    cycle(chair, axles={1: 32, 3: 16}, seen_ms=1000)

    assert sieved(chair) is shown


def test_where_a_train_was_before_it_lost_its_place_explains_no_axles() -> None:
    chair = Chair((entry(1, 320.0),), sections=True, now_ms=1000)
    chair.reports(1, 400.0, latent_m=1900.0)
    chair.now_ns += 501 * MS
    chair.reports(1, 400.0, latent_m=1900.0, localised=False)
    chair.reports(STRANGER, 300.0)
    cycle(chair, axles={1: 32, 3: 16}, seen_ms=1501)
    assert sieved(chair) is False

    chair.now_ns += 200 * MS
    chair.reports(1, 400.0)
    chair.reports(STRANGER, 300.0)
    cycle(chair, axles={1: 32})
    assert sieved(chair) is True


def test_one_outside_the_area_explains_axles_while_its_word_is_young() -> None:
    chair = Chair((), sections=True, now_ms=1000)
    inside = chair.reports(STRANGER, 1990.0)
    behind = chair.reports(4, 2085.0)
    chair.track(axles={8: 32}, seen_ms=1000)
    around, view = chair.master._around, chair.master._track

    young = [(inside, chair.now_ns), (behind, chair.now_ns)]
    scene = around.scene(STRANGER, around.look((), young, view, chair.now_ns))
    assert [each.axles for each in scene.standing] == [16]
    old = [young[0], (replace(behind, echo_ns=0), chair.now_ns)]
    assert around.scene(STRANGER, around.look((), old, view, chair.now_ns)).standing == ()


def test_who_says_that_it_is_near_may_not_have_been_there_when_all_was_counted() -> None:
    chair = Chair((), sections=True, now_ms=1000)
    inside = chair.reports(STRANGER, 1990.0)
    behind = replace(chair.reports(4, 2085.0), echo_ns=950 * MS)
    chair.track(axles={8: 32}, seen_ms=900)
    around, view = chair.master._around, chair.master._track

    told = [(inside, chair.now_ns), (behind, chair.now_ns)]
    (other,) = around.scene(STRANGER, around.look((), told, view, chair.now_ns)).standing
    assert (other.farther_m, other.behind_m) == (2.0, 4.0)


def test_a_train_of_the_roster_may_not_have_been_there_either() -> None:
    chair = Chair((entry(1, 320.0),), sections=True, now_ms=1000)
    chair.reports(1, 400.0, echo_ns=950 * MS)
    chair.track(axles={1: 32}, seen_ms=900)
    around, view = chair.master._around, chair.master._track

    (other,) = around.scene(STRANGER, around.look((), [], view, chair.now_ns)).standing
    assert (other.farther_m, other.behind_m) == (2.0, 4.0)
    assert (
        around.scene(STRANGER, around.look((), [], None, chair.now_ns)).standing[0].behind_m == 0.0
    )


def test_a_train_of_the_roster_explains_axles_while_its_word_is_young() -> None:
    chair = Chair((entry(1, 320.0),), sections=True, now_ms=1000)
    chair.reports(1, 400.0)
    chair.track(axles={1: 32}, seen_ms=1000)
    around, view = chair.master._around, chair.master._track

    def standing(age_ms: int) -> list[int]:
        scene = around.scene(STRANGER, around.look((), [], view, chair.now_ns + age_ms * MS))
        return [each.axles for each in scene.standing]

    assert standing(500) == [16]
    assert standing(501) == []


def test_who_stood_before_and_after_was_there_just_so() -> None:
    chair = Chair((entry(1, 320.0),), sections=True, now_ms=1000)
    chair.reports(1, 400.0)
    chair.now_ns += 200 * MS
    chair.reports(1, 400.0)
    chair.track(axles={1: 16}, seen_ms=1100)
    around, view = chair.master._around, chair.master._track

    scene = around.scene(STRANGER, around.look((), [], view, chair.now_ns))
    assert scene.at_rest == (StandingTrain(320.0, 400.0, 16),)
    assert around.scene(STRANGER, around.look((), [], view, chair.now_ns + 1000 * MS)).at_rest == ()


@pytest.mark.parametrize(("since_ms", "there"), [(1000, True), (1001, False)])
def test_one_that_waits_in_the_area_is_there_now_and_may_be_forgotten(
    since_ms: int, *, there: bool
) -> None:
    """Another newcomer is not sieved by it, but its axles are nobody else's."""
    chair = Chair((), sections=True, now_ms=since_ms)
    waits = chair.reports(4, 700.0)
    chair.now_ns += 100 * MS
    chair.track(axles={1: 16, 3: 16}, seen_ms=1000)
    around, view = chair.master._around, chair.master._track

    told = [(waits, chair.now_ns)]
    look = around.look((), told, view, chair.now_ns)
    scene = around.scene(STRANGER, look, inside=True)

    assert (scene.standing, scene.at_rest) == ((), ())
    assert scene.there == ((StandingTrain(620.0, 700.0, 16),) if there else ())
    assert around.scene(STRANGER, look).there == ()
    assert around.scene(4, look, inside=True).there == ()


def test_beyond_the_end_of_the_line_nobody_hides() -> None:
    """Farther back others stand whom this master does not hear."""
    chair = Chair((), area=2, sections=True, now_ms=1000)
    chair.reports(STRANGER, 3995.0)
    cycle(chair, axles={7: 16, 8: 16}, seen_ms=1000)

    assert sieved(chair) is True


def test_as_long_as_nothing_was_counted_nothing_is_shown() -> None:
    chair = Chair((), sections=True, now_ms=1000)
    told = chair.reports(STRANGER, 300.0)
    around, strangers = chair.master._around, [(told, chair.now_ns)]

    scene = around.scene(STRANGER, around.look((), strangers, None, chair.now_ns))
    assert (scene.counted, scene.stood) == ((), False)
    assert around.sight(strangers, None, chair.now_ns).standing == ()
