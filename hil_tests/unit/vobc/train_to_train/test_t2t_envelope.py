"""Every threat of EN 50159 against every kind of message, through the codec and the checks of
the core."""

import dataclasses
import hmac
import math
from typing import Any

import msgspec
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from vobc.train_to_train.guards import MemberGuards
from vobc.train_to_train.member import AreaMember
from vobc.train_to_train.reception import SOURCES_MAX, Reception
from vobc.train_to_train.vocabulary import AreaMemory, T2tConfig
from zenoh_config.codec import (
    BENCH_KEY,
    CODE_BYTES,
    DATABASE_BYTES,
    HEADER,
    MAX_BYTES,
    VERSION,
    pack,
    unpack,
)
from zenoh_config.messages import Refused, RefusedReason, SpeedRestriction
from zenoh_config.t2t import (
    BROADCAST,
    ROSTER_MAX,
    Admission,
    AdmissionState,
    AreaAuthority,
    ClaimKind,
    Heartbeat,
    LeaseAnswer,
    LeaseKind,
    LeaseRequest,
    LineOrder,
    ObjectClaim,
    ObjectState,
    ObjectStatus,
    OrderKind,
    Phase,
    RosterAck,
    RosterCommit,
    RosterEntry,
    SectionState,
    StandbySync,
    SwitchKind,
    SwitchStep,
    SyncAck,
    SyncEntry,
    T2tMessage,
    TrackStatus,
    TrainReport,
)
from zenoh_config.t2t_supervision import (
    Decree,
    DecreeAnswer,
    DecreeKind,
    LeaseNote,
    LeaseReason,
    LineState,
    Removal,
    RemovalAnswer,
    RemovalState,
    TrainDecree,
)
from zenoh_config.t2t_types import T2T_TYPES

MS = 1_000_000
OWN, PEER, ARBITER = 4, 9, 65_001
TRAIN = (PEER, OWN, 1, 7, 2, 100, 5000 * MS)
WAYSIDE = (0, OWN, 1, 7, 2, 100, 5000 * MS)
DESK = (65_100, OWN, 1, 7, 2, 100, 5000 * MS)
WITNESS = (ARBITER, OWN, 1, 7, 2, 100, 5000 * MS)
LIMIT = (SpeedRestriction(10.0, 20.0, 5.0),)
ROSTER = (RosterEntry(9, 410.5, True), RosterEntry(4, 10.0, False))
REPORT = TrainReport(
    *(*TRAIN, True, 98.0, 102.0, 20.0, 21.5, 3.0, False, 300.0, 300.0, 140.0, 7, 3, True, 0, 0, 16),
    *(False, 0, 4950 * MS),
)
AUTHORITY = AreaAuthority(*TRAIN, 1, 4900 * MS, 800.0, 15.0, 3, 2, LIMIT)
HEARTBEAT = Heartbeat(*TRAIN, Phase.ISSUING, 4, 3)

EVERY: dict[type[T2tMessage], T2tMessage] = {
    type(each): each
    for each in (
        LeaseRequest(PEER, ARBITER, 1, 7, 2, 100, 0, LeaseKind.ACQUIRE, 5, 0),
        LeaseAnswer(*WITNESS, True, 5, 4990 * MS, 4, 0, 6, 2, ROSTER),
        HEARTBEAT,
        REPORT,
        AUTHORITY,
        StandbySync(*TRAIN, 2, (SyncEntry(9, 410.5, 900.0),)),
        SyncAck(*TRAIN, 99),
        RosterCommit(PEER, ARBITER, 1, 7, 2, 100, 0, 2, ROSTER),
        RosterAck(*WITNESS, 2),
        SwitchStep(*TRAIN, SwitchKind.PREPARE, 3, 4),
        ObjectClaim(PEER, 0, 1, 7, 2, 100, 0, 3, ClaimKind.CLAIM, 8),
        ObjectStatus(*WAYSIDE, 3, ObjectState.LOCKED, 7, 8, False),
        TrackStatus(*WAYSIDE, 4950 * MS, (SectionState(1, True, 16),), LIMIT, ()),
        LineOrder(*DESK, OrderKind.STOP, 4),
        Admission(*TRAIN, AdmissionState.WAITS, 3),
        Decree(65_100, 0, 0, 0, 2, 100, 0, 4900 * MS, DecreeKind.RESTRICT, 0, 10.0, 20.0, 5.0),
        LineState(
            *(0, 65_535, 0, 0, 2, 100, 5000 * MS, 2, 99, DecreeAnswer.DONE),
            (TrainDecree(4, True, False, False, 2),),
            (LeaseNote(1, 4, 7, 9, LeaseReason.RAN_OUT, 4000 * MS),),
            LIMIT,
            (),
        ),
        Removal(*DESK, 4900 * MS, 3),
        RemovalAnswer(PEER, 65_100, 1, 7, 2, 100, 0, 3, RemovalState.AXLES),
    )
}
TO_TRAINS = [
    each
    for each in EVERY.values()
    if not isinstance(
        each, LeaseRequest | RosterCommit | ObjectClaim | Decree | LineState | RemovalAnswer
    )
]
kinds = pytest.mark.parametrize("message", EVERY.values(), ids=lambda m: type(m).__name__)
heard = pytest.mark.parametrize("message", TO_TRAINS, ids=lambda m: type(m).__name__)


def member() -> AreaMember:
    return AreaMember(
        T2tConfig(), MemberGuards(), boot=1, memory=AreaMemory(1, 7, PEER, 0), now_ns=0
    )


def refusal(payload: bytes) -> RefusedReason:
    result = unpack(payload)
    assert isinstance(result, Refused)
    return result.reason


def test_there_is_an_example_of_every_kind() -> None:
    assert set(EVERY) == set(T2T_TYPES)


@kinds
def test_a_packed_message_unpacks_unchanged(message: T2tMessage) -> None:
    assert unpack(pack(message)) == message


# Corruption and masquerade.


@kinds
def test_no_single_flipped_bit_gets_through(message: T2tMessage) -> None:
    payload = pack(message)

    for at in range(len(payload)):
        for bit in (1, 0x80):
            spoiled = bytes([*payload[:at], payload[at] ^ bit, *payload[at + 1 :]])
            assert refusal(spoiled) is RefusedReason.WRONG_CODE


@kinds
def test_a_message_without_the_key_is_refused(message: T2tMessage) -> None:
    forged = pack(message, b"another key, 16+ bytes")

    assert refusal(forged) is RefusedReason.WRONG_CODE


@heard
def test_a_message_from_the_wrong_kind_of_sender_is_refused(message: T2tMessage) -> None:
    hearing = Reception(OWN, boot=1)
    other = 0 if 0 < message.source < 65_000 else PEER

    assert not hearing.admits(dataclasses.replace(message, source=other), 0)
    assert hearing.refusals == {RefusedReason.WRONG_SOURCE: 1}


# Insertion.


@heard
def test_a_message_for_another_train_is_refused(message: T2tMessage) -> None:
    hearing = Reception(OWN, boot=1)

    assert not hearing.admits(dataclasses.replace(message, destination=OWN + 1), 0)
    assert hearing.refusals == {RefusedReason.WRONG_DESTINATION: 1}
    for_all = dataclasses.replace(message, destination=BROADCAST)
    assert hearing.admits(for_all, 0) is not isinstance(message, AreaAuthority)


# Repetition and resequencing.


def admitted_twice(first: T2tMessage, second: T2tMessage) -> bool:
    """Whether both messages pass the order checks; for authorities, that of the member counts
    too."""
    hearing, own = Reception(OWN, boot=1), member()
    taken = []
    for message in (first, second):
        passes = hearing.admits(message, 0)
        if passes and isinstance(message, AreaAuthority):
            passes = own.takes(message, 5000 * MS) == ""
        taken.append(passes)
    assert taken[0]
    return taken[1]


@heard
def test_a_repetition_is_not_taken(message: T2tMessage) -> None:
    assert not admitted_twice(message, message)


@heard
def test_a_message_out_of_order_is_refused(message: T2tMessage) -> None:
    earlier = dataclasses.replace(message, sequence=message.sequence - 1)
    later = dataclasses.replace(message, sequence=message.sequence + 1)

    assert not admitted_twice(message, earlier)
    assert admitted_twice(message, later)


@heard
def test_a_message_of_an_earlier_incarnation_is_refused(message: T2tMessage) -> None:
    earlier: T2tMessage
    if isinstance(message, AreaAuthority):
        # A new incarnation has a new term, and that order counts.
        message = dataclasses.replace(message, term=8)
        earlier = dataclasses.replace(message, term=7, boot=1, sequence=5000)
    else:
        earlier = dataclasses.replace(message, boot=1, sequence=5000)

    assert not admitted_twice(message, earlier)


# Delay and deletion.


@pytest.mark.parametrize(
    ("age_ms", "refused"), [(0, ""), (1000, ""), (1001, "too old"), (-1, "too old")]
)
def test_an_authority_is_as_old_as_the_report_that_it_answers(age_ms: int, refused: str) -> None:
    assert member().takes(AUTHORITY, AUTHORITY.echo_ns + age_ms * MS) == refused


@pytest.mark.parametrize(
    ("changed", "refused"),
    [
        ({"to_boot": 2}, "wrong boot incarnation"),
        ({"term": 6}, "old term"),
        ({"source": PEER + 1}, "old term"),
        ({"term": 8, "source": PEER + 1}, ""),
    ],
)
def test_an_authority_must_be_for_this_incarnation_and_from_the_owner_of_the_newest_term(
    changed: dict[str, Any], refused: str
) -> None:
    offered = dataclasses.replace(AUTHORITY, **changed)

    assert member().takes(offered, 5000 * MS) == refused


def test_a_refused_authority_changes_nothing() -> None:
    own = member()
    own.takes(AUTHORITY, 5000 * MS)
    before = (own.held, own.newest, own.memory, own.rank)

    own.takes(dataclasses.replace(AUTHORITY, term=6, sequence=101, end_m=900.0), 5000 * MS)
    own.takes(dataclasses.replace(AUTHORITY, term=9, to_boot=3), 5000 * MS)

    assert (own.held, own.newest, own.memory, own.rank) == before


# Faulty senders, floods, doubles.

NO_HONEST_ONE = [
    dataclasses.replace(REPORT, front_min_m=math.nan),
    dataclasses.replace(REPORT, rear_min_m=99.0),
    dataclasses.replace(REPORT, latent_m=101.0),
    dataclasses.replace(REPORT, latent_m=math.inf),
    dataclasses.replace(REPORT, speed_mps=1e9),
    dataclasses.replace(REPORT, axles=1001),
    dataclasses.replace(AUTHORITY, end_m=1e7),
    dataclasses.replace(AUTHORITY, end_m=math.nan),
    dataclasses.replace(AUTHORITY, rear_m=801.0),
    dataclasses.replace(AUTHORITY, term=2**48),
    dataclasses.replace(AUTHORITY, echo_ns=2**63),
    dataclasses.replace(AUTHORITY, restrictions=(SpeedRestriction(1.0, 2.0, 0.0),)),
    dataclasses.replace(HEARTBEAT, area=256),
    dataclasses.replace(HEARTBEAT, boot=-1),
    dataclasses.replace(HEARTBEAT, standby=70_000),
    RosterCommit(PEER, ARBITER, 1, 7, 2, 100, 0, 2, ROSTER * (ROSTER_MAX // 2 + 1)),
    RosterCommit(PEER, ARBITER, 1, 7, 2, 100, 0, 2, (RosterEntry(9, math.inf, True),)),
]


@pytest.mark.parametrize("message", NO_HONEST_ONE)
def test_implausible_numbers_are_neither_sent_nor_accepted(message: T2tMessage) -> None:
    with pytest.raises(ValueError, match=type(message).__name__):
        pack(message)


@settings(max_examples=100, deadline=None)
@given(st.binary(max_size=200), st.integers(0, 40))
def test_any_body_under_a_right_code_is_a_message_or_a_reason(body: bytes, kind: int) -> None:
    """A faulty node with the key sends a correct code around arbitrary content."""
    sealed = HEADER.pack(VERSION, kind, PEER, OWN, 1, 1) + bytes(DATABASE_BYTES) + body
    payload = sealed + hmac.digest(BENCH_KEY, sealed, "sha256")[:CODE_BYTES]

    assert unpack(payload) is not None


def test_a_body_of_a_wrong_enumeration_is_refused() -> None:
    body = msgspec.msgpack.encode([1, 7, 2, 9, 4, 3])
    sealed = HEADER.pack(VERSION, 18, PEER, OWN, 1, 1) + bytes(DATABASE_BYTES) + body
    payload = sealed + hmac.digest(BENCH_KEY, sealed, "sha256")[:CODE_BYTES]

    assert refusal(payload) is RefusedReason.WRONG_FIELDS


def test_the_largest_area_fits_into_one_message() -> None:
    full = tuple([RosterEntry(60_000 + n, 123_456.789, True) for n in range(ROSTER_MAX)])

    assert len(pack(RosterCommit(PEER, ARBITER, 1, 7, 2, 100, 0, 2, full))) <= MAX_BYTES


def test_memory_stays_bounded_for_any_number_of_senders() -> None:
    hearing = Reception(OWN, boot=1)

    for n in range(SOURCES_MAX + 500):
        area, source = 1 + n % 200, 1 + n // 200
        hearing.admits(dataclasses.replace(HEARTBEAT, area=area, source=source + 10), 0)

    assert len(hearing._newest) == SOURCES_MAX
    assert hearing.refusals[RefusedReason.WRONG_SOURCE] == 500


def test_own_messages_coming_back_are_no_duplicate_address_and_foreign_ones_are() -> None:
    hearing = Reception(OWN, boot=3)
    own = dataclasses.replace(HEARTBEAT, source=OWN, boot=3, sequence=10)

    hearing.admits(own, own_sequence=10)
    hearing.admits(dataclasses.replace(own, boot=2, sequence=99), own_sequence=10)
    assert not hearing.doubled
    hearing.admits(dataclasses.replace(own, sequence=11), own_sequence=10)

    assert hearing.doubled
