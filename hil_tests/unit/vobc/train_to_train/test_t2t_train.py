"""One train as a whole: memory, clock, position, accepted senders, and the authority it acts on."""

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import pytest

from firmware_py.trackdb.areas import Area, AreaMap, TrackSection
from vobc.train_to_train.area_participant import Chance
from vobc.train_to_train.guards import MemberGuards, TrainGuards, without
from vobc.train_to_train.train import TrainCore
from vobc.train_to_train.vocabulary import (
    AreaMemory,
    HeldAuthority,
    OwnTrain,
    Role,
    Stepped,
    T2tConfig,
    TrainMemory,
    TrainState,
)
from zenoh_config.messages import RefusedReason, SpeedRestriction
from zenoh_config.t2t import (
    BROADCAST,
    NO_TRAIN,
    SUPERVISION,
    AreaAuthority,
    Heartbeat,
    LeaseAnswer,
    LeaseRequest,
    LineOrder,
    OrderKind,
    Phase,
    RosterAck,
    RosterCommit,
    StandbySync,
    SwitchKind,
    SwitchStep,
    SyncAck,
    T2tMessage,
    TrainReport,
)

MS = 1_000_000
OWN, MASTER, ARBITER = 5, 9, 65_001
AREAS = (Area(1, 0.0, 2000.0), Area(2, 2000.0, 4000.0), Area(3, 4000.0, 6000.0))
LINE = AreaMap("test", AREAS)
FRESH = TrainMemory()
KEPT = TrainMemory(6, (AreaMemory(1, seen_term=3, owner=8, tried_term=2),))


def ns(at_ms: float) -> int:
    return round(at_ms * MS)


def own(front_m: float = 500.0, **told: Any) -> OwnTrain:
    """The train rolls and knows its position exactly, unless the test sets otherwise."""
    train = OwnTrain(
        *(True, front_m, front_m, front_m - 80.0, front_m - 80.0, 2.0, False),
        *(front_m, front_m, 16),
    )
    return train._replace(**told)


_SEQUENCE: Iterator[int] = iter(range(1, 10**9))


def head(
    source: int, area: int = 1, term: int = 4, to: int = OWN
) -> tuple[int, int, int, int, int, int, int]:
    return (source, to, area, term, 1, next(_SEQUENCE), 77)


def authority(area: int, end_m: float, echo_ms: float, **told: Any) -> AreaAuthority:
    """An authority for the first incarnation of train 5 from the master of term 4."""
    source, term = told.get("source", MASTER), told.get("term", 4)
    slow: tuple[SpeedRestriction, ...] = told.get("restrictions", ())
    place = (end_m, told.get("rear_m", 400.0), told.get("behind", NO_TRAIN), 1, slow)
    first = head(source, area, term, told.get("to", OWN))
    return AreaAuthority(*first, told.get("boot", 1), ns(echo_ms), *place)


def beat(area: int = 1, term: int = 4, *, source: int = MASTER, standby: int = 0) -> Heartbeat:
    return Heartbeat(*head(source, area, term, BROADCAST), Phase.ISSUING, standby, 1)


def order(kind: OrderKind, train: int = OWN, *, area: int = 1) -> LineOrder:
    return LineOrder(*head(SUPERVISION, area, 0, BROADCAST), kind, train)


class Ride:
    def __init__(
        self,
        memory: TrainMemory | None = FRESH,
        *,
        line: AreaMap = LINE,
        **told: Any,
    ) -> None:
        self.core = TrainCore(T2tConfig(), line, address=OWN, memory=memory, start_ns=0, **told)

    def step(self, at_ms: float, *heard: T2tMessage, late_ns: int = 0, **told: Any) -> Stepped:
        return self.core.step(ns(at_ms) + late_ns, heard, own(**told))

    def reports(self, stepped: Stepped, area: int = 1) -> list[TrainReport]:
        return [m for m in stepped.out if isinstance(m, TrainReport) and m.area == area]

    def held_m(self, stepped: Stepped) -> float | None:
        return None if stepped.authority is None else stepped.authority.end_m


NO_PART = Stepped(None, None, ())


# Memory.


def test_the_first_step_hands_out_the_memory_of_a_new_incarnation_and_the_next_nothing() -> None:
    ride = Ride(KEPT)
    assert ride.core.memory == replace(KEPT, boot=7)

    first, second = ride.step(0), ride.step(5)

    assert first.memory == replace(KEPT, boot=7)
    assert second.memory is None
    assert {message.boot for message in first.out} == {7}


def test_a_train_with_nothing_stored_is_in_its_first_incarnation() -> None:
    assert Ride().core.memory == TrainMemory(1)


def test_a_new_term_is_handed_out_to_be_stored_once() -> None:
    ride = Ride(KEPT)
    ride.step(0)

    stepped = ride.step(10, beat(term=4))

    changed = TrainMemory(7, (AreaMemory(1, seen_term=4, owner=MASTER, tried_term=2),))
    assert stepped.memory == changed
    assert ride.core.memory is stepped.memory
    assert ride.step(20).memory is None
    assert ride.step(30, beat(term=4)).memory is None
    assert ride.core.memory == changed


def test_new_terms_of_two_areas_are_stored_together() -> None:
    ride = Ride()
    ride.step(0, front_m=1900.0)

    stepped = ride.step(10, beat(1, 4), beat(2, 6), front_m=1900.0)

    assert stepped.memory == TrainMemory(1, (AreaMemory(1, 4, MASTER), AreaMemory(2, 6, MASTER)))


def test_a_train_with_unreadable_memory_does_not_participate() -> None:
    ride = Ride(None)

    for at_ms in (0, 100, 5000):
        assert ride.step(at_ms, beat(), authority(1, 900.0, at_ms)) == NO_PART
        assert ride.core.next_due_ns() == ns(at_ms + 1000)
    assert ride.core.desk(1) is None


def test_a_removed_guard_permits_what_it_would_have_prevented() -> None:
    guards = TrainGuards(member=without(MemberGuards(), "young_enough"))
    late = authority(1, 900.0, 0)

    assert ride_takes(Ride(), late) == "too old"
    assert ride_takes(Ride(guards=guards), late) == "taken"


def ride_takes(ride: Ride, heard: AreaAuthority) -> str:
    ride.step(0)
    ride.step(1001, heard)
    desk = ride.core.desk(1)
    assert desk is not None
    return next(iter(ride.core.refusals), "taken")


# Random numbers.


def second_try_ns(ride: Ride) -> int:
    """The instant of its second application. The arbiter refuses the first one at once."""
    tries: list[int] = []
    while len(tries) < 2:
        now_ns = ride.core.next_due_ns()
        stepped = ride.core.step(now_ns, (), own())
        for asked in [m for m in stepped.out if isinstance(m, LeaseRequest)]:
            tries.append(now_ns)
            head = (65_001, OWN, 1, 0, 1, asked.sequence, 0)
            refusal = LeaseAnswer(*head, False, asked.nonce, 0, 0, 0, 0, 0, ())
            ride.core.step(now_ns, (refusal,), own())
    return tries[1]


@pytest.mark.parametrize(("told", "seed"), [({}, 0), ({"seed": 3}, 3)])
def test_backoffs_differ_by_address_and_seed(told: dict[str, Any], seed: int) -> None:
    """The first application comes at 400 ms and is lost at once; then one backoff of 80 ms
    passes."""
    chance = Chance(OWN * 65_537 + seed)

    assert second_try_ns(Ride(**told)) == ns(480) + chance.below(80 * MS)


# Clock and position.


def test_a_second_step_at_the_same_instant_does_not_count_as_a_backward_clock() -> None:
    ride = Ride()
    ride.step(100)

    assert ride.step(100).state is TrainState.NON_COMMUNICATING
    assert not ride.core.refusals


def test_a_train_whose_clock_goes_back_no_longer_participates() -> None:
    ride = Ride()
    ride.step(100)

    assert ride.step(100, late_ns=-1) == NO_PART
    assert ride.step(5000, beat()) == NO_PART
    assert ride.step(4000) == NO_PART
    assert ride.core.refusals == {"clock went back": 1}


def test_a_clock_before_the_start_instant_counts_as_set_back() -> None:
    core = TrainCore(T2tConfig(), LINE, address=OWN, memory=TrainMemory(), start_ns=50)
    assert core.next_due_ns() == 50

    assert core.step(49, (), own()) == NO_PART


@pytest.mark.parametrize(("rear_m", "back"), [(389.0, False), (388.5, True), (500.0, False)])
def test_a_position_beyond_rollback_jog_and_uncertainty_counts_as_gone_back(
    rear_m: float, *, back: bool
) -> None:
    """From 400 m: 2 m of rollback, 5 m of jog, and 4 m between the ends of its front."""
    ride = Ride()
    ride.step(0, rear_min_m=400.0)
    ride.step(10, rear_min_m=395.0)

    stepped = ride.step(20, rear_min_m=rear_m, front_min_m=498.0, front_max_m=502.0)

    assert (stepped == NO_PART) is back
    assert ride.core.refusals == ({"place went back": 1} if back else {})
    again = ride.step(30, rear_min_m=rear_m, front_min_m=498.0, front_max_m=502.0)
    assert (again == NO_PART) is back
    assert ride.core.refusals == ({"place went back": 1} if back else {})


def test_only_the_first_backward_jump_is_reported() -> None:
    ride = Ride()
    ride.step(100)
    ride.step(50, front_m=300.0)
    ride.step(40, front_m=100.0)

    assert ride.core.refusals == {"clock went back": 1}


def test_the_position_of_a_lost_train_does_not_count() -> None:
    ride = Ride()
    ride.step(0)

    stepped = ride.step(10, localised=False, front_m=90.0)

    assert stepped.state is TrainState.LOST
    assert ride.step(20).state is TrainState.NON_COMMUNICATING


def test_a_train_that_receives_its_own_address_is_silent_in_the_same_step() -> None:
    ride = Ride()
    ride.step(0)
    ride.step(10, authority(1, 900.0, 5))
    double = replace(beat(source=OWN), sequence=10**9)

    assert ride.step(100, double) == NO_PART
    assert ride.step(200) == NO_PART
    assert ride.core.next_due_ns() == ns(1200)


# Accepted messages.


@pytest.mark.parametrize(("count", "refused"), [(1000, 0), (1001, 1), (1234, 234)])
def test_a_step_processes_at_most_1000_messages(count: int, refused: int) -> None:
    ride = Ride()
    orders = [order(OrderKind.STOP, 77, area=3) for _ in range(count)]

    ride.step(0, *orders)

    flood = {"flood": refused} if refused else {}
    assert dict(ride.core.refusals) == {"area of no concern": 1000, **flood}
    ride.step(10, order(OrderKind.STOP, 77, area=3))
    ride.step(20, *[order(OrderKind.STOP, 77, area=3) for _ in range(1002)])
    assert ride.core.refusals["flood"] == refused + 2


def test_a_refused_message_is_counted_once_and_has_no_effect() -> None:
    ride = Ride()
    ride.step(0)

    stepped = ride.step(10, authority(1, 900.0, 5, to=6), authority(1, 900.0, 5, source=65_001))
    ride.step(20)
    ride.step(30, authority(1, 900.0, 5, to=6))

    assert stepped.authority is None
    assert dict(ride.core.refusals) == {
        RefusedReason.WRONG_DESTINATION.value: 2,
        RefusedReason.WRONG_SOURCE.value: 1,
    }


def test_refused_authorities_are_counted_once_each() -> None:
    ride = Ride()
    ride.step(0)
    ride.step(2000, authority(1, 900.0, 0), authority(1, 900.0, 1))
    ride.step(2010, authority(1, 900.0, 2, boot=2))
    ride.step(2020)

    assert dict(ride.core.refusals) == {"too old": 2, "wrong boot incarnation": 1}


def test_a_request_of_an_area_is_answered_in_the_same_step() -> None:
    ride = Ride()
    ride.step(0)
    ride.step(10, beat(standby=OWN))
    sync = StandbySync(*head(MASTER), 1, ())

    stepped = ride.step(20, sync)

    assert [m.synced for m in stepped.out if isinstance(m, SyncAck)] == [sync.sequence]


def test_each_area_gets_its_own_messages_only() -> None:
    ride = Ride()
    stepped = ride.step(0, beat(1, 4), beat(2, 6), front_m=1900.0)

    assert [r.term for r in ride.reports(stepped, 1)] == [4]
    assert [r.term for r in ride.reports(stepped, 2)] == [6]
    assert not ride.core.refusals


# Areas.


def numbers(stepped: Stepped) -> list[int]:
    return [number for number, _ in stepped.roles]


@pytest.mark.parametrize(
    ("front_max_m", "areas"), [(1199.9, [1]), (1200.0, [1, 2]), (3199.9, [2]), (3200.0, [2, 3])]
)
def test_a_train_applies_800_m_before_a_border(front_max_m: float, areas: list[int]) -> None:
    stepped = Ride().step(0, front_m=front_max_m)

    assert numbers(stepped) == areas
    assert all(role is Role.APPLICANT for _, role in stepped.roles)


@pytest.mark.parametrize(("rear_m", "areas"), [(2150.0, [1, 2]), (2150.1, [2])])
def test_a_train_keeps_reporting_for_150_m_behind_a_border(rear_m: float, areas: list[int]) -> None:
    assert numbers(Ride().step(0, front_m=rear_m + 80.0, rear_min_m=rear_m)) == areas


@pytest.mark.parametrize(
    ("joint_m", "told_to_m"), [(2145.0, 2150.0), (2147.0, 2151.0), (2300.0, 2304.0)]
)
def test_it_keeps_reporting_to_the_end_of_the_section_behind_the_border(
    joint_m: float, told_to_m: float
) -> None:
    """The overhang of 4 m counts if it reaches farther."""
    ends_m = (0.0, 1000.0, 2000.0, joint_m, 4000.0, 6000.0)
    sections = [TrackSection(n, ends_m[n - 1], ends_m[n]) for n in range(1, len(ends_m))]
    line = AreaMap("test", AREAS, tuple(sections))

    def areas(rear_m: float) -> list[int]:
        return numbers(Ride(line=line).step(0, front_m=rear_m + 80.0, rear_min_m=rear_m))

    assert areas(told_to_m) == [1, 2]
    assert areas(told_to_m + 0.1) == [2]


def test_a_lost_train_keeps_its_areas() -> None:
    ride = Ride()
    ride.step(0, front_m=1900.0)
    ride.step(100, front_m=2300.0)

    stepped = ride.step(200, front_m=0.0, localised=False)

    assert numbers(stepped) == [2]
    assert len(ride.reports(stepped, 2)) == 1
    assert ride.reports(stepped, 1) == []


def test_a_train_lost_from_the_start_has_no_area() -> None:
    ride = Ride()

    stepped = ride.step(0, localised=False)

    assert (stepped.state, stepped.roles, stepped.out) == (TrainState.LOST, (), ())
    assert ride.core.next_due_ns() == ns(1000)


def test_the_train_finds_its_participants_by_area() -> None:
    ride = Ride()
    ride.step(0, front_m=1900.0)

    assert ride.core.address == OWN
    assert [desk and desk.area.number for desk in map(ride.core.desk, (1, 2, 3))] == [1, 2, None]


@pytest.mark.parametrize(("now_ms", "told"), [(1000, (1, 6)), (1000.000_001, (0, NO_TRAIN))])
def test_it_names_the_train_ahead_to_the_next_area_while_its_authority_is_recent(
    now_ms: float, told: tuple[int, int]
) -> None:
    ride = Ride()
    ride.step(0, authority(1, 2000.0, 0, behind=6), beat(2), front_m=1900.0)

    stepped = ride.step(now_ms, beat(1), beat(2, 5), front_m=1900.0)

    assert [(r.comes_from, r.behind) for r in ride.reports(stepped, 2)] == [told]
    assert [(r.comes_from, r.behind) for r in ride.reports(stepped, 1)] in ([], [(0, NO_TRAIN)])


def test_the_first_area_with_an_authority_has_no_former_area() -> None:
    ride = Ride()
    heard = (authority(1, 2000.0, 0, behind=6), authority(2, 2500.0, 0, behind=7))

    stepped = ride.step(0, *heard, front_m=1900.0)

    told = [(r.comes_from, r.behind) for area in (1, 2) for r in ride.reports(stepped, area)]
    assert told == [(0, NO_TRAIN), (1, 6)]


def test_without_an_authority_it_names_no_former_area() -> None:
    stepped = Ride().step(0, front_m=3900.0)

    assert [(r.comes_from, r.behind) for r in Ride().reports(stepped, 3)] == [(0, NO_TRAIN)]


# The authority that it acts on.

SLOW, SLOWER = SpeedRestriction(1500.0, 1600.0, 10.0), SpeedRestriction(2100.0, 2200.0, 5.0)


@pytest.mark.parametrize(("first_ms", "second_ms"), [(80, 90), (90, 80)])
def test_the_next_areas_authority_continues_one_to_the_border(
    first_ms: float, second_ms: float
) -> None:
    ride = Ride()
    one = authority(1, 2000.0, first_ms, rear_m=1700.0, restrictions=(SLOW,))
    two = authority(2, 2500.0, second_ms, rear_m=1600.0, term=6, restrictions=(SLOWER,))

    stepped = ride.step(100, one, two, front_m=1900.0)

    assert stepped.authority == HeldAuthority(
        end_m=2500.0,
        rear_m=1700.0,
        echo_ns=ns(80),
        area=2,
        term=6,
        sequence=two.sequence,
        restrictions=(SLOW, SLOWER),
    )


def test_an_authority_that_ends_before_the_border_is_not_continued() -> None:
    one = authority(1, 1950.0, 80, rear_m=1700.0, restrictions=(SLOW,))
    ride = Ride()

    stepped = ride.step(100, one, authority(2, 2500.0, 80), front_m=1900.0)

    assert stepped.authority == HeldAuthority(1950.0, 1700.0, ns(80), 1, 4, one.sequence, (SLOW,))


@pytest.mark.parametrize(
    ("front_max_m", "end_m"),
    [(500.0, 1989.0), (1900.0, 1989.0), (1989.0, 1989.0), (1990.0, 1990.0), (2003.0, 2000.0)],
)
def test_without_an_authority_of_the_next_area_it_ends_11_m_before_the_border(
    front_max_m: float, end_m: float
) -> None:
    """A shadow train there may overhang by 4 m, roll back by 2 m and jog by 5 m.

    A train that is already nearer stays where it is and never crosses the border by this authority.
    """
    ride = Ride()
    place: dict[str, Any] = {"front_min_m": min(front_max_m, 1999.0), "front_max_m": front_max_m}

    stepped = ride.step(100, authority(1, 2000.0, 80), **place)

    assert ride.held_m(stepped) == end_m


@pytest.mark.parametrize(
    ("first_m", "second_m", "end_m"),
    [
        (1989.0, 1900.0, 1989.0),
        (1989.1, 1900.0, 1900.0),
        (1999.9, 1989.0, 1989.0),
        (1999.9, 1995.0, 1995.0),
        (1999.9, 2500.0, 1999.9),
        (2000.0, 1989.0, 1989.0),
        (2000.0, 2500.0, 2500.0),
    ],
)
def test_nearer_than_11_m_to_the_border_the_next_areas_authority_counts(
    first_m: float, second_m: float, end_m: float
) -> None:
    ride = Ride()
    both = authority(1, first_m, 80), authority(2, second_m, 70)

    assert ride.held_m(ride.step(100, *both, front_m=1800.0)) == end_m


def test_that_near_to_the_border_the_older_of_both_gives_the_age() -> None:
    ride = Ride()

    stepped = ride.step(100, authority(1, 1995.0, 80), authority(2, 2500.0, 70), front_m=1800.0)

    assert stepped.authority is not None
    assert stepped.authority.echo_ns == ns(70)


def test_the_end_of_the_line_is_the_end() -> None:
    ride = Ride()

    assert ride.held_m(ride.step(100, authority(3, 6000.0, 80), front_m=5000.0)) == 5989.0


def test_an_authority_of_the_next_area_alone_does_not_count() -> None:
    ride = Ride()

    assert ride.step(100, authority(2, 2500.0, 80), front_m=1900.0).authority is None


@pytest.mark.parametrize(("rear_m", "of_the_first"), [(2001.9, True), (2002.0, False)])
def test_an_authority_begins_where_the_rear_may_roll_back_to(
    rear_m: float, *, of_the_first: bool
) -> None:
    """Objects and restrictions of the area behind apply until the rear has left it."""
    ride = Ride()
    one = authority(1, 2000.0, 80, rear_m=1.0, restrictions=(SLOW,))
    two = authority(2, 2500.0, 90, rear_m=2.0, restrictions=(SLOWER,))

    held = ride.step(100, one, two, front_m=rear_m + 80.0, rear_min_m=rear_m).authority

    assert held is not None
    assert held.end_m == 2500.0
    assert held.rear_m == (1.0 if of_the_first else 2002.0)
    assert held.echo_ns == ns(80 if of_the_first else 90)
    assert held.restrictions == ((SLOW, SLOWER) if of_the_first else (SLOWER,))


@pytest.mark.parametrize("front_m", [2000.0, 2040.0])
@pytest.mark.parametrize(("area", "end_m"), [(1, 2000.0), (2, 2500.0)])
def test_a_train_in_two_areas_needs_the_authorities_of_both(
    area: int, end_m: float, front_m: float
) -> None:
    ride = Ride()

    stepped = ride.step(100, authority(area, end_m, 80), front_m=front_m, rear_min_m=1960.0)

    assert stepped.authority is None


@pytest.mark.parametrize(("told_m", "back_m"), [(-3, -3), (2001.9, 2002), (2002.1, 2002.1)])
def test_a_rear_never_jogs_back_over_a_border_even_with_rollback(
    told_m: float, back_m: float
) -> None:
    """Only the area before could know what lies there. No area precedes the line's beginning."""
    told = authority(1 if told_m < 0.0 else 2, 2000.0, 80, rear_m=told_m)

    held = Ride().step(100, told, front_m=told_m + 84.0, rear_min_m=told_m + 4.0).authority

    assert held is not None
    assert held.rear_m == back_m


def test_before_the_line_the_first_areas_authority_counts_whatever_its_age() -> None:
    ride = Ride()
    before: dict[str, Any] = {"front_m": -10.0, "rear_min_m": -90.0}
    assert ride.step(0, **before).authority is None

    ride.step(100, authority(1, 900.0, 80), **before)

    assert ride.held_m(ride.step(1500, **before)) == 900.0


def test_in_two_areas_the_first_areas_end_binds() -> None:
    ride = Ride()
    heard = (authority(1, 1990.0, 80), authority(2, 2500.0, 80))

    assert ride.held_m(ride.step(100, *heard, front_m=2040.0, rear_min_m=1960.0)) == 1990.0


@pytest.mark.parametrize(
    ("front_min_m", "end_m", "of_ms"), [(1999.9, 2000.0, 3500), (2000.0, 2500.0, 2000)]
)
def test_the_authority_of_the_fronts_area_counts_whatever_its_age(
    front_min_m: float, end_m: float, of_ms: int
) -> None:
    """Without it the end would lie behind the front. The whole authority is as old as this part."""
    ride = Ride()
    ride.step(2000, authority(2, 2500.0, 2000), front_m=1990.0)

    stepped = ride.step(
        3500,
        authority(1, 2000.0, 3500),
        front_m=front_min_m,
        front_max_m=2010.0,
        rear_min_m=1930.0,
    )

    assert ride.held_m(stepped) == end_m
    assert stepped.authority is not None
    assert stepped.authority.echo_ns == ns(of_ms)


@pytest.mark.parametrize(
    ("age_ms", "easy_m", "continued"),
    [
        (499.999_999, 1950.0, True),
        (500.0, 1950.0, False),
        (500.0, 1989.0, False),
        (500.0, 1989.1, True),
        (1000.0, 1989.1, True),
        (1000.000_001, 1989.1, False),
    ],
)
def test_an_ageing_authority_of_the_next_area_is_ignored_while_the_train_can_stop_easily(
    age_ms: float, easy_m: float, *, continued: bool
) -> None:
    """Such an authority would only make the whole authority older. An expired one never counts."""
    ride = Ride()
    ride.step(2000, authority(2, 2500.0, 2000), front_m=1900.0)

    now_ms = 2000 + age_ms
    stepped = ride.step(now_ms, authority(1, 2000.0, now_ms), front_m=1900.0, easy_m=easy_m)

    assert ride.held_m(stepped) == (2500.0 if continued else 1989.0)


def test_a_lost_train_acts_on_no_authority() -> None:
    ride = Ride()
    ride.step(0, authority(1, 900.0, 0))

    assert ride.step(10, localised=False).authority is None


def test_a_report_includes_the_messages_of_the_same_step() -> None:
    ride = Ride()
    ride.step(0)

    (report,) = ride.reports(ride.step(100, authority(1, 900.0, 90)))

    assert (report.latent_m, report.held_end_m) == (900.0, 900.0)


def answers(out: tuple[T2tMessage, ...]) -> list[T2tMessage]:
    """The answers of an arbiter that grants and commits everything."""
    said: list[T2tMessage] = []
    for m in out:
        first = head(ARBITER, m.area, m.term)
        if isinstance(m, LeaseRequest):
            said.append(LeaseAnswer(*first, True, m.nonce, m.stamp_ns, OWN, 0, 0, 0, ()))
        elif isinstance(m, RosterCommit):
            said.append(RosterAck(*first, m.version))
    return said


def commanding() -> tuple[Ride, Stepped, int]:
    """A train that commands itself alone, the step with its first authority, and the instant of
    that, ms."""
    ride = Ride()
    stepped = ride.step(0)
    for at_ms in range(5, 2000, 5):
        stepped = ride.step(at_ms, *answers(stepped.out))
        if stepped.authority is not None:
            return ride, stepped, at_ms
    raise AssertionError("never")


def test_a_train_may_act_at_once_on_its_own_grant() -> None:
    _, stepped, at_ms = commanding()

    assert stepped.roles == ((1, Role.MASTER),)
    assert stepped.authority is not None
    assert stepped.authority.end_m == 1989.0
    assert ns(at_ms) - stepped.authority.echo_ns <= ns(100)


def test_its_own_grant_stays_reserved_even_if_another_master_withdraws_it_at_once() -> None:
    """The train has acted on it since the step of the grant."""
    ride, _, at_ms = commanding()

    shorter = authority(1, 600.0, at_ms, source=8, term=9)
    (report,) = ride.reports(ride.step(at_ms + 5, shorter, reach_m=700.0))

    assert (report.held_end_m, report.latent_m) == (600.0, 700.0)


# Its state towards its masters, and when it is due.


@pytest.mark.parametrize(
    ("front_min_m", "front_max_m", "rear_m", "state"),
    [
        (1900.0, 1900.0, 1820.0, TrainState.CONTROLLED),
        (1990.0, 2000.0, 1910.0, TrainState.CONTROLLED),
        (1990.0, 2000.1, 1910.0, TrainState.CO_MANAGED),
        (2050.0, 2050.0, 1999.9, TrainState.CO_MANAGED),
        (2080.0, 2080.0, 2000.0, TrainState.CONTROLLED),
    ],
)
def test_a_train_is_co_managed_while_any_part_of_it_may_be_in_a_second_area(
    front_min_m: float, front_max_m: float, rear_m: float, state: TrainState
) -> None:
    ride = Ride()
    heard = (authority(1, 2000.0, 80), authority(2, 2500.0, 80))
    place: dict[str, Any] = {
        "front_min_m": front_min_m,
        "front_max_m": front_max_m,
        "rear_min_m": rear_m,
    }

    stepped = ride.step(100, *heard, **place)

    assert numbers(stepped) == [1, 2]
    assert stepped.state is state


@pytest.mark.parametrize(
    ("late_ns", "state"), [(0, TrainState.CONTROLLED), (1, TrainState.NON_COMMUNICATING)]
)
def test_an_authority_older_than_a_second_is_passed_on_but_does_not_count(
    late_ns: int, state: TrainState
) -> None:
    """Protection sees the age of the authority."""
    ride = Ride()
    ride.step(2000, authority(1, 900.0, 1500))

    stepped = ride.step(2500, beat(), late_ns=late_ns)

    assert ride.held_m(stepped) == 900.0
    assert stepped.state is state


def test_it_is_due_when_the_first_of_its_areas_is() -> None:
    ride = Ride()
    assert ride.core.next_due_ns() == 0
    ride.step(0, front_m=1100.0)
    assert ride.core.next_due_ns() == ns(100)

    ride.step(50, front_m=1200.0)
    assert ride.core.next_due_ns() == ns(100), "when the first reports"
    ride.step(100, front_m=1200.0)
    assert ride.core.next_due_ns() == ns(150), "and the second"


def test_left_areas_no_longer_make_it_due() -> None:
    ride = Ride()
    ride.step(0, front_m=1900.0)
    ride.step(50, front_m=1900.0)

    stepped = ride.step(100, front_m=6240.0)

    assert stepped.roles == ()
    assert stepped.state is TrainState.NON_COMMUNICATING
    assert ride.core.next_due_ns() == ns(1100)


def test_it_is_not_due_for_an_application_that_it_may_not_make() -> None:
    """The train could have applied long ago, but out of service it may not."""
    ride = Ride()
    ride.step(0, out_of_service=True)

    ride.step(500, out_of_service=True)

    assert ride.core.next_due_ns() == ns(600)


def test_a_train_that_is_called_in_the_area_ahead_applies_there_only() -> None:
    ride = Ride()
    ride.step(0, beat(1, standby=OWN), beat(2, standby=OWN), front_m=1900.0)
    resign = SwitchStep(*head(MASTER, 2), SwitchKind.RESIGN, 0, OWN)

    stepped = ride.step(10, resign, front_m=1900.0)

    assert stepped.roles == ((1, Role.STANDBY), (2, Role.CANDIDATE))
