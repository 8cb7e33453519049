"""The arbiter: one holder for each area at a time, under terms that only grow, across restarts."""

from dataclasses import replace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hil_tests.unit.vobc.train_to_train.t2t_rig import Rig, line_of
from plant_emulator.wayside.arbiter import (
    Arbiter,
    ArbiterGuards,
    Plea,
    by_holder,
    lease_is_free,
    of_masters,
    term_is_new,
)
from plant_emulator.wayside.t2t_vocabulary import ArbiterMemory, LeaseMemory
from vobc.train_to_train.vocabulary import T2tConfig
from zenoh_config.codec import pack
from zenoh_config.messages import RefusedReason
from zenoh_config.t2t import (
    BROADCAST,
    FIRST_ARBITER,
    Heartbeat,
    LeaseAnswer,
    LeaseKind,
    LeaseRequest,
    Phase,
    RosterAck,
    RosterCommit,
    RosterEntry,
    T2tMessage,
)
from zenoh_config.term_grants import GrantCheck, TermGrant, signer_from_seed
from zenoh_config.timers import TIMERS_A, TIMERS_B, LineTimers

MS = 1_000_000
ADDRESS = 65_001
LEASE_MS = TIMERS_A.lease_ms
ROSTER = (RosterEntry(7, 100.0, True), RosterEntry(4, 10.0, False))


class ArbiterRig:
    """An arbiter that has been up long enough, and the sequence numbers of its clients."""

    def __init__(self, memory: ArbiterMemory | None = None, *, waited: bool = True) -> None:
        self.now_ms = 0
        self.memory: ArbiterMemory | None = memory or ArbiterMemory()
        self.arbiter = Arbiter(TIMERS_A, address=ADDRESS, memory=self.memory, start_ns=0)
        self.sequence = 0
        if waited:
            self.now_ms = LEASE_MS + 1

    def says(self, message: T2tMessage) -> tuple[T2tMessage, ...]:
        stepped = self.arbiter.step(self.now_ms * MS, (message,))
        self.memory = stepped.memory or self.memory
        return stepped.out

    def request(
        self,
        train: int,
        term: int,
        kind: LeaseKind = LeaseKind.ACQUIRE,
        *,
        successor: int = 0,
        less_ms: int = 0,
    ) -> LeaseRequest:
        self.sequence += 1
        head = (train, ADDRESS, 1, term, 1, self.sequence, self.now_ms * MS)
        return LeaseRequest(*head, kind, self.sequence, successor, less_ms * MS)

    def ask(
        self,
        train: int,
        term: int,
        kind: LeaseKind = LeaseKind.ACQUIRE,
        *,
        successor: int = 0,
        less_ms: int = 0,
    ) -> LeaseAnswer:
        request = self.request(train, term, kind, successor=successor, less_ms=less_ms)
        (answer,) = self.says(request)
        assert isinstance(answer, LeaseAnswer)
        return answer

    def commit(self, train: int, term: int, version: int) -> bool:
        self.sequence += 1
        head = (train, ADDRESS, 1, term, 1, self.sequence, 0)
        out = self.says(RosterCommit(*head, version, ROSTER))
        return any(isinstance(each, RosterAck) for each in out)


def test_the_first_request_gets_the_lease_and_the_second_is_informed_how_long_to_wait() -> None:
    desk = ArbiterRig()

    assert desk.ask(1, 1).granted
    desk.now_ms += 100
    refused = desk.ask(2, 2)

    assert not refused.granted
    assert refused.term == 1
    assert refused.holder == 1
    assert refused.wait_ns == TIMERS_A.arbiter_lease_ns - 100 * MS


def test_an_expired_lease_goes_to_a_higher_term_and_not_a_tick_earlier() -> None:
    desk = ArbiterRig()
    desk.ask(1, 1)
    granted_ms = desk.now_ms
    desk.now_ms = granted_ms + LEASE_MS
    assert not desk.ask(2, 2).granted  # Clocks differ, so the arbiter waits a little longer.

    desk.now_ms += 1

    assert not desk.ask(2, 1).granted  # An acknowledged term is never granted again.
    assert desk.ask(2, 2).granted


def test_a_holder_may_renew_without_limit() -> None:
    desk = ArbiterRig()
    desk.ask(1, 1)
    for _ in range(20):
        desk.now_ms += TIMERS_A.renew_ms
        assert desk.ask(1, 1, LeaseKind.RENEW).granted
        assert not desk.ask(2, 2).granted


@pytest.mark.parametrize("less_ms", [0, 1, 120])
def test_the_arbiter_waits_exactly_as_long_as_a_shortened_grant(less_ms: int) -> None:
    desk = ArbiterRig()
    desk.ask(1, 1)
    desk.now_ms += LEASE_MS
    desk.ask(1, 1, LeaseKind.RENEW, less_ms=less_ms)

    # This is the end of a whole lease of 300.6 ms.
    desk.now_ms += 300 - less_ms
    assert not desk.ask(2, 2).granted
    desk.now_ms += 1
    assert desk.ask(2, 2).granted


@pytest.mark.parametrize("less_ms", [150, 300, 100_000])
def test_no_renewal_shortens_an_earlier_grant(less_ms: int) -> None:
    desk = ArbiterRig()
    desk.ask(1, 1)
    desk.now_ms += 100
    assert desk.ask(1, 1, LeaseKind.RENEW, less_ms=less_ms).granted

    desk.now_ms += LEASE_MS - 100
    assert not desk.ask(2, 2).granted
    desk.now_ms += 1
    assert desk.ask(2, 2).granted


def test_only_the_holder_renews_and_only_under_the_present_term() -> None:
    desk = ArbiterRig()
    desk.ask(1, 5)

    assert not desk.ask(2, 5, LeaseKind.RENEW).granted
    assert not desk.ask(1, 4, LeaseKind.RENEW).granted


def test_a_named_successor_need_not_wait_and_ends_the_old_lease() -> None:
    desk = ArbiterRig()
    desk.ask(1, 1)
    assert not desk.ask(2, 2).granted
    desk.ask(1, 1, LeaseKind.RENEW, successor=2)

    assert desk.ask(2, 2).granted
    assert not desk.ask(1, 1, LeaseKind.RENEW).granted


def test_a_withdrawn_successor_has_no_right() -> None:
    desk = ArbiterRig()
    desk.ask(1, 1)
    desk.ask(1, 1, LeaseKind.RENEW, successor=2)
    desk.ask(1, 1, LeaseKind.RENEW)

    assert not desk.ask(2, 2).granted


def test_a_successor_that_gives_up_does_not_free_the_former_masters_lease() -> None:
    desk = ArbiterRig()
    desk.ask(1, 1)
    desk.ask(1, 1, LeaseKind.RENEW, successor=2)
    desk.ask(2, 2)
    desk.ask(2, 2, LeaseKind.RELEASE)

    assert not desk.ask(3, 3).granted
    desk.now_ms += LEASE_MS + 1
    assert desk.ask(3, 3).granted


def test_a_returned_lease_is_free_at_once() -> None:
    desk = ArbiterRig()
    desk.ask(1, 1)
    desk.ask(1, 1, LeaseKind.RELEASE)

    assert desk.ask(2, 2).granted


def test_a_restarted_arbiter_waits_a_whole_lease_and_remembers_terms_and_roster() -> None:
    desk = ArbiterRig()
    desk.ask(1, 7)
    assert desk.commit(1, 7, 3)

    again = ArbiterRig(desk.memory, waited=False)

    assert not again.ask(2, 8).granted
    assert again.ask(1, 7, LeaseKind.RENEW).granted
    again.now_ms += 2 * LEASE_MS
    assert not again.ask(2, 7).granted
    answer = again.ask(2, 8)
    assert (answer.roster_term, answer.roster_version, answer.roster) == (7, 3, ROSTER)


def test_an_arbiter_with_unreadable_memory_sends_and_stores_nothing() -> None:
    """Otherwise its next start would trust an empty memory and grant a term twice."""
    arbiter = Arbiter(TIMERS_A, address=ADDRESS, memory=None, start_ns=0)
    request = ArbiterRig().request(1, 1)

    for _ in range(2):
        stepped = arbiter.step(10_000 * MS, (request,))
        assert (stepped.out, stepped.memory) == ((), None)


@pytest.mark.parametrize(("train", "term", "version"), [(2, 7, 4), (1, 6, 4), (1, 7, 2)])
def test_a_foreign_outdated_or_older_roster_is_not_stored(
    train: int, term: int, version: int
) -> None:
    desk = ArbiterRig()
    desk.ask(1, 7)
    desk.commit(1, 7, 3)

    assert not desk.commit(train, term, version)
    assert desk.arbiter.lease(1).roster_version == 3


def test_a_repeated_request_changes_nothing() -> None:
    desk = ArbiterRig()
    request = desk.request(1, 1)
    desk.says(request)
    before = desk.arbiter.memory

    assert desk.says(request) == ()
    assert desk.arbiter.memory == before


STEPS = st.lists(
    st.tuples(
        st.integers(1, 3), st.integers(1, 8), st.sampled_from(list(LeaseKind)), st.integers(0, 200)
    ),
    max_size=40,
)


@settings(max_examples=60, deadline=None)
@given(STEPS)
def test_whatever_is_asked_a_term_has_one_holder_and_leases_do_not_overlap(
    steps: list[tuple[int, int, LeaseKind, int]],
) -> None:
    """The oracle keeps beside the arbiter which train may rely on which lease, by the train's
    own clock."""
    desk = ArbiterRig()
    owners: dict[int, int] = {}
    valid: dict[int, tuple[int, int]] = {}
    """By train: its term, and the end of its lease by its own clock."""

    for train, term, kind, pause_ms in steps:
        desk.now_ms += pause_ms
        answer = desk.ask(train, term, kind)
        if kind is LeaseKind.RELEASE:
            if valid.get(train, (0, 0))[0] == term:
                del valid[train]
            continue
        if not answer.granted:
            continue
        assert owners.setdefault(term, train) == train
        others = [until for other, (_, until) in valid.items() if other != train]
        assert all(until <= desk.now_ms * MS for until in others)
        valid[train] = (term, desk.now_ms * MS + TIMERS_A.holder_lease_ns)


def plea(source: int, term: int, *, expired: bool = False) -> Plea:
    """A request while train 4 holds a lease under term 7, which train 6 may take over."""
    return Plea(source, term, LeaseMemory(1, promised=7, holder=4, successor=6), expired)


@pytest.mark.parametrize(("term", "new"), [(6, False), (7, False), (8, True)])
def test_a_term_is_new_only_above_the_acknowledged_one(term: int, *, new: bool) -> None:
    assert term_is_new(plea(4, term)) is new


@pytest.mark.parametrize(
    ("source", "expired", "free"),
    [(4, False, True), (6, False, True), (5, False, False), (5, True, True), (4, True, True)],
)
def test_a_running_lease_is_available_to_its_holder_and_successor_only(
    source: int, *, expired: bool, free: bool
) -> None:
    assert lease_is_free(plea(source, 8, expired=expired)) is free


@pytest.mark.parametrize(
    ("source", "term", "holds"),
    [(4, 7, True), (4, 6, False), (4, 8, False), (6, 7, False), (6, 6, False)],
)
def test_the_holder_is_one_train_under_one_term(source: int, term: int, *, holds: bool) -> None:
    assert by_holder(plea(source, term)) is holds


def raw_request(
    source: int,
    *,
    sequence: int = 1,
    area: int = 1,
    term: int = 1,
    kind: LeaseKind = LeaseKind.ACQUIRE,
) -> LeaseRequest:
    return LeaseRequest(source, ADDRESS, area, term, 1, sequence, 777, kind, 55, 0)


def raw_commit(*, term: int, version: int, sequence: int = 1) -> RosterCommit:
    return RosterCommit(4, ADDRESS, 1, term, 1, sequence, 0, version, ROSTER)


def up_since_long(memory: ArbiterMemory, guards: ArbiterGuards | None = None) -> Arbiter:
    return Arbiter(TIMERS_A, address=ADDRESS, memory=memory, start_ns=-(10**9), guards=guards)


def kept(term: int, version: int) -> LeaseMemory:
    """The memory of area 1, which train 4 commands under term 7."""
    return LeaseMemory(1, 7, 4, 6, term, version, ROSTER)


def test_a_grant_names_its_request_and_holds_the_stored_roster() -> None:
    arbiter = up_since_long(ArbiterMemory(boot=2, areas=(kept(7, 3),)))

    granted = arbiter.step(1000, (raw_request(6, term=8),))

    head = (ADDRESS, 6, 1, 8, 3, 1, 1000)
    assert granted.out == (LeaseAnswer(*head, True, 55, 777, 6, 0, 7, 3, ROSTER),)
    assert granted.memory == ArbiterMemory(3, (LeaseMemory(1, 8, 6, 0, 7, 3, ROSTER),))


def test_a_refusal_holds_acknowledged_term_holder_and_wait_but_no_roster() -> None:
    arbiter = up_since_long(ArbiterMemory(boot=2, areas=(kept(7, 3),)))
    arbiter.step(0, (raw_request(4, term=7, kind=LeaseKind.RENEW),))

    refused = arbiter.step(1000, (raw_request(5, term=9),))

    head = (ADDRESS, 5, 1, 7, 3, 2, 1000)
    assert refused.out == (LeaseAnswer(*head, False, 55, 777, 4, 300_599_000, 0, 0, ()),)


def test_a_renewal_is_granted_without_the_roster() -> None:
    arbiter = up_since_long(ArbiterMemory(areas=(kept(7, 3),)))

    stepped = arbiter.step(1000, (raw_request(4, term=7, kind=LeaseKind.RENEW),))

    head = (ADDRESS, 4, 1, 7, 1, 1, 1000)
    assert stepped.out == (LeaseAnswer(*head, True, 55, 777, 4, 0, 0, 0, ()),)


def test_an_old_term_is_refused_without_a_wait_after_the_lease_expired() -> None:
    arbiter = up_since_long(ArbiterMemory(areas=(kept(7, 3),)))

    (answer,) = arbiter.step(1000, (raw_request(5, term=7),)).out

    assert isinstance(answer, LeaseAnswer)
    assert answer.granted is False
    assert answer.wait_ns == 0


@pytest.mark.parametrize(
    "asked",
    [
        raw_request(5, term=7),
        raw_request(5, term=7, kind=LeaseKind.RENEW),
        raw_request(4, term=7, kind=LeaseKind.RELEASE),
    ],
)
def test_every_other_request_is_refused(asked: LeaseRequest) -> None:
    (answer,) = up_since_long(ArbiterMemory(areas=(kept(7, 3),))).step(1000, (asked,)).out

    assert isinstance(answer, LeaseAnswer)
    assert answer.granted is False


def test_a_lease_ends_at_one_instant() -> None:
    arbiter = up_since_long(ArbiterMemory())
    arbiter.step(0, (raw_request(4),))

    assert arbiter.expiry_ns(1) == 300_600_000
    answers = [
        arbiter.step(now_ns, (raw_request(5, term=2, sequence=n),)).out[0]
        for n, now_ns in enumerate((300_599_999, 300_600_000), start=1)
    ]
    assert [isinstance(a, LeaseAnswer) and a.granted for a in answers] == [False, True]


def test_a_restarted_arbiter_counts_its_wait_from_its_own_start() -> None:
    arbiter = Arbiter(TIMERS_A, address=ADDRESS, memory=ArbiterMemory(), start_ns=1_000)

    assert arbiter.expiry_ns(1) == 300_601_000


def test_without_the_guard_of_the_start_an_arbiter_grants_at_once() -> None:
    arbiter = Arbiter(
        TIMERS_A,
        address=ADDRESS,
        memory=ArbiterMemory(),
        start_ns=1_000,
        guards=ArbiterGuards(waits_after_start=False),
    )

    assert arbiter.expiry_ns(1) == 1_000


@pytest.mark.parametrize(
    ("source", "heard"), [(0, False), (1, True), (64_999, True), (65_000, False), (65_535, False)]
)
def test_only_trains_are_answered(source: int, *, heard: bool) -> None:
    stepped = up_since_long(ArbiterMemory()).step(1000, (raw_request(source),))

    assert (len(stepped.out) == 1) is heard


def test_messages_for_other_receivers_are_not_answered() -> None:
    heartbeat = Heartbeat(4, BROADCAST, 1, 7, 1, 1, 0, Phase.ISSUING, 0, 1)
    arbiter = up_since_long(ArbiterMemory(areas=(kept(7, 3),)))

    assert arbiter.step(1000, (heartbeat,)).out == ()


def test_requests_of_one_step_are_answered_in_order() -> None:
    repeated = raw_request(4, sequence=1)
    other = raw_request(5, term=2)
    arbiter = up_since_long(ArbiterMemory())

    answers = arbiter.step(1000, (repeated, repeated, other)).out

    assert [(each.destination, each.sequence) for each in answers] == [(4, 1), (5, 2)]
    assert arbiter.gate.refusals == {RefusedReason.NOT_NEWER: 1}


def test_an_arbiter_ignores_messages_for_another_one() -> None:
    arbiter = Arbiter(TIMERS_A, address=65_002, memory=ArbiterMemory(), start_ns=-(10**9))

    assert arbiter.step(1000, (raw_request(4),)).out == ()
    assert arbiter.gate.refusals == {RefusedReason.WRONG_DESTINATION: 1}


def test_areas_are_granted_independently_and_stored_in_order() -> None:
    arbiter = up_since_long(ArbiterMemory())

    arbiter.step(0, (raw_request(4, area=2, term=5),))
    stepped = arbiter.step(1000, (raw_request(5, area=1, term=3),))

    first, second = LeaseMemory(1, 3, 5), LeaseMemory(2, 5, 4)
    assert stepped.memory == ArbiterMemory(1, (first, second))
    assert (arbiter.lease(1), arbiter.lease(2), arbiter.lease(3)) == (
        first,
        second,
        LeaseMemory(3, 0, 0, 0, 0, 0, ()),
    )
    assert (arbiter.expiry_ns(1), arbiter.expiry_ns(2)) == (300_601_000, 300_600_000)


def test_it_stores_its_incarnation_first_and_then_only_what_changed() -> None:
    arbiter = up_since_long(ArbiterMemory(boot=4))

    assert arbiter.step(0, ()).memory == ArbiterMemory(boot=5)
    assert arbiter.step(1, ()).memory is None
    assert arbiter.step(2, (raw_request(4),)).memory == ArbiterMemory(5, (LeaseMemory(1, 1, 4),))
    renewal = raw_request(4, sequence=2, kind=LeaseKind.RENEW)
    assert arbiter.step(3, (renewal,)).memory is None


def test_a_new_request_of_the_holder_clears_its_successor() -> None:
    arbiter = up_since_long(ArbiterMemory(areas=(kept(7, 3),)))

    arbiter.step(0, (raw_request(4, term=8),))

    assert arbiter.lease(1).successor == 0


def test_an_arbiter_without_memory_acknowledges_no_term() -> None:
    arbiter = Arbiter(TIMERS_A, address=ADDRESS, memory=None, start_ns=-(10**9))

    arbiter.step(1000, (raw_request(4),))

    assert arbiter.memory == ArbiterMemory(boot=1)
    assert arbiter.gate.refusals == {}


def test_a_roster_is_stored_and_acknowledged_with_term_and_version() -> None:
    arbiter = up_since_long(ArbiterMemory(areas=(LeaseMemory(1, 7, 4, 6),)))

    stepped = arbiter.step(1000, (raw_commit(term=7, version=2),))

    assert stepped.out == (RosterAck(ADDRESS, 4, 1, 7, 1, 1, 1000, 2),)
    assert stepped.memory == ArbiterMemory(1, (kept(7, 2),))


@pytest.mark.parametrize(
    ("term", "version", "taken"),
    [(7, 2, True), (7, 3, True), (7, 4, False), (6, 9, True), (8, 1, False)],
)
def test_a_roster_never_replaces_a_newer_one(term: int, version: int, *, taken: bool) -> None:
    before = kept(term, version)
    arbiter = up_since_long(ArbiterMemory(areas=(before,)))

    stepped = arbiter.step(1000, (raw_commit(term=7, version=3),))

    assert (len(stepped.out) == 1) is taken
    assert arbiter.lease(1) == (kept(7, 3) if taken else before)


def test_a_roster_is_stored_even_long_after_the_lease_expired() -> None:
    """The guard ignores an expired lease, because no other train has commanded since."""
    guards = ArbiterGuards(by_holder=lambda plea: not plea.expired)
    arbiter = up_since_long(ArbiterMemory(areas=(kept(7, 2),)), guards)

    stepped = arbiter.step(10**12, (raw_commit(term=7, version=3),))

    assert len(stepped.out) == 1


@pytest.mark.parametrize(("after_ms", "granted"), [(1, False), (300, False), (301, True)])
def test_after_a_restart_a_displaced_lease_is_waited_out_when_its_successor_gives_up(
    after_ms: int, *, granted: bool
) -> None:
    """The arbiter waits a whole lease of 300.6 ms from the start, because train 1 may still rely
    on its lease."""
    desk = ArbiterRig()
    desk.ask(1, 1)
    desk.ask(1, 1, LeaseKind.RENEW, successor=2)
    desk.ask(2, 2)
    again = ArbiterRig(desk.memory, waited=False)
    again.sequence = desk.sequence
    again.ask(2, 2, LeaseKind.RELEASE)

    again.now_ms += after_ms
    assert again.ask(3, 3).granted is granted


@pytest.mark.parametrize("arbiters", [0, 1, 2, 3, 4, 5])
@pytest.mark.parametrize("lease_ms", [LEASE_MS - 1, LEASE_MS, LEASE_MS + 1, TIMERS_B.lease_ms])
@pytest.mark.parametrize("kind", LeaseKind)
def test_a_request_with_other_arbiters_or_lease_times_is_ignored(
    arbiters: int, lease_ms: int, kind: LeaseKind
) -> None:
    """A train that asks one of three arbiters would have its own majority beside that of the
    others."""
    arbiter = Arbiter(
        TIMERS_A, address=ADDRESS, memory=ArbiterMemory(), start_ns=-(10**9), arbiters=3
    )
    holder = LeaseRequest(7, ADDRESS, 1, 5, 1, 1, 0, LeaseKind.ACQUIRE, 1, 0, 0, 3, LEASE_MS)
    (answer,) = arbiter.step(0, (holder,)).out
    assert isinstance(answer, LeaseAnswer)
    assert answer.granted
    before, expiry_ns = arbiter.memory, arbiter.expiry_ns(1)

    term = 6 if kind is LeaseKind.ACQUIRE else 5
    head = (7, ADDRESS, 1, term, 1, 2, MS)
    stepped = arbiter.step(MS, (LeaseRequest(*head, kind, 2, 0, 0, arbiters, lease_ms),))

    agrees = (arbiters, lease_ms) == (3, LEASE_MS)
    assert len(stepped.out) == agrees
    assert arbiter.gate.refusals[RefusedReason.OTHER_RULES] == (not agrees)
    if not agrees:
        assert (arbiter.memory, arbiter.expiry_ns(1)) == (before, expiry_ns)
        assert stepped.memory is None


@pytest.mark.parametrize("arbiters", [1, 3])
@pytest.mark.parametrize("timers", [TIMERS_A, TIMERS_B])
def test_a_request_names_the_expected_arbiters_and_lease_time(
    arbiters: int, timers: LineTimers
) -> None:
    addresses = tuple(range(FIRST_ARBITER, FIRST_ARBITER + arbiters))
    rig = Rig(line_of(0.0, 2000.0), config=T2tConfig(timers=timers, arbiters=addresses))
    rig.start_train(1, 500.0)
    rig.run_until(rig.is_commanded)
    rig.run(200)

    asked = [said for _, said in rig.log if isinstance(said, LeaseRequest)]
    assert {each.kind for each in asked} == {LeaseKind.ACQUIRE, LeaseKind.RENEW}
    assert {(each.arbiters, each.lease_ms) for each in asked} == {(arbiters, timers.lease_ms)}


# Slow networks and hostile trains.


def test_a_repeated_request_extends_the_lease_and_reports_the_roster_again() -> None:
    """The answer to the first one may be lost or late."""
    desk = ArbiterRig()
    desk.ask(1, 1)
    assert desk.commit(1, 1, 1)
    desk.now_ms += 75

    again = desk.ask(1, 1)

    assert again.granted
    assert again.roster == ROSTER
    assert desk.arbiter.expiry_ns(1) == desk.now_ms * MS + TIMERS_A.arbiter_lease_ns
    assert not desk.ask(2, 1).granted


def test_a_repeated_request_after_a_release_is_that_of_the_same_holder() -> None:
    desk = ArbiterRig()
    desk.ask(1, 1)
    desk.ask(1, 1, LeaseKind.RELEASE)

    assert desk.ask(2, 2).granted
    assert not desk.ask(1, 1).granted


@pytest.mark.parametrize(
    ("step", "granted"), [(1, True), (20_000, True), (20_001, False), (2**48 - 6, False)]
)
def test_a_term_far_above_the_acknowledged_one_is_refused(step: int, *, granted: bool) -> None:
    desk = ArbiterRig()
    desk.ask(1, 5)
    desk.now_ms += LEASE_MS + 1

    answer = desk.ask(2, 5 + step)

    assert answer.granted is granted
    assert answer.term == (5 + step if granted else 5)


@pytest.mark.parametrize(
    ("train", "term", "passes"), [(1, 1, True), (2, 1, False), (1, 2, False), (1, 0, False)]
)
def test_objects_and_track_receive_only_the_train_to_which_an_arbiter_granted_the_term(
    train: int, term: int, *, passes: bool
) -> None:
    desk = ArbiterRig()
    desk.ask(1, 1)
    beat = Heartbeat(train, 65_535, 1, term, 1, 1, 0, Phase.ISSUING, 0, 1)
    request = desk.request(3, 9)

    heard = of_masters([ArbiterRig().arbiter, desk.arbiter], [beat, request], majority=1)

    assert heard == ([beat, request] if passes else [request])
    assert of_masters([], [beat], majority=1) == []


def test_a_candidate_that_one_arbiter_of_three_granted_the_term_commands_nothing() -> None:
    """The other two granted the same term to train 2."""
    desks = [ArbiterRig(), ArbiterRig(), ArbiterRig()]
    for desk, train in zip(desks, (3, 2, 2), strict=True):
        assert desk.ask(train, 4).granted
    beats = [Heartbeat(train, BROADCAST, 1, 4, 1, 1, 0, Phase.ISSUING, 0, 1) for train in (3, 2)]

    assert of_masters([each.arbiter for each in desks], beats, majority=2) == beats[1:]


@pytest.mark.parametrize("stamp_ns", [0, 7 * MS, 2**63 - 1])
def test_a_grant_is_signed_with_the_end_that_its_holder_may_rely_on(stamp_ns: int) -> None:
    signer, public = signer_from_seed(bytes(32))
    desk, check = ArbiterRig(), GrantCheck({ADDRESS: public})
    arbiter = Arbiter(
        TIMERS_A, address=ADDRESS, memory=ArbiterMemory(), start_ns=-(10**9), signer=signer
    )
    request = replace(desk.request(7, 3, less_ms=50), stamp_ns=stamp_ns)

    (answer,) = arbiter.step(0, (request,)).out
    (refusal,) = arbiter.step(1, (desk.request(8, 4),)).out

    assert isinstance(answer, LeaseAnswer)
    assert isinstance(refusal, LeaseAnswer)
    (grant,) = answer.grants
    end_ns = min(stamp_ns + TIMERS_A.holder_lease_ns - 50 * MS, 2**63 - 1)
    assert grant.end_ns == end_ns
    assert check.holds(TermGrant(1, 3, 7, ADDRESS, end_ns), grant.signature)
    assert refusal.grants == ()
    assert pack(answer)
