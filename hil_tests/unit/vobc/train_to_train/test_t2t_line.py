"""Trains that command themselves on a small railway: the behaviour that a passenger would
notice."""

import pytest

from hil_tests.unit.vobc.train_to_train.t2t_rig import ARBITER, MS, Rig, line_of
from vobc.train_to_train.train import TrainCore
from vobc.train_to_train.vocabulary import Role, T2tConfig, TrainState
from zenoh_config.messages import SpeedRestriction
from zenoh_config.t2t import (
    SUPERVISION,
    AreaAuthority,
    Heartbeat,
    LineOrder,
    OrderKind,
    Phase,
    SwitchKind,
    SwitchStep,
    T2tMessage,
)
from zenoh_config.timers import TIMERS_B

THREE = T2tConfig(arbiters=(65_001, 65_002, 65_003))


def started(trains: int = 4, *, config: T2tConfig | None = None, section_m: float = 100.0) -> Rig:
    """One area with trains 300 m apart, all commanded and running."""
    rig = Rig(line_of(0.0, 4000.0, section_m=section_m), config=config)
    for n in range(trains):
        rig.start_train(n + 1, 1500.0 - 300.0 * n)
    rig.run_until(lambda: all(t.held is not None for t in rig.trains.values()), 5000)
    rig.run(6000)
    return rig


def term_of(rig: Rig) -> int:
    return max(t.held.term for t in rig.trains.values() if t.held is not None)


def all_under(rig: Rig, term: int) -> bool:
    alive = [t for t in rig.trains.values() if t.alive and not t.paused]
    return all(t.held is not None and t.held.term > term for t in alive)


def emergencies(rig: Rig) -> int:
    return sum(t.emergencies for t in rig.trains.values() if t.alive)


def order(rig: Rig, kind: OrderKind, train: int, sequence: int) -> LineOrder:
    return LineOrder(SUPERVISION, 65_535, 1, 0, 1, sequence, rig.now_ns, kind, train)


def test_the_first_train_becomes_master_another_standby_and_all_get_authorities() -> None:
    rig = started()

    assert len(rig.masters()) == 1
    assert [t.roles[1] for t in rig.trains.values()].count(Role.STANDBY) == 1
    assert all(t.state is TrainState.CONTROLLED for t in rig.trains.values())
    assert all(t.speed_mps > 3.0 for t in rig.trains.values())


def test_two_candidates_within_5_ms_in_an_empty_area_end_in_one_grant() -> None:
    for seed in range(5):
        rig = Rig(line_of(0.0, 4000.0), config=THREE)
        rig.start_train(1, 1500.0, seed=seed)
        rig.start_train(2, 1000.0, seed=seed)

        rig.run_until(rig.is_commanded, 5000)
        rig.run(1000)

        assert len(rig.masters()) == 1


@pytest.mark.parametrize("arbiters", [1, 3])
def test_a_killed_master_is_replaced_before_any_train_brakes(arbiters: int) -> None:
    rig = started(config=THREE if arbiters == 3 else None)
    term = term_of(rig)

    rig.kill(rig.masters()[0])
    took_ms = rig.run_until(lambda: all_under(rig, term), 2000)

    assert took_ms <= 450
    assert emergencies(rig) == 0
    assert len(rig.masters()) == 1


def test_with_the_timers_of_a_clean_network_it_is_replaced_within_200_ms() -> None:
    rig = started(config=T2tConfig(timers=TIMERS_B))
    term = term_of(rig)

    rig.kill(rig.masters()[0])

    assert rig.run_until(lambda: all_under(rig, term), 2000) <= 200


def test_a_master_that_is_cut_off_stops_before_its_lease_ends_and_is_not_obeyed_again() -> None:
    rig = started()
    old = rig.masters()[0]
    term = term_of(rig)
    cut_ns = rig.now_ns
    rig.spoil = lambda message, to: [] if old in (message.source, to) else [5]

    rig.run_until(
        lambda: all(t.held and t.held.term > term for a, t in rig.trains.items() if a != old)
    )
    rig.run(10_000)

    late = [
        sent_ns
        for sent_ns, message in rig.log
        if isinstance(message, AreaAuthority) and message.source == old and sent_ns > cut_ns
    ]
    assert max(late, default=0) <= cut_ns + rig.config.timers.lease_ms * MS
    rig.spoil = lambda message, to: [5]
    rig.run(1500)
    assert len(rig.masters()) == 1


def test_authorities_of_a_master_that_paused_for_5_s_are_refused() -> None:
    rig = started()
    old = rig.masters()[0]
    term = term_of(rig)

    rig.trains[old].paused = True
    rig.run(5000)
    assert all_under(rig, term)
    rig.trains[old].paused = False
    sent = len(rig.log)
    rig.run(1000)

    spoken = [m for _, m in rig.log[sent:] if m.source == old and isinstance(m, AreaAuthority)]
    assert spoken == []
    assert emergencies(rig) <= rig.trains[old].emergencies
    assert old not in rig.masters()


def test_a_planned_switch_leaves_no_gap_in_any_trains_authority() -> None:
    rig = started()
    term = term_of(rig)
    successor = 3 if rig.masters() != [3] else 2
    oldest_ms = 0

    for n in range(40):
        if not all_under(rig, term):
            rig.say(order(rig, OrderKind.SWITCH_MASTER, successor, n + 1))
        rig.run(50)
        ages = [(rig.now_ns - t.held.echo_ns) // MS for t in rig.trains.values() if t.held]
        assert len(ages) == len(rig.trains)
        oldest_ms = max(oldest_ms, *ages)

    assert rig.masters() == [successor]
    assert oldest_ms <= 400


@pytest.mark.parametrize("lost", [SwitchKind.READY, SwitchKind.COMMIT])
def test_a_switch_with_a_lost_step_is_aborted_without_effect(
    lost: SwitchKind,
) -> None:
    rig = started()
    master, term = rig.masters()[0], term_of(rig)

    def lossy(message: T2tMessage, to: int) -> list[int]:
        return [] if isinstance(message, SwitchStep) and message.kind is lost else [5]

    rig.spoil = lossy
    rig.say(order(rig, OrderKind.SWITCH_MASTER, 3 if master != 3 else 2, 1))
    rig.run(3000)

    aborted = [m for _, m in rig.log if isinstance(m, SwitchStep) and m.kind is SwitchKind.ABORT]
    assert aborted
    assert rig.masters() == [master]
    assert term_of(rig) == term
    assert emergencies(rig) == 0


def test_a_train_out_of_service_hands_over_its_command_and_is_not_elected_again() -> None:
    rig = started()
    master = rig.masters()[0]

    rig.trains[master].out_of_service = True
    rig.run(2500)

    assert rig.masters() != [master]
    assert len(rig.masters()) == 1


def test_a_train_that_supervision_takes_out_of_service_gives_up_its_command() -> None:
    rig = started()
    (master,) = rig.masters()

    def out(sequence: int) -> LineOrder:
        head = (SUPERVISION, master, 1, 0, 1, sequence, rig.now_ns)
        return LineOrder(*head, OrderKind.OUT_OF_SERVICE, master)

    rig.say(out(1))
    rig.run(2500)

    assert rig.masters() != [master]
    (successor,) = rig.masters()
    rig.kill(successor)
    rig.run(1500)
    assert master not in rig.masters()


def test_trains_pass_a_border_at_full_speed_and_belong_to_both_areas_on_it() -> None:
    rig = Rig(line_of(0.0, 1200.0, 3000.0, section_m=100.0, apply_m=600.0))
    for n in range(2):
        rig.start_train(n + 1, 900.0 - 300.0 * n)
    states, slowest_mps = set(), 99.0

    for _ in range(500):
        rig.run(100)
        follower = rig.trains[2]
        if 1203.0 < follower.front_m < 1278.0:
            states.add(follower.state)
            slowest_mps = min(slowest_mps, follower.speed_mps)

    assert states == {TrainState.CO_MANAGED}
    assert slowest_mps > 17.0
    assert emergencies(rig) == 0


def test_without_a_permit_of_the_area_behind_the_border_a_train_stops_before_it() -> None:
    rig = Rig(line_of(0.0, 1200.0, 3000.0, apply_m=600.0))
    train = rig.start_train(1, 700.0)
    rig.run(1000)
    # No message of the second area arrives, so it has no lease and no master.
    rig.spoil = lambda message, to: [] if message.area == 2 else [5]

    rig.run(60_000)

    assert 1180.0 < train.front_m < 1189.0
    assert train.speed_mps < 1.0
    assert train.emergencies == 0


def test_a_silent_train_stays_an_obstacle_and_returns_when_it_reports_again() -> None:
    rig = started(3)
    silent = rig.trains[2]
    rig.spoil = lambda message, to: [] if 2 in (message.source, to) else [5]

    rig.run(20_000)
    assert silent.state is TrainState.NON_COMMUNICATING
    assert silent.speed_mps == 0.0
    assert rig.trains[3].front_m < silent.rear_m
    rig.spoil = lambda message, to: [5]
    rig.run(2000)

    assert silent.state is TrainState.CONTROLLED
    assert silent.held is not None


def test_the_reservation_of_a_silent_train_moves_on_as_sections_clear_behind_it() -> None:
    rig = started(3, section_m=25.0)
    silent = rig.trains[2]
    rig.spoil = lambda message, to: [] if message.source == 2 else [5]
    told_m = silent.rear_m

    rig.run(15_000)

    follower = rig.trains[3]
    assert follower.held is not None
    assert follower.held.end_m > told_m
    assert follower.held.end_m < silent.rear_m


def test_a_train_without_readable_memory_does_not_participate() -> None:
    rig = Rig(line_of(0.0, 4000.0))
    rig.start_train(1, 1500.0)
    rig.trains[1].core = TrainCore(rig.config, rig.line, address=1, memory=None, start_ns=0)
    rig.run(2000)

    assert rig.log == []
    assert rig.trains[1].held is None


def test_without_the_arbiter_trains_stop_within_their_authorities() -> None:
    rig = started(2)
    rig.stop_arbiter(ARBITER)
    gone_ns = rig.now_ns

    rig.run(20_000)

    late = [at for at, m in rig.log if isinstance(m, AreaAuthority) and at > gone_ns]
    assert max(late) <= gone_ns + rig.config.timers.lease_ms * MS
    assert all(t.speed_mps == 0.0 for t in rig.trains.values())
    rig.start_arbiter(ARBITER)
    rig.run(3000)
    assert all(t.speed_mps > 0.0 for t in rig.trains.values())


def test_the_loss_of_one_arbiter_of_three_has_no_effect() -> None:
    rig = started(config=THREE)
    rig.stop_arbiter(65_002)
    term = term_of(rig)

    rig.run(2000)
    assert term_of(rig) == term
    rig.kill(rig.masters()[0])

    assert rig.run_until(lambda: all_under(rig, term), 2000) <= 450


def test_an_object_opens_only_when_no_train_can_reach_it_and_locks_again() -> None:
    rig = Rig(line_of(0.0, 4000.0, section_m=100.0, objects=[(1800.0, 1840.0)]))
    rig.start_train(1, 1200.0)
    rig.run(3000)
    rig.wanted = {1}

    rig.run(50_000)  # The rig itself checks that no train can enter the object while it is open.
    assert rig.trains[1].front_m < 1800.0
    assert rig.trains[1].emergencies == 0
    rig.wanted = set()
    rig.run(10_000)

    assert rig.trains[1].held is not None
    assert rig.trains[1].held.end_m > 1840.0


def test_a_hidden_vehicle_between_two_trains_is_an_obstacle() -> None:
    rig = Rig(line_of(0.0, 4000.0, section_m=100.0))
    rig.extra_axles = {11: 4}
    rig.start_train(1, 1850.0)
    rig.start_train(2, 650.0)

    rig.run(3000)

    held = rig.trains[2].held
    assert held is not None
    assert held.end_m == 1000.0 - 4.0 - 7.0  # Overhang, rollback and jog.


def test_a_vehicle_hidden_beside_a_train_keeps_it_from_its_first_authority() -> None:
    rig = Rig(line_of(0.0, 4000.0, section_m=100.0))
    rig.extra_axles = {15: 4}
    rig.start_train(1, 1460.0)

    rig.run(3000)
    assert rig.trains[1].held is None
    rig.extra_axles = {}
    rig.run(1000)

    assert rig.trains[1].held is not None


def test_a_closed_stretch_and_a_restriction_reach_the_trains_they_concern() -> None:
    rig = started(2)
    rig.track.closed = (SpeedRestriction(3000.0, 3100.0, 1.0),)
    rig.track.restrictions = (SpeedRestriction(2000.0, 2100.0, 8.0),)

    rig.run(500)

    first, second = rig.trains[1].held, rig.trains[2].held
    assert first is not None
    assert second is not None
    assert first.end_m == 3000.0
    assert first.restrictions == rig.track.restrictions
    assert second.restrictions == ()


def test_a_remote_emergency_brake_ends_the_authority_where_the_train_is() -> None:
    rig = started(2)
    train = rig.trains[1]

    rig.say(order(rig, OrderKind.STOP, 1, 1))
    rig.run(300)

    assert train.held is not None
    assert train.held.end_m <= train.front_m + 10.0
    rig.run(25_000)
    assert train.speed_mps == 0.0
    rig.say(order(rig, OrderKind.GO, 1, 2))
    rig.run(1000)
    assert train.speed_mps > 0.0


def test_a_restarted_train_is_commanded_again_and_does_not_obey_its_former_master() -> None:
    rig = started(3)
    victim = next(a for a in rig.trains if a not in rig.masters())
    seen = rig.trains[victim].memory.of_area(1).seen_term

    rig.kill(victim)
    rig.run(500)
    rig.restart(victim)
    rig.run(1000)

    train = rig.trains[victim]
    assert train.memory.boot == 2
    assert train.memory.of_area(1).seen_term >= seen
    assert train.held is not None


def test_two_trains_with_one_address_both_stop_participating() -> None:
    rig = started(2)
    twin = Heartbeat(2, 65_535, 1, 99, 77, 1, rig.now_ns, Phase.ISSUING, 0, 1)

    rig._boxes.clear()
    rig.trains[2].inbox.append(twin)
    rig.run(200)

    assert rig.trains[2].held is None


def test_the_same_seed_gives_the_same_traffic() -> None:
    def traffic() -> list[tuple[int, T2tMessage]]:
        rig = started(3, config=THREE)
        rig.kill(rig.masters()[0])
        rig.run(2000)
        return rig.log

    assert traffic() == traffic()
