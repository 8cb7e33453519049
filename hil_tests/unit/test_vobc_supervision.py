"""Supervision: the transition table walked guard by guard, and the latch of the emergency."""

import itertools
from dataclasses import replace

import pytest

from can_dbc.vobc import Missing, Supervision
from vobc.atp.supervision import (
    CAUSES,
    HELD_CAUSES,
    TRANSITIONS,
    Cause,
    Seen,
    cause_of,
    next_state,
)
from vobc.config import load_config
from vobc.vocabulary import Ceiling, Interval

CONFIG = load_config("florence4").atp
CEILING = Ceiling(10.0, 11.0, 12.0, 13.0, 500.0)
MOVING = (Supervision.NOMINAL, Supervision.WARNING, Supervision.SERVICE)
STATES = tuple(Supervision)


def speed(best: float, half: float = 0.2) -> Interval:
    return Interval(best - half, best, best + half)


RUNNING = Seen(
    limits=CONFIG,
    speed_mps=speed(9.0),
    ceiling=CEILING,
    standing=False,
    standstill=False,
    missing=0,
    silent=0,
    authority_age_s=0.2,
    rollback_m=0.0,
    held_movement_m=0.0,
    button_pressed=False,
    overruns=0,
    not_finite=False,
    reset=False,
)
STANDING = replace(RUNNING, speed_mps=speed(0.0), standing=True, standstill=True)


def test_every_state_has_a_row() -> None:
    assert set(TRANSITIONS) == set(Supervision)


EMERGENCIES = {
    Cause.OVERSPEED: replace(RUNNING, speed_mps=Interval(12.5, 12.8, 13.0)),
    Cause.AUTHORITY_OLD: replace(RUNNING, authority_age_s=CONFIG.authority_age_max_s),
    Cause.ROLLBACK: replace(RUNNING, rollback_m=CONFIG.rollback_m),
    Cause.VITAL_INPUT_LOST: replace(RUNNING, missing=Missing.BRAKE, silent=Missing.BRAKE),
    Cause.LOCALISATION_LOST: replace(RUNNING, missing=Missing.LOCALISATION),
    Cause.BUTTON: replace(RUNNING, button_pressed=True),
    Cause.OVERRUN: replace(RUNNING, overruns=CONFIG.overruns_max + 1),
    Cause.NOT_FINITE: replace(RUNNING, not_finite=True),
}


def test_every_cause_of_a_moving_train_has_a_case_here() -> None:
    assert set(EMERGENCIES) == set(CAUSES)
    assert set(CAUSES) | set(HELD_CAUSES) == set(Cause)


@pytest.mark.parametrize("state", MOVING)
@pytest.mark.parametrize("cause", list(EMERGENCIES))
def test_every_cause_brings_the_emergency_from_every_moving_state_and_is_named(
    state: Supervision, cause: Cause
) -> None:
    seen = EMERGENCIES[cause]

    assert next_state(state, seen) is Supervision.EMERGENCY
    assert cause_of(state, seen) is cause


@pytest.mark.parametrize(
    "silent", [Missing.BRAKE, Missing.TRACTION, Missing.ODOMETER, Missing.DESK]
)
@pytest.mark.parametrize("state", MOVING)
def test_each_vital_node_that_falls_silent_in_motion_stops_the_train(
    state: Supervision, silent: Missing
) -> None:
    seen = replace(RUNNING, missing=int(silent), silent=int(silent))

    assert next_state(state, seen) is Supervision.EMERGENCY


@pytest.mark.parametrize("missing", [Missing.DOORS, Missing.TAG_READER])
def test_a_node_that_motion_can_do_without_stops_no_moving_train(missing: Missing) -> None:
    seen = replace(RUNNING, missing=int(missing), silent=int(missing))

    assert next_state(Supervision.NOMINAL, seen) is Supervision.NOMINAL


def test_a_unit_that_is_not_ready_but_heard_stops_no_moving_train() -> None:
    seen = replace(RUNNING, missing=int(Missing.TRACTION))

    assert next_state(Supervision.NOMINAL, seen) is Supervision.NOMINAL


@pytest.mark.parametrize(
    ("high", "state"),
    [
        (12.999, Supervision.SERVICE),
        (13.0, Supervision.EMERGENCY),
        (13.001, Supervision.EMERGENCY),
        (12.0, Supervision.SERVICE),
        (11.999, Supervision.NOMINAL),
    ],
)
def test_reaching_a_limit_counts_as_exceeding_it(high: float, state: Supervision) -> None:
    seen = replace(RUNNING, speed_mps=Interval(9.0, 9.5, high))

    assert next_state(Supervision.NOMINAL, seen) is state


@pytest.mark.parametrize(("best", "state"), [(10.99, 1), (11.0, 2), (11.5, 2)])
def test_the_warning_comes_with_the_best_estimate(best: float, state: int) -> None:
    seen = replace(RUNNING, speed_mps=Interval(best, best, best))

    assert next_state(Supervision.NOMINAL, seen) == state


@pytest.mark.parametrize("state", [Supervision.WARNING, Supervision.SERVICE])
@pytest.mark.parametrize(("best", "ends"), [(9.99, True), (10.0, False), (10.5, False)])
def test_warning_and_service_last_until_the_speed_is_under_the_ceiling(
    state: Supervision, best: float, ends: bool
) -> None:
    seen = replace(RUNNING, speed_mps=Interval(best, best, best))

    assert next_state(state, seen) is (Supervision.NOMINAL if ends else state)


def test_an_ageing_authority_brakes_by_service_and_a_fresh_one_lets_go() -> None:
    patient = replace(RUNNING, limits=replace(CONFIG, authority_age_max_s=5.0))
    ageing = replace(patient, authority_age_s=3.0)
    fresh = replace(patient, authority_age_s=2.999)

    assert next_state(Supervision.NOMINAL, ageing) is Supervision.SERVICE
    assert next_state(Supervision.WARNING, ageing) is Supervision.SERVICE
    assert next_state(Supervision.SERVICE, ageing) is Supervision.SERVICE
    assert next_state(Supervision.SERVICE, fresh) is Supervision.NOMINAL


@pytest.mark.parametrize("missing", [flag for flag in Missing if flag])
@pytest.mark.parametrize("state", MOVING)
def test_whatever_is_missing_at_standstill_holds_the_train_without_a_latch(
    state: Supervision, missing: Missing
) -> None:
    seen = replace(STANDING, missing=int(missing), silent=int(missing), authority_age_s=0.0)

    assert next_state(state, seen) is Supervision.NO_AUTHORITY
    assert next_state(Supervision.NO_AUTHORITY, seen) is Supervision.NO_AUTHORITY
    assert next_state(Supervision.NO_AUTHORITY, STANDING) is Supervision.NOMINAL


def test_an_authority_that_dies_at_standstill_latches_nothing() -> None:
    seen = replace(STANDING, missing=int(Missing.AUTHORITY), authority_age_s=99.0)

    assert next_state(Supervision.SERVICE, seen) is Supervision.NO_AUTHORITY


def test_a_train_that_only_seems_to_stand_is_held_but_not_let_go() -> None:
    """Silence takes the proof of standstill away before it takes the inputs away."""
    seems = replace(STANDING, standstill=False)
    silent = replace(seems, missing=int(Missing.ODOMETER), silent=int(Missing.ODOMETER))

    assert next_state(Supervision.NOMINAL, silent) is Supervision.NO_AUTHORITY
    assert next_state(Supervision.NO_AUTHORITY, seems) is Supervision.NO_AUTHORITY


def test_a_host_that_stalls_while_the_train_stands_latches_nothing() -> None:
    seen = replace(STANDING, overruns=50)

    assert next_state(Supervision.NOMINAL, seen) is Supervision.NOMINAL


def test_nothing_lets_a_held_train_go_before_standstill_is_proven() -> None:
    assert next_state(Supervision.NO_AUTHORITY, RUNNING) is Supervision.NO_AUTHORITY


def test_a_held_train_that_moves_half_a_metre_is_stopped() -> None:
    still = replace(STANDING, missing=int(Missing.AUTHORITY), held_movement_m=0.499)
    moved = replace(still, held_movement_m=0.5)

    assert next_state(Supervision.NO_AUTHORITY, still) is Supervision.NO_AUTHORITY
    assert next_state(Supervision.NO_AUTHORITY, moved) is Supervision.EMERGENCY
    assert cause_of(Supervision.NO_AUTHORITY, moved) is Cause.HELD_TRAIN_MOVED


def test_the_button_stops_a_held_train_too() -> None:
    seen = replace(STANDING, button_pressed=True)

    assert next_state(Supervision.NO_AUTHORITY, seen) is Supervision.EMERGENCY
    assert cause_of(Supervision.NO_AUTHORITY, seen) is Cause.BUTTON


def test_a_standing_train_exceeds_no_limit() -> None:
    """At the end of its authority even zero is the emergency speed; it may stand there."""
    seen = replace(STANDING, ceiling=Ceiling(0.0, 0.0, 0.0, 0.0, 0.2), standstill=False)

    assert next_state(Supervision.NOMINAL, seen) is Supervision.NOMINAL
    assert next_state(Supervision.SERVICE, seen) is Supervision.NOMINAL


def test_only_standstill_and_reset_and_a_cleared_cause_together_end_an_emergency() -> None:
    """All 32 combinations."""
    for standstill, reset, pressed, bad, moved in itertools.product((False, True), repeat=5):
        seen = replace(
            STANDING,
            standstill=standstill,
            reset=reset,
            button_pressed=pressed,
            not_finite=bad,
            held_movement_m=9.0 if moved else 0.0,
        )

        state = next_state(Supervision.EMERGENCY, seen)

        free = standstill and reset and not pressed and not bad and not moved
        assert state is (Supervision.NO_AUTHORITY if free else Supervision.EMERGENCY)


def test_no_state_but_the_held_one_follows_an_emergency() -> None:
    targets = {target for _, target in TRANSITIONS[Supervision.EMERGENCY]}

    assert targets == {Supervision.NO_AUTHORITY}


def test_emergency_is_looked_at_first_wherever_the_train_may_move() -> None:
    for state in MOVING:
        assert TRANSITIONS[state][0][1] is Supervision.EMERGENCY


def test_one_missed_cycle_more_than_two_is_too_many() -> None:
    assert next_state(Supervision.NOMINAL, replace(RUNNING, overruns=2)) is Supervision.NOMINAL
    assert next_state(Supervision.NOMINAL, replace(RUNNING, overruns=3)) is Supervision.EMERGENCY


def test_a_little_rollback_is_forgiven() -> None:
    assert (
        next_state(Supervision.NOMINAL, replace(RUNNING, rollback_m=0.499)) is Supervision.NOMINAL
    )
