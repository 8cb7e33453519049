"""Supervision: from what protection sees to its state. A table and the guards it names."""

from collections.abc import Callable, Mapping
from typing import Final

from can_dbc.vobc import OperatingMode, Supervision
from vobc.atp.emergencies import surely_slower
from vobc.atp.modes import NEEDED, SUPERVISED, authority_is_fresh
from vobc.atp.seen import GuardInputs

Guard = Callable[[GuardInputs], bool]


def emergency(seen: GuardInputs) -> bool:
    """At least one cause of `vobc.atp.emergencies` is there, or not released yet."""
    return bool(seen.latched)


def emergency_released(seen: GuardInputs) -> bool:
    return not seen.latched


def movement_permitted(seen: GuardInputs) -> bool:
    return seen.mode in NEEDED


def movement_over(seen: GuardInputs) -> bool:
    return seen.mode not in NEEDED


def over_warning(seen: GuardInputs) -> bool:
    """The best estimate: a warning that came by uncertainty alone would not be heeded for long."""
    return not seen.standing and not abs(seen.speed_mps.best) < seen.ceiling.warning_mps


def service_needed(seen: GuardInputs) -> bool:
    """Over the limit, an authority that gets old, nobody who answers for driving on sight, or a
    stop that was asked for and does not come.
    """
    return over_service(seen) or authority_ages(seen) or permission_gone(seen) or stops_not(seen)


def over_service(seen: GuardInputs) -> bool:
    return not seen.standing and not surely_slower(seen, seen.ceiling.service_mps)


def authority_ages(seen: GuardInputs) -> bool:
    return seen.mode in SUPERVISED and not authority_is_fresh(seen)


def permission_gone(seen: GuardInputs) -> bool:
    """Whoever answers for a movement on sight does so no more."""
    if seen.mode is OperatingMode.RESTRICTED:
        return not seen.person_at_desk
    return seen.mode is OperatingMode.CREEP and not seen.creep_ordered


def stops_not(seen: GuardInputs) -> bool:
    """Asked to stop now, operation does not."""
    return not seen.standing and not abs(seen.speed_mps.best) <= seen.stop_by_mps


def under_ceiling(seen: GuardInputs) -> bool:
    """Back where nothing is exceeded and nothing else asks for the brake."""
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
"""Emergency is latched. It leads back only to the held state, from which the operating mode lets
the train go; so does the state at start, where nothing is latched."""


def next_state(state: Supervision, seen: GuardInputs) -> Supervision:
    """The first guard that holds decides; when none holds the state stays."""
    for guard, target in TRANSITIONS[state]:
        if guard(seen):
            return target
    return state
