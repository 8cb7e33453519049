"""Text for the application and release of the emergency brake, with the deciding numbers."""

from collections.abc import Callable, Mapping
from typing import Final

from can_dbc.vobc import Cause, EventKind
from vobc.events.words import flag_words, place_words
from vobc.vocabulary import CycleInput, CycleOutput, Event, Source

Tell = Callable[[CycleInput, CycleOutput], str]
"""Returns an empty text if the numbers are not known."""

CAUSE_SOURCES: Final[Mapping[Cause, tuple[Source, ...]]] = {
    Cause.NONE: (),
    Cause.OVERSPEED: (Source.TACHO, Source.AUTHORITY, Source.DOPPLER),
    Cause.AUTHORITY_OLD: (Source.AUTHORITY,),
    Cause.ROLLBACK: (Source.TACHO,),
    Cause.HELD_TRAIN_MOVED: (Source.TACHO, Source.BRAKE),
    Cause.VITAL_INPUT_LOST: (Source.BRAKE, Source.TRACTION, Source.TACHO, Source.DESK),
    Cause.LOCALISATION_LOST: (Source.TAG, Source.TACHO),
    Cause.BUTTON: (Source.DESK,),
    Cause.OVERRUN: (Source.CLOCK,),
    Cause.NOT_FINITE: (),
    Cause.BRAKE_UNIT: (Source.BRAKE,),
    Cause.REMOTE: (Source.ORDERS,),
    Cause.OBSTACLE: (Source.ALARMS,),
    Cause.DOOR_UNLOCKED: (Source.DOORS, Source.TACHO),
    Cause.PASSENGER_ALARM: (Source.DESK, Source.TACHO),
    Cause.OVERSHOT: (Source.TACHO, Source.TAG),
    Cause.WRONG_DIRECTION: (Source.TACHO,),
    Cause.REPLICAS_DISAGREE: (Source.TACHO, Source.AUTHORITY),
    Cause.CLOCK_STEPPED: (Source.CLOCK,),
    Cause.JOG_EXCEEDED: (Source.TACHO,),
    Cause.PAST_AUTHORITY: (Source.AUTHORITY, Source.TACHO),
    Cause.ASLEEP_MOVED: (Source.TACHO, Source.COLD),
}
"""Inputs that each cause is decided from, the most important one first."""


def emergency_applied(before: CycleOutput, inputs: CycleInput, output: CycleOutput) -> Event:
    """The emergency brake is applied, or stays applied for another cause."""
    cause = output.emergency_cause
    again = before.supervision is output.supervision
    words = "emergency brake stays on, now for another cause" if again else "emergency brake"
    tell = TELLERS.get(cause)
    reason = (tell(inputs, output) if tell is not None else "") or _own_words(output)
    return Event(
        EventKind.EMERGENCY_APPLIED,
        f"{words}: {reason}{place_words(output)}",
        CAUSE_SOURCES[cause],
        int(cause),
    )


def emergency_released(
    before: CycleOutput, inputs: CycleInput, output: CycleOutput, inputs_before: CycleInput | None
) -> Event:
    """Release of the emergency brake by the source of the reset in this cycle, or by itself."""
    desk, orders = inputs.desk, inputs.orders
    told_before = None if inputs_before is None else inputs_before.orders
    by, sources = "by itself at standstill", (Source.TACHO,)
    if desk is not None and desk.reset_requested:
        by, sources = "by a reset at the desk", (Source.DESK,)
    elif orders is not None and told_before is not None and orders.releases > told_before.releases:
        by, sources = f"by reset {orders.releases} of the centre", (Source.ORDERS,)
    words = f"emergency brake released {by}; its cause was: {_own_words(before)}"
    return Event(
        EventKind.EMERGENCY_RELEASED,
        words + place_words(output),
        sources,
        int(before.emergency_cause),
    )


def _own_words(output: CycleOutput) -> str:
    """Text of the cause as protection states it."""
    return output.cause or output.emergency_cause.name.replace("_", " ").lower()


def _overspeed(_: CycleInput, output: CycleOutput) -> str:
    motion, ceiling = output.motion, output.ceiling
    if motion is None or ceiling is None:
        return ""
    return (
        f"speed {motion.speed_mps.high:.2f} m/s reached the emergency limit of"
        f" {ceiling.emergency_mps:.2f} m/s, {ceiling.distance_to_authority_m:.1f} m before the end"
        " of authority"
    )


def _authority_old(inputs: CycleInput, _: CycleOutput) -> str:
    authority = inputs.authority
    if authority is None:
        return "there is no movement authority"
    return (
        f"the movement authority to {authority.end_m:.1f} m (term {authority.term}, sequence"
        f" {authority.sequence}) is {inputs.authority_age_s:.2f} s old, and the orders with its"
        f" restrictions {inputs.orders_age_s:.2f} s"
    )


def _past_authority(inputs: CycleInput, output: CycleOutput) -> str:
    authority, motion = inputs.authority, output.motion
    if authority is None or motion is None:
        return ""
    return (
        f"the front may stand at {motion.front_m.high:.2f} m, the authority ends at"
        f" {authority.end_m:.2f} m"
    )


def _input_lost(inputs: CycleInput, output: CycleOutput) -> str:
    ages = (
        f"brake {inputs.brake_age_s:.2f} s, traction {inputs.traction_age_s:.2f} s, tacho"
        f" {inputs.tacho_age_s:.2f} s, desk {inputs.desk_age_s:.2f} s"
    )
    return f"lost while moving: {flag_words(output.missing)}; last received: {ages} ago"


def _localisation_lost(_: CycleInput, output: CycleOutput) -> str:
    cause = "" if output.motion is None else output.motion.lost_cause
    return f"{_own_words(output)}{': ' if cause else ''}{cause}"


def _overrun(inputs: CycleInput, _: CycleOutput) -> str:
    return f"{inputs.overruns} control cycles missed in a row, {inputs.dt_s:.3f} s without control"


def _clock_stepped(inputs: CycleInput, _: CycleOutput) -> str:
    return f"the clock stepped: {inputs.dt_s:.3f} s since the cycle before"


def _brake_unit(inputs: CycleInput, output: CycleOutput) -> str:
    brake = inputs.brake
    pressed = "" if brake is None else f", {brake.applied_decel_mps2:.2f} m/s² applied"
    return f"{_own_words(output)}{pressed}"


TELLERS: Final[Mapping[Cause, Tell]] = {
    Cause.OVERSPEED: _overspeed,
    Cause.AUTHORITY_OLD: _authority_old,
    Cause.PAST_AUTHORITY: _past_authority,
    Cause.VITAL_INPUT_LOST: _input_lost,
    Cause.LOCALISATION_LOST: _localisation_lost,
    Cause.OVERRUN: _overrun,
    Cause.CLOCK_STEPPED: _clock_stepped,
    Cause.BRAKE_UNIT: _brake_unit,
}
"""Causes with specific numbers. For the others, speed and place are enough."""
