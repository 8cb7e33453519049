"""Which trains account for counted axles: those that already stood there during the count."""

from dataclasses import replace
from typing import Any

import pytest

from hil_tests.unit.vobc.train_to_train.t2t_chair import MS, TERM, Chair, entry
from vobc.train_to_train.authority import StandingTrain

STRANGER = 3


def sieved(chair: Chair, train: int = STRANGER) -> bool | None:
    """Whether a train is sieved; None if it is not on the roster."""
    return next((e.sieved for e in chair.master.roster.proposed if e.train == train), None)


def cycle(chair: Chair, *, axles: dict[int, int], seen_ms: int | None = None) -> None:
    chair.track(axles=axles, seen_ms=seen_ms)
    chair.step(0)
    chair.keeps()


def test_a_count_from_before_a_train_stopped_does_not_sieve_it() -> None:
    """The count included the shadow train but not yet the newcomer: as many axles as the
    newcomer has."""
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
def test_a_count_while_a_train_stands_sieves_it(later_ms: int) -> None:
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
def test_a_train_is_sieved_only_if_it_stood_all_the_time_in_one_incarnation(
    between: dict[str, Any],
) -> None:
    chair = Chair((), sections=True, now_ms=1000)
    chair.reports(STRANGER, 300.0)
    chair.now_ns += 50 * MS
    chair.reports(STRANGER, 300.0, **between)
    chair.now_ns += 50 * MS
    chair.reports(STRANGER, 300.0, boot=between.get("boot", 1))
    cycle(chair, axles={1: 16}, seen_ms=1049)

    assert sieved(chair) is False


def test_a_train_of_the_roster_is_sieved_by_the_same_rule() -> None:
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
def test_a_delayed_report_does_not_prove_that_a_train_stands_there_now(
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


def test_a_report_to_the_former_master_has_no_known_age() -> None:
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
def test_a_train_that_may_have_run_on_since_its_report_accounts_for_no_axles(
    told: dict[str, Any], *, shown: bool
) -> None:
    """The report has only just arrived; its echo shows its age."""
    chair = Chair((entry(1, 320.0),), sections=True, now_ms=1000)
    chair.reports(1, 400.0, **told)
    chair.reports(STRANGER, 300.0)
    cycle(chair, axles={1: 32, 3: 16}, seen_ms=1000)

    assert sieved(chair) is shown


def test_the_last_position_of_a_lost_train_accounts_for_no_axles() -> None:
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


def test_a_train_outside_the_area_accounts_for_axles_while_its_report_is_recent() -> None:
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


def test_a_train_that_reports_itself_near_may_not_have_been_there_during_the_count() -> None:
    chair = Chair((), sections=True, now_ms=1000)
    inside = chair.reports(STRANGER, 1990.0)
    behind = replace(chair.reports(4, 2085.0), echo_ns=950 * MS)
    chair.track(axles={8: 32}, seen_ms=900)
    around, view = chair.master._around, chair.master._track

    told = [(inside, chair.now_ns), (behind, chair.now_ns)]
    (other,) = around.scene(STRANGER, around.look((), told, view, chair.now_ns)).standing
    assert (other.farther_m, other.behind_m) == (2.0, 4.0)


def test_a_train_of_the_roster_may_not_have_been_there_during_the_count_either() -> None:
    chair = Chair((entry(1, 320.0),), sections=True, now_ms=1000)
    chair.reports(1, 400.0, echo_ns=950 * MS)
    chair.track(axles={1: 32}, seen_ms=900)
    around, view = chair.master._around, chair.master._track

    (other,) = around.scene(STRANGER, around.look((), [], view, chair.now_ns)).standing
    assert (other.farther_m, other.behind_m) == (2.0, 4.0)
    assert (
        around.scene(STRANGER, around.look((), [], None, chair.now_ns)).standing[0].behind_m == 0.0
    )


def test_a_train_of_the_roster_accounts_for_axles_while_its_report_is_recent() -> None:
    chair = Chair((entry(1, 320.0),), sections=True, now_ms=1000)
    chair.reports(1, 400.0)
    chair.track(axles={1: 32}, seen_ms=1000)
    around, view = chair.master._around, chair.master._track

    def standing(age_ms: int) -> list[int]:
        scene = around.scene(STRANGER, around.look((), [], view, chair.now_ns + age_ms * MS))
        return [each.axles for each in scene.standing]

    assert standing(500) == [16]
    assert standing(501) == []


def test_a_train_that_stood_before_and_after_the_count_stood_there_during_it() -> None:
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
def test_a_waiting_train_counts_as_present_and_may_be_dropped(
    since_ms: int, *, there: bool
) -> None:
    """Another newcomer is not sieved by it, but its axles count as its own."""
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


def test_there_is_no_shadow_train_beyond_the_end_of_the_line() -> None:
    """Other trains may stand farther back, where this master receives no report."""
    chair = Chair((), area=2, sections=True, now_ms=1000)
    chair.reports(STRANGER, 3995.0)
    cycle(chair, axles={7: 16, 8: 16}, seen_ms=1000)

    assert sieved(chair) is True


def test_without_a_count_no_train_is_sieved() -> None:
    chair = Chair((), sections=True, now_ms=1000)
    told = chair.reports(STRANGER, 300.0)
    around, strangers = chair.master._around, [(told, chair.now_ns)]

    scene = around.scene(STRANGER, around.look((), strangers, None, chair.now_ns))
    assert (scene.counted, scene.stood) == ((), False)
    assert around.sight(strangers, None, chair.now_ns).standing == ()
