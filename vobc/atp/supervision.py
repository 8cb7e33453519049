"""Supervision states of protection: a transition table and its guards."""

from collections.abc import Callable, Mapping
from typing import Final

from can_dbc.vobc import OperatingMode, Supervision
from vobc.atp.emergencies import surely_slower
from vobc.atp.guard_inputs import GuardInputs
from vobc.atp.modes import NEEDED, SUPERVISED, authority_is_fresh

Guard = Callable[[GuardInputs], bool]


def emergency(seen: GuardInputs) -> bool:
    """At least one cause of `vobc.atp.emergencies` is present or not released yet."""
    return bool(seen.latched)


def emergency_released(seen: GuardInputs) -> bool:
    return not seen.latched


def movement_permitted(seen: GuardInputs) -> bool:
    return seen.mode in NEEDED


def movement_over(seen: GuardInputs) -> bool:
    return seen.mode not in NEEDED


def over_warning(seen: GuardInputs) -> bool:
    """The best estimate reaches the warning limit.

    A warning by uncertainty alone would soon be ignored.
    """
    return not seen.standing and not abs(seen.speed_mps.best) < seen.ceiling.warning_mps


def service_needed(seen: GuardInputs) -> bool:
    """The service brake is needed.

    Reasons: speed over the limit, an ageing authority, no permission for driving on sight, or a
    requested stop that does not happen.
    """
    return over_service(seen) or authority_ages(seen) or permission_gone(seen) or stops_not(seen)


def over_service(seen: GuardInputs) -> bool:
    return not seen.standing and not surely_slower(seen, seen.ceiling.service_mps)


def authority_ages(seen: GuardInputs) -> bool:
    return seen.mode in SUPERVISED and not authority_is_fresh(seen)


def permission_gone(seen: GuardInputs) -> bool:
    """The permission for a movement on sight has ended."""
    if seen.mode is OperatingMode.RESTRICTED:
        return not seen.person_at_desk
    return seen.mode is OperatingMode.CREEP and not seen.creep_ordered


def stops_not(seen: GuardInputs) -> bool:
    """Operation does not stop although requested."""
    return not seen.standing and not abs(seen.speed_mps.best) <= seen.stop_by_mps


def under_ceiling(seen: GuardInputs) -> bool:
    """No limit is exceeded any more, and nothing else requires the brake."""
    under = seen.standing or abs(seen.speed_mps.best) < seen.ceiling.permitted_mps
    return under and not service_needed(seen)


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


def next_state(state: Supervision, seen: GuardInputs) -> Supervision:
    """Follow the first guard that holds. If none holds, the state stays."""
    for guard, target in TRANSITIONS[state]:
        if guard(seen):
            return target
    return state
