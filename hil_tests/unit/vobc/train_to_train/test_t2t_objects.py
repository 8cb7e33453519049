"""Wayside objects (switches, crossings, platform tracks): which claims they obey, and how a
master uses them."""

from dataclasses import replace

import pytest

from firmware_py.trackdb.areas import ObjectKind, ObjectSite
from plant_emulator.wayside.line_object import LineObject
from plant_emulator.wayside.t2t_vocabulary import ObjectMemory
from vobc.train_to_train.authority import Bar, BarredTrack
from vobc.train_to_train.guards import MasterGuards, Reach, cannot_reach, without
from vobc.train_to_train.objects import Claim, TrackObjects
from zenoh_config.t2t import (
    BROADCAST,
    ClaimKind,
    Heartbeat,
    ObjectClaim,
    ObjectState,
    ObjectStatus,
    Phase,
)
from zenoh_config.timers import TIMERS_A

SITE = ObjectSite(3, ObjectKind.CROSSING, 500.0, 520.0)


class Crossing:
    def __init__(self, memory: ObjectMemory | None = None) -> None:
        self.memory = memory or ObjectMemory()
        self.object = LineObject(TIMERS_A, SITE, 1, memory=self.memory, start_ns=0)
        self.now_ns = 0

    def on_message(
        self, *messages: ObjectClaim | Heartbeat, wanted: bool = False, occupied: bool = False
    ) -> ObjectStatus | None:
        self.now_ns += 1
        stepped = self.object.step(self.now_ns, messages, release_wanted=wanted, occupied=occupied)
        self.memory = stepped.memory or self.memory
        (said,) = stepped.out or (None,)
        assert said is None or isinstance(said, ObjectStatus)
        return said

    @property
    def state(self) -> ObjectState:
        return self.object.memory.state


def claim(train: int, term: int, kind: ClaimKind, nonce: int) -> ObjectClaim:
    return ObjectClaim(train, 0, 1, term, 1, nonce, 0, SITE.number, kind, nonce)


LOCK, OPEN = ClaimKind.CLAIM, ClaimKind.RELEASE


def test_an_object_locks_for_a_claim_and_reports_which() -> None:
    crossing = Crossing()

    status = crossing.on_message(claim(1, 4, LOCK, 9))

    assert status is not None
    assert (status.state, status.claim_term, status.nonce) == (ObjectState.LOCKED, 4, 9)
    assert status.term == 4


@pytest.mark.parametrize(
    "late",
    [
        claim(1, 4, OPEN, 8),  # Sent before the claim, received after it.
        claim(1, 4, OPEN, 9),  # Repeated under the claim's own number.
        claim(1, 3, OPEN, 10),  # From an earlier term.
        claim(2, 4, OPEN, 10),  # From a sender that does not own the term.
    ],
)
def test_a_release_that_is_late_old_or_not_the_masters_opens_nothing(late: ObjectClaim) -> None:
    crossing = Crossing()
    crossing.on_message(claim(1, 4, LOCK, 9))

    crossing.on_message(late)

    assert crossing.state is ObjectState.LOCKED
    assert crossing.object.refused == 1


def test_a_heartbeat_alone_fences_an_object_off_from_the_former_master() -> None:
    crossing = Crossing()
    crossing.on_message(claim(1, 4, LOCK, 9))

    crossing.on_message(Heartbeat(2, BROADCAST, 1, 5, 1, 1, 0, Phase.FENCING, 0, 1))
    crossing.on_message(claim(1, 4, OPEN, 10))

    assert crossing.state is ObjectState.LOCKED


def test_an_object_never_moves_under_a_train() -> None:
    crossing = Crossing()
    crossing.on_message(claim(1, 4, LOCK, 9))

    crossing.on_message(claim(1, 4, OPEN, 10), occupied=True)
    assert crossing.state is ObjectState.LOCKED
    crossing.on_message(claim(1, 4, OPEN, 11))

    assert crossing.state is ObjectState.FREE


def test_an_object_with_a_pending_release_is_not_locked_again() -> None:
    crossing = Crossing()

    crossing.on_message(claim(1, 4, LOCK, 9), wanted=True)

    assert crossing.state is ObjectState.FREE


def test_an_object_remembers_its_state_over_a_restart_and_fails_safe_without_memory() -> None:
    crossing = Crossing()
    crossing.on_message(claim(1, 4, LOCK, 9))
    again = Crossing(crossing.memory)
    again.on_message(claim(2, 3, OPEN, 99))
    assert again.state is ObjectState.LOCKED

    lost = LineObject(TIMERS_A, SITE, 1, memory=None, start_ns=0)
    stepped = lost.step(1, (claim(1, 9, LOCK, 1),), release_wanted=False, occupied=False)
    assert lost.memory.state is ObjectState.FAILED
    assert stepped.memory is None, "the next start would take it for its own"


def status(state: ObjectState, term: int, nonce: int, *, wanted: bool = False) -> ObjectStatus:
    return ObjectStatus(0, BROADCAST, 1, term, 1, 1, 0, SITE.number, state, term, nonce, wanted)


def far(train_reserved_m: float = 400.0, *, rear_m: float = 0.0) -> Reach:
    return Reach(train_reserved_m, rear_m, SITE.start_m, SITE.end_m)


class TestMasterOfObjects:
    def objects(self) -> TrackObjects:
        return TrackObjects(5, (SITE,), MasterGuards())

    def fresh(self, *heard: ObjectStatus) -> TrackObjects:
        objects = self.objects()
        for each in heard:
            objects.on_message(each)
        return objects

    def plan(self, objects: TrackObjects, *reaches: Reach, needed: bool = True) -> list[ClaimKind]:
        said = objects.plan(needed=lambda _: needed, reaches=lambda _: list(reaches))
        return [each.kind for _, each in said]

    def test_an_object_that_never_reported_is_neither_passed_nor_claimed(self) -> None:
        objects = self.objects()

        assert self.plan(objects, far()) == []
        assert [each.bar for each in objects.stretches()] == [Bar.UNSURE]

    def test_a_lock_of_an_earlier_claim_does_not_confirm_this_one(self) -> None:
        objects = self.objects()
        objects.on_message(status(ObjectState.LOCKED, 4, 1))

        assert self.plan(objects, far()) == [LOCK]
        assert [each.bar for each in objects.stretches()] == [Bar.UNSURE]

    def test_a_confirmed_lock_permits_passing_until_a_release_is_requested(self) -> None:
        objects = self.objects()
        objects.on_message(status(ObjectState.LOCKED, 4, 1))
        self.plan(objects, far())
        objects.on_message(status(ObjectState.LOCKED, 5, 1))
        assert self.plan(objects, far()) == []
        assert objects.stretches() == []

        objects.on_message(status(ObjectState.LOCKED, 5, 1, wanted=True))
        assert [each.bar for each in objects.stretches()] == [Bar.CLOSING]

    def test_it_is_released_only_when_no_train_can_reach_it_and_is_barred_at_once(self) -> None:
        objects = self.objects()
        objects.on_message(status(ObjectState.LOCKED, 5, 1, wanted=True))
        self.plan(objects, far(600.0))
        assert self.plan(objects, far(600.0)) == []

        assert self.plan(objects, far(), far(900.0, rear_m=530.0)) == [OPEN]
        assert [each.bar for each in objects.stretches()] == [Bar.UNSURE]
        objects.on_message(status(ObjectState.FREE, 5, 2, wanted=True))
        assert [each.bar for each in objects.stretches()] == [Bar.SHUT]

    def test_after_a_release_the_lock_before_it_confirms_nothing(self) -> None:
        objects = self.objects()
        objects.on_message(status(ObjectState.LOCKED, 5, 1, wanted=True))
        self.plan(objects, far(600.0))
        self.plan(objects, far())
        objects.on_message(status(ObjectState.LOCKED, 5, 1))

        assert [each.bar for each in objects.stretches()] == [Bar.UNSURE]
        assert self.plan(objects, far()) == [LOCK]

    def bars(self, objects: TrackObjects) -> list[Bar]:
        return [each.bar for each in objects.stretches()]

    def test_claims_and_releases_are_numbered_from_1_and_repeated_until_confirmed(self) -> None:
        objects = self.fresh(status(ObjectState.FREE, 0, 0))
        said = []
        for wanted in (False, False, True, True, False, False):
            objects.on_message(status(ObjectState.LOCKED, 0, 0, wanted=wanted))
            said += objects.plan(needed=lambda _: True, reaches=lambda _: [far()])

        numbers = [(LOCK, 1), (LOCK, 1), (OPEN, 2), (OPEN, 2), (LOCK, 3), (LOCK, 3)]
        assert said == [(SITE, Claim(kind, nonce)) for kind, nonce in numbers]

    @pytest.mark.parametrize(
        ("term", "nonce", "said"), [(5, 1, []), (5, 2, [LOCK]), (4, 1, [LOCK]), (1, 5, [LOCK])]
    )
    def test_a_claim_is_confirmed_when_its_term_and_number_come_back(
        self, term: int, nonce: int, said: list[ClaimKind]
    ) -> None:
        objects = self.fresh(status(ObjectState.FREE, 4, 1))
        self.plan(objects)

        objects.on_message(status(ObjectState.LOCKED, term, nonce))

        assert self.plan(objects) == said

    def test_an_object_that_no_train_comes_near_is_not_claimed(self) -> None:
        objects = self.fresh(status(ObjectState.FREE, 0, 0))

        assert self.plan(objects, needed=False) == []
        assert self.plan(objects, needed=True) == [LOCK]

    def test_a_claim_is_kept_when_no_train_is_near_any_more(self) -> None:
        objects = self.fresh(status(ObjectState.FREE, 0, 0))
        self.plan(objects)

        assert self.plan(objects, needed=False) == [LOCK]

    def test_a_release_is_not_withdrawn_without_a_train(self) -> None:
        objects = self.fresh(status(ObjectState.LOCKED, 0, 0, wanted=True))
        assert self.plan(objects, far()) == [OPEN]
        objects.on_message(status(ObjectState.LOCKED, 0, 0))

        assert self.plan(objects, needed=False) == []
        assert self.plan(objects, needed=True) == [LOCK]

    def test_a_release_of_a_free_object_needs_no_message(self) -> None:
        objects = self.fresh(status(ObjectState.FREE, 0, 0, wanted=True))

        assert self.plan(objects, far()) == []

    def test_one_train_that_can_reach_an_object_delays_its_release(self) -> None:
        objects = self.fresh(status(ObjectState.LOCKED, 0, 0, wanted=True))

        assert self.plan(objects, far(), far(600.0), needed=False) == [LOCK]

    def test_without_any_train_it_is_released(self) -> None:
        objects = self.fresh(status(ObjectState.LOCKED, 0, 0, wanted=True))

        assert self.plan(objects) == [OPEN]

    def test_a_sent_release_stands_when_a_train_comes(self) -> None:
        """The object may have opened already, so the train stays barred from it."""
        objects = self.fresh(status(ObjectState.LOCKED, 0, 0, wanted=True))
        self.plan(objects, far())

        assert self.plan(objects, far(600.0)) == [OPEN]

    def test_a_failed_object_gets_no_message_and_no_train_passes(self) -> None:
        objects = self.fresh(status(ObjectState.FAILED, 0, 0))

        assert self.plan(objects, far()) == []
        assert self.bars(objects) == [Bar.SHUT]

    def test_a_free_object_is_barred_until_its_lock_is_confirmed(self) -> None:
        objects = self.fresh(status(ObjectState.FREE, 0, 0))
        self.plan(objects)

        assert objects.stretches() == [BarredTrack(500.0, 520.0, Bar.SHUT)]

    @pytest.mark.parametrize("nonce", [0, 1])
    def test_a_lock_that_was_never_requested_confirms_nothing_even_under_the_own_term(
        self, nonce: int
    ) -> None:
        assert self.bars(self.fresh(status(ObjectState.LOCKED, 5, nonce))) == [Bar.UNSURE]

    def test_a_lock_with_the_number_of_a_release_confirms_nothing(self) -> None:
        objects = self.fresh(status(ObjectState.LOCKED, 0, 0, wanted=True))
        self.plan(objects)

        objects.on_message(status(ObjectState.LOCKED, 5, 1))

        assert self.bars(objects) == [Bar.UNSURE]

    def test_objects_of_other_areas_are_ignored(self) -> None:
        objects = TrackObjects(5, (), MasterGuards())
        objects.on_message(status(ObjectState.LOCKED, 5, 1))

        assert objects.statuses == {}
        assert objects.stretches() == []

    def test_each_of_several_objects_is_claimed_by_its_own_number(self) -> None:
        other = ObjectSite(4, ObjectKind.SWITCH, 700.0, 710.0)
        objects = TrackObjects(5, (SITE, other), MasterGuards())
        silent = ObjectSite(9, ObjectKind.SWITCH, 800.0, 810.0)
        objects.on_message(status(ObjectState.FREE, 0, 0))
        objects.on_message(replace(status(ObjectState.FREE, 0, 0), number=other.number))
        objects.on_message(replace(status(ObjectState.FREE, 0, 0), number=silent.number))

        said = objects.plan(needed=lambda _: True, reaches=lambda _: [])

        assert said == [(SITE, Claim(LOCK, 1)), (other, Claim(LOCK, 2))]
        assert set(objects.statuses) == {3, 4}
        objects.on_message(replace(status(ObjectState.LOCKED, 5, 2), number=other.number))
        assert objects.stretches() == [BarredTrack(500.0, 520.0, Bar.SHUT)]

    def test_without_the_object_guard_even_an_unreported_object_bars_nothing(self) -> None:
        objects = TrackObjects(5, (SITE,), without(MasterGuards(), "object_confirmed"))
        assert objects.stretches() == []

        objects.on_message(status(ObjectState.FREE, 0, 0, wanted=True))
        assert self.bars(objects) == [Bar.CLOSING]


@pytest.mark.parametrize(
    ("reach", "answer"),
    [
        (far(500.0), True),
        (far(500.1), False),
        (far(900.0, rear_m=520.0), True),
        (far(900.0, rear_m=519.9), False),
    ],
)
def test_a_train_cannot_reach_an_object_behind_it_or_beyond_its_authority(
    reach: Reach, answer: bool
) -> None:
    assert cannot_reach(reach) is answer
