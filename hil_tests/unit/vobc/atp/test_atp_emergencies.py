"""Emergencies: each rule on both sides of its threshold, and who may release which cause."""

import itertools
import math
from dataclasses import replace
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from can_dbc.vobc import Cause, Missing, OperatingMode, Supervision
from hil_tests.unit.vobc.atp.guard_inputs_rig import CEILING, CONFIG, MOVING, RUNNING, STANDING
from vobc.atp.emergencies import (
    LOOKED_AT,
    RULE_OF,
    RULES,
    Reset,
    When,
    in_cause_words,
    latched_after,
    released,
)
from vobc.atp.guard_inputs import GuardInputs
from vobc.vocabulary import Interval

HELD = (Supervision.NO_AUTHORITY, Supervision.EMERGENCY)
CAUSES = [cause for cause in Cause if cause]


def facts(**changes: Any) -> GuardInputs:
    return RUNNING._replace(**changes)


JUST = 1e-9
STATION_CAUSES = (
    Cause.OBSTACLE,
    Cause.DOOR_UNLOCKED,
    Cause.PASSENGER_ALARM,
    Cause.OVERSHOT,
)

THERE_AND_NOT: dict[Cause, list[tuple[dict[str, Any], dict[str, Any]]]] = {
    Cause.NOT_FINITE: [({"not_finite": True}, {})],
    Cause.CLOCK_STEPPED: [({"clock_stepped": True}, {})],
    Cause.REPLICAS_DISAGREE: [({"replicas_disagree": True}, {})],
    Cause.BUTTON: [({"button_pressed": True}, {})],
    Cause.REMOTE: [({"ordered_to_stop": True}, {})],
    **{cause: [({"station_cause": cause}, {})] for cause in STATION_CAUSES},
    Cause.VITAL_INPUT_LOST: [
        ({"silent": flag, "missing": flag}, {"missing": flag})
        for flag in (Missing.BRAKE, Missing.TRACTION, Missing.ODOMETER, Missing.DESK)
    ],
    Cause.BRAKE_UNIT: [({"brake_unit_braked": True}, {})],
    Cause.LOCALISATION_LOST: [
        ({"missing": Missing.LOCALISATION}, {"missing": Missing.TAG_READER | Missing.DOORS}),
    ],
    Cause.AUTHORITY_OLD: [
        (
            {"authority_age_s": CONFIG.authority_age_max_s},
            {"authority_age_s": CONFIG.authority_age_max_s - JUST},
        ),
        ({"authority_age_s": math.nan}, {}),
    ],
    Cause.PAST_AUTHORITY: [
        (
            {"ceiling": replace(CEILING, distance_to_authority_m=-JUST)},
            {"ceiling": replace(CEILING, distance_to_authority_m=0.0)},
        ),
        ({"ceiling": replace(CEILING, distance_to_authority_m=math.nan)}, {}),
    ],
    Cause.OVERSPEED: [
        (
            {"speed_mps": Interval(9.0, 9.5, 13.0)},
            {"speed_mps": Interval(9.0, 9.5, 13.0 - JUST)},
        ),
        (
            {"speed_mps": Interval(-13.0, -9.5, -9.0)},
            {"speed_mps": Interval(-13.0 + JUST, -9.5, -9.0)},
        ),
        ({"ceiling": replace(CEILING, emergency_mps=math.nan)}, {}),
        ({"speed_mps": Interval(math.nan, 9.0, 9.2)}, {}),
        ({"speed_mps": Interval(8.8, 9.0, math.nan)}, {}),
        # The second computation alone suffices, but only where protection supervises a position.
        *(
            (
                {"mode": mode, "energy_exceeded": True},
                {"mode": on_sight, "energy_exceeded": True},
            )
            for mode in (OperatingMode.AUTHORISED, OperatingMode.JOG)
            for on_sight in (OperatingMode.RESTRICTED, OperatingMode.CREEP)
        ),
    ],
    Cause.WRONG_DIRECTION: [
        ({"behind_jog_m": CONFIG.rollback_m}, {"behind_jog_m": CONFIG.rollback_m - JUST}),
        ({"behind_jog_m": math.nan}, {}),
    ],
    Cause.ROLLBACK: [
        ({"rollback_m": CONFIG.rollback_m}, {"rollback_m": CONFIG.rollback_m - JUST}),
        ({"rollback_m": math.nan}, {}),
        ({"rollback_room_m": 0.0}, {"rollback_room_m": JUST}),
        ({"rollback_room_m": math.nan}, {}),
    ],
    Cause.JOG_EXCEEDED: [
        ({"jog_movement_m": CONFIG.jog_m}, {"jog_movement_m": CONFIG.jog_m - JUST}),
        ({"station_cause": Cause.JOG_EXCEEDED}, {}),
        ({"jog_movement_m": math.nan}, {}),
    ],
    Cause.OVERRUN: [({"overruns": CONFIG.overruns_max + 1}, {"overruns": CONFIG.overruns_max})],
    Cause.ASLEEP_MOVED: [
        (
            {"mode": OperatingMode.ASLEEP, "held_movement_m": CONFIG.held_movement_m},
            {"mode": OperatingMode.ASLEEP, "held_movement_m": CONFIG.held_movement_m - JUST},
        ),
    ],
    Cause.HELD_TRAIN_MOVED: [
        (
            {"mode": OperatingMode.STANDBY, "held_movement_m": CONFIG.held_movement_m},
            {"mode": OperatingMode.STANDBY, "held_movement_m": CONFIG.held_movement_m - JUST},
        ),
        ({"mode": OperatingMode.STANDBY, "held_movement_m": math.nan}, {}),
    ],
}
PAIRS = [(cause, *pair) for cause, pairs in THERE_AND_NOT.items() for pair in pairs]


def test_every_cause_has_one_rule_and_a_case_here() -> None:
    assert [rule.cause for rule in RULES] == list(RULE_OF)
    assert set(RULE_OF) == set(CAUSES) == set(THERE_AND_NOT)
    assert all(in_cause_words(cause) for cause in CAUSES)
    assert len({rule.words for rule in RULES}) == len(RULES)


@pytest.mark.parametrize(("cause", "there", "not_there"), PAIRS)
def test_every_cause_comes_at_its_threshold_and_not_before(
    cause: Cause, there: dict[str, Any], not_there: dict[str, Any]
) -> None:
    when = RULE_OF[cause].when

    for state in Supervision:
        looked_at = {
            When.MOVING: state in MOVING,
            When.HELD: state in HELD,
            When.ALWAYS: True,
        }[when]
        assert (cause in latched_after(state, facts(**there))) is looked_at
        assert cause not in latched_after(state, facts(**not_there))


@pytest.mark.parametrize("cause", CAUSES)
def test_a_single_cause_is_named_alone(cause: Cause) -> None:
    there, _ = THERE_AND_NOT[cause][0]
    state = Supervision.NO_AUTHORITY if RULE_OF[cause].when is When.HELD else Supervision.NOMINAL

    assert latched_after(state, facts(**there)) == (cause,)


STANDING_EXCUSES = (
    Cause.OVERSPEED,
    Cause.AUTHORITY_OLD,
    Cause.PAST_AUTHORITY,
    Cause.VITAL_INPUT_LOST,
    Cause.BRAKE_UNIT,
    Cause.LOCALISATION_LOST,
    Cause.OVERRUN,
)


@pytest.mark.parametrize("cause", STANDING_EXCUSES)
def test_a_standing_train_is_exempt_from_causes_that_only_matter_in_motion(cause: Cause) -> None:
    for there, _ in THERE_AND_NOT[cause]:
        seen = facts(**there)._replace(standing=True)

        assert latched_after(Supervision.NOMINAL, seen) == ()


@pytest.mark.parametrize(
    "cause", [Cause.AUTHORITY_OLD, Cause.PAST_AUTHORITY, Cause.LOCALISATION_LOST]
)
@pytest.mark.parametrize("mode", [OperatingMode.RESTRICTED, OperatingMode.CREEP])
def test_on_sight_neither_place_nor_authority_is_needed(cause: Cause, mode: OperatingMode) -> None:
    there, _ = THERE_AND_NOT[cause][0]

    assert latched_after(Supervision.NOMINAL, facts(**there, mode=mode)) == ()


@pytest.mark.parametrize("missing", [Missing.DOORS, Missing.TAG_READER, Missing.ALARMS])
def test_a_node_that_motion_does_not_need_stops_no_moving_train(missing: Missing) -> None:
    seen = facts(missing=int(missing), silent=int(missing))

    assert latched_after(Supervision.NOMINAL, seen) == ()


WHO = {
    Cause.NOT_FINITE: Reset.DESK,
    Cause.CLOCK_STEPPED: Reset.DESK,
    Cause.REPLICAS_DISAGREE: Reset.DESK,
    Cause.BUTTON: Reset.DESK,
    Cause.REMOTE: Reset.CENTRE,
    Cause.OVERSHOT: Reset.CENTRE,
}
"""Either kind of reset releases every other cause."""


@pytest.mark.parametrize("cause", CAUSES)
def test_each_cause_is_released_only_at_standstill_and_only_by_the_reset_its_rule_names(
    cause: Cause,
) -> None:
    named = WHO.get(cause, Reset.DESK | Reset.CENTRE)

    for number, standing, standstill in itertools.product(range(4), (False, True), (False, True)):
        seen = STANDING._replace(
            latched=(cause,), resets=number, standing=standing, standstill=standstill
        )

        left = latched_after(Supervision.EMERGENCY, seen)

        free = standing and standstill and bool(named & number)
        assert left == (() if free else (cause,))
        assert released(RULE_OF[cause], seen) is free


@pytest.mark.parametrize("cause", [rule.cause for rule in RULES if rule.when is When.ALWAYS])
def test_no_reset_releases_a_cause_that_persists(cause: Cause) -> None:
    there, _ = THERE_AND_NOT[cause][0]
    seen = STANDING._replace(latched=(cause,), resets=3, **there)

    assert latched_after(Supervision.EMERGENCY, seen) == (cause,)


@pytest.mark.parametrize("cause", [rule.cause for rule in RULES if rule.when is When.ALWAYS])
def test_a_persisting_cause_keeps_its_place_before_later_ones(cause: Cause) -> None:
    there, _ = THERE_AND_NOT[cause][0]
    later = Cause.REMOTE if cause is not Cause.REMOTE else Cause.BUTTON
    waits = int(Reset.DESK if later is Cause.REMOTE else Reset.CENTRE)
    seen = STANDING._replace(latched=(cause, later), resets=waits, **there)

    assert latched_after(Supervision.EMERGENCY, seen) == (cause, later)


def test_every_cause_waits_for_its_own_release() -> None:
    latched = (Cause.BUTTON, Cause.REMOTE)
    by_desk = STANDING._replace(latched=latched, resets=int(Reset.DESK))
    by_centre = STANDING._replace(latched=latched, resets=int(Reset.CENTRE))
    by_both = STANDING._replace(latched=latched, resets=3)

    assert latched_after(Supervision.EMERGENCY, by_desk) == (Cause.REMOTE,)
    assert latched_after(Supervision.EMERGENCY, by_centre) == (Cause.BUTTON,)
    assert latched_after(Supervision.EMERGENCY, by_both) == ()


def test_a_later_cause_is_appended_once() -> None:
    seen = facts(latched=(Cause.OVERSPEED,), button_pressed=True, ordered_to_stop=True)

    after = latched_after(Supervision.EMERGENCY, seen)

    assert after == (Cause.OVERSPEED, Cause.BUTTON, Cause.REMOTE)
    assert latched_after(Supervision.EMERGENCY, seen._replace(latched=after)) == after


def test_only_a_small_overshoot_releases_itself_and_only_at_standstill() -> None:
    for cause, little, standstill in itertools.product(CAUSES, (False, True), (False, True)):
        seen = STANDING._replace(latched=(cause,), overshot_little=little, standstill=standstill)

        left = latched_after(Supervision.EMERGENCY, seen)

        assert (left == ()) is (cause is Cause.OVERSHOT and little and standstill)


def test_an_overshoot_that_is_still_reported_does_not_block_its_release() -> None:
    """The station guard reports the overshoot until the train has moved."""
    seen = STANDING._replace(
        latched=(Cause.OVERSHOT,), station_cause=Cause.OVERSHOT, overshot_little=True
    )

    assert latched_after(Supervision.EMERGENCY, seen) == ()


@given(
    st.lists(st.sampled_from(CAUSES), unique=True).map(tuple),
    st.integers(0, 3),
    st.booleans(),
    st.sampled_from(list(Supervision)),
)
def test_no_latched_cause_is_released_without_standstill_and_reset(
    latched: tuple[Cause, ...], resets: int, standstill: bool, state: Supervision
) -> None:
    seen = STANDING._replace(latched=latched, resets=resets, standstill=standstill)

    left = latched_after(state, seen)

    assert set(left) <= set(latched)
    if not standstill or resets == 0:
        assert left == latched


def test_an_emergency_is_supervised_like_a_held_train() -> None:
    assert LOOKED_AT[Supervision.EMERGENCY] is LOOKED_AT[Supervision.NO_AUTHORITY]
    assert set(LOOKED_AT) == set(Supervision)
