"""Supervision states: every guard of the table on both sides of its threshold."""

import math
from dataclasses import replace

import pytest

from can_dbc.vobc import Cause, OperatingMode, Supervision
from hil_tests.unit.vobc.atp.guard_inputs_rig import CEILING, CONFIG, MOVING, RUNNING, STANDING
from vobc.atp.modes import NEEDED
from vobc.atp.supervision import TRANSITIONS, next_state
from vobc.vocabulary import Ceiling, Interval


def exactly(speed_mps: float) -> Interval:
    return Interval(speed_mps, speed_mps, speed_mps)


def test_every_state_has_a_row() -> None:
    assert set(TRANSITIONS) == set(Supervision)


def test_every_other_state_checks_for_an_emergency_first() -> None:
    for state in Supervision:
        if state is not Supervision.EMERGENCY:
            assert TRANSITIONS[state][0][1] is Supervision.EMERGENCY


def test_only_the_held_state_follows_an_emergency() -> None:
    targets = {target for _, target in TRANSITIONS[Supervision.EMERGENCY]}

    assert targets == {Supervision.NO_AUTHORITY}


@pytest.mark.parametrize("state", list(Supervision))
@pytest.mark.parametrize("facts", [RUNNING, STANDING], ids=["running", "standing"])
def test_a_latched_cause_means_emergency_in_every_state(state: Supervision, facts: object) -> None:
    seen = (RUNNING if facts is RUNNING else STANDING)._replace(latched=(Cause.BUTTON,))

    assert next_state(state, seen) is Supervision.EMERGENCY


@pytest.mark.parametrize("seen", [RUNNING, STANDING], ids=["running", "standing"])
def test_an_emergency_without_latched_causes_ends_in_the_held_state(
    seen: object,
) -> None:
    facts = RUNNING if seen is RUNNING else STANDING

    assert next_state(Supervision.EMERGENCY, facts) is Supervision.NO_AUTHORITY


@pytest.mark.parametrize("mode", list(OperatingMode))
@pytest.mark.parametrize("state", MOVING)
def test_without_emergency_the_mode_alone_decides_whether_the_train_may_move(
    state: Supervision, mode: OperatingMode
) -> None:
    seen = STANDING._replace(mode=mode, person_at_desk=True, creep_ordered=True)

    moves = mode in NEEDED

    assert (next_state(Supervision.NO_AUTHORITY, seen) is Supervision.NOMINAL) is moves
    assert (next_state(state, seen) is not Supervision.NO_AUTHORITY) is moves


@pytest.mark.parametrize(
    ("high", "state"),
    [
        (11.999, Supervision.NOMINAL),
        (12.0, Supervision.SERVICE),
        (12.5, Supervision.SERVICE),
        (math.nan, Supervision.SERVICE),
    ],
)
def test_reaching_a_limit_counts_as_exceeding_it(high: float, state: Supervision) -> None:
    seen = RUNNING._replace(speed_mps=Interval(9.0, 9.5, high))

    assert next_state(Supervision.NOMINAL, seen) is state


@pytest.mark.parametrize("speed_mps", [Interval(math.nan, 9.0, 9.2), Interval(8.8, 9.0, math.nan)])
def test_a_nan_speed_bound_reaches_every_limit(speed_mps: Interval) -> None:
    seen = RUNNING._replace(speed_mps=speed_mps)

    assert next_state(Supervision.NOMINAL, seen) is Supervision.SERVICE


def test_a_speed_backwards_is_limited_as_well() -> None:
    under = RUNNING._replace(speed_mps=Interval(-11.999, -9.0, -8.0))
    over = RUNNING._replace(speed_mps=Interval(-12.0, -9.0, -8.0))

    assert next_state(Supervision.NOMINAL, under) is Supervision.NOMINAL
    assert next_state(Supervision.NOMINAL, over) is Supervision.SERVICE


@pytest.mark.parametrize(
    ("best", "state"),
    [
        (10.99, Supervision.NOMINAL),
        (11.0, Supervision.WARNING),
        (11.5, Supervision.WARNING),
        (-11.0, Supervision.WARNING),
    ],
)
def test_the_warning_comes_with_the_best_estimate(best: float, state: Supervision) -> None:
    seen = RUNNING._replace(speed_mps=exactly(best))

    assert next_state(Supervision.NOMINAL, seen) is state


@pytest.mark.parametrize("state", [Supervision.WARNING, Supervision.SERVICE])
@pytest.mark.parametrize(
    ("best", "ends"), [(9.99, True), (10.0, False), (-9.99, True), (-10.0, False)]
)
def test_warning_and_service_last_until_the_speed_is_under_the_ceiling(
    state: Supervision, best: float, ends: bool
) -> None:
    seen = RUNNING._replace(speed_mps=exactly(best))

    assert next_state(state, seen) is (Supervision.NOMINAL if ends else state)


def test_service_lasts_while_a_bound_of_the_speed_is_over_its_limit() -> None:
    seen = RUNNING._replace(speed_mps=Interval(8.0, 9.0, 12.0))

    assert next_state(Supervision.SERVICE, seen) is Supervision.SERVICE


@pytest.mark.parametrize("mode", [OperatingMode.AUTHORISED, OperatingMode.JOG])
def test_an_ageing_authority_applies_the_service_brake_and_a_fresh_one_releases_it(
    mode: OperatingMode,
) -> None:
    aged_s = CONFIG.authority_service_ratio * CONFIG.authority_age_max_s
    ageing = RUNNING._replace(mode=mode, authority_age_s=aged_s)
    fresh = RUNNING._replace(mode=mode, authority_age_s=aged_s - 1e-9)

    for state in MOVING:
        assert next_state(state, ageing) is Supervision.SERVICE
    assert next_state(Supervision.SERVICE, fresh) is Supervision.NOMINAL
    assert next_state(Supervision.NOMINAL, ageing._replace(authority_age_s=math.nan)) is (
        Supervision.SERVICE
    )


@pytest.mark.parametrize(
    ("mode", "answered", "unanswered"),
    [
        (OperatingMode.RESTRICTED, {"person_at_desk": True}, {"person_at_desk": False}),
        (OperatingMode.CREEP, {"creep_ordered": True}, {"creep_ordered": False}),
    ],
)
def test_on_sight_only_the_requester_counts_and_not_the_age_of_the_authority(
    mode: OperatingMode, answered: dict[str, bool], unanswered: dict[str, bool]
) -> None:
    seen = RUNNING._replace(mode=mode, authority_age_s=math.inf)

    with_answer = seen._replace(**answered)  # type: ignore[arg-type]
    without = seen._replace(**unanswered)  # type: ignore[arg-type]

    assert next_state(Supervision.NOMINAL, with_answer) is Supervision.NOMINAL
    assert next_state(Supervision.NOMINAL, without) is Supervision.SERVICE
    assert next_state(Supervision.SERVICE, without) is Supervision.SERVICE


@pytest.mark.parametrize(("best", "brakes"), [(6.0, False), (6.001, True), (-6.001, True)])
def test_a_train_that_does_not_stop_on_order_is_braked(best: float, brakes: bool) -> None:
    seen = RUNNING._replace(speed_mps=exactly(best), stop_by_mps=6.0)

    state = next_state(Supervision.NOMINAL, seen)

    assert state is (Supervision.SERVICE if brakes else Supervision.NOMINAL)


def test_a_standing_train_exceeds_no_limit() -> None:
    """At the end of its authority the emergency limit is zero; the train may stand there."""
    seen = STANDING._replace(
        ceiling=Ceiling(0.0, 0.0, 0.0, 0.0, 0.2), standstill=False, stop_by_mps=-1.0
    )

    assert next_state(Supervision.NOMINAL, seen) is Supervision.NOMINAL
    assert next_state(Supervision.WARNING, seen) is Supervision.NOMINAL
    assert next_state(Supervision.SERVICE, seen) is Supervision.NOMINAL


def test_a_nan_ceiling_brakes() -> None:
    seen = RUNNING._replace(ceiling=replace(CEILING, service_mps=math.nan))

    assert next_state(Supervision.NOMINAL, seen) is Supervision.SERVICE
