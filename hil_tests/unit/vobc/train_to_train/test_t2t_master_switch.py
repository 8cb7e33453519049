"""A master's sieving, restarted trains, objects, standby and succession, step by step."""

from typing import Any

import pytest

from firmware_py.trackdb.areas import ObjectKind, ObjectSite
from hil_tests.unit.vobc.train_to_train.t2t_chair import (
    MS,
    OWN,
    TERM,
    Chair,
    authorities,
    entry,
    of,
)
from vobc.train_to_train.planned_switch import SwitchState
from zenoh_config.t2t import (
    BROADCAST,
    Admission,
    AreaAuthority,
    ClaimKind,
    Heartbeat,
    ObjectClaim,
    ObjectState,
    ObjectStatus,
    OrderKind,
    RosterCommit,
    StandbySync,
    SwitchKind,
    SwitchStep,
    SyncEntry,
)

CROSSING = ObjectSite(3, ObjectKind.CROSSING, 1500.0, 1520.0)


class TestSieve:
    def test_a_train_alone_among_its_axles_is_sieved_and_this_is_committed(self) -> None:
        chair = Chair((entry(1, 900.0, sieved=False),), sections=True)
        chair.track(axles={2: 16})
        chair.reports(1, 900.0)
        said = chair.step(0)
        assert next(each.roster for each in of(RosterCommit, said)) == (entry(1, 900.0),)
        assert list(authorities(said)) == [1]

    @pytest.mark.parametrize("told", [{"standstill": False}, {"axles": 12}])
    def test_a_moving_train_or_one_with_another_axle_count_is_not_sieved(
        self, told: dict[str, Any]
    ) -> None:
        chair = Chair((entry(1, 900.0, sieved=False),), sections=True)
        chair.track(axles={2: 16})
        chair.reports(1, 900.0, **told)
        assert of(RosterCommit, chair.step(0)) == []

    def test_registered_restarted_and_departed_trains_account_for_their_axles(
        self,
    ) -> None:
        """Train 1 stands between them all, and in each step another train accounts for 16 axles."""
        for other in ("roster", "newborn"):
            roster = (entry(2, 990.0), entry(1, 900.0, sieved=False))
            chair = Chair(roster, sections=True)
            chair.track(axles={2: 32})
            chair.reports(1, 900.0)
            if other == "roster":
                chair.reports(2, 990.0)
            else:
                chair.reports(2, 990.0, boot=2)
            chair.step(0)
            assert [each.sieved for each in chair.master.roster.proposed] == [True, True]

        chair = Chair((entry(1, 1990.0, sieved=False),), sections=True)
        chair.track(axles={4: 16, 5: 16})
        chair.reports(1, 1990.0)
        chair.reports(9, 2100.0)
        chair.step(0)
        assert [each.sieved for each in chair.master.roster.proposed] == [True]

    def test_an_applicant_in_the_area_accounts_for_no_axles(self) -> None:
        chair = Chair((entry(1, 900.0, sieved=False),), sections=True)
        chair.track(axles={2: 32})
        chair.reports(1, 900.0, latent_m=1900.0)
        chair.reports(3, 990.0)
        chair.step(0)
        assert [each.sieved for each in chair.master.roster.proposed] == [False]

    def test_without_axle_counters_every_train_is_sieved(self) -> None:
        chair = Chair((entry(1, 900.0, sieved=False),))
        chair.reports(1, 900.0)
        chair.step(0)
        assert [each.sieved for each in chair.master.roster.proposed] == [True]

    def test_a_silent_train_is_not_sieved(self) -> None:
        chair = Chair((entry(1, 900.0, sieved=False),))
        chair.step(0)
        assert [each.sieved for each in chair.master.roster.proposed] == [False]

    def test_an_order_to_stop_is_committed_on_the_roster(self) -> None:
        chair = Chair()
        chair.orders(OrderKind.STOP, 2)
        chair.step(0)
        assert [each.stopped for each in chair.master.roster.proposed] == [False, True]
        chair.keeps()
        chair.orders(OrderKind.GO, 2)
        chair.step()
        assert [each.stopped for each in chair.master.roster.proposed] == [False, False]


class TestNewborns:
    def test_a_train_restarted_in_place_keeps_its_place_under_its_new_incarnation(self) -> None:
        chair = Chair()
        chair.reports(1, 900.0)
        chair.reports(2, 500.0)
        chair.step(0)
        chair.reports(2, 500.0, boot=2)
        said = chair.step()
        assert [each.boot for each in chair.master.roster.proposed] == [1, 2]
        assert 2 not in authorities(said)
        chair.keeps()
        chair.reports(2, 500.0, boot=2)
        assert authorities(chair.step())[2].to_boot == 2

    def test_a_report_of_the_former_incarnation_refutes_a_restart(self) -> None:
        chair = Chair()
        chair.reports(2, 500.0, boot=2)
        chair.reports(2, 500.0)
        assert chair.master._newborns.told() == []

    def test_a_restarted_train_that_came_back_elsewhere_applies_like_an_unregistered_one(
        self,
    ) -> None:
        chair = Chair(sections=True)
        chair.track(axles={1: 16})
        chair.reports(2, 300.0)
        chair.reports(1, 100.0, boot=2)
        said = chair.step(0)
        assert chair.order() == [2, 1]
        assert [each.destination for each in of(Admission, said)] == [1]


class TestObjects:
    def chair(self) -> Chair:
        return Chair((entry(1, 900.0),), objects=(CROSSING,))

    def says(
        self, chair: Chair, state: ObjectState, term: int, nonce: int, *, wanted: bool = False
    ) -> None:
        head = (0, BROADCAST, 1, term, 1, 1, 0)
        chair.on_message(ObjectStatus(*head, CROSSING.number, state, term, nonce, wanted))

    def test_an_object_is_claimed_for_an_approaching_train_and_passed_once_confirmed(
        self,
    ) -> None:
        chair = self.chair()
        self.says(chair, ObjectState.FREE, 0, 0)
        chair.reports(1, 900.0)
        said = chair.step(0)
        assert of(ObjectClaim, said) == [
            ObjectClaim(OWN, 0, 1, TERM, 9, 1, 0, CROSSING.number, ClaimKind.CLAIM, 1)
        ]
        assert authorities(said)[1].end_m == 1500.0
        self.says(chair, ObjectState.LOCKED, TERM, 1)
        chair.reports(1, 900.0)
        said = chair.step()
        assert of(ObjectClaim, said) == []
        assert authorities(said)[1].end_m == 2000.0

    @pytest.mark.parametrize(("granted_m", "released"), [(1500.0, True), (1500.1, False)])
    def test_an_object_is_released_when_no_train_can_reach_it(
        self, granted_m: float, *, released: bool
    ) -> None:
        chair = self.chair()
        self.says(chair, ObjectState.LOCKED, TERM - 1, 9, wanted=True)
        chair.reports(1, 900.0, latent_m=granted_m)
        kinds = [each.kind for each in of(ObjectClaim, chair.step(0))]
        assert (ClaimKind.RELEASE in kinds) is released


class TestSuccession:
    def test_the_rearmost_fit_train_is_standby_and_gets_all_records(self) -> None:
        chair = Chair()
        chair.reports(1, 900.0)
        chair.reports(2, 500.0)
        said = chair.step(0)
        assert said[0] == StandbySync(
            *(OWN, 2, 1, TERM, 9, 3, 0),
            1,
            (SyncEntry(1, 820.0, 2000.0, 1), SyncEntry(2, 420.0, 813.0, 1)),
        )
        assert [type(each) for each in said[1:3]] == [AreaAuthority, AreaAuthority]
        assert [each.standby for each in of(Heartbeat, said)] == [2]

    @pytest.mark.parametrize("told", [{"out_of_service": True}, {"term": TERM - 1}, {"boot": 2}])
    def test_an_unfit_train_does_not_become_standby(self, told: dict[str, Any]) -> None:
        chair = Chair()
        chair.reports(1, 900.0)
        chair.reports(2, 500.0, **told)
        chair.step(0)
        assert chair.master.succession.standby == 1
        assert chair.master.is_fit(2, chair.now_ns) is False
        assert chair.master.is_fit(1, chair.now_ns)

    def test_a_train_out_of_service_by_command_is_not_fit_until_the_command_ends(self) -> None:
        chair = Chair()
        chair.reports(1, 900.0)
        chair.orders(OrderKind.OUT_OF_SERVICE, 1)
        assert not chair.master.is_fit(1, 0)
        chair.orders(OrderKind.IN_SERVICE, 1)
        chair.orders(OrderKind.IN_SERVICE, 1)
        assert chair.master.is_fit(1, 0)

    def test_a_master_is_never_its_own_standby(self) -> None:
        chair = Chair((entry(OWN, 900.0),))
        chair.reports(OWN, 900.0)
        assert chair.master.is_fit(OWN, 0) is False
        chair.step(0)
        assert chair.master.succession.standby == 0

    def over(self, *, away: bool = False) -> Chair:
        chair = Chair()
        chair.reports(1, 900.0)
        chair.reports(2, 500.0)
        if not away:
            chair.orders(OrderKind.SWITCH_MASTER, 1)
        chair.step(0, away=away)
        return chair

    def test_an_ordered_switch_is_prepared_with_all_and_committed_once_all_are_ready(self) -> None:
        chair = self.over()
        steps = of(SwitchStep, chair.step(50))
        assert [(s.destination, s.kind, s.nonce, s.successor) for s in steps] == [
            (BROADCAST, SwitchKind.PREPARE, 1, 1)
        ]
        chair.reports(1, 900.0, ready_nonce=1)
        chair.reports(2, 500.0, ready_nonce=1)
        chair.on_message(SwitchStep(*self.ready(chair, TERM - 1), SwitchKind.READY, 1, 1))
        chair.on_message(SwitchStep(*self.ready(chair, TERM), SwitchKind.PREPARE, 1, 1))
        chair.step(50)
        assert chair.lease.successor == 0
        chair.on_message(SwitchStep(*self.ready(chair, TERM), SwitchKind.READY, 1, 1))
        chair.reports(1, 900.0, ready_nonce=1)
        chair.reports(2, 500.0, ready_nonce=1)
        said = chair.step()
        assert [each.kind for each in of(SwitchStep, said)] == [SwitchKind.COMMIT]
        assert chair.lease.successor == 1

    def ready(self, chair: Chair, term: int) -> tuple[int, int, int, int, int, int, int]:
        return chair.head(1, term=term)

    def test_a_change_of_the_switch_is_sent_at_once(self) -> None:
        chair = Chair()
        chair.reports(1, 900.0)
        chair.reports(2, 500.0)
        chair.step(0)
        chair.step(60)
        chair.orders(OrderKind.SWITCH_MASTER, 1)
        chair.master._cycle_ns = chair.now_ns + 10 * MS
        assert len(of(SwitchStep, chair.step(10))) == 1, "before the next beat"

    @pytest.mark.parametrize("own_first", [False, True])
    def test_a_reporting_train_that_is_not_ready_delays_the_switch_but_not_the_master_itself(
        self, *, own_first: bool
    ) -> None:
        chair = Chair((entry(1, 900.0), entry(OWN, 500.0)))
        chair.reports(1, 900.0)
        chair.reports(OWN, 500.0)
        chair.orders(OrderKind.SWITCH_MASTER, 1)
        chair.step(0)
        chair.reports(1, 900.0, ready_nonce=int(own_first))
        chair.reports(OWN, 500.0, ready_nonce=0)
        chair.on_message(SwitchStep(*self.ready(chair, TERM), SwitchKind.READY, 1, 1))
        chair.step()
        state = chair.master.succession.switch.state
        assert state is (SwitchState.COMMITTED if own_first else SwitchState.PREPARING)

    @pytest.mark.parametrize(("age_ms", "state"), [(500, "preparing"), (501, "committed")])
    def test_a_silent_train_does_not_delay_the_switch(self, age_ms: int, state: str) -> None:
        chair = self.over()
        chair.reports(2, 500.0, ready_nonce=0)
        chair.now_ns += age_ms * MS
        chair.reports(1, 900.0, ready_nonce=1)
        chair.on_message(SwitchStep(*self.ready(chair, TERM), SwitchKind.READY, 1, 1))
        chair.step(0)
        assert chair.master.succession.switch.state.value == state

    def test_a_restarted_train_delays_the_switch_until_it_is_ready(self) -> None:
        chair = self.over()
        chair.reports(2, 500.0, boot=2, localised=False, ready_nonce=0)
        chair.reports(2, 500.0, boot=2, localised=False, ready_nonce=0)
        chair.master._known.records[2].ready_nonce = None
        chair.reports(1, 900.0, ready_nonce=1)
        chair.on_message(SwitchStep(*self.ready(chair, TERM), SwitchKind.READY, 1, 1))
        chair.step()
        assert chair.master.succession.switch.state is SwitchState.PREPARING

    def test_a_master_that_goes_or_is_taken_out_of_service_hands_over_by_itself(self) -> None:
        assert self.over(away=True).master.succession.switch.state is SwitchState.PREPARING
        chair = Chair((entry(1, 900.0), entry(OWN, 500.0)))
        chair.reports(1, 900.0)
        chair.orders(OrderKind.OUT_OF_SERVICE, OWN)
        chair.step(0)
        assert chair.master.succession.switch.successor == 1

    def test_a_master_without_other_trains_has_no_other_to_hear(self) -> None:
        chair = Chair((entry(OWN, 500.0),))
        assert not chair.master.has_others
        chair.reports(3, 200.0)
        assert chair.master.has_others
        assert Chair().master.has_others


class TestDeaf:
    @pytest.mark.parametrize(("silence_ms", "deaf"), [(319, False), (320, True)])
    def test_a_master_whose_two_other_trains_fell_silent_together_receives_none(
        self, silence_ms: int, *, deaf: bool
    ) -> None:
        chair = Chair()
        chair.reports(1, 900.0)
        chair.reports(2, 500.0)
        assert chair.master.receives_from_no_train(silence_ms * MS) is deaf

    def test_its_own_messages_do_not_count_as_received(self) -> None:
        chair = Chair((entry(1, 900.0), entry(OWN, 500.0)))
        chair.reports(1, 900.0)
        chair.reports(OWN, 500.0)
        assert not chair.master.receives_from_no_train(9000 * MS)
