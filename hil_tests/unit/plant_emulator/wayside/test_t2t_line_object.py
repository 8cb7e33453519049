"""A switch, crossing or platform track: which messages it obeys, what it stores and what it
sends."""

from dataclasses import replace

import pytest

from firmware_py.trackdb.areas import ObjectKind, ObjectSite
from plant_emulator.wayside.line_object import (
    Demand,
    LineObject,
    ObjectGuards,
    ObjectTerm,
    free_to_lock,
    newer_claim,
    no_train_in_it,
    owner_of_term,
    term_not_old,
)
from plant_emulator.wayside.t2t_vocabulary import ObjectMemory, WaysideStepped
from zenoh_config.t2t import (
    BROADCAST,
    ClaimKind,
    Heartbeat,
    ObjectClaim,
    ObjectState,
    ObjectStatus,
    Phase,
    RosterCommit,
    T2tMessage,
)
from zenoh_config.timers import TIMERS_A

SITE = ObjectSite(3, ObjectKind.SWITCH, 500.0, 520.0)
LOCK, OPEN = ClaimKind.CLAIM, ClaimKind.RELEASE
FREE, LOCKED, FAILED = ObjectState.FREE, ObjectState.LOCKED, ObjectState.FAILED
MEMORY = ObjectMemory(boot=6, seen_term=7, owner=4, state=LOCKED, claim_term=7, nonce=20)
STARTED = ObjectMemory(boot=7, seen_term=7, owner=4, state=LOCKED, claim_term=7, nonce=20)
"""The same memory after the next start."""


def claim(
    kind: ClaimKind = LOCK,
    *,
    source: int = 4,
    area: int = 1,
    term: int = 7,
    number: int = 3,
    nonce: int = 21,
) -> ObjectClaim:
    return ObjectClaim(source, 0, area, term, 1, 1, 0, number, kind, nonce)


def heartbeat(term: int, *, source: int = 4, area: int = 1) -> Heartbeat:
    return Heartbeat(source, BROADCAST, area, term, 1, 1, 0, Phase.FENCING, 0, 1)


def started(
    memory: ObjectMemory | None = MEMORY,
    *,
    start_ns: int = 0,
    guards: ObjectGuards | None = None,
) -> LineObject:
    return LineObject(TIMERS_A, SITE, 1, memory=memory, start_ns=start_ns, guards=guards)


def stepped(
    line_object: LineObject,
    *messages: T2tMessage,
    now_ns: int = 0,
    wanted: bool = False,
    occupied: bool = False,
) -> WaysideStepped[ObjectMemory]:
    return line_object.step(now_ns, messages, release_wanted=wanted, occupied=occupied)


def after(*messages: T2tMessage, wanted: bool = False, occupied: bool = False) -> LineObject:
    line_object = started()
    stepped(line_object, *messages, wanted=wanted, occupied=occupied)
    return line_object


def demand(
    kind: ClaimKind = LOCK,
    *,
    term: int = 7,
    nonce: int = 21,
    state: ObjectState = LOCKED,
    wanted: bool = False,
    occupied: bool = False,
) -> Demand:
    memory = ObjectMemory(seen_term=7, owner=4, state=state, claim_term=7, nonce=20)
    return Demand(claim(kind, term=term, nonce=nonce), memory, wanted, occupied)


@pytest.mark.parametrize(
    ("term", "nonce", "newer"),
    [(7, 19, False), (7, 20, False), (7, 21, True), (8, 1, True), (6, 99, False), (8, 20, True)],
)
def test_a_claim_is_newer_by_its_term_and_then_by_its_number(
    term: int, nonce: int, *, newer: bool
) -> None:
    assert newer_claim(demand(term=term, nonce=nonce)) is newer


@pytest.mark.parametrize(
    ("kind", "occupied", "allowed"),
    [(LOCK, False, True), (LOCK, True, True), (OPEN, False, True), (OPEN, True, False)],
)
def test_a_train_in_it_forbids_to_open_and_not_to_lock(
    kind: ClaimKind, *, occupied: bool, allowed: bool
) -> None:
    assert no_train_in_it(demand(kind, occupied=occupied)) is allowed


@pytest.mark.parametrize(
    ("kind", "state", "wanted", "allowed"),
    [
        (LOCK, FREE, True, False),
        (LOCK, FREE, False, True),
        (LOCK, LOCKED, True, True),
        (LOCK, LOCKED, False, True),
        (OPEN, FREE, True, True),
        (OPEN, FREE, False, True),
        (OPEN, LOCKED, True, True),
    ],
)
def test_an_object_that_may_open_now_is_not_locked(
    kind: ClaimKind, state: ObjectState, *, wanted: bool, allowed: bool
) -> None:
    assert free_to_lock(demand(kind, state=state, wanted=wanted)) is allowed


@pytest.mark.parametrize(("term", "obeyed"), [(6, False), (7, True), (8, True)])
def test_no_term_below_the_highest_received_is_obeyed(term: int, *, obeyed: bool) -> None:
    assert term_not_old(ObjectTerm(term, 4, MEMORY)) is obeyed


@pytest.mark.parametrize(
    ("term", "source", "owner"), [(7, 4, True), (7, 5, False), (8, 5, True), (8, 4, True)]
)
def test_a_term_belongs_to_its_first_sender(term: int, source: int, *, owner: bool) -> None:
    assert owner_of_term(ObjectTerm(term, source, MEMORY)) is owner


def test_a_status_holds_the_whole_state_and_a_running_number() -> None:
    line_object = started()

    (first,) = stepped(line_object, now_ns=5).out
    (second,) = stepped(line_object, now_ns=6, wanted=True).out

    assert first == ObjectStatus(0, 65_535, 1, 7, 7, 1, 5, 3, LOCKED, 7, 20, False)
    assert second == ObjectStatus(0, 65_535, 1, 7, 7, 2, 6, 3, LOCKED, 7, 20, True)


def test_a_status_is_sent_every_50_ms() -> None:
    line_object = started(start_ns=1_000)
    assert line_object.next_due_ns() == 1_000
    assert len(stepped(line_object, now_ns=1_000).out) == 1
    assert line_object.next_due_ns() == 50_001_000

    said = [len(stepped(line_object, now_ns=at).out) for at in (1_001, 50_000_999, 50_001_000)]

    assert said == [0, 0, 1]
    assert line_object.next_due_ns() == 100_001_000


def test_the_first_step_sends_a_status() -> None:
    assert len(stepped(started(start_ns=1_000), now_ns=10).out) == 1


@pytest.mark.parametrize(
    ("messages", "wanted", "said"),
    [
        ((), False, 0),
        ((), True, 1),
        ((claim(OPEN),), False, 1),
        ((heartbeat(8),), False, 1),
        ((heartbeat(7),), False, 0),
        ((claim(OPEN, nonce=20),), False, 0),
    ],
)
def test_a_change_is_sent_at_once_and_delays_the_next_status(
    messages: tuple[T2tMessage, ...], said: int, *, wanted: bool
) -> None:
    line_object = started()
    stepped(line_object)

    assert len(stepped(line_object, *messages, now_ns=100, wanted=wanted).out) == said
    assert line_object.next_due_ns() == 50_000_000 + 100 * said
    assert stepped(line_object, now_ns=200, wanted=wanted).out == ()


def test_it_stores_its_incarnation_first_and_then_only_what_changed() -> None:
    line_object = started()

    assert stepped(line_object).memory == STARTED
    assert stepped(line_object, now_ns=1).memory is None
    assert stepped(line_object, heartbeat(7), claim(OPEN, nonce=20), now_ns=2).memory is None
    assert stepped(line_object, heartbeat(8, source=5), now_ns=3).memory == ObjectMemory(
        7, 8, 5, LOCKED, 7, 20
    )
    assert stepped(line_object, now_ns=4).memory is None


def test_a_change_in_the_first_step_is_stored_with_it() -> None:
    assert stepped(started(), claim(OPEN)).memory == ObjectMemory(7, 7, 4, FREE, 7, 21)


@pytest.mark.parametrize(("kind", "state"), [(ClaimKind.CLAIM, LOCKED), (ClaimKind.RELEASE, FREE)])
def test_an_obeyed_message_is_stored_with_its_term_owner_and_number(
    kind: ClaimKind, state: ObjectState
) -> None:
    line_object = after(claim(kind, source=9, term=8, nonce=1))

    assert line_object.memory == ObjectMemory(7, 8, 9, state, 8, 1)
    assert line_object.refused == 0


def test_every_message_of_one_step_is_processed() -> None:
    line_object = after(claim(OPEN, nonce=21), claim(LOCK, nonce=22))

    assert line_object.memory == ObjectMemory(7, 7, 4, LOCKED, 7, 22)


@pytest.mark.parametrize(
    "message",
    [
        claim(OPEN, area=2),
        claim(OPEN, nonce=20),
        claim(OPEN, term=6, nonce=99),
        claim(OPEN, source=5),
        claim(OPEN, source=0, term=8),
        claim(OPEN, source=65_000, term=8),
        heartbeat(8, area=2),
        heartbeat(6),
        heartbeat(7, source=5),
        heartbeat(8, source=0),
        heartbeat(8, source=65_000),
        RosterCommit(4, BROADCAST, 1, 8, 1, 1, 0, 1, ()),
    ],
)
def test_a_message_from_a_wrong_sender_is_counted_without_effect(message: T2tMessage) -> None:
    line_object = after(message)
    assert line_object.memory == STARTED
    assert line_object.refused == 1

    stepped(line_object, message, message)
    assert line_object.refused == 3


@pytest.mark.parametrize("source", [1, 4, 64_999])
def test_every_train_may_bring_a_new_term(source: int) -> None:
    line_object = after(claim(OPEN, source=source, term=8, nonce=1))

    assert line_object.memory == ObjectMemory(7, 8, source, FREE, 8, 1)


def test_a_heartbeat_of_the_known_term_is_neither_refused_nor_stored() -> None:
    line_object = after(heartbeat(7))

    assert (line_object.memory, line_object.refused) == (STARTED, 0)


@pytest.mark.parametrize("term", [6, 7, 8])
def test_a_claim_for_another_object_is_ignored(term: int) -> None:
    line_object = after(claim(OPEN, number=2, term=term))

    assert (line_object.memory, line_object.refused) == (STARTED, 0)


def test_a_claim_that_it_cannot_obey_still_updates_the_term() -> None:
    line_object = after(claim(OPEN, source=9, term=8, nonce=1), occupied=True)

    assert line_object.memory == ObjectMemory(7, 8, 9, LOCKED, 7, 20)
    assert line_object.refused == 1


def test_an_opened_object_with_a_pending_request_is_not_locked() -> None:
    line_object = after(claim(OPEN), claim(LOCK, nonce=22), wanted=True)

    assert line_object.memory.state is FREE
    assert line_object.refused == 1


def test_an_object_without_memory_has_failed_and_ignores_and_stores_nothing() -> None:
    line_object = started(None)

    first = stepped(line_object, heartbeat(8), claim(LOCK, term=9))
    second = stepped(line_object, heartbeat(8), now_ns=50_000_000)

    lost = ObjectMemory(boot=1, state=FAILED)
    assert (line_object.memory, line_object.refused) == (lost, 3)
    assert (first.memory, second.memory) == (None, None)
    assert first.out == (ObjectStatus(0, 65_535, 1, 0, 1, 1, 0, 3, FAILED, 0, 0, False),)
    assert len(second.out) == 1


def passes(_: object) -> bool:
    return True


@pytest.mark.parametrize(
    ("guards", "message", "wanted", "occupied"),
    [
        (ObjectGuards(term_not_old=passes), heartbeat(6), False, False),
        (ObjectGuards(owner_of_term=passes), heartbeat(7, source=5), False, False),
        (ObjectGuards(newer_claim=passes), claim(OPEN, nonce=20), False, False),
        (ObjectGuards(no_train_in_it=passes), claim(OPEN), False, True),
        (ObjectGuards(free_to_lock=passes), claim(LOCK), True, False),
    ],
)
def test_each_guard_alone_prevents_one_fault(
    guards: ObjectGuards, message: T2tMessage, *, wanted: bool, occupied: bool
) -> None:
    memory = ObjectMemory(seen_term=7, owner=4, state=FREE, claim_term=7, nonce=20)
    guarded, unguarded = started(memory), started(memory, guards=guards)

    stepped(guarded, message, wanted=wanted, occupied=occupied)
    stepped(unguarded, message, wanted=wanted, occupied=occupied)

    assert (guarded.refused, unguarded.refused) == (1, 0)


@pytest.mark.parametrize(("state", "reported"), [(LOCKED, FAILED), (FREE, FREE), (FAILED, FAILED)])
def test_an_object_whose_switch_failed_says_so_while_it_is_locked(
    state: ObjectState, reported: ObjectState
) -> None:
    line_object = started(replace(MEMORY, state=state))
    sent = line_object.step(0, (), release_wanted=False, occupied=True, failed=True).out
    (status,) = [each for each in sent if isinstance(each, ObjectStatus)]

    assert status.state is reported
    # The lock itself is kept, and counts again once the switch is detected.
    healed = line_object.step(1, (), release_wanted=False, occupied=True).out
    assert [each.state for each in healed if isinstance(each, ObjectStatus)] == (
        [state] if reported is not state else []
    )
