"""A train is taken off the roster by a person's word, if nothing speaks against it."""

from typing import Any

import pytest

from hil_tests.unit.vobc.train_to_train.t2t_chair import (
    LENGTH_M,
    MS,
    OWN,
    TERM,
    Chair,
    authorities,
    entry,
    of,
)
from vobc.train_to_train.removals import TrackObservation
from zenoh_config.t2t import SUPERVISION, RosterEntry
from zenoh_config.t2t_supervision import Removal, RemovalAnswer, RemovalState

GONE, NEXT = 1, 2
ROSTER = (entry(GONE, 900.0), entry(NEXT, 780.0))
"""Both in the second section, from 500 m to 1000 m; the second stands right behind the first."""
SILENT_MS = 1001
"""An authority of timers A is obeyed for a second."""


def scene(roster: tuple[RosterEntry, ...] = ROSTER, *, silent_ms: int = SILENT_MS) -> Chair:
    """The first has said nothing since there is this master, the second stands and says so."""
    chair = Chair(roster, sections=True)
    chair.now_ns = silent_ms * MS
    chair.reports(NEXT, 780.0)
    return chair


def answers(said: list[Any]) -> dict[int, RemovalState]:
    told = of(RemovalAnswer, said)
    assert all((e.source, e.destination, e.area) == (OWN, SUPERVISION, 1) for e in told)
    assert len({each.train for each in told}) == len(told)
    return {each.train: each.state for each in told}


def judged(chair: Chair, train: int = GONE, **told: Any) -> RemovalState | None:
    chair.track(**{"axles": {2: 16}, **told})
    chair.removes(train)
    return answers(chair.step(0)).get(train)


def test_who_waited_behind_it_goes_on_when_it_is_kept_that_it_is_gone() -> None:
    chair = scene()
    chair.track(axles={2: 16})
    said = chair.step(0)
    assert authorities(said)[NEXT].end_m < 820.0
    assert answers(said) == {}

    chair.now_ns += MS
    chair.removes(GONE)
    assert answers(chair.step(100)) == {GONE: RemovalState.AXLES}  # Seen before a person said so.
    chair.now_ns += 100 * MS
    chair.reports(NEXT, 780.0)
    assert judged(chair) is RemovalState.COMMITTING
    assert chair.order() == [NEXT]
    assert answers(chair.step(100)) == {GONE: RemovalState.COMMITTING}

    chair.keeps()
    chair.reports(NEXT, 780.0)
    chair.track(axles={2: 16})
    said = chair.step(100)
    assert answers(said) == {GONE: RemovalState.GONE}
    assert authorities(said)[NEXT].end_m == 2000.0
    assert sorted(chair.master._known.records) == [NEXT]


@pytest.mark.parametrize(("axles", "state"), [(16, "COMMITTING"), (17, "AXLES"), (15, "AXLES")])
def test_who_waits_for_its_place_because_of_it_explains_its_own_axles(
    axles: int, state: str
) -> None:
    """What the one that is gone held is not known: it may have gone past the one that waits."""
    chair = Chair((entry(GONE, 900.0),), sections=True)
    chair.now_ns = SILENT_MS * MS
    chair.reports(NEXT, 1300.0)

    assert judged(chair, axles={3: axles}) is RemovalState[state]


@pytest.mark.parametrize(
    ("silent_ms", "state"),
    [(1, RemovalState.HEARD), (1000, RemovalState.HEARD), (1001, RemovalState.COMMITTING)],
)
def test_as_long_as_it_may_obey_an_authority_it_stays(silent_ms: int, state: RemovalState) -> None:
    chair = scene(silent_ms=silent_ms)

    assert judged(chair) is state
    assert chair.order() == ([NEXT] if state is RemovalState.COMMITTING else [GONE, NEXT])


@pytest.mark.parametrize("lost", [True, False])
def test_who_is_heard_stays_also_when_it_began_anew(*, lost: bool) -> None:
    chair = scene()
    chair.reports(GONE, 900.0, boot=1, localised=not lost)
    assert judged(chair, axles={2: 32}) is RemovalState.HEARD

    # Somebody is where it was, and may be it.
    chair = scene()
    chair.reports(GONE, 300.0, boot=2, localised=not lost)
    assert judged(chair, axles={2: 32}) is RemovalState.HEARD
    assert chair.order() == [GONE, NEXT]

    chair.now_ns += 501 * MS
    chair.reports(NEXT, 780.0)
    assert judged(chair, axles={2: 32}) is RemovalState.AXLES

    chair.now_ns += 100 * MS
    chair.reports(NEXT, 780.0)
    assert judged(chair) is RemovalState.COMMITTING


def test_its_last_axle_may_stand_4_m_before_its_rear_wherever_its_new_life_was() -> None:
    chair = scene((entry(GONE, 1078.0), entry(NEXT, 780.0)))
    chair.reports(GONE, 300.0, boot=2)
    assert judged(chair, axles={2: 16, 3: 16}) is RemovalState.HEARD

    chair.now_ns += 501 * MS
    chair.reports(NEXT, 780.0)
    assert judged(chair, axles={2: 16, 3: 16}) is RemovalState.AXLES


@pytest.mark.parametrize(
    ("axles", "state"),
    [
        ({2: 16}, RemovalState.COMMITTING),
        ({2: 32}, RemovalState.AXLES),
        ({2: 16, 3: 16}, RemovalState.AXLES),
        ({2: 16, 5: 16}, RemovalState.AXLES),  # Nobody knows what it was granted: it may be there.
        ({1: 16, 2: 16}, RemovalState.COMMITTING),  # Behind where it was.
        ({1: 16, 2: 24}, RemovalState.AXLES),  # Somebody comes nearer.
        ({}, RemovalState.COMMITTING),
        ({2: 0}, RemovalState.AXLES),
    ],
)
def test_what_is_counted_stands_against_a_persons_word(
    axles: dict[int, int], state: RemovalState
) -> None:
    assert judged(scene(), axles=axles) is state


@pytest.mark.parametrize(
    ("axles", "state"),
    [({2: 16}, RemovalState.COMMITTING), ({2: 16, 4: 16}, RemovalState.AXLES)],
)
def test_axles_beyond_all_that_it_was_granted_may_be_its_own(
    axles: dict[int, int], state: RemovalState
) -> None:
    """It may have been driven there by hand (seed 132971)."""
    chair = Chair(ROSTER, sections=True)
    chair.reports(GONE, 900.0, latent_m=1100.0, held_end_m=1100.0)
    chair.now_ns = SILENT_MS * MS
    chair.reports(NEXT, 780.0)

    assert judged(chair, axles=axles) is state


@pytest.mark.parametrize(
    ("ahead_m", "state"), [(1500.0, RemovalState.COMMITTING), (1500.1, RemovalState.AXLES)]
)
def test_but_not_beyond_the_train_ahead(ahead_m: float, state: RemovalState) -> None:
    """Which is on its way, and explains nothing."""
    chair = Chair((entry(6, ahead_m + LENGTH_M), *ROSTER), sections=True)
    chair.reports(GONE, 900.0, latent_m=1100.0, held_end_m=1100.0)
    chair.now_ns = SILENT_MS * MS
    chair.reports(NEXT, 780.0)

    assert judged(chair, axles={2: 16, 4: 16}) is state


@pytest.mark.parametrize(
    ("rear_m", "state"), [(1007.0, RemovalState.COMMITTING), (1006.9, RemovalState.AXLES)]
)
def test_it_may_have_rolled_and_jogged_back(rear_m: float, state: RemovalState) -> None:
    chair = Chair((entry(GONE, rear_m + LENGTH_M), entry(NEXT, 1200.0)), sections=True)
    chair.now_ns = SILENT_MS * MS
    chair.reports(NEXT, 1200.0)

    assert judged(chair, axles={2: 8, 3: 16}) is state


def test_axles_behind_where_its_rear_has_been_are_no_matter() -> None:
    chair = Chair((entry(GONE, 1200.0), entry(NEXT, 1090.0)), sections=True)
    chair.now_ns = SILENT_MS * MS
    chair.reports(NEXT, 1090.0)

    assert judged(chair, axles={1: 16, 3: 32}) is RemovalState.AXLES
    chair.now_ns += 200 * MS
    assert judged(chair, axles={1: 16, 3: 16}) is RemovalState.COMMITTING


@pytest.mark.parametrize(
    "told", [{"standstill": False, "speed_mps": 0.1}, {"localised": False}, {"axles": 20}]
)
def test_axles_are_explained_only_by_who_stands_there(told: dict[str, Any]) -> None:
    chair = Chair(ROSTER, sections=True)
    chair.now_ns = SILENT_MS * MS
    chair.reports(NEXT, 780.0, **told)

    assert judged(chair) is RemovalState.AXLES


def test_who_came_to_stand_after_all_was_counted_explains_nothing() -> None:
    for late_ms in (0, 1):
        chair = Chair(ROSTER, sections=True)
        chair.now_ns = SILENT_MS * MS
        chair.reports(NEXT, 780.0, standstill=False, speed_mps=0.1)
        chair.removes(GONE)
        chair.now_ns += 10 * MS
        chair.track(axles={2: 16})
        chair.now_ns += late_ms * MS
        chair.reports(NEXT, 780.0)

        state = RemovalState.AXLES if late_ms else RemovalState.COMMITTING
        assert answers(chair.step(0)) == {GONE: state}


def test_who_has_not_been_heard_lately_explains_nothing() -> None:
    chair = scene()
    chair.now_ns += 500 * MS
    assert judged(chair) is RemovalState.COMMITTING

    chair = scene()
    chair.now_ns += 501 * MS
    assert judged(chair) is RemovalState.AXLES


@pytest.mark.parametrize(
    ("age_ms", "state"),
    [
        (0, RemovalState.COMMITTING),
        (3000, RemovalState.COMMITTING),
        (3001, RemovalState.TOO_OLD),
        (-1, RemovalState.TOO_OLD),
    ],
)
def test_what_a_person_saw_long_ago_does_not_count(age_ms: int, state: RemovalState) -> None:
    chair = scene(silent_ms=4000)
    chair.track(axles={2: 16})
    chair.removes(GONE, echo_ms=4000 - age_ms)

    assert answers(chair.step(0)) == {GONE: state}
    assert chair.order() == ([NEXT] if state is RemovalState.COMMITTING else [GONE, NEXT])
    assert answers(chair.step(100)).get(GONE) is (None if age_ms in (3001, -1) else state)


def test_a_removal_counts_for_three_seconds_and_the_newest_of_them() -> None:
    chair = scene()
    assert judged(chair, axles={2: 32}) is RemovalState.AXLES
    chair.removes(GONE, echo_ms=0)  # Late, and of no more account than the one before.
    chair.now_ns = (SILENT_MS + 3000) * MS
    chair.track(axles={2: 32})
    assert answers(chair.step(0)) == {GONE: RemovalState.AXLES}
    assert answers(chair.step(100)) == {}


@pytest.mark.parametrize("term", [TERM - 1, TERM + 1, 0])
def test_what_was_said_to_another_command_does_not_count(term: int) -> None:
    chair = scene()
    chair.track(axles={2: 16})
    chair.removes(GONE, term=term)

    assert answers(chair.step(0)) == {}
    assert chair.order() == [GONE, NEXT]


def test_three_seconds_are_three_seconds() -> None:
    for late_ns in (0, 1):
        chair = scene(silent_ms=4000)
        chair.track(axles={2: 16})
        echo_ns = chair.now_ns - 3_000_000_000 - late_ns
        chair.on_message(Removal(*chair.head(65_100), echo_ns, GONE))
        wanted = RemovalState.TOO_OLD if late_ns else RemovalState.COMMITTING
        assert answers(chair.step(0)) == {GONE: wanted}


def test_who_is_not_on_the_roster_is_gone() -> None:
    chair = scene()

    assert judged(chair, 5) is RemovalState.GONE
    assert chair.order() == [GONE, NEXT]


def test_who_is_not_on_a_roster_that_is_not_kept_is_not_surely_gone() -> None:
    chair = scene()
    judged(chair)
    chair.removes(5)

    assert answers(chair.step(100))[5] is RemovalState.COMMITTING


def test_as_long_as_a_roster_is_not_kept_nothing_is_said_of_any_train() -> None:
    chair = scene()
    chair.reports(5, 300.0)

    assert judged(chair, 5, axles={1: 16, 2: 32}) is RemovalState.COMMITTING
    assert chair.order() == [GONE, NEXT, 5]
    chair.keeps()
    chair.now_ns += 200 * MS
    chair.reports(5, 300.0)
    assert judged(chair, 5, axles={1: 16, 2: 32}) is RemovalState.HEARD


def test_a_seventeenth_is_not_heard_of_but_those_that_are_go_on() -> None:
    chair = scene()
    chair.track(axles={2: 16})
    for train in range(101, 117):
        chair.removes(train)
    chair.step(0)
    chair.now_ns += 3000 * MS
    chair.removes(101)
    chair.removes(117)
    chair.track(axles={2: 16})
    chair.step(0)
    chair.now_ns += MS
    chair.track(axles={2: 16})

    assert list(answers(chair.step(200))) == [101]


def test_sixteen_are_answered_at_a_time() -> None:
    chair = scene()
    chair.track(axles={2: 16})
    for train in range(101, 130):
        chair.removes(train)
    chair.removes(101)

    states = answers(chair.step(0))
    assert sorted(states) == [*range(101, 117)]
    assert set(states.values()) == {RemovalState.GONE}


def test_sixteen_that_are_late_are_told_so() -> None:
    chair = scene()
    chair.track(axles={2: 16})
    for train in range(101, 130):
        chair.removes(train, echo_ms=-10_000)

    assert answers(chair.step(0)) == dict.fromkeys(range(101, 117), RemovalState.TOO_OLD)
    assert answers(chair.step(100)) == {}


def test_before_the_track_is_known_nobody_goes() -> None:
    chair = scene()
    chair.removes(GONE)

    assert answers(chair.step(0)) == {}
    assert chair.order() == [GONE, NEXT]


def test_where_no_axles_are_counted_a_persons_word_is_all_there_is() -> None:
    chair = Chair(ROSTER)
    chair.now_ns = SILENT_MS * MS
    chair.removes(GONE)

    assert answers(chair.step(0)) == {GONE: RemovalState.COMMITTING}
    assert chair.order() == [NEXT]


def test_whose_axles_show_after_it_left_the_roster_is_another() -> None:
    """What is excused for a moment is one that runs over the border, and nobody that is gone."""
    chair = scene()
    judged(chair)

    assert chair.order() == [NEXT]
    assert chair.master._left is None


@pytest.mark.parametrize("heard", [True, False])
def test_a_train_that_fell_silent_hides_nobody(*, heard: bool) -> None:
    """A newcomer and one that hides stand in one section: what is counted there would be the
    newcomer's and that of a train that was there when it was heard last, and was taken away since.
    """
    chair = Chair((entry(GONE, 900.0),), sections=True)
    chair.reports(GONE, 900.0, latent_m=900.0)
    chair.now_ns = 600 * MS
    if heard:
        chair.reports(GONE, 900.0, latent_m=900.0)
    chair.reports(NEXT, 600.0)
    chair.track(axles={2: 32})
    chair.step(0)

    assert chair.order() == [GONE, NEXT]
    assert chair.master.roster.proposed[1].sieved is heard


def test_where_axles_are_counted_and_none_were_told_yet_nobody_goes() -> None:
    chair = scene()
    chair.removes(GONE)
    unseen = TrackObservation(True, None, (), set(), 2000.0)

    removals, roster = chair.master._removals, chair.master.roster
    assert removals.gone(roster, lambda _: unseen, chair.now_ns) == set()
    assert dict(removals.answers(roster)) == {GONE: RemovalState.AXLES}
