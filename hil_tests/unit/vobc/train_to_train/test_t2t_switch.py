"""The standby and the successor of a master, and each step of a planned switch."""

from collections.abc import Callable

import pytest
from hypothesis import given
from hypothesis import strategies as st

from vobc.train_to_train.message_heads import MessageHead
from vobc.train_to_train.planned_switch import (
    PlannedSwitch,
    SwitchGuardInputs,
    SwitchState,
    asked_for,
)
from vobc.train_to_train.succession import Succession
from zenoh_config.t2t import BROADCAST, SwitchKind, SwitchStep, T2tMessage

IDLE, PREPARING = SwitchState.IDLE, SwitchState.PREPARING
COMMITTED = SwitchState.COMMITTED
OWN = 5
LIMIT_NS = 1000


def is_fit(train: int) -> bool:
    """Trains 7 and 8 are fit; any other address than 7 to 9 is a mistake of the caller."""
    return {7: True, 8: True, 9: False}[train]


def unfit(_train: int) -> bool:
    return False


def anybody(_train: int) -> bool:
    return True


def yes() -> bool:
    return True


def no() -> bool:
    return False


def never_asked() -> bool:
    raise AssertionError("no switch runs")


def preparing(*, at_ns: int = 5000) -> PlannedSwitch:
    switch = PlannedSwitch(LIMIT_NS)
    switch.step(at_ns, wanted=7, fit=is_fit, all_ready=never_asked)
    assert switch.state is PREPARING
    return switch


def committed(*, at_ns: int = 5000) -> PlannedSwitch:
    switch = preparing(at_ns=at_ns)
    switch.is_ready(7, switch.nonce)
    switch.step(at_ns + 1, wanted=7, fit=is_fit, all_ready=yes)
    assert switch.state is COMMITTED
    return switch


# The switch itself.


def test_initially_no_switch_runs_and_none_was_aborted() -> None:
    switch = PlannedSwitch(LIMIT_NS)

    assert switch.state is IDLE
    assert (switch.successor, switch.nonce, switch.aborted) == (0, 0, 0)
    assert switch.successor_ready is False


def test_a_switch_begins_when_a_fit_successor_is_wanted() -> None:
    switch = PlannedSwitch(LIMIT_NS)

    switch.step(5000, wanted=0, fit=is_fit, all_ready=never_asked)
    assert switch.state is IDLE
    switch.step(5000, wanted=9, fit=is_fit, all_ready=never_asked)
    assert switch.state is IDLE
    assert (switch.nonce, switch.aborted, switch.successor) == (0, 0, 0)
    switch.step(5000, wanted=7, fit=is_fit, all_ready=never_asked)

    assert switch.state is PREPARING
    assert (switch.nonce, switch.successor) == (1, 7)
    assert switch.successor_ready is False


@pytest.mark.parametrize(
    ("wanted", "fit", "begins"), [(7, True, True), (7, False, False), (0, True, False)]
)
def test_address_zero_is_never_a_successor(wanted: int, *, fit: bool, begins: bool) -> None:
    look = SwitchGuardInputs(wanted, fit, successor_ready=False, all_ready=False, timed_out=False)

    assert asked_for(look) is begins


@pytest.mark.parametrize(
    ("successor", "others", "state"),
    [(True, True, COMMITTED), (True, False, PREPARING), (False, True, PREPARING)],
)
def test_it_commits_when_the_successor_and_all_others_are_ready(
    state: SwitchState, *, successor: bool, others: bool
) -> None:
    switch = preparing()
    if successor:
        switch.is_ready(7, 1)

    switch.step(5001, wanted=7, fit=is_fit, all_ready=yes if others else no)

    assert switch.state is state
    assert (switch.successor, switch.nonce) == (7, 1)


@pytest.mark.parametrize(
    ("train", "nonce", "ready"),
    [(7, 2, True), (8, 2, False), (7, 1, False), (7, 3, False), (2, 7, False)],
)
def test_only_the_successor_is_ready_and_only_for_this_switch(
    train: int, nonce: int, *, ready: bool
) -> None:
    switch = preparing()
    switch.step(5001, wanted=7, fit=unfit, all_ready=yes)
    switch.step(5002, wanted=7, fit=is_fit, all_ready=never_asked)
    assert switch.nonce == 2

    switch.is_ready(train, nonce)

    assert switch.successor_ready is ready


def test_a_ready_successor_stays_ready_whatever_other_trains_report() -> None:
    switch = preparing()
    switch.is_ready(7, 1)

    switch.is_ready(8, 1)

    assert switch.successor_ready is True


@pytest.mark.parametrize("make", [preparing, committed])
def test_no_train_is_ready_for_a_switch_that_does_not_run(
    make: Callable[[], PlannedSwitch],
) -> None:
    switch = PlannedSwitch(LIMIT_NS)
    switch.is_ready(0, 0)
    assert switch.successor_ready is False

    switch = make()
    switch.is_ready(7, 1)
    switch.step(5002, wanted=7, fit=unfit, all_ready=yes)
    switch.step(5003, wanted=8, fit=is_fit, all_ready=never_asked)

    assert switch.state is PREPARING
    assert switch.successor_ready is False  # The successor was ready for the switch before.


@pytest.mark.parametrize("make", [preparing, committed])
@pytest.mark.parametrize(("after_ns", "over"), [(999, False), (1000, True), (1001, True)])
def test_a_switch_that_takes_too_long_is_aborted(
    make: Callable[[], PlannedSwitch], after_ns: int, *, over: bool
) -> None:
    switch = make()
    before = switch.state

    switch.step(5000 + after_ns, wanted=7, fit=is_fit, all_ready=no)

    assert switch.state is (IDLE if over else before)
    assert switch.aborted == (1 if over else 0)
    assert switch.successor == (0 if over else 7)


@pytest.mark.parametrize("make", [preparing, committed])
def test_a_switch_is_aborted_when_its_successor_is_no_longer_fit(
    make: Callable[[], PlannedSwitch],
) -> None:
    """This holds although all are ready and another train is wanted and fit by now."""
    switch = make()
    switch.is_ready(7, 1)

    switch.step(5002, wanted=8, fit=lambda train: train == 8, all_ready=yes)

    assert switch.state is IDLE
    assert (switch.aborted, switch.successor) == (1, 0)


@pytest.mark.parametrize("make", [preparing, committed])
def test_another_order_does_not_change_a_running_switch(
    make: Callable[[], PlannedSwitch],
) -> None:
    switch = make()
    before = switch.state

    for wanted in (0, 8, 9):
        switch.step(5002, wanted=wanted, fit=is_fit, all_ready=no)
        assert (switch.state, switch.successor, switch.nonce) == (before, 7, 1)


def test_one_step_makes_one_change_and_a_new_switch_has_its_own_number_and_time() -> None:
    switch = preparing()
    switch.step(6000, wanted=8, fit=is_fit, all_ready=yes)
    assert switch.state is IDLE

    switch.step(6000, wanted=8, fit=is_fit, all_ready=yes)
    assert switch.state is PREPARING
    assert (switch.nonce, switch.successor, switch.aborted) == (2, 8, 1)

    switch.step(6999, wanted=8, fit=is_fit, all_ready=no)
    assert switch.state is PREPARING
    switch.step(7000, wanted=8, fit=is_fit, all_ready=no)
    assert switch.state is IDLE
    assert switch.aborted == 2


# The standby.


@pytest.mark.parametrize(
    ("fit", "standby"), [((), 0), ((7,), 7), ((7, 8), 8), ((7, 8, 9), 9), ((9, 8, 7, 6), 6)]
)
def test_the_rearmost_fit_train_is_standby(fit: tuple[int, ...], standby: int) -> None:
    succession = Succession(OWN, LIMIT_NS)
    assert succession.standby == 0

    succession.choose_standby(fit)

    assert succession.standby == standby


def test_a_standby_stays_for_as_long_as_it_is_fit() -> None:
    succession = Succession(OWN, LIMIT_NS)
    succession.choose_standby((7, 8))

    succession.choose_standby((8, 7, 6))
    assert succession.standby == 8
    succession.choose_standby((7, 6))
    assert succession.standby == 6
    succession.choose_standby(())
    assert succession.standby == 0


# The successor.


def steps(
    succession: Succession,
    now_ns: int = 5000,
    *,
    away: bool = False,
    fit: Callable[[int], bool] = is_fit,
    ready: tuple[tuple[int, int], ...] = (),
) -> bool:
    return succession.step(now_ns, away=away, fit=fit, ready=ready)


def ordered(wanted: int = 7, *, standby: int = 8) -> Succession:
    succession = Succession(OWN, LIMIT_NS)
    succession.standby, succession.wanted = standby, wanted
    return succession


def running(*, commit: bool = False) -> Succession:
    succession = ordered()
    assert steps(succession) is True
    if commit:
        succession.switch.is_ready(7, 1)
        assert steps(succession) is True
    assert succession.switch.state is (COMMITTED if commit else PREPARING)
    return succession


def test_without_an_order_and_while_the_master_stays_there_is_no_successor() -> None:
    succession = Succession(OWN, LIMIT_NS)
    assert (succession.wanted, succession.standby, succession.named) == (0, 0, 0)
    succession.choose_standby((8,))

    assert steps(succession, fit=anybody) is False

    assert succession.switch.state is IDLE
    assert (succession.wanted, succession.standby, succession.named) == (0, 8, 0)


def test_an_ordered_successor_becomes_standby_first() -> None:
    """The successor needs the records that a standby has."""
    succession = ordered(7, standby=8)

    assert steps(succession) is True

    assert succession.switch.state is PREPARING
    assert (succession.switch.successor, succession.standby, succession.wanted) == (7, 7, 7)


def test_when_the_master_must_resign_its_standby_succeeds() -> None:
    succession = ordered(0, standby=8)

    assert steps(succession, away=True) is True

    assert (succession.switch.successor, succession.standby) == (8, 8)
    assert succession.wanted == 0


def test_an_ordered_successor_goes_before_the_standby_even_when_the_master_must_resign() -> None:
    succession = ordered(7, standby=8)

    assert steps(succession, away=True) is True

    assert (succession.switch.successor, succession.standby) == (7, 7)


def test_a_master_that_is_ordered_to_succeed_itself_stays() -> None:
    succession = ordered(OWN, standby=8)

    assert steps(succession, fit=anybody) is False

    assert succession.switch.state is IDLE
    assert (succession.wanted, succession.standby) == (0, 8)


def test_an_order_waits_until_the_train_is_fit() -> None:
    succession = ordered(9, standby=8)

    assert steps(succession) is False
    assert (succession.wanted, succession.standby) == (9, 8)
    assert succession.switch.state is IDLE

    assert steps(succession, fit=anybody) is True
    assert succession.switch.successor == 9


@pytest.mark.parametrize(
    ("ready", "commits"),
    [
        ((), True),
        (((7, 1),), True),
        (((7, 1), (8, 1)), True),
        (((7, 1), (8, 0)), False),
        (((7, 0), (8, 1)), False),
        (((7, 2), (8, 2)), False),
    ],
)
def test_it_commits_when_all_reporting_trains_are_ready_for_this_switch(
    ready: tuple[tuple[int, int], ...], *, commits: bool
) -> None:
    succession = running()
    succession.switch.is_ready(7, 1)

    assert steps(succession, ready=ready) is commits

    assert succession.switch.state is (COMMITTED if commits else PREPARING)
    assert succession.named == (7 if commits else 0)
    assert succession.wanted == 7


@pytest.mark.parametrize("commit", [False, True])
def test_an_order_whose_switch_failed_is_not_tried_again(*, commit: bool) -> None:
    succession = running(commit=commit)
    assert steps(succession, 5999) is False
    assert succession.wanted == 7

    assert steps(succession, 6000) is True

    assert succession.switch.state is IDLE
    assert (succession.wanted, succession.named) == (0, 0)
    assert steps(succession, 6001) is False


# Messages about the switch.


def said(succession: Succession, now_ns: int = 70) -> list[T2tMessage]:
    return succession.steps(now_ns, lambda at_ns, to: MessageHead(OWN, to, 1, 4, 3, 9, at_ns))


def told(to: int, kind: SwitchKind, nonce: int, successor: int) -> list[T2tMessage]:
    return [SwitchStep(OWN, to, 1, 4, 3, 9, 70, kind, nonce, successor)]


def test_without_a_switch_nothing_is_sent() -> None:
    assert said(Succession(OWN, LIMIT_NS)) == []


def test_the_request_to_prepare_is_repeated_to_all() -> None:
    succession = running()

    for _ in range(3):
        assert said(succession) == told(BROADCAST, SwitchKind.PREPARE, 1, 7)


def test_the_commit_is_repeated_to_the_successor_alone() -> None:
    succession = running(commit=True)

    for _ in range(3):
        assert said(succession) == told(7, SwitchKind.COMMIT, 1, 7)


@pytest.mark.parametrize("commit", [False, True])
def test_an_abort_is_sent_to_all_once(*, commit: bool) -> None:
    succession = running(commit=commit)
    said(succession)
    steps(succession, 6000)

    assert said(succession) == told(BROADCAST, SwitchKind.ABORT, 1, 0)
    assert said(succession) == []

    succession.wanted = 8
    steps(succession, 6001)
    assert said(succession) == told(BROADCAST, SwitchKind.PREPARE, 2, 8)
    steps(succession, 7001)
    assert said(succession) == told(BROADCAST, SwitchKind.ABORT, 2, 0)
    assert said(succession) == []


DEEDS = st.lists(
    st.one_of(
        st.tuples(st.just("ready"), st.sampled_from((7, 8)), st.integers(0, 4)),
        st.tuples(st.just("wish"), st.sampled_from((0, 5, 7, 8)), st.just(0)),
        st.tuples(st.just("step"), st.sampled_from((7, 8)), st.integers(0, 600)),
    ),
    max_size=30,
)


@given(DEEDS)
def test_only_a_train_ready_for_this_switch_is_ever_named(
    deeds: list[tuple[str, int, int]],
) -> None:
    succession = Succession(OWN, LIMIT_NS)
    answered: set[tuple[int, int]] = set()
    now_ns = 5000
    for deed, train, number in deeds:
        switch = succession.switch
        if deed == "ready":
            switch.is_ready(train, number)
            if switch.state is PREPARING:
                answered.add((train, number))
        elif deed == "wish":
            succession.wanted = train
        else:
            now_ns += number
            steps(succession, now_ns, away=number > 300, fit={train}.__contains__)
        if succession.named:
            assert (succession.named, switch.nonce) in answered
            assert succession.named != OWN
