"""A master step by step: what it waits for, when it sends, what it grants and to whom."""

import pytest

from firmware_py.trackdb.areas import ObjectKind, ObjectSite
from hil_tests.unit.vobc.train_to_train.t2t_chair import (
    ARBITERS,
    LENGTH_M,
    MS,
    OWN,
    TERM,
    TWO,
    Chair,
    authorities,
    entry,
    of,
)
from vobc.train_to_train.vocabulary import T2tConfig
from zenoh_config.messages import SpeedRestriction
from zenoh_config.t2t import (
    BROADCAST,
    Admission,
    AdmissionState,
    AreaAuthority,
    Heartbeat,
    ObjectClaim,
    ObjectState,
    ObjectStatus,
    OrderKind,
    Phase,
    RosterAck,
    RosterCommit,
)


class TestBefore:
    def test_until_the_roster_is_committed_it_fences_and_asks_arbiters_to_store_it(self) -> None:
        chair = Chair(kept=False)
        chair.reports(1, 900.0)

        beat, *commits = chair.step(0)

        assert beat == Heartbeat(OWN, BROADCAST, 1, TERM, 9, 1, 0, Phase.FENCING, 0, 1)
        assert [each.destination for each in commits] == list(ARBITERS)
        for commit in of(RosterCommit, commits):
            assert (commit.version, commit.roster) == (1, TWO)
            assert (commit.source, commit.area, commit.term, commit.boot) == (OWN, 1, TERM, 9)
        assert [each.sequence for each in commits] == [2, 3, 4]
        assert chair.master.next_due_ns() == 50 * MS

    def test_it_is_due_at_once_and_claims_no_object_before_the_roster_is_committed(self) -> None:
        site = ObjectSite(3, ObjectKind.CROSSING, 1500.0, 1520.0)
        chair = Chair(kept=False, objects=(site,))
        assert chair.master.next_due_ns() == 0
        chair.reports(1, 900.0)
        head = (0, BROADCAST, 1, TERM, 1, 1, 0)
        chair.on_message(ObjectStatus(*head, site.number, ObjectState.FREE, 0, 0, False))
        assert of(ObjectClaim, chair.step(0)) == []
        chair.keeps()
        assert len(of(ObjectClaim, chair.step(0))) == 1

    def test_only_arbiters_without_an_answer_are_asked_again(self) -> None:
        chair = Chair(kept=False)
        chair.keeps(arbiters=1)

        assert [each.destination for each in of(RosterCommit, chair.step())] == [65_002, 65_003]

    def test_a_committed_roster_is_not_sent_again(self) -> None:
        said = Chair().step()

        assert of(RosterCommit, said) == []
        assert [each.phase for each in of(Heartbeat, said)] == [Phase.ISSUING]

    @pytest.mark.parametrize(("version", "term"), [(2, TERM), (0, TERM), (1, TERM - 1)])
    def test_an_acknowledgement_of_another_roster_does_not_count(
        self, version: int, term: int
    ) -> None:
        chair = Chair(kept=False)
        chair.keeps(version, term=term)

        assert [each.phase for each in of(Heartbeat, chair.step())] == [Phase.FENCING]

    def test_an_arbiter_of_another_line_does_not_count(self) -> None:
        chair = Chair(kept=False)
        for arbiter in (65_001, 65_004, 65_005):
            chair.on_message(RosterAck(*chair.head(arbiter), 1))
        assert [each.phase for each in of(Heartbeat, chair.step())] == [Phase.FENCING]

    def test_nothing_is_sent_when_the_lease_ends_before_the_message_leaves(self) -> None:
        chair = Chair(kept=False)
        chair.lease.until_ns = 210 * MS
        assert chair.step(199)
        assert chair.step(1) == []
        assert chair.step(100) == []


class TestRhythm:
    def test_it_beats_every_50_ms_and_grants_every_100(self) -> None:
        chair = Chair()
        beats, grants = [], []
        for at_ms in range(0, 400, 10):
            if at_ms % 50 == 0:
                chair.reports(1, 900.0)
            said = chair.step(10 if at_ms else 0)
            beats += [at_ms] * len(of(Heartbeat, said))
            grants += [at_ms] * len(of(AreaAuthority, said))
        assert beats == list(range(0, 400, 50))
        assert grants == list(range(0, 400, 100))

    def test_missed_cycles_are_skipped_and_the_phase_stays(self) -> None:
        chair = Chair()
        chair.step(0)
        assert chair.master.next_due_ns() == 50 * MS
        assert len(of(Heartbeat, chair.step(170))) == 1
        assert chair.master.next_due_ns() == 200 * MS
        chair.step(29)
        assert chair.master.next_due_ns() == 200 * MS
        assert len(of(Heartbeat, chair.step(1))) == 1
        assert chair.master.next_due_ns() == 250 * MS

    def test_cycles_are_due_once_the_track_is_known(self) -> None:
        chair = Chair(sections=True)
        chair.step(10)
        chair.step(50)
        assert chair.master.next_due_ns() == 100 * MS
        chair.track()
        chair.step(0)
        assert chair.master.next_due_ns() == 100 * MS, "it had been due since 0"

    def test_the_first_authority_of_a_term_does_not_wait_for_the_next_cycle(
        self,
    ) -> None:
        chair = Chair()
        chair.reports(1, 900.0)
        assert list(authorities(chair.step(0))) == [1]

        chair.now_ns += 30 * MS
        chair.reports(1, 900.0)
        chair.reports(2, 500.0)
        assert chair.master.next_due_ns() == 30 * MS
        assert list(authorities(chair.step(0))) == [1, 2]
        chair.step(20)
        chair.reports(2, 500.0)
        assert chair.master.next_due_ns() == 100 * MS
        assert authorities(chair.step(79)) == {}
        assert list(authorities(chair.step(1))) == [1, 2]


class TestTrack:
    def test_on_a_line_with_axle_counters_no_authority_is_granted_before_the_first_count(
        self,
    ) -> None:
        chair = Chair(sections=True)
        chair.reports(1, 900.0)
        assert authorities(chair.step()) == {}
        chair.reports(1, 900.0)
        chair.track(axles={2: 16, 1: 16})
        assert list(authorities(chair.step(0))) == [1]

    def test_a_track_status_for_an_earlier_term_does_not_count(self) -> None:
        chair = Chair(sections=True)
        chair.reports(1, 900.0)
        chair.track(term=TERM - 1)
        assert authorities(chair.step(0)) == {}

    @pytest.mark.parametrize(("age_ms", "known"), [(1000, True), (1001, False)])
    def test_a_track_status_counts_for_the_life_of_an_authority(
        self, age_ms: int, *, known: bool
    ) -> None:
        chair = Chair(sections=True, now_ms=5000)
        chair.track(seen_ms=5000 - age_ms)
        chair.reports(1, 900.0)

        assert bool(authorities(chair.step(0))) is known

    def test_a_line_without_axle_counters_needs_no_track_status(self) -> None:
        chair = Chair()
        chair.reports(1, 900.0)
        assert list(authorities(chair.step(0))) == [1]

    def test_closed_track_and_restrictions_of_supervision_bind(self) -> None:
        chair = Chair(sections=True)
        chair.reports(1, 900.0)
        slow = SpeedRestriction(1100.0, 1200.0, 5.0)
        far = SpeedRestriction(1900.0, 1950.0, 5.0)
        shut = SpeedRestriction(1700.0, 1800.0, 0.0)
        chair.track(axles={2: 16, 1: 16}, restrictions=(slow, far), closed=(shut,))

        authority = authorities(chair.step(0))[1]

        assert authority.end_m == 1700.0
        assert authority.restrictions == (slow,)

    def test_an_authority_ends_with_room_before_unaccounted_axles(self) -> None:
        """The last axle may overhang by 4 m, and the vehicle may roll and jog back by 7 m."""
        chair = Chair(sections=True)
        chair.reports(1, 900.0)
        chair.track(axles={2: 16, 1: 16, 4: 4})

        assert authorities(chair.step(0))[1].end_m == 1500.0 - 4.0 - 7.0

    def test_axles_in_the_next_area_do_not_limit_this_one(self) -> None:
        chair = Chair(sections=True)
        chair.reports(1, 900.0)
        chair.track(axles={2: 16, 1: 16, 5: 4})

        assert authorities(chair.step(0))[1].end_m == 2000.0

    @pytest.mark.parametrize(
        ("front_m", "seen_ms", "end_m"),
        [
            (2087.0, 0, 2000.0),
            (2087.0, 99, 2000.0),
            (2087.0, 100, 1489.0),
            (2090.0, 24, 2000.0),
            (2090.0, 25, 1489.0),
            (2200.0, 0, 1489.0),
        ],
    )
    def test_axles_counted_while_a_train_was_leaving_are_its_own(
        self, front_m: float, seen_ms: int, end_m: float
    ) -> None:
        """The report arrives at 0.1 s; within a millisecond before, the train ran at most 4 cm."""
        chair = Chair(sections=True)
        chair.now_ns = 100 * MS
        chair.track(axles={1: 16, 4: 4}, seen_ms=seen_ms)
        chair.reports(1, front_m)
        chair.step(0)
        assert chair.order() == [2]
        chair.keeps()
        chair.reports(2, 500.0)
        assert authorities(chair.step())[2].end_m == end_m

    @pytest.mark.parametrize("heard_ms", [100, 110, 600])
    def test_the_report_of_an_unsieved_train_ahead_does_not_account_for_axles_near_it(
        self, heard_ms: int
    ) -> None:
        """The train's own report came after these axles were counted (simulation seed 2414)."""
        chair = Chair((entry(1, 2060.0, sieved=False), entry(2, 500.0)), sections=True, now_ms=100)
        chair.track(axles={1: 16, 4: 19})
        chair.now_ns = heard_ms * MS
        chair.reports(1, 2060.0)
        chair.reports(2, 500.0)
        assert authorities(chair.step(0))[2].end_m == 1489.0

    @pytest.mark.parametrize("granted_m", [500.0, 989.0, 995.0])
    def test_a_train_ahead_extends_no_authority_before_it_is_committed_on_the_roster(
        self, granted_m: float
    ) -> None:
        """The next master knew this train by its axles alone (simulation seed 101286).

        It did not account for axles in the section that the train behind had already been granted.
        """
        chair = Chair((entry(2, 500.0),), sections=True, now_ms=100)
        for _ in range(2):
            chair.track(axles={1: 16, 3: 12, 4: 4})
            chair.reports(2, 500.0, latent_m=granted_m)
            chair.reports(1, 1520.0)
            said = chair.step()

        assert authorities(said)[2].end_m == granted_m
        assert chair.order() == [1, 2]
        assert chair.master.roster.pending
        chair.keeps()
        chair.track(axles={1: 16, 3: 12, 4: 4})
        chair.reports(2, 500.0)
        chair.reports(1, 1520.0)
        assert authorities(chair.step())[2].end_m == 1440.0 - 7.0

    def test_axles_near_a_train_that_left_unsieved_still_count(self) -> None:
        chair = Chair((entry(1, 1900.0, sieved=False), entry(2, 500.0)), sections=True, now_ms=100)
        chair.track(axles={1: 16, 4: 19})
        chair.now_ns += 10 * MS
        chair.reports(1, 2090.0, axles=16)
        chair.step(0)
        assert chair.order() == [2]
        chair.keeps()
        chair.reports(2, 500.0)
        assert authorities(chair.step())[2].end_m == 1489.0


class TestAuthority:
    def test_it_answers_the_report_and_reaches_to_the_end_of_the_area(self) -> None:
        chair = Chair(area=2, roster=(entry(1, 2900.0, boot=3),))
        told = chair.reports(1, 2900.0, boot=3)

        said = chair.step(0)

        (authority,) = of(AreaAuthority, said)
        assert authority == AreaAuthority(
            *(OWN, 1, 2, TERM, 9, 1, chair.now_ns),
            3,
            told.stamp_ns,
            4000.0,
            2815.0,
            0,
            1,
            (),
        )

    def test_the_following_train_stays_7_m_behind_and_its_authority_names_the_train_ahead(
        self,
    ) -> None:
        chair = Chair()
        chair.reports(1, 900.0)
        chair.reports(2, 500.0)

        authority = authorities(chair.step(0))[2]

        assert (authority.end_m, authority.rear_m) == (813.0, 415.0)
        assert (authority.behind, authority.rank) == (1, 2)

    def test_no_authority_is_longer_than_3000_m(self) -> None:
        config_m = T2tConfig().longest_authority_m
        assert config_m == 3000.0
        chair = Chair()
        chair.reports(1, 900.0)
        assert authorities(chair.step(0))[1].end_m == 2000.0

    def test_a_silent_unacknowledged_or_unsieved_train_gets_no_authority(self) -> None:
        roster = (
            entry(1, 1900.0),
            entry(2, 1500.0),
            entry(3, 1100.0, sieved=False),
            entry(4, 700.0),
        )
        chair = Chair(roster, sections=True)
        chair.track(axles={4: 32, 3: 8})
        chair.reports(2, 1500.0, term=TERM - 1)
        chair.reports(3, 1100.0)
        chair.reports(4, 700.0)

        assert list(authorities(chair.step(0))) == [4]

    @pytest.mark.parametrize(("age_ms", "granted"), [(500, [1]), (501, [])])
    def test_a_report_older_than_half_an_authority_is_not_answered(
        self, age_ms: int, granted: list[int]
    ) -> None:
        chair = Chair()
        chair.reports(1, 900.0)
        assert list(authorities(chair.step(age_ms))) == granted

    def test_a_train_that_never_had_a_position_gets_no_authority_and_does_no_harm(self) -> None:
        chair = Chair()
        chair.reports(1, 900.0, localised=False)
        assert authorities(chair.step(0)) == {}

    def test_an_outstanding_authority_stays_reserved_until_it_is_acknowledged(self) -> None:
        chair = Chair()
        chair.reports(1, 900.0)
        first = authorities(chair.step(0))[1]
        record = chair.master._known.records[1]
        assert record.sent == [(first.sequence, 2000.0, record.received_at_ns + 2000 * MS)]
        assert record.granted_m == 2000.0
        chair.reports(1, 900.0, held_term=TERM, held_sequence=first.sequence, latent_m=950.0)
        assert record.granted_m == 950.0

    def test_an_end_behind_the_rollback_distance_is_not_sent(self) -> None:
        """The train ahead rolled back farther than permitted: 7 m behind its rear is behind 415
        m."""
        chair = Chair()
        chair.reports(1, 501.0)
        chair.reports(2, 500.0, latent_m=501.0)
        chair.master._known.records[1].rear_m = 421.9
        assert 2 not in authorities(chair.step(0))
        chair.master._known.records[1].rear_m = 422.0
        assert authorities(chair.step())[2].end_m == 415.0

    @pytest.mark.parametrize(
        ("shut_m", "end_m"), [((1490.0, 1600.0), 1490.0), ((1500.0, 1510.0), 1500.0)]
    )
    def test_the_nearest_barred_track_counts_and_of_two_the_more_restrictive(
        self, shut_m: tuple[float, float], end_m: float
    ) -> None:
        """Unsure track alone would have left the train the authority that it had."""
        site = ObjectSite(3, ObjectKind.CROSSING, 1500.0, 1520.0)
        chair = Chair((entry(1, 900.0),), sections=True, objects=(site,))
        head = (0, BROADCAST, 1, TERM, 1, 1, 0)
        chair.on_message(ObjectStatus(*head, site.number, ObjectState.LOCKED, 0, 0, False))
        chair.track(axles={2: 16}, closed=(SpeedRestriction(*shut_m, 0.0),))
        chair.reports(1, 900.0, latent_m=1900.0)

        assert authorities(chair.step(0))[1].end_m == end_m

    def test_a_stopped_train_gets_an_authority_that_ends_at_its_front(self) -> None:
        chair = Chair()
        chair.orders(OrderKind.STOP, 1)
        chair.orders(OrderKind.STOP, 99)
        chair.reports(1, 900.0)
        chair.reports(2, 500.0)
        ends_m = {train: each.end_m for train, each in authorities(chair.step(0)).items()}
        assert ends_m == {1: 900.0, 2: 813.0}
        chair.keeps()
        chair.orders(OrderKind.GO, 1)
        chair.reports(1, 900.0)
        assert authorities(chair.step())[1].end_m == 2000.0

    def test_the_track_before_an_applicant_ahead_is_kept_free(self) -> None:
        chair = Chair((entry(2, 500.0),))
        chair.reports(2, 500.0, latent_m=700.0)
        chair.reports(3, 680.0)
        chair.reports(4, 600.0, localised=False)

        assert authorities(chair.step(0))[2].end_m == 593.0


class TestRoster:
    def test_a_newcomer_is_proposed_announced_and_committed_at_once(self) -> None:
        chair = Chair()
        chair.reports(1, 950.0)
        told, received_at_ns = chair.reports(3, 200.0), chair.now_ns

        said = chair.step(20)

        assert chair.order() == [1, 2, 3]
        assert [each.rear_m for each in chair.master.roster.proposed] == [870.0, 420.0, 120.0]
        (admission,) = of(Admission, said)
        assert (admission.destination, admission.state, admission.waits_for) == (
            3,
            AdmissionState.COMMITTING,
            0,
        )
        assert admission.term == TERM
        assert {each.version for each in of(RosterCommit, said)} == {2}
        assert [each.roster_version for each in of(Heartbeat, said)] == [2]
        assert 3 not in authorities(said)
        assert chair.master._known.records[3].report is told
        assert chair.master._known.records[3].received_at_ns == received_at_ns
        chair.keeps()
        chair.reports(3, 200.0)
        assert 3 in authorities(chair.step())

    def test_between_two_beats_a_change_is_sent_at_once(self) -> None:
        chair = Chair()
        chair.step(0)
        chair.step(60)
        chair.reports(3, 200.0)
        chair.reports(1, 900.0)
        said = chair.step(10)
        assert list(authorities(said)) == [1], "it is due, as it had not been granted anything"
        assert len(of(RosterCommit, said)) == 3
        chair.keeps()
        chair.reports(4, 100.0, rear_min_m=20.0)
        assert of(RosterCommit, chair.step(20)) == []
        assert chair.master.next_due_ns() == 120 * MS

    def test_one_roster_change_is_committed_before_the_next_begins(self) -> None:
        chair = Chair()
        chair.reports(3, 200.0)
        chair.step(0)
        chair.reports(4, 110.0)
        chair.step()
        assert chair.order() == [1, 2, 3]
        chair.keeps()
        chair.reports(4, 110.0)
        chair.step()
        assert chair.order() == [1, 2, 3, 4]

    def test_an_applicant_that_must_wait_is_informed_which_train_it_waits_for(self) -> None:
        chair = Chair()
        chair.reports(1, 900.0)
        chair.reports(2, 500.0, latent_m=600.0)
        chair.reports(3, 680.0)

        (admission,) = of(Admission, chair.step(0))

        assert (admission.destination, admission.waits_for) == (3, 2)
        assert admission.state is AdmissionState.UNPLACED
        assert chair.order() == [1, 2]

    def test_applicants_come_in_from_the_foremost_on(self) -> None:
        chair = Chair((entry(1, 1500.0),))
        chair.reports(1, 1500.0)
        chair.reports(4, 500.0)
        chair.reports(5, 900.0, localised=False)
        chair.reports(3, 700.0)

        admissions = of(Admission, chair.step(0))

        assert [each.destination for each in admissions] == [3, 4]
        assert chair.order() == [1, 3, 4]
        assert chair.master.has_others

    @pytest.mark.parametrize(("age_ms", "order"), [(500, [1, 2, 3]), (501, [1, 2])])
    def test_a_silent_applicant_is_dropped(self, age_ms: int, order: list[int]) -> None:
        chair = Chair(now_ms=1000)
        chair.reports(3, 200.0)
        chair.step(age_ms)
        assert chair.order() == order
        assert list(chair.master._applicants) == ([3] if order == [1, 2, 3] else [])

    def test_only_the_first_64_applicants_are_kept(self) -> None:
        chair = Chair(kept=False)
        for train in range(100, 170):
            chair.reports(train, 200.0)
        chair.reports(100, 210.0)
        assert sorted(chair.master._applicants) == list(range(100, 164))
        assert chair.master._applicants[100][0].front_max_m == 210.0

    def test_a_train_on_the_roster_does_not_apply(self) -> None:
        chair = Chair()
        chair.reports(3, 200.0)
        chair.step(0)
        chair.keeps()
        chair.reports(3, 200.0)
        assert chair.master._applicants == {}

    @pytest.mark.parametrize(("rear_m", "order"), [(2006.9, [1, 2]), (2007.0, [2])])
    def test_a_train_whose_rear_is_past_the_border_by_its_rollback_distance_has_left(
        self, rear_m: float, order: list[int]
    ) -> None:
        chair = Chair()
        chair.reports(1, rear_m + LENGTH_M)
        chair.reports(2, 500.0)

        said = chair.step(0)

        assert chair.order() == order
        assert sorted(chair.master._known.records) == order
        assert bool(of(RosterCommit, said)) is (order == [2])

    def test_a_train_that_left_and_still_reports_accounts_for_its_axles(self) -> None:
        chair = Chair(sections=True)
        chair.track()
        chair.reports(9, 2500.0)
        chair.reports(9, 2087.1 + LENGTH_M)
        assert list(chair.master._around._passed) == [9]
        assert chair.master._applicants == {}
        chair.reports(8, 2000.0)
        chair.reports(8, 2100.0)
        assert list(chair.master._around._passed) == [9, 8]
        assert chair.master._applicants == {}
        chair.step(0)
        assert list(chair.master._around._passed) == [9, 8]
        chair.reports(3, 200.0)
        chair.step(500)
        assert list(chair.master._around._passed) == [9, 8]
        chair.track()
        chair.keeps()
        chair.reports(4, 100.0)
        chair.step(100)
        assert list(chair.master._around._passed) == []
