"""Which messages a train accepts: by sender, receiver and order; and how it heads its own."""

from collections.abc import Callable
from dataclasses import replace

import pytest

from vobc.train_to_train.area_participant import ROUTES as PARTICIPANT_ROUTES
from vobc.train_to_train.master import ROUTES as MASTER_ROUTES
from vobc.train_to_train.message_heads import MessageHead, MessageHeads
from vobc.train_to_train.reception import SENDERS, Reception
from zenoh_config.messages import RefusedReason
from zenoh_config.t2t import (
    BROADCAST,
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
    StandbySync,
    SwitchKind,
    SwitchStep,
    SyncAck,
    T2tMessage,
    TrackStatus,
    TrainReport,
)
from zenoh_config.t2t_supervision import Decree, LineState, RemovalAnswer
from zenoh_config.t2t_types import T2T_TYPES

OWN = 5
OWN_BOOT = 3
SPOKEN = 10
"""Sequence number of the last message that the train itself sent."""

WRONG_SOURCE = RefusedReason.WRONG_SOURCE
WRONG_DESTINATION = RefusedReason.WRONG_DESTINATION
WRONG_BOOT = RefusedReason.WRONG_BOOT
NOT_NEWER = RefusedReason.NOT_NEWER

Head7 = tuple[int, int, int, int, int, int, int]
Maker = Callable[[Head7], T2tMessage]


def head(
    source: int, *, to: int = OWN, area: int = 1, boot: int = OWN_BOOT, sequence: int = 20
) -> Head7:
    return source, to, area, 4, boot, sequence, 0


def report(told: Head7) -> T2tMessage:
    return TrainReport(
        *told,
        localised=True,
        front_min_m=499.0,
        front_max_m=500.0,
        rear_min_m=420.0,
        protected_m=420.0,
        speed_mps=0.0,
        standstill=True,
        latent_m=500.0,
        held_end_m=500.0,
        easy_m=500.0,
        held_term=0,
        held_sequence=0,
        member=False,
        behind=0,
        comes_from=0,
        axles=16,
        out_of_service=False,
        ready_nonce=0,
        echo_ns=0,
    )


def heartbeat(told: Head7) -> T2tMessage:
    return Heartbeat(*told, Phase.ISSUING, 0, 1)


def authority(told: Head7) -> T2tMessage:
    return AreaAuthority(*told, 1, 0, 900.0, 0.0, 0, 1, ())


def order(told: Head7) -> T2tMessage:
    return LineOrder(*told, OrderKind.STOP, OWN)


def answer(told: Head7) -> T2tMessage:
    return LeaseAnswer(*told, True, 1, 0, OWN, 0, 0, 0, ())


def status(told: Head7, number: int = 3) -> T2tMessage:
    return ObjectStatus(*told, number, ObjectState.LOCKED, 4, 2, False)


def track(told: Head7) -> T2tMessage:
    return TrackStatus(*told, 0, (), (), ())


OF_TRAINS: tuple[Maker, ...] = (
    heartbeat,
    report,
    authority,
    lambda told: StandbySync(*told, 1, ()),
    lambda told: SyncAck(*told, 1),
    lambda told: SwitchStep(*told, SwitchKind.PREPARE, 1, 7),
    lambda told: Admission(*told, AdmissionState.WAITS, 0),
    lambda told: ObjectClaim(*told, 3, ClaimKind.CLAIM, 1),
)
OF_ARBITERS: tuple[Maker, ...] = (answer, lambda told: RosterAck(*told, 1))
OF_WAYSIDE: tuple[Maker, ...] = (status, track)
OF_SUPERVISION: tuple[Maker, ...] = (order,)
FOR_ARBITERS: tuple[Maker, ...] = (
    lambda told: LeaseRequest(*told, LeaseKind.ACQUIRE, 1, 0),
    lambda told: RosterCommit(*told, 1, ()),
)
EVERYBODY = (0, 1, 64_999, 65_000, 65_001, 65_050, 65_099, 65_100, 65_101)
"""Addresses of the wayside, of the first and last trains and arbiters, of supervision, and of
none of them."""


def fresh() -> Reception:
    return Reception(OWN, OWN_BOOT)


def why_not(hearing: Reception, message: T2tMessage) -> RefusedReason | None:
    """The one counted reason for a refusal, or None for an accepted message."""
    before = hearing.refusals.copy()
    if hearing.admits(message, SPOKEN):
        assert hearing.refusals == before
        return None
    (counted,) = (hearing.refusals - before).items()
    assert counted[1] == 1
    return counted[0]


# Which sender may send which message.


@pytest.mark.parametrize(
    ("makers", "speakers"),
    [
        (OF_TRAINS, {1, 64_999}),
        (OF_ARBITERS, {65_001, 65_050, 65_099}),
        (OF_WAYSIDE, {0}),
        (OF_SUPERVISION, {65_100}),
        (FOR_ARBITERS, set()),
    ],
)
def test_a_message_is_accepted_only_from_its_proper_sender(
    makers: tuple[Maker, ...], speakers: set[int]
) -> None:
    for make in makers:
        heard = {who for who in EVERYBODY if why_not(fresh(), make(head(who))) is None}
        assert heard == speakers
        for who in set(EVERYBODY) - speakers:
            assert why_not(fresh(), make(head(who))) is WRONG_SOURCE


@pytest.mark.parametrize("make", [*OF_TRAINS, *OF_SUPERVISION])
@pytest.mark.parametrize(
    ("to", "reason"),
    [(OWN, None), (BROADCAST, None), (6, WRONG_DESTINATION), (0, WRONG_DESTINATION)],
)
def test_only_messages_for_this_train_or_for_all_are_accepted(
    make: Maker, to: int, reason: RefusedReason | None
) -> None:
    source = 65_100 if make is order else 9
    if make is authority and to == BROADCAST:
        # It says where one train may go.
        reason = WRONG_DESTINATION

    assert why_not(fresh(), make(head(source, to=to))) is reason


def test_refusals_are_counted_by_reason() -> None:
    hearing = fresh()
    assert hearing.refusals == {}

    assert hearing.admits(heartbeat(head(9)), SPOKEN) is True
    assert hearing.admits(heartbeat(head(9)), SPOKEN) is False
    assert hearing.admits(heartbeat(head(9)), SPOKEN) is False
    assert hearing.admits(heartbeat(head(9, to=6)), SPOKEN) is False

    assert hearing.refusals == {NOT_NEWER: 2, WRONG_DESTINATION: 1}


# Another node under the same address.


@pytest.mark.parametrize(
    ("boot", "sequence", "doubled"),
    [(3, 9, False), (3, 10, False), (3, 11, True), (2, 11, False), (4, 1, True)],
)
def test_a_message_with_its_address_that_it_has_not_sent_comes_from_a_duplicate(
    boot: int, sequence: int, *, doubled: bool
) -> None:
    """A train's own messages come back too, some from an earlier incarnation; the train never
    accepts them."""
    hearing = fresh()
    assert hearing.doubled is False

    assert why_not(hearing, heartbeat(head(OWN, boot=boot, sequence=sequence))) is WRONG_SOURCE
    assert hearing.doubled is doubled

    hearing.admits(heartbeat(head(OWN, sequence=1)), SPOKEN)
    assert hearing.doubled is doubled  # A detected duplicate address stays.


def test_another_sender_with_higher_numbers_does_not_count_as_a_duplicate() -> None:
    hearing = fresh()

    hearing.admits(heartbeat(head(9, boot=99, sequence=99)), SPOKEN)

    assert hearing.doubled is False


# Order of messages.


@pytest.mark.parametrize(
    ("boot", "sequence", "reason"),
    [
        (3, 21, None),
        (4, 1, None),
        (30, 20, None),
        (3, 20, NOT_NEWER),
        (3, 19, NOT_NEWER),
        (2, 21, WRONG_BOOT),
        (2, 20, WRONG_BOOT),
        (0, 99, WRONG_BOOT),
    ],
)
def test_one_senders_messages_are_accepted_in_order_of_incarnation_and_number(
    boot: int, sequence: int, reason: RefusedReason | None
) -> None:
    hearing = fresh()
    assert why_not(hearing, report(head(9, boot=3, sequence=20))) is None

    assert why_not(hearing, report(head(9, boot=boot, sequence=sequence))) is reason


def test_a_refused_message_does_not_advance_the_order() -> None:
    hearing = fresh()
    assert why_not(hearing, report(head(9, sequence=20))) is None
    assert why_not(hearing, report(head(9, to=6, sequence=30))) is WRONG_DESTINATION
    assert why_not(hearing, report(head(9, sequence=10))) is NOT_NEWER

    assert why_not(hearing, report(head(9, sequence=21))) is None
    assert why_not(hearing, report(head(9, sequence=21))) is NOT_NEWER


@pytest.mark.parametrize(
    "other",
    [
        report(head(8, sequence=1)),
        report(head(9, area=2, sequence=1)),
        heartbeat(head(9, sequence=1)),
    ],
)
def test_each_sender_area_and_kind_of_message_has_its_own_order(other: T2tMessage) -> None:
    hearing = fresh()
    assert why_not(hearing, report(head(9, sequence=20))) is None

    assert why_not(hearing, other) is None
    assert why_not(hearing, other) is NOT_NEWER


def test_every_object_of_the_wayside_has_its_own_order() -> None:
    hearing = fresh()
    assert why_not(hearing, status(head(0, sequence=20), 3)) is None

    assert why_not(hearing, status(head(0, sequence=10), 4)) is None
    assert why_not(hearing, status(head(0, sequence=10), 0)) is None
    assert why_not(hearing, status(head(0, sequence=19), 3)) is NOT_NEWER


def test_the_member_checks_the_order_of_authorities() -> None:
    """A new master's authority may come before the last ones of the former master; each has its
    term."""
    hearing = fresh()

    for sequence in (20, 20, 1):
        assert why_not(hearing, authority(head(9, sequence=sequence))) is None


def test_a_flood_of_new_senders_does_not_evict_the_16384_known_streams() -> None:
    hearing = fresh()
    trains = [train for train in range(1, 20_000) if train != OWN]
    sample = report(head(trains[0]))
    for train in trains[:16_384]:
        assert hearing.admits(replace(sample, source=train), SPOKEN)

    assert why_not(hearing, report(head(trains[16_384]))) is WRONG_SOURCE
    assert why_not(hearing, report(head(trains[16_384]))) is WRONG_SOURCE
    assert why_not(hearing, report(head(trains[16_383], sequence=21))) is None
    assert why_not(hearing, report(head(trains[0], sequence=21))) is None
    assert why_not(hearing, report(head(trains[0], sequence=21))) is NOT_NEWER


# Headers of the train's own messages.


def test_a_train_numbers_all_its_messages_from_1() -> None:
    speaker = MessageHeads(OWN, OWN_BOOT)
    assert speaker.sequence == 0

    first = speaker.head(70, to=9, area=1, term=4)
    second = speaker.head(80, to=BROADCAST, area=2, term=6)

    assert first == MessageHead(
        source=5, destination=9, area=1, term=4, boot=3, sequence=1, stamp_ns=70
    )
    assert second == (5, BROADCAST, 2, 6, 3, 2, 80)
    assert speaker.sequence == 2


def test_every_message_has_its_senders_unless_it_never_goes_to_a_train() -> None:
    not_to_trains = {LeaseRequest, RosterCommit, Decree, RemovalAnswer, LineState}

    assert set(SENDERS) == set(T2T_TYPES) - not_to_trains


def test_every_route_is_for_a_message_that_a_train_may_receive() -> None:
    assert set(MASTER_ROUTES) | set(PARTICIPANT_ROUTES) <= set(SENDERS)
