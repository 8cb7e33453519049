"""Causes of the emergency brake and who may release it, in one table."""

import enum
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

from can_dbc.vobc import Cause, OperatingMode, Supervision
from vobc.atp.guard_inputs import GuardInputs
from vobc.atp.inputs import LOCALISATION, VITAL_IN_MOTION
from vobc.atp.modes import SUPERVISED

Guard = Callable[[GuardInputs], bool]


class When(enum.Enum):
    """States of supervision in which a cause is checked."""

    MOVING = "while the train may move"
    HELD = "while it is held"
    ALWAYS = "always"


class Reset(enum.IntFlag):
    """Who may reset a cause at standstill once it is gone."""

    DESK = 1
    CENTRE = 2


# Speed.


def over_emergency(inputs: GuardInputs) -> bool:
    """A bound of the speed reaches the limit. A standing train never exceeds it.

    Under full supervision the second computation may find it first. Either of the two is enough.
    """
    return not inputs.standing and (
        not surely_slower(inputs, inputs.ceiling.emergency_mps)
        or (inputs.mode in SUPERVISED and inputs.energy_exceeded)
    )


def surely_slower(inputs: GuardInputs, limit_mps: float) -> bool:
    """Both bounds of the speed, forwards and backwards, are below the limit. NaN is not."""
    return -limit_mps < inputs.speed_mps.low and inputs.speed_mps.high < limit_mps


def past_authority(inputs: GuardInputs) -> bool:
    return (
        not inputs.standing
        and inputs.mode in SUPERVISED
        and not inputs.ceiling.distance_to_authority_m >= 0.0
    )


def authority_too_old(inputs: GuardInputs) -> bool:
    """The authority or its restrictions are too old."""
    return (
        not inputs.standing
        and inputs.mode in SUPERVISED
        and (
            not inputs.authority_age_s < inputs.limits.authority_age_max_s
            or not inputs.restrictions_age_s < inputs.limits.restrictions_age_max_s
        )
    )


# Place and direction.


def rolled_back(inputs: GuardInputs) -> bool:
    """The train rolled back too far, or could no longer be held within the limit of the line."""
    return not inputs.rollback_m < inputs.limits.rollback_m or not inputs.rollback_room_m > 0.0


def backed_too_far(inputs: GuardInputs) -> bool:
    """The train is farther back than the place that protects the rear during a jog."""
    return not inputs.behind_jog_m < inputs.limits.rollback_m


def jog_exceeded(inputs: GuardInputs) -> bool:
    return (
        inputs.station_cause is Cause.JOG_EXCEEDED
        or not inputs.jog_movement_m < inputs.limits.jog_m
    )


def moved_while_held(inputs: GuardInputs) -> bool:
    return inputs.mode is not OperatingMode.ASLEEP and _moved(inputs)


def moved_while_asleep(inputs: GuardInputs) -> bool:
    return inputs.mode is OperatingMode.ASLEEP and _moved(inputs)


def _moved(inputs: GuardInputs) -> bool:
    return not inputs.held_movement_m < inputs.limits.held_movement_m


# Inputs and the controller itself.


def vital_lost(inputs: GuardInputs) -> bool:
    """A vital input is silent.

    A unit that reports not ready still answers, and the train may coast.
    """
    return not inputs.standing and bool(inputs.silent & VITAL_IN_MOTION)


def localisation_lost(inputs: GuardInputs) -> bool:
    return not inputs.standing and inputs.mode in SUPERVISED and bool(inputs.missing & LOCALISATION)


def brake_unit_braked(inputs: GuardInputs) -> bool:
    return not inputs.standing and inputs.brake_unit_braked


def overrun(inputs: GuardInputs) -> bool:
    return not inputs.standing and inputs.overruns > inputs.limits.overruns_max


def not_finite(inputs: GuardInputs) -> bool:
    return inputs.not_finite


def clock_stepped(inputs: GuardInputs) -> bool:
    return inputs.clock_stepped


def replicas_disagree(inputs: GuardInputs) -> bool:
    return inputs.replicas_disagree


# People, centre, stations.


def button(inputs: GuardInputs) -> bool:
    return inputs.button_pressed


def ordered_by_centre(inputs: GuardInputs) -> bool:
    return inputs.ordered_to_stop


def obstacle(inputs: GuardInputs) -> bool:
    return inputs.station_cause is Cause.OBSTACLE


def door_unlocked(inputs: GuardInputs) -> bool:
    return inputs.station_cause is Cause.DOOR_UNLOCKED


def passenger_alarm(inputs: GuardInputs) -> bool:
    return inputs.station_cause is Cause.PASSENGER_ALARM


def overshot(inputs: GuardInputs) -> bool:
    return inputs.station_cause is Cause.OVERSHOT


def overshot_little(inputs: GuardInputs) -> bool:
    return inputs.overshot_little


def never(_seen: GuardInputs) -> bool:
    return False


@dataclass(frozen=True, slots=True)
class EmergencyRule:
    """One cause with its conditions for application and release."""

    cause: Cause
    comes: Guard
    """Condition of the cause. In the states where it is checked, it also prevents the release."""
    when: When
    reset_by: Reset
    words: str
    """Text for the log and the driver's desk."""
    by_itself: Guard = never
    """While this holds at standstill, the cause needs no reset."""


EITHER: Final = Reset.DESK | Reset.CENTRE

RULES: Final = (
    # Causes that invalidate every other result come first, then people, then the train.
    EmergencyRule(Cause.NOT_FINITE, not_finite, When.ALWAYS, Reset.DESK, "a number was not finite"),
    EmergencyRule(Cause.CLOCK_STEPPED, clock_stepped, When.ALWAYS, Reset.DESK, "the clock stepped"),
    EmergencyRule(
        Cause.REPLICAS_DISAGREE,
        replicas_disagree,
        When.ALWAYS,
        Reset.DESK,
        "the two computations of protection disagree",
    ),
    EmergencyRule(Cause.BUTTON, button, When.ALWAYS, Reset.DESK, "emergency button pressed"),
    EmergencyRule(
        Cause.REMOTE, ordered_by_centre, When.ALWAYS, Reset.CENTRE, "ordered by the centre"
    ),
    EmergencyRule(Cause.OBSTACLE, obstacle, When.ALWAYS, EITHER, "obstacle touched"),
    EmergencyRule(
        Cause.DOOR_UNLOCKED,
        door_unlocked,
        When.MOVING,
        EITHER,
        "doors not locked at or leaving a platform",
    ),
    EmergencyRule(
        Cause.PASSENGER_ALARM,
        passenger_alarm,
        When.MOVING,
        EITHER,
        "passenger alarm at or leaving a platform",
    ),
    EmergencyRule(
        Cause.OVERSHOT,
        overshot,
        When.MOVING,
        Reset.CENTRE,
        "stopping point overshot",
        by_itself=overshot_little,
    ),
    EmergencyRule(
        Cause.VITAL_INPUT_LOST,
        vital_lost,
        When.MOVING,
        EITHER,
        "vital input lost while moving",
    ),
    EmergencyRule(
        Cause.BRAKE_UNIT,
        brake_unit_braked,
        When.MOVING,
        EITHER,
        "the brake unit braked by itself",
    ),
    EmergencyRule(
        Cause.LOCALISATION_LOST,
        localisation_lost,
        When.MOVING,
        EITHER,
        "localisation lost while moving",
    ),
    EmergencyRule(
        Cause.AUTHORITY_OLD,
        authority_too_old,
        When.MOVING,
        EITHER,
        "movement authority or its restrictions too old",
    ),
    EmergencyRule(
        Cause.PAST_AUTHORITY,
        past_authority,
        When.MOVING,
        EITHER,
        "front may be beyond the end of authority",
    ),
    EmergencyRule(
        Cause.OVERSPEED,
        over_emergency,
        When.MOVING,
        EITHER,
        "speed at or over the emergency limit",
    ),
    EmergencyRule(
        Cause.WRONG_DIRECTION,
        backed_too_far,
        When.MOVING,
        EITHER,
        "train moves against its direction",
    ),
    EmergencyRule(Cause.ROLLBACK, rolled_back, When.MOVING, EITHER, "train rolled back"),
    EmergencyRule(
        Cause.JOG_EXCEEDED,
        jog_exceeded,
        When.MOVING,
        EITHER,
        "jog too far, too fast or once too often",
    ),
    EmergencyRule(Cause.OVERRUN, overrun, When.MOVING, EITHER, "control cycles missed"),
    EmergencyRule(
        Cause.ASLEEP_MOVED,
        moved_while_asleep,
        When.HELD,
        EITHER,
        "train moved while asleep",
    ),
    EmergencyRule(
        Cause.HELD_TRAIN_MOVED,
        moved_while_held,
        When.HELD,
        EITHER,
        "train moved while it was to be held",
    ),
)
"""The first rule that holds names the emergency."""

RULE_OF: Final = {rule.cause: rule for rule in RULES}

_HELD: Final = tuple(rule for rule in RULES if rule.when is not When.MOVING)
_MOVING: Final = tuple(rule for rule in RULES if rule.when is not When.HELD)

LOOKED_AT: Final = {
    Supervision.NO_AUTHORITY: _HELD,
    Supervision.NOMINAL: _MOVING,
    Supervision.WARNING: _MOVING,
    Supervision.SERVICE: _MOVING,
    Supervision.EMERGENCY: _HELD,
}
"""Rules checked in each state. A train under the emergency brake counts as held."""


def latched_after(state: Supervision, inputs: GuardInputs) -> tuple[Cause, ...]:
    """Causes that keep the emergency brake on: earlier ones not yet released, and new ones.

    Each cause is released by the source that its rule names. The brake is released when no cause is
    left.
    """
    kept = [cause for cause in inputs.latched if not released(RULE_OF[cause], inputs)]
    for rule in LOOKED_AT[state]:
        if rule.comes(inputs) and rule.cause not in kept:
            kept.append(rule.cause)
    return tuple(kept)


def present(causes: tuple[Cause, ...], inputs: GuardInputs) -> tuple[Cause, ...]:
    """Those of the causes that are always checked and present now."""
    rules = [RULE_OF[cause] for cause in causes]
    return tuple([rule.cause for rule in rules if rule.when is When.ALWAYS and rule.comes(inputs)])


def released(rule: EmergencyRule, inputs: GuardInputs) -> bool:
    """The train stands, the cause is gone, and a permitted source has just reset it."""
    if not inputs.at_rest or (rule.when is When.ALWAYS and rule.comes(inputs)):
        return False
    return bool(inputs.resets & rule.reset_by) or rule.by_itself(inputs)


def in_cause_words(cause: Cause) -> str:
    return RULE_OF[cause].words
