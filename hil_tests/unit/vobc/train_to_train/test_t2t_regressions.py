"""Known mistakes of such protocols, each in its own situation."""

import pytest

from hil_tests.unit.vobc.train_to_train.t2t_rig import MS, Rig, line_of
from vobc.train_to_train.guards import LeaseGuards, MasterGuards
from vobc.train_to_train.lease import Lease, LeaseState
from vobc.train_to_train.master import Master
from vobc.train_to_train.message_heads import MessageHeads
from vobc.train_to_train.occupancy import TrainTable
from vobc.train_to_train.train import TrainCore
from vobc.train_to_train.vocabulary import OwnTrain, T2tConfig, TrainMemory
from zenoh_config.t2t import (
    BROADCAST,
    AreaAuthority,
    Heartbeat,
    LeaseAnswer,
    LeaseKind,
    LeaseRequest,
    Phase,
    RosterAck,
    RosterCommit,
    RosterEntry,
    T2tMessage,
    TrainReport,
)

THREE = T2tConfig(arbiters=(65_001, 65_002, 65_003))


def own(front_m: float = 500.0, *, speed_mps: float = 0.0, reach_m: float = 0.0) -> OwnTrain:
    reach_m = max(front_m, reach_m)
    standing = speed_mps == 0.0
    return OwnTrain(
        *(True, front_m, front_m, front_m - 80.0, front_m - 80.0, speed_mps, standing, reach_m),
        *(reach_m, 16),
    )


def authority(
    end_m: float, sequence: int, *, area: int = 1, term: int = 4, echo_ms: int = 1000
) -> AreaAuthority:
    head = (9, 5, area, term, 1, sequence, 0)
    return AreaAuthority(*head, 1, echo_ms * MS, end_m, 0.0, 0, 1, ())


def reports(out: tuple[T2tMessage, ...], area: int = 1) -> list[TrainReport]:
    return [m for m in out if isinstance(m, TrainReport) and m.area == area]


def train(line_borders_m: tuple[float, ...] = (0.0, 4000.0)) -> TrainCore:
    line = line_of(*line_borders_m)
    return TrainCore(T2tConfig(), line, address=5, memory=TrainMemory(), start_ns=0)


class TestMember:
    def test_an_acknowledged_authority_is_already_applied(self) -> None:
        """A premature acknowledgement would make the master rely on an authority that the brakes
        do not supervise yet."""
        core = train()
        core.step(1000 * MS, (), own())

        stepped = core.step(1100 * MS, (authority(900.0, 1),), own())

        (report,) = reports(stepped.out)
        assert (report.held_term, report.held_sequence, report.latent_m) == (4, 1, 900.0)
        assert stepped.authority is not None
        assert stepped.authority.end_m == 900.0
        assert stepped.memory is not None
        assert stepped.memory.of_area(1).seen_term == 4

    def test_it_reports_the_farthest_point_and_not_the_binding_end(self) -> None:
        """The first area stops the train before the border, but the authority beyond it stays
        reserved."""
        core = train((0.0, 1000.0, 3000.0))
        core.step(1000 * MS, (), own(700.0))

        heard = (authority(800.0, 1), authority(1700.0, 2, area=2))
        stepped = core.step(1100 * MS, heard, own(700.0))

        assert stepped.authority is not None
        assert stepped.authority.end_m == 800.0
        assert reports(stepped.out, 2)[0].latent_m == 1700.0

    def test_a_shortened_authority_stays_reserved_for_the_stopping_distance(self) -> None:
        core = train()
        core.step(1000 * MS, (authority(900.0, 1),), own(speed_mps=15.0, reach_m=650.0))
        shorter = authority(550.0, 2)

        moving = core.step(1100 * MS, (shorter,), own(510.0, speed_mps=15.0, reach_m=650.0))
        stopped = core.step(1300 * MS, (), own(540.0))

        assert moving.authority is not None
        assert moving.authority.end_m == 550.0
        assert reports(moving.out)[0].latent_m == 650.0
        assert reports(stopped.out)[0].latent_m == 550.0

    def test_a_train_that_starts_while_rolling_includes_its_stopping_distance(self) -> None:
        stepped = train().step(1000 * MS, (), own(speed_mps=15.0, reach_m=650.0))

        assert reports(stepped.out)[0].latent_m == 650.0

    @pytest.mark.parametrize("late_ms", [50, 300, 900])
    def test_an_old_authority_delayed_across_a_takeover_is_void(self, late_ms: int) -> None:
        core = train()
        core.step(1000 * MS, (authority(600.0, 1),), own())
        fence = Heartbeat(8, BROADCAST, 1, 5, 1, 1, 0, Phase.FENCING, 0, 1)
        core.step(1010 * MS, (fence,), own())

        stepped = core.step((1010 + late_ms) * MS, (authority(900.0, 2),), own())

        assert stepped.authority is not None
        assert stepped.authority.end_m == 600.0
        assert core.refusals["old term"] == 1

    def test_a_restart_does_not_bring_an_old_term_back(self) -> None:
        core = train()
        fence = Heartbeat(8, BROADCAST, 1, 5, 1, 1, 0, Phase.FENCING, 0, 1)
        core.step(1000 * MS, (), own())
        stored = core.step(1010 * MS, (fence,), own()).memory
        assert stored is not None
        line = line_of(0.0, 4000.0)
        again = TrainCore(T2tConfig(), line, address=5, memory=stored, start_ns=0)
        again.step(1000 * MS, (), own())

        stepped = again.step(1010 * MS, (authority(900.0, 1),), own())

        assert stepped.authority is None
        assert again.memory.boot == stored.boot + 1

    def test_an_authority_that_ran_out_is_dropped_only_when_the_train_stands(self) -> None:
        core = train()
        core.step(1000 * MS, (authority(900.0, 1),), own(speed_mps=9.0, reach_m=550.0))

        rolling = core.step(2100 * MS, (), own(510.0, speed_mps=1.0, reach_m=512.0))
        standing = core.step(2200 * MS, (), own(511.0))

        assert reports(rolling.out)[0].latent_m == 900.0
        assert rolling.authority is not None  # The authority is old, and protection sees its age.
        assert standing.authority is None
        assert reports(standing.out)[0].latent_m == 511.0


class TestCandidate:
    def lease(self, config: T2tConfig = THREE) -> Lease:
        return Lease(config, LeaseGuards())

    def answer(
        self, lease: Lease, arbiter: int, nonce: int, *, granted: bool = True, term: int = 0
    ) -> LeaseAnswer:
        term = term or lease.term
        return LeaseAnswer(arbiter, 5, 1, term, 1, nonce, 0, granted, nonce, 0, 0, 0, 0, 0, ())

    def test_a_term_is_never_requested_twice(self) -> None:
        """An arbiter of three may hold the lease of the first attempt, and the same term would
        pass for it."""
        lease = self.lease()

        first = lease.ask(0, seen_term=4, tried_term=0)
        again = lease.ask(200 * MS, seen_term=4, tried_term=first.term)
        refused = self.answer(lease, 65_001, again.nonce, granted=False, term=30)
        lease.on_message(refused, 210 * MS)
        last = lease.ask(400 * MS, seen_term=4, tried_term=again.term)

        assert (first.term, again.term, last.term) == (5, 6, 31)

    def test_a_requested_term_is_stored_in_the_same_step(self) -> None:
        core = train()
        stepped = core.step(0, (), own())
        while not any(isinstance(each, LeaseRequest) for each in stepped.out):
            stepped = core.step(core.next_due_ns(), (), own())

        (request,) = [each for each in stepped.out if isinstance(each, LeaseRequest)]
        assert stepped.memory is not None
        assert stepped.memory.of_area(1).tried_term == request.term

    def test_two_of_three_grants_make_a_master_and_each_arbiter_counts_once(self) -> None:
        lease = self.lease()
        request = lease.ask(0, seen_term=0, tried_term=0)

        lease.on_message(self.answer(lease, 65_001, request.nonce), 5 * MS)
        lease.on_message(self.answer(lease, 65_001, request.nonce), 6 * MS)
        lease.on_message(self.answer(lease, 65_009, request.nonce), 6 * MS)
        assert lease.state is LeaseState.ASKED
        lease.on_message(self.answer(lease, 65_003, request.nonce), 7 * MS)

        assert lease.state is LeaseState.HELD

    def test_an_answer_to_an_earlier_attempt_does_not_count_as_a_vote_for_this_one(self) -> None:
        lease = self.lease(T2tConfig())
        first = lease.ask(0, seen_term=0, tried_term=0)
        old = self.answer(lease, 65_001, first.nonce)
        lease.ask(200 * MS, seen_term=0, tried_term=first.term)

        lease.on_message(old, 210 * MS)

        assert lease.state is LeaseState.ASKED

    def test_a_lease_counts_from_the_request_and_ends_early_for_its_holder(self) -> None:
        config = T2tConfig()
        lease = self.lease(config)
        request = lease.ask(1000 * MS, seen_term=0, tried_term=0)
        lease.on_message(self.answer(lease, 65_001, request.nonce), 1200 * MS)
        end_ns = 1000 * MS + config.timers.holder_lease_ns - config.timers.margin_ms * MS

        assert lease.runs(end_ns - 1)
        assert not lease.runs(end_ns)

    def test_a_losing_candidate_returns_its_grants(self) -> None:
        """With three arbiters, partial grants that are never returned would block both
        candidates forever."""
        for seed in range(6):
            rig = Rig(line_of(0.0, 4000.0), config=THREE)
            for n in range(3):
                rig.start_train(n + 1, 1500.0 - 300.0 * n, seed=seed)
            took_ms = rig.run_until(rig.is_commanded, 3000)
            assert took_ms < 1500
        assert any(isinstance(m, LeaseRequest) and m.kind is LeaseKind.RELEASE for _, m in rig.log)


ROSTER = (RosterEntry(1, 820.0, True, 1), RosterEntry(2, 420.0, True, 1))


class Command:
    """A master under term 1 in the area from 0 to 2000 m; its arbiter has stored this roster."""

    def __init__(self, roster: tuple[RosterEntry, ...] = ROSTER) -> None:
        lease = Lease(T2tConfig(), LeaseGuards())
        request = lease.ask(0, seen_term=0, tried_term=0)
        head = (65_001, 7, 1, 1, 1, 1, 0)
        lease.on_message(LeaseAnswer(*head, True, request.nonce, 0, 7, 0, 0, 1, roster), 0)
        lease.until_ns = 10**15
        self.now_ns = 0
        self.sequence = 0
        self.master = Master(
            T2tConfig(),
            MasterGuards(),
            line_of(0.0, 2000.0, 4000.0),
            1,
            speaker=MessageHeads(7, 1),
            lease=lease,
            table=TrainTable(),
            now_ns=0,
        )

    def on_message(self, train: int, front_m: float, **told: float) -> None:
        self.sequence += 1
        latent_m = told.get("latent_m", front_m)
        self.master.on_message(
            TrainReport(
                source=train,
                destination=BROADCAST,
                area=1,
                term=int(told.get("term", 1)),
                boot=1,
                sequence=self.sequence,
                stamp_ns=self.now_ns,
                localised=True,
                front_min_m=front_m,
                front_max_m=front_m,
                rear_min_m=front_m - 80.0,
                protected_m=front_m - 80.0,
                speed_mps=0.0,
                standstill=True,
                latent_m=latent_m,
                held_end_m=latent_m,
                easy_m=front_m,
                held_term=int(told.get("held_term", 0)),
                held_sequence=int(told.get("held_sequence", 0)),
                member="latent_m" in told,
                behind=int(told.get("behind", 0)),
                comes_from=int(told.get("comes_from", 0)),
                axles=16,
                out_of_service=False,
                ready_nonce=0,
                echo_ns=self.now_ns,
            ),
            self.now_ns,
        )

    def step(self, ms: int = 100, *, acks: bool = True) -> dict[int, AreaAuthority]:
        """Run a step and return the issued authorities by train.

        The arbiter commits rosters at once unless `acks` is false.
        """
        self.now_ns += ms * MS
        issued = {}
        for message in self.master.step(self.now_ns, away=False):
            if isinstance(message, AreaAuthority):
                issued[message.destination] = message
            elif isinstance(message, RosterCommit) and acks:
                head = (65_001, 7, 1, 1, 1, message.sequence, 0)
                self.master.on_message(RosterAck(*head, message.version), self.now_ns)
        return issued

    def order(self) -> list[int]:
        return [entry.train for entry in self.master.roster.proposed]


def test_stale_positions_do_not_change_the_order_of_trains() -> None:
    """A delayed report of the leader places it behind its follower."""
    command = Command()
    command.on_message(2, 850.0)
    command.on_message(1, 830.0)

    issued = command.step() | command.step()

    assert command.order() == [1, 2]
    assert 2 not in issued  # As far as is known, it is at the leader's rear already.


def test_no_authority_is_issued_before_the_roster_is_committed_under_the_new_term() -> None:
    command = Command()
    command.on_message(1, 900.0)
    assert command.step(acks=False) == {}
    assert command.step(acks=True) == {}

    command.on_message(1, 900.0)

    assert command.step()[1].end_m == 2000.0


def test_a_train_that_has_not_acknowledged_gets_no_authority_and_stays_an_obstacle() -> None:
    command = Command()
    command.on_message(1, 900.0, term=0)
    command.on_message(2, 500.0)

    issued = command.step() | command.step()

    assert list(issued) == [2]
    assert issued[2].end_m == 820.0 - 7.0


def test_a_followers_authority_proves_how_far_a_silent_leader_had_come() -> None:
    """Otherwise every takeover would take back the authorities behind a failed master."""
    command = Command()
    command.now_ns = MS
    command.on_message(2, 500.0, latent_m=1100.0)

    issued = command.step() | command.step()

    assert issued[2].end_m == 1100.0


def test_a_train_that_left_is_removed_and_delays_no_other() -> None:
    command = Command()
    command.on_message(1, 2087.0)
    command.on_message(2, 500.0)
    command.step()
    command.step()

    issued = command.step()

    assert command.order() == [2]
    assert issued[2].end_m == 2000.0


def test_a_train_over_the_border_by_less_than_it_may_roll_back_stays_on_the_roster() -> None:
    command = Command()
    command.on_message(1, 2086.9)
    command.on_message(2, 500.0)
    command.step()

    assert command.step()[2].end_m == pytest.approx(1999.9)
    assert command.order() == [1, 2]


def test_trains_cross_the_border_in_line() -> None:
    """Train 4 follows train 3 and applies first; only train 3 can be ahead of it."""
    lease_area_two = Command(roster=(RosterEntry(1, 2500.0, True, 1),))
    command = lease_area_two
    command.master = _second_area(command)
    command.step()
    command.on_message(4, 1500.0, comes_from=1, behind=3)
    command.step()
    assert command.order() == [1]

    command.on_message(3, 1800.0, comes_from=1)
    command.on_message(4, 1500.0, comes_from=1, behind=3)
    command.step()

    assert command.order() == [1, 3, 4]


def test_who_comes_over_the_border_without_authority_there_waits() -> None:
    command = Command(roster=(RosterEntry(1, 2500.0, True, 1),))
    command.master = _second_area(command)
    command.step()

    command.on_message(3, 1800.0)
    command.step()

    assert command.order() == [1]


def _second_area(command: Command) -> Master:
    return Master(
        T2tConfig(),
        MasterGuards(),
        line_of(0.0, 2000.0, 4000.0),
        2,
        speaker=MessageHeads(7, 1),
        lease=command.master._lease,
        table=TrainTable(),
        now_ns=0,
    )


def test_a_newcomer_gets_no_authority_before_its_entry_is_committed() -> None:
    command = Command(roster=(RosterEntry(1, 820.0, True, 1),))
    command.step()
    command.on_message(1, 900.0)
    command.on_message(3, 500.0)

    assert list(command.step(acks=False)) == [1]
    command.on_message(3, 500.0)
    assert list(command.step(acks=True)) == [1]
    command.on_message(3, 500.0)

    assert 3 in command.step()


def test_no_train_is_admitted_within_the_authority_of_another() -> None:
    command = Command()
    command.step()
    command.on_message(1, 900.0)
    command.on_message(2, 500.0)
    command.step()
    command.on_message(2, 500.0)

    command.on_message(3, 700.0)  # Train 3 starts where train 2 may go by an outstanding authority.
    command.step()

    assert command.order() == [1, 2]


def test_an_outstanding_authority_counts_until_a_newer_one_is_acknowledged() -> None:
    command = Command()
    command.step()
    command.on_message(1, 900.0)
    command.on_message(2, 500.0)
    (sent,) = [each for to, each in command.step().items() if to == 2]
    record = command.master._known.records[2]

    command.on_message(2, 510.0)
    assert record.granted_m == sent.end_m
    command.on_message(2, 520.0, held_term=1, held_sequence=sent.sequence - 1)
    assert record.granted_m == sent.end_m
    command.on_message(2, 530.0, held_term=1, held_sequence=sent.sequence)

    assert record.granted_m == 530.0


def test_a_report_that_is_too_old_to_be_answered_is_not_answered() -> None:
    command = Command()
    command.step()
    command.on_message(1, 900.0)
    assert 1 in command.step()

    assert command.step(500) == {}


@pytest.mark.parametrize(("front_m", "told"), [(4283.9, True), (4284.1, False)])
def test_a_train_reports_to_an_area_as_far_as_its_sections_are_reported(
    front_m: float, told: bool
) -> None:
    """Otherwise no train accounted for axles behind the border. A train just before it never got
    an authority again (simulation seed 232)."""
    line = line_of(0.0, 4050.0, 8100.0, section_m=150.0)
    core = TrainCore(T2tConfig(), line, address=5, memory=TrainMemory(), start_ns=0)

    core.step(0, (), own(front_m))

    assert line.sections_told(1)[-1].end_m == 4200.0
    assert bool(reports(core.step(100 * MS, (), own(front_m)).out, area=1)) is told


def test_a_train_that_left_the_area_accounts_for_its_axles_while_it_reports() -> None:
    """A train that restarted just before the border once waited forever for these axles
    (simulation seed 2113)."""
    command = Command()
    command.step()
    command.on_message(3, 2100.0)
    command.on_message(1, 1990.0)
    newcomer = command.master._known.records[1].report
    assert newcomer is not None

    def standing_m() -> list[float]:
        scene = command.master._scene(command.now_ns, newcomer)
        return [each.rear_m for each in scene.standing]

    assert command.order() == [1, 2]
    assert 2020.0 in standing_m()
    command.now_ns += 1000 * MS
    assert 2020.0 not in standing_m()
