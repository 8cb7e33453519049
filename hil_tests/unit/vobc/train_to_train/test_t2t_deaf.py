"""A holder that hears nothing: what it asks for, how long it counts on it, when it gives up."""

from fractions import Fraction

import pytest

from hil_tests.unit.vobc.train_to_train.t2t_rig import MS, Rig, line_of
from vobc.train_to_train.guards import LeaseGuards
from vobc.train_to_train.lease import ArbiterRequest, Lease
from vobc.train_to_train.vocabulary import T2tConfig
from zenoh_config.t2t import LeaseAnswer, LeaseKind, LeaseRequest, SwitchKind, SwitchStep
from zenoh_config.timers import TIMER_SETS, TIMERS_A

ANSWER_MS = 5


def held(at_ms: int = 1000) -> Lease:
    """Granted by the one arbiter, whose answer took 5 ms."""
    lease = Lease(T2tConfig(), LeaseGuards())
    answered(lease, lease.ask(at_ms * MS, seen_term=0, tried_term=0), at_ms + ANSWER_MS)
    return lease


def answered(lease: Lease, request: ArbiterRequest, at_ms: int) -> None:
    head = (65_001, 5, 1, lease.term, 1, request.nonce, 0)
    lease.on_message(LeaseAnswer(*head, True, request.nonce, 0, 5, 0, 0, 0, ()), at_ms * MS)


def test_who_is_answered_as_usual_asks_for_whole_leases() -> None:
    lease = held()

    for at_ms in range(1075, 3000, 75):
        request = lease.renew(at_ms * MS)
        assert request.less_ns == 0
        answered(lease, request, at_ms + ANSWER_MS)


def test_who_hears_nothing_asks_for_less_by_as_much_as_it_waits_longer_than_usual() -> None:
    lease = held()

    # Usual are a renewal's period of 75 ms, a margin of 10 ms, and the 5 ms that the answer took.
    less_ms = [lease.renew(at_ms * MS).less_ns / MS for at_ms in (1075, 1090, 1091, 1150, 1225)]
    assert less_ms == [0, 0, 1, 60, 135]
    assert lease.renew(60_000 * MS).less_ns == TIMERS_A.holder_lease_ns


def test_on_a_slow_network_late_answers_are_usual() -> None:
    lease = Lease(T2tConfig(), LeaseGuards())
    requests = {1000: lease.ask(1000 * MS, seen_term=0, tried_term=0)}
    answered(lease, requests[1000], 1150)

    for at_ms in range(1150, 4000, 75):
        requests[at_ms] = lease.renew(at_ms * MS)
        if at_ms - 150 in requests:
            answered(lease, requests[at_ms - 150], at_ms)
        assert lease.runs(at_ms * MS)
        assert requests[at_ms].less_ns == 0 or at_ms == 1300, "before the first renewal's answer"


def test_after_two_lost_answers_the_third_keeps_the_lease() -> None:
    lease = held()
    for at_ms in (1075, 1150):
        lease.renew(at_ms * MS)
    third = lease.renew(1225 * MS)
    before_ns = lease.until_ns
    answered(lease, third, 1230)

    assert lease.until_ns == 1225 * MS + TIMERS_A.holder_lease_ns - third.less_ns
    assert lease.until_ns > before_ns
    assert lease.renew(1300 * MS).less_ns == 0


@pytest.mark.parametrize("timers", sorted(TIMER_SETS))
@pytest.mark.parametrize("less_ratio", [0, Fraction(1, 1000), Fraction(1, 2), Fraction(99, 100)])
def test_however_clocks_drift_the_arbiter_waits_longer_than_the_holder_counts_on(
    timers: str, less_ratio: Fraction
) -> None:
    """In true time: the holder's clock as slow as it may be, the arbiter's as fast."""
    line = TIMER_SETS[timers]
    less_ns = int(line.holder_lease_ns * less_ratio)
    drift = Fraction(2, 1000)
    assert drift == Fraction(str(line.drift_ratio))

    holder_ns = (line.holder_lease_ns - less_ns) / (1 - drift)
    arbiter_ns = (line.arbiter_lease_ns - less_ns) / (1 + drift)

    assert holder_ns <= arbiter_ns


def three() -> tuple[Rig, int]:
    """Three trains under one master, and that."""
    rig = Rig(line_of(0.0, 4000.0))
    for n in range(3):
        rig.start_train(n + 1, 1500.0 - 300.0 * n)
    rig.run_until(lambda: all(each.held for each in rig.trains.values()), 5000)
    rig.run(1000)
    (master,) = rig.masters()
    return rig, master


def test_a_master_that_hears_nothing_for_a_silence_resigns_to_its_standby() -> None:
    rig, master = three()
    begun = len(rig.log)
    rig.spoil = lambda message, receiver: [] if receiver == master else [5]

    took_ms = rig.run_until(lambda: rig.masters() not in ([], [master]), 1000)

    said = [(at, m) for at, m in rig.log[begun:] if m.source == master]
    resigned = [(at, m) for at, m in said if isinstance(m, SwitchStep)]
    released = [at for at, m in said if isinstance(m, LeaseRequest) and m.kind is LeaseKind.RELEASE]
    assert [m.kind for _, m in resigned] == [SwitchKind.RESIGN]
    assert released[0] <= resigned[0][0]
    assert TIMERS_A.silence_ms <= took_ms <= TIMERS_A.silence_ms + 60
    assert rig.masters() == [resigned[0][1].destination]


def test_one_of_two_trains_goes_on_commanding_although_it_does_not_hear_the_other() -> None:
    """It may as well be the other's voice; nobody would be served better."""
    rig = Rig(line_of(0.0, 4000.0))
    for n in range(2):
        rig.start_train(n + 1, 1500.0 - 300.0 * n)
    rig.run_until(lambda: all(each.held for each in rig.trains.values()), 5000)
    (master,) = rig.masters()
    rig.spoil = lambda message, receiver: [] if message.source == 3 - master else [5]

    rig.run(3000)

    assert rig.masters() == [master]
