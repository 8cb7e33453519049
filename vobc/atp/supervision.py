"""Supervision states of protection: a transition table and its guards."""

from collections.abc import Callable, Mapping
from typing import Final

from can_dbc.vobc import OperatingMode, Supervision
from vobc.atp.emergencies import surely_slower
from vobc.atp.guard_inputs import GuardInputs
from vobc.atp.modes import NEEDED, SUPERVISED, authority_is_fresh

Guard = Callable[[GuardInputs], bool]


def emergency(inputs: GuardInputs) -> bool:
    """At least one cause of `vobc.atp.emergencies` is present or not released yet."""
    return bool(inputs.latched)


def emergency_released(inputs: GuardInputs) -> bool:
    return not inputs.latched


def movement_permitted(inputs: GuardInputs) -> bool:
    return inputs.mode in NEEDED


def movement_over(inputs: GuardInputs) -> bool:
    return inputs.mode not in NEEDED


def over_warning(inputs: GuardInputs) -> bool:
    """The best estimate reaches the warning limit.

    A warning by uncertainty alone would soon be ignored.
    """
    return not inputs.standing and not abs(inputs.speed_mps.best) < inputs.ceiling.warning_mps


def service_needed(inputs: GuardInputs) -> bool:
    """The service brake is needed.

    Reasons: speed over the limit, an ageing authority, no permission for driving on sight, or a
    requested stop that does not happen.
    """
    return (
        over_service(inputs)
        or authority_ages(inputs)
        or permission_gone(inputs)
        or stops_not(inputs)
    )


def over_service(inputs: GuardInputs) -> bool:
    return not inputs.standing and not surely_slower(inputs, inputs.ceiling.service_mps)


def authority_ages(inputs: GuardInputs) -> bool:
    return inputs.mode in SUPERVISED and not authority_is_fresh(inputs)


def permission_gone(inputs: GuardInputs) -> bool:
    """The permission for a movement on sight has ended."""
    if inputs.mode is OperatingMode.RESTRICTED:
        return not inputs.person_at_desk
    return inputs.mode is OperatingMode.CREEP and not inputs.creep_ordered


def stops_not(inputs: GuardInputs) -> bool:
    """Operation does not stop although requested."""
    return not inputs.standing and not abs(inputs.speed_mps.best) <= inputs.stop_by_mps


def under_ceiling(inputs: GuardInputs) -> bool:
    """No limit is exceeded any more, and nothing else requires the brake."""
    under = inputs.standing or abs(inputs.speed_mps.best) < inputs.ceiling.permitted_mps
    return under and not service_needed(inputs)


TRANSITIONS: Final[Mapping[Supervision, tuple[tuple[Guard, Supervision], ...]]] = {
    Supervision.NO_AUTHORITY: (
        (emergency, Supervision.EMERGENCY),
        (movement_permitted, Supervision.NOMINAL),
    ),
    Supervision.NOMINAL: (
        (emergency, Supervision.EMERGENCY),
        (movement_over, Supervision.NO_AUTHORITY),
        (service_needed, Supervision.SERVICE),
        (over_warning, Supervision.WARNING),
    ),
    Supervision.WARNING: (
        (emergency, Supervision.EMERGENCY),
        (movement_over, Supervision.NO_AUTHORITY),
        (service_needed, Supervision.SERVICE),
        (under_ceiling, Supervision.NOMINAL),
    ),
    Supervision.SERVICE: (
        (emergency, Supervision.EMERGENCY),
        (movement_over, Supervision.NO_AUTHORITY),
        (under_ceiling, Supervision.NOMINAL),
    ),
    Supervision.EMERGENCY: ((emergency_released, Supervision.NO_AUTHORITY),),
}
"""EMERGENCY is latched. It leads only to the held state, from which the operating mode releases the
train. The held state is also the state at start, where nothing is latched."""


def next_state(state: Supervision, inputs: GuardInputs) -> Supervision:
    """Follow the first guard that holds. If none holds, the state stays."""
    for guard, target in TRANSITIONS[state]:
        if guard(inputs):
            return target
    return state
