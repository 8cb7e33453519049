"""A lease holder that receives nothing: what it asks for, how long it relies on the lease, when
it resigns."""

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
    """A lease that the single arbiter granted after 5 ms."""
    lease = Lease(T2tConfig(), LeaseGuards())
    answered(lease, lease.ask(at_ms * MS, seen_term=0, tried_term=0), at_ms + ANSWER_MS)
    return lease


def answered(lease: Lease, request: ArbiterRequest, at_ms: int) -> None:
    head = (65_001, 5, 1, lease.term, 1, request.nonce, 0)
    lease.on_message(LeaseAnswer(*head, True, request.nonce, 0, 5, 0, 0, 0, ()), at_ms * MS)


def test_a_holder_that_gets_answers_as_usual_asks_for_whole_leases() -> None:
    lease = held()

    for at_ms in range(1075, 3000, 75):
        request = lease.renew(at_ms * MS)
        assert request.less_ns == 0
        answered(lease, request, at_ms + ANSWER_MS)


def test_a_holder_without_answers_shortens_its_request_by_the_extra_wait() -> None:
    lease = held()

    # The usual wait is the renewal period of 75 ms, a margin of 10 ms, and the 5 ms of the answer.
    less_ms = [lease.renew(at_ms * MS).less_ns / MS for at_ms in (1075, 1090, 1091, 1150, 1225)]
    assert less_ms == [0, 0, 1, 60, 135]
    assert lease.renew(60_000 * MS).less_ns == TIMERS_A.holder_lease_ns


def test_on_a_slow_network_late_answers_count_as_usual() -> None:
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
def test_the_arbiter_waits_longer_than_the_holder_relies_on_the_lease_despite_clock_drift(
    timers: str, less_ratio: Fraction
) -> None:
    """In true time, the holder's clock is as slow as permitted and the arbiter's as fast."""
    line = TIMER_SETS[timers]
    less_ns = int(line.holder_lease_ns * less_ratio)
    drift = Fraction(2, 1000)
    assert drift == Fraction(str(line.drift_ratio))

    holder_ns = (line.holder_lease_ns - less_ns) / (1 - drift)
    arbiter_ns = (line.arbiter_lease_ns - less_ns) / (1 + drift)

    assert holder_ns <= arbiter_ns


def three() -> tuple[Rig, int]:
    """A rig with three trains under one master, and the address of that master."""
    rig = Rig(line_of(0.0, 4000.0))
    for n in range(3):
        rig.start_train(n + 1, 1500.0 - 300.0 * n)
    rig.run_until(lambda: all(each.held for each in rig.trains.values()), 5000)
    rig.run(1000)
    (master,) = rig.masters()
    return rig, master


def test_a_deaf_master_resigns_to_its_standby() -> None:
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


def test_a_master_goes_on_commanding_although_its_only_other_train_is_silent() -> None:
    """The fault may as well be in the other train's transmitter; a change of master would help
    no train."""
    rig = Rig(line_of(0.0, 4000.0))
    for n in range(2):
        rig.start_train(n + 1, 1500.0 - 300.0 * n)
    rig.run_until(lambda: all(each.held for each in rig.trains.values()), 5000)
    (master,) = rig.masters()
    rig.spoil = lambda message, receiver: [] if message.source == 3 - master else [5]

    rig.run(3000)

    assert rig.masters() == [master]
