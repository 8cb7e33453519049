"""A member of one area: the terms it obeys, the authorities it takes, the farthest point it may
reach."""

import math
from dataclasses import replace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from vobc.train_to_train.guards import MemberGuards
from vobc.train_to_train.member import AreaMember
from vobc.train_to_train.vocabulary import AreaMemory, OwnTrain, T2tConfig
from zenoh_config.t2t import BROADCAST, AreaAuthority, Heartbeat, Phase, SignedGrant
from zenoh_config.term_grants import GrantCheck, signer_from_seed

MS = 1_000_000
BOOT = 6
MASTER = 9
RIVAL = 8
OLD_NS = 1_000_000_000
"""Maximum age of an authority, ns."""


def member(*, seen_term: int = 4, owner: int = MASTER, now_ns: int = 0) -> AreaMember:
    memory = AreaMemory(1, seen_term, owner, tried_term=2)
    return AreaMember(T2tConfig(), MemberGuards(), boot=BOOT, memory=memory, now_ns=now_ns)


def heartbeat(
    term: int = 4, source: int = MASTER, *, standby: int = 0, stamp_ns: int = 0
) -> Heartbeat:
    return Heartbeat(source, BROADCAST, 1, term, 1, 1, stamp_ns, Phase.ISSUING, standby, 1)


def authority(
    end_m: float = 900.0,
    sequence: int = 1,
    *,
    term: int = 4,
    source: int = MASTER,
    boot: int = BOOT,
    echo_ns: int = 0,
    rank: int = 2,
) -> AreaAuthority:
    head = (source, 5, 1, term, 1, sequence, 0)
    return AreaAuthority(*head, boot, echo_ns, end_m, 0.0, 0, rank, ())


def own(
    front_m: float = 500.0,
    *,
    reach_m: float | None = None,
    standstill: bool = True,
    localised: bool = True,
) -> OwnTrain:
    reach_m = front_m if reach_m is None else reach_m
    rear_m = front_m - 80.0
    speed_mps = 0.0 if standstill else 5.0
    place = (localised, front_m - 1.0, front_m, rear_m, rear_m, speed_mps, standstill)
    return OwnTrain(*place, reach_m, reach_m, 16)


def test_it_echoes_the_newest_heartbeat_of_the_term_that_it_obeys() -> None:
    obeys = member()
    assert obeys.beat_ns == 0

    obeys.on_heartbeat(heartbeat(stamp_ns=70), 1)
    assert obeys.beat_ns == 70
    obeys.on_heartbeat(heartbeat(term=3, stamp_ns=90), 2)
    obeys.on_heartbeat(heartbeat(source=RIVAL, stamp_ns=95), 3)
    assert obeys.beat_ns == 70
    assert obeys.takes(authority(), 4) == ""
    assert obeys.beat_ns == 70


@pytest.mark.parametrize("first", [heartbeat(term=5, source=RIVAL, stamp_ns=8), None])
def test_for_a_new_term_it_echoes_no_heartbeat_of_another_master(first: Heartbeat | None) -> None:
    obeys = member()
    obeys.on_heartbeat(heartbeat(stamp_ns=70), 1)
    if first is None:
        assert obeys.takes(authority(term=5, source=RIVAL), 2) == ""
        assert obeys.beat_ns == 0
    else:
        obeys.on_heartbeat(first, 2)
        assert obeys.beat_ns == 8


def test_a_member_begins_with_its_stored_terms_and_no_authority() -> None:
    fresh = member(now_ns=7)

    assert fresh.memory == AreaMemory(1, 4, MASTER, 2)
    assert (fresh.held, fresh.latent_m) == (None, None)
    assert fresh.newest == (0, -1)
    assert (fresh.standby, fresh.rank) == (0, 4)
    assert fresh.master_heard_ns == 7
    assert fresh.new_promise is False
    assert not fresh.is_young(0)


# Terms.


@pytest.mark.parametrize(
    ("term", "source", "obeyed"),
    [
        (4, MASTER, True),
        (4, RIVAL, False),
        (3, MASTER, False),
        (3, RIVAL, False),
        (5, MASTER, True),
        (5, RIVAL, True),
        (99, RIVAL, True),
    ],
)
def test_a_term_has_one_owner_and_no_earlier_term_is_obeyed(
    term: int, source: int, *, obeyed: bool
) -> None:
    each = member()

    assert each.fences(heartbeat(term, source)) is obeyed

    promised = AreaMemory(1, term, source, 2) if obeyed else AreaMemory(1, 4, MASTER, 2)
    assert each.memory == promised
    assert each.new_promise is (obeyed and term > 4)


def test_a_new_term_is_acknowledged_once_and_its_first_sender_stays_its_owner() -> None:
    each = member()
    assert each.fences(heartbeat(5, RIVAL))
    each.new_promise = False

    assert not each.fences(heartbeat(5, MASTER))
    assert each.fences(heartbeat(5, RIVAL))

    assert each.memory == AreaMemory(1, 5, RIVAL, 2)
    assert each.new_promise is False


def test_an_acknowledgement_stays_pending_until_it_is_sent() -> None:
    each = member()
    each.fences(heartbeat(5, RIVAL))

    each.fences(heartbeat(5, RIVAL))
    each.fences(heartbeat(4, MASTER))

    assert each.new_promise is True


def test_a_heartbeat_proves_that_the_master_lives_and_names_the_standby() -> None:
    each = member()

    assert each.on_heartbeat(heartbeat(standby=7), 50 * MS) is True
    assert (each.master_heard_ns, each.standby) == (50 * MS, 7)
    assert each.on_heartbeat(heartbeat(standby=0), 60 * MS) is True
    assert (each.master_heard_ns, each.standby) == (60 * MS, 0)


@pytest.mark.parametrize("false", [heartbeat(3, standby=7), heartbeat(4, RIVAL, standby=7)])
def test_a_heartbeat_of_an_earlier_term_or_a_foreign_sender_is_ignored(false: Heartbeat) -> None:
    each = member()

    assert each.on_heartbeat(false, 50 * MS) is False

    assert (each.master_heard_ns, each.standby) == (0, 0)


# Authorities.


def test_an_accepted_authority_is_held_and_proves_that_the_master_lives() -> None:
    each = member()
    given = authority(sequence=12, term=5, rank=3, source=RIVAL)

    assert each.takes(given, 50 * MS) == ""

    assert each.held is given
    assert each.newest == (5, 12)
    assert each.rank == 3
    assert each.master_heard_ns == 50 * MS
    assert each.memory == AreaMemory(1, 5, RIVAL, 2)


@pytest.mark.parametrize(
    ("offered", "reason"),
    [
        (authority(950.0, 8), ""),
        (authority(950.0, 1, term=5, source=RIVAL), ""),
        (authority(950.0, 7), "repeated or out of order"),
        (authority(950.0, 6), "repeated or out of order"),
        (authority(950.0, 8, term=3), "old term"),
        (authority(950.0, 8, source=RIVAL), "old term"),
        (authority(950.0, 8, boot=5), "wrong boot incarnation"),
        (authority(950.0, 8, boot=7), "wrong boot incarnation"),
        (authority(950.0, 8, echo_ns=10 * MS - OLD_NS), ""),
        (authority(950.0, 8, echo_ns=10 * MS - OLD_NS - 1), "too old"),
        (authority(950.0, 8, echo_ns=10 * MS), ""),
        (authority(950.0, 8, echo_ns=10 * MS + 1), "too old"),
    ],
)
def test_a_refused_authority_has_a_reason_and_no_effect(
    offered: AreaAuthority, reason: str
) -> None:
    each = member()
    before = authority(900.0, 7, rank=2)
    assert each.takes(before, 0) == ""

    assert each.takes(offered, 10 * MS) == reason

    assert each.held is (before if reason else offered)
    assert each.newest == ((4, 7) if reason else (offered.term, offered.sequence))
    assert each.master_heard_ns == (0 if reason else 10 * MS)


@pytest.mark.parametrize("false", [{"boot": 5}, {"echo_ns": 11 * MS}])
def test_an_authority_for_another_incarnation_or_of_unknown_age_acknowledges_no_term(
    false: dict[str, int],
) -> None:
    each = member()

    assert each.takes(authority(term=9, source=RIVAL, **false), 10 * MS) != ""

    assert each.memory.seen_term == 4
    assert each.new_promise is False


@pytest.mark.parametrize(("age_ns", "young"), [(0, True), (OLD_NS, True), (OLD_NS + 1, False)])
def test_a_held_authority_expires_a_second_after_the_report_it_answers(
    age_ns: int, *, young: bool
) -> None:
    each = member()
    each.takes(authority(echo_ns=40 * MS), 50 * MS)

    assert each.is_young(40 * MS + age_ns) is young


# The held authority, and the farthest point that the train may reach.


@pytest.mark.parametrize(
    ("now_ns", "standstill", "kept"),
    [
        (OLD_NS, True, True),
        (OLD_NS, False, True),
        (OLD_NS + 1, True, False),
        (OLD_NS + 1, False, True),
    ],
)
def test_an_expired_authority_is_dropped_once_the_train_stands(
    now_ns: int, *, standstill: bool, kept: bool
) -> None:
    each = member()
    given = authority(900.0)
    each.takes(given, 0)

    each.settle(now_ns, own(500.0, standstill=standstill))

    assert each.held is (given if kept else None)
    assert each.latent_m == (900.0 if kept else 500.0)


def test_a_train_without_authority_may_come_as_far_as_its_stopping_place() -> None:
    each = member()

    each.settle(0, own(500.0, reach_m=620.0, standstill=False))
    assert each.latent_m == 620.0
    each.settle(1, own(510.0, reach_m=615.0, standstill=False))
    assert each.latent_m == 615.0
    each.settle(2, own(520.0, reach_m=640.0, standstill=False))
    assert each.latent_m == 615.0  # No authority has lengthened it since.
    each.settle(3, own(630.0, reach_m=640.0, standstill=False))
    assert each.latent_m == 630.0  # Never less than its present position.


def test_a_shorter_authority_binds_but_the_stopping_distance_stays_reserved() -> None:
    each = member()
    each.takes(authority(900.0, 1), 0)
    each.settle(0, own(500.0, reach_m=620.0, standstill=False))
    assert each.latent_m == 900.0

    each.takes(authority(550.0, 2), 1)
    each.settle(1, own(500.0, reach_m=620.0, standstill=False))
    assert each.latent_m == 620.0
    each.settle(2, own(530.0, standstill=True))
    assert each.latent_m == 550.0


def test_a_longer_authority_is_reserved_at_once() -> None:
    each = member()
    each.settle(0, own(500.0))

    each.takes(authority(900.0, 1), 0)
    each.settle(0, own(500.0))

    assert each.latent_m == 900.0


def test_the_farthest_point_is_never_behind_the_front() -> None:
    each = member()
    each.settle(0, own(500.0, reach_m=700.0, standstill=False))

    each.settle(1, own(600.0, reach_m=590.0))

    assert each.latent_m == 600.0


def test_a_lost_train_keeps_its_farthest_point() -> None:
    each = member()
    each.takes(authority(900.0, 1), 0)
    each.settle(0, own(500.0))

    each.takes(authority(800.0, 2), 1)
    each.settle(1, own(0.0, localised=False))
    assert each.latent_m == 900.0
    each.takes(authority(950.0, 3), 2)
    each.settle(2, own(0.0, localised=False))
    assert each.latent_m == 950.0


def test_a_dropped_authority_of_a_lost_train_stays_reserved() -> None:
    each = member()
    each.takes(authority(900.0, 1), 0)
    each.settle(0, own(500.0))

    each.settle(OLD_NS + 1, own(0.0, localised=False))

    assert each.held is None
    assert each.latent_m == 900.0


def test_a_train_that_never_had_a_position_has_no_farthest_point() -> None:
    each = member()
    each.settle(0, own(0.0, localised=False))
    assert each.latent_m is None

    each.takes(authority(900.0, 1), 1)
    each.settle(1, own(0.0, localised=False))

    assert each.latent_m is None


STEPS = st.lists(
    st.tuples(
        st.one_of(st.none(), st.floats(0.0, 500.0)),
        st.floats(0.0, 30.0),
        st.floats(0.0, 200.0),
    ),
    max_size=20,
)


@given(STEPS)
def test_the_farthest_point_covers_front_held_end_and_the_stopping_place_of_former_ends(
    steps: list[tuple[float | None, float, float]],
) -> None:
    """Each step gives the distance to a new end of authority, the distance run, and the stopping
    distance."""
    each = member()
    front_m, sequence, before_m = 0.0, 0, float("inf")
    for end_m, way_m, stops_m in steps:
        front_m += way_m
        if end_m is not None:
            sequence += 1
            each.takes(authority(front_m + end_m, sequence), 0)
        each.settle(0, own(front_m, reach_m=front_m + stops_m, standstill=False))

        held_m = front_m if each.held is None else each.held.end_m
        assert each.latent_m is not None
        assert each.latent_m >= max(front_m, held_m, min(before_m, front_m + stops_m))
        assert each.latent_m <= max(front_m, held_m, front_m + stops_m)
        before_m = each.latent_m


@pytest.mark.parametrize(
    ("limit_m", "end_m"), [(math.inf, 900.0), (901.0, 900.0), (700.0, 700.0), (400.0, 500.0)]
)
def test_it_reports_its_authority_as_far_as_it_uses_it(limit_m: float, end_m: float) -> None:
    each = member()
    assert each.held_end_m(500.0) == 500.0
    assert each.takes(authority(900.0), 0) == ""

    each.settle(1, own(500.0), limit_m=limit_m)

    assert each.held_end_m(500.0) == end_m
    assert each.latent_m == 900.0


# Terms on a secured line.

ARBITERS = (65_001, 65_002, 65_003)
SIGNERS = {each: signer_from_seed(bytes([each % 256]) * 32) for each in ARBITERS}
CHECK = GrantCheck({each: public for each, (_, public) in SIGNERS.items()})
SECURED = T2tConfig(arbiters=ARBITERS, grants=CHECK)


def secured_member() -> AreaMember:
    return AreaMember(SECURED, MemberGuards(), boot=BOOT, memory=AreaMemory(1, 4, MASTER), now_ns=0)


def signed(arbiter: int, *, by: int | None = None, **other: int) -> SignedGrant:
    """The grant of term 5 to RIVAL, or of something else, signed by this arbiter or another one."""
    signer, _ = SIGNERS[by or arbiter]
    what = {"area": 1, "term": 5, "holder": RIVAL, "arbiter": arbiter, "end_ns": 300, **other}
    return signer.signed(**what)


def shown(*grants: SignedGrant, stamp_ns: int = 0) -> Heartbeat:
    return replace(heartbeat(5, RIVAL, stamp_ns=stamp_ns), grants=grants)


FIRST, SECOND, THIRD = (signed(each) for each in ARBITERS)


@pytest.mark.parametrize("grants", [(FIRST, SECOND), (THIRD, FIRST), (FIRST, SECOND, THIRD)])
def test_a_majority_of_signed_grants_proves_a_term(grants: tuple[SignedGrant, ...]) -> None:
    each = secured_member()

    assert each.on_heartbeat(shown(*grants), 1)
    assert each.memory == AreaMemory(1, 5, RIVAL)


@pytest.mark.parametrize(
    "second",
    [
        (),
        (FIRST,),
        (signed(65_002, area=2),),
        (signed(65_002, term=6),),
        (signed(65_002, holder=MASTER),),
        (signed(65_002, by=65_001),),
        (signed(65_002, end_ns=10),),
        (SECOND._replace(end_ns=301),),
        (SECOND._replace(arbiter=65_003),),
        (SECOND._replace(arbiter=65_004),),
        (SECOND._replace(signature=b""),),
        (SECOND._replace(signature=SECOND.signature[:-1] + b"x"),),
    ],
)
def test_less_than_a_majority_of_valid_grants_proves_nothing(
    second: tuple[SignedGrant, ...],
) -> None:
    each = secured_member()

    assert not each.on_heartbeat(shown(FIRST, *second, stamp_ns=10), 1)
    assert not each.on_heartbeat(shown(*second, FIRST, stamp_ns=10), 1)
    assert each.memory == AreaMemory(1, 4, MASTER)
    assert not each.new_promise


@given(st.lists(st.tuples(st.sampled_from(ARBITERS), st.booleans()), max_size=5))
@settings(max_examples=40)
def test_no_term_is_obeyed_without_valid_grants_of_two_different_arbiters(
    drawn: list[tuple[int, bool]],
) -> None:
    each = secured_member()
    grants = [signed(arbiter) if good else signed(arbiter, term=6) for arbiter, good in drawn]

    obeyed = each.fences(shown(*grants))

    assert obeyed is (len({arbiter for arbiter, good in drawn[:2] if good}) == 2)
    assert each.memory == (AreaMemory(1, 5, RIVAL) if obeyed else AreaMemory(1, 4, MASTER))


def test_a_grant_counts_until_its_end_by_the_clock_of_the_holder() -> None:
    assert secured_member().fences(shown(FIRST, SECOND, stamp_ns=299))
    assert not secured_member().fences(shown(FIRST, SECOND, stamp_ns=300))


def test_only_a_heartbeat_proves_a_term_and_then_every_message_of_it_counts() -> None:
    each = secured_member()
    first = authority(term=5, source=RIVAL)

    assert each.takes(first, 1) == "old term"
    assert each.on_heartbeat(shown(FIRST, SECOND), 2)
    assert each.takes(first, 3) == ""
    # The term is known now. Its heartbeats need no proof any more, and other senders have none.
    assert each.on_heartbeat(shown(), 4)
    assert not each.on_heartbeat(replace(shown(FIRST, SECOND), source=MASTER), 5)


def test_a_sender_of_an_invalid_grant_is_checked_once_in_a_step() -> None:
    each = secured_member()

    assert not each.fences(shown(FIRST, FIRST._replace(end_ns=301)))
    assert not each.fences(shown(FIRST, SECOND))
    each.settle(1, own())
    assert each.fences(shown(FIRST, SECOND))


def test_no_report_unseats_a_master_whose_term_is_proven() -> None:
    assert member().believes_reported(5)
    assert not secured_member().believes_reported(5)
