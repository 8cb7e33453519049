"""An operator's command removes a train from the roster, unless evidence contradicts it."""

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
"""Both trains are in the second section (500 m to 1000 m); the second one stands right behind
the first."""
SILENT_MS = 1001
"""Just over the second for which an authority of timer set A is valid, ms."""


def scene(roster: tuple[RosterEntry, ...] = ROSTER, *, silent_ms: int = SILENT_MS) -> Chair:
    """The first train has been silent since this master began; the second one stands and
    reports."""
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


def test_the_train_behind_goes_on_once_the_removal_is_committed() -> None:
    chair = scene()
    chair.track(axles={2: 16})
    said = chair.step(0)
    assert authorities(said)[NEXT].end_m < 820.0
    assert answers(said) == {}

    chair.now_ns += MS
    chair.removes(GONE)
    assert answers(chair.step(100)) == {
        GONE: RemovalState.AXLES
    }  # The status is older than the command.
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
def test_an_applicant_that_waits_for_the_removal_accounts_for_its_own_axles(
    axles: int, state: str
) -> None:
    """The authority of the removed train is unknown: it may have gone past the waiting one."""
    chair = Chair((entry(GONE, 900.0),), sections=True)
    chair.now_ns = SILENT_MS * MS
    chair.reports(NEXT, 1300.0)

    assert judged(chair, axles={3: axles}) is RemovalState[state]


@pytest.mark.parametrize(
    ("silent_ms", "state"),
    [(1, RemovalState.HEARD), (1000, RemovalState.HEARD), (1001, RemovalState.COMMITTING)],
)
def test_a_train_stays_while_it_may_obey_an_authority(silent_ms: int, state: RemovalState) -> None:
    chair = scene(silent_ms=silent_ms)

    assert judged(chair) is state
    assert chair.order() == ([NEXT] if state is RemovalState.COMMITTING else [GONE, NEXT])


@pytest.mark.parametrize("lost", [True, False])
def test_a_reporting_train_stays_even_after_a_restart(*, lost: bool) -> None:
    chair = scene()
    chair.reports(GONE, 900.0, boot=1, localised=not lost)
    assert judged(chair, axles={2: 32}) is RemovalState.HEARD

    # A vehicle stands where it was, and may be it.
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


def test_the_last_axle_may_stand_4_m_before_the_rear_of_a_restarted_train() -> None:
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
        # The train's authority is unknown, so it may be there.
        ({2: 16, 5: 16}, RemovalState.AXLES),
        # These axles are behind the train's former place.
        ({1: 16, 2: 16}, RemovalState.COMMITTING),
        ({1: 16, 2: 24}, RemovalState.AXLES),  # A vehicle comes closer.
        ({}, RemovalState.COMMITTING),
        ({2: 0}, RemovalState.AXLES),
    ],
)
def test_counted_axles_contradict_the_command(axles: dict[int, int], state: RemovalState) -> None:
    assert judged(scene(), axles=axles) is state


@pytest.mark.parametrize(
    ("axles", "state"),
    [({2: 16}, RemovalState.COMMITTING), ({2: 16, 4: 16}, RemovalState.AXLES)],
)
def test_axles_beyond_all_that_it_was_granted_may_be_its_own(
    axles: dict[int, int], state: RemovalState
) -> None:
    """A person may have driven it there by hand (simulation seed 132971)."""
    chair = Chair(ROSTER, sections=True)
    chair.reports(GONE, 900.0, latent_m=1100.0, held_end_m=1100.0)
    chair.now_ns = SILENT_MS * MS
    chair.reports(NEXT, 780.0)

    assert judged(chair, axles=axles) is state


@pytest.mark.parametrize(
    ("ahead_m", "state"), [(1500.0, RemovalState.COMMITTING), (1500.1, RemovalState.AXLES)]
)
def test_axles_beyond_the_train_ahead_are_not_its_own(ahead_m: float, state: RemovalState) -> None:
    """The train ahead is moving and accounts for no axles."""
    chair = Chair((entry(6, ahead_m + LENGTH_M), *ROSTER), sections=True)
    chair.reports(GONE, 900.0, latent_m=1100.0, held_end_m=1100.0)
    chair.now_ns = SILENT_MS * MS
    chair.reports(NEXT, 780.0)

    assert judged(chair, axles={2: 16, 4: 16}) is state


@pytest.mark.parametrize(
    ("rear_m", "state"), [(1007.0, RemovalState.COMMITTING), (1006.9, RemovalState.AXLES)]
)
def test_a_removed_train_may_have_rolled_and_jogged_back(
    rear_m: float, state: RemovalState
) -> None:
    chair = Chair((entry(GONE, rear_m + LENGTH_M), entry(NEXT, 1200.0)), sections=True)
    chair.now_ns = SILENT_MS * MS
    chair.reports(NEXT, 1200.0)

    assert judged(chair, axles={2: 8, 3: 16}) is state


def test_axles_behind_its_former_rear_do_not_matter() -> None:
    chair = Chair((entry(GONE, 1200.0), entry(NEXT, 1090.0)), sections=True)
    chair.now_ns = SILENT_MS * MS
    chair.reports(NEXT, 1090.0)

    assert judged(chair, axles={1: 16, 3: 32}) is RemovalState.AXLES
    chair.now_ns += 200 * MS
    assert judged(chair, axles={1: 16, 3: 16}) is RemovalState.COMMITTING


@pytest.mark.parametrize(
    "told", [{"standstill": False, "speed_mps": 0.1}, {"localised": False}, {"axles": 20}]
)
def test_only_trains_that_stand_there_account_for_axles(told: dict[str, Any]) -> None:
    chair = Chair(ROSTER, sections=True)
    chair.now_ns = SILENT_MS * MS
    chair.reports(NEXT, 780.0, **told)

    assert judged(chair) is RemovalState.AXLES


def test_a_train_that_stopped_after_the_count_accounts_for_no_axles() -> None:
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


def test_a_silent_train_accounts_for_no_axles() -> None:
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
def test_an_old_command_does_not_count(age_ms: int, state: RemovalState) -> None:
    chair = scene(silent_ms=4000)
    chair.track(axles={2: 16})
    chair.removes(GONE, echo_ms=4000 - age_ms)

    assert answers(chair.step(0)) == {GONE: state}
    assert chair.order() == ([NEXT] if state is RemovalState.COMMITTING else [GONE, NEXT])
    assert answers(chair.step(100)).get(GONE) is (None if age_ms in (3001, -1) else state)


def test_a_removal_counts_for_three_seconds_and_the_newest_of_them() -> None:
    chair = scene()
    assert judged(chair, axles={2: 32}) is RemovalState.AXLES
    chair.removes(GONE, echo_ms=0)  # This older command does not replace the one before.
    chair.now_ns = (SILENT_MS + 3000) * MS
    chair.track(axles={2: 32})
    assert answers(chair.step(0)) == {GONE: RemovalState.AXLES}
    assert answers(chair.step(100)) == {}


@pytest.mark.parametrize("term", [TERM - 1, TERM + 1, 0])
def test_a_command_to_another_master_does_not_count(term: int) -> None:
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


def test_a_train_that_is_not_on_the_roster_counts_as_removed() -> None:
    chair = scene()

    assert judged(chair, 5) is RemovalState.GONE
    assert chair.order() == [GONE, NEXT]


def test_a_train_missing_on_an_uncommitted_roster_is_not_certainly_removed() -> None:
    chair = scene()
    judged(chair)
    chair.removes(5)

    assert answers(chair.step(100))[5] is RemovalState.COMMITTING


def test_an_uncommitted_roster_gives_no_answer_about_any_train() -> None:
    chair = scene()
    chair.reports(5, 300.0)

    assert judged(chair, 5, axles={1: 16, 2: 32}) is RemovalState.COMMITTING
    assert chair.order() == [GONE, NEXT, 5]
    chair.keeps()
    chair.now_ns += 200 * MS
    chair.reports(5, 300.0)
    assert judged(chair, 5, axles={1: 16, 2: 32}) is RemovalState.HEARD


def test_a_seventeenth_removal_is_ignored_while_the_others_go_on() -> None:
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


def test_sixteen_removals_are_answered_at_a_time() -> None:
    chair = scene()
    chair.track(axles={2: 16})
    for train in range(101, 130):
        chair.removes(train)
    chair.removes(101)

    states = answers(chair.step(0))
    assert sorted(states) == [*range(101, 117)]
    assert set(states.values()) == {RemovalState.GONE}


def test_sixteen_late_removals_are_answered_as_late() -> None:
    chair = scene()
    chair.track(axles={2: 16})
    for train in range(101, 130):
        chair.removes(train, echo_ms=-10_000)

    assert answers(chair.step(0)) == dict.fromkeys(range(101, 117), RemovalState.TOO_OLD)
    assert answers(chair.step(100)) == {}


def test_no_train_is_removed_before_the_first_track_status() -> None:
    chair = scene()
    chair.removes(GONE)

    assert answers(chair.step(0)) == {}
    assert chair.order() == [GONE, NEXT]


def test_without_axle_counters_the_command_is_sufficient() -> None:
    chair = Chair(ROSTER)
    chair.now_ns = SILENT_MS * MS
    chair.removes(GONE)

    assert answers(chair.step(0)) == {GONE: RemovalState.COMMITTING}
    assert chair.order() == [NEXT]


def test_axles_that_appear_after_the_removal_belong_to_another_vehicle() -> None:
    """Only a train that runs over the border is exempt for a moment, but not a removed one."""
    chair = scene()
    judged(chair)

    assert chair.order() == [NEXT]
    assert chair.master._left is None


@pytest.mark.parametrize("heard", [True, False])
def test_a_silent_train_does_not_mask_a_shadow_train(*, heard: bool) -> None:
    """A newcomer and a shadow train stand in one section.

    The master would attribute the axles to the newcomer and to a silent train that has since been
    taken away.
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


def test_no_train_is_removed_before_the_first_axle_count() -> None:
    chair = scene()
    chair.removes(GONE)
    unseen = TrackObservation(True, None, (), set(), 2000.0)

    removals, roster = chair.master._removals, chair.master.roster
    assert removals.gone(roster, lambda _: unseen, chair.now_ns) == set()
    assert dict(removals.answers(roster)) == {GONE: RemovalState.AXLES}
