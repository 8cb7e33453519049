"""Operating modes: kinds of supervised movement and their requirements, as a table."""

from collections.abc import Callable, Mapping
from typing import Final

from can_dbc.vobc import Inhibit, OperatingMode
from vobc.atp.departure import NOT_AGAINST_JOG
from vobc.atp.guard_inputs import GuardInputs
from vobc.atp.inputs import (
    ALARMS,
    AUTHORITY,
    BRAKE,
    DESK,
    DOORS,
    LOCALISATION,
    ODOMETER,
    TAG_READER,
    TRACTION,
)

Guard = Callable[[GuardInputs], bool]

ON_SIGHT: Final = BRAKE | TRACTION | ODOMETER | DOORS | DESK
"""Inputs without which no movement begins."""
PLACED: Final = ON_SIGHT | ALARMS | TAG_READER | AUTHORITY | LOCALISATION

NEEDED: Final[Mapping[OperatingMode, int]] = {
    OperatingMode.RESTRICTED: ON_SIGHT,
    # No driver looks out of the front window.
    OperatingMode.CREEP: ON_SIGHT | ALARMS,
    OperatingMode.AUTHORISED: PLACED,
    OperatingMode.JOG: PLACED,
}
"""Inputs that a mode needs to begin a movement, as flags of `Missing`. A mode that is not listed
does not move."""

SUPERVISED: Final = frozenset({OperatingMode.AUTHORISED, OperatingMode.JOG})
"""Modes that need a movement authority and a known place."""

UNHEEDED: Final[Mapping[OperatingMode, Inhibit]] = {
    OperatingMode.ASLEEP: Inhibit.NONE,
    OperatingMode.STANDBY: Inhibit.NONE,
    OperatingMode.RESTRICTED: Inhibit.AUTHORITY | Inhibit.CENTRE_SILENT,
    OperatingMode.CREEP: Inhibit.AUTHORITY,
    OperatingMode.AUTHORISED: Inhibit.NONE,
    OperatingMode.JOG: NOT_AGAINST_JOG,
}
"""Departure inhibits that do not prevent movement in this mode."""


def told_to_sleep(seen: GuardInputs) -> bool:
    return seen.sleep_ordered and seen.at_rest


def woken(seen: GuardInputs) -> bool:
    return not seen.sleep_ordered


def emergency_at_rest(seen: GuardInputs) -> bool:
    """After an emergency the earlier permission must be requested again."""
    return seen.standing and bool(seen.latched)


def ready_at_standstill(seen: GuardInputs) -> bool:
    """No movement begins on an authority that is about to expire."""
    return _may_begin(seen, OperatingMode.AUTHORISED) and authority_is_fresh(seen)


def creep_ordered(seen: GuardInputs) -> bool:
    return seen.creep_ordered and _may_begin(seen, OperatingMode.CREEP)


def sight_asked(seen: GuardInputs) -> bool:
    return seen.sight_asked and _may_begin(seen, OperatingMode.RESTRICTED)


def _may_begin(seen: GuardInputs, mode: OperatingMode) -> bool:
    return seen.at_rest and not seen.latched and not seen.missing & NEEDED[mode]


def authority_is_fresh(seen: GuardInputs) -> bool:
    """The authority is young enough to need no service brake."""
    limits = seen.limits
    return seen.authority_age_s < limits.authority_service_ratio * limits.authority_age_max_s


def place_and_authority_found(seen: GuardInputs) -> bool:
    """Full supervision takes over a train only if its speed is well below the ceiling."""
    quick_mps = seen.speed_mps.high + seen.limits.takeover_margin_mps
    return (
        not seen.latched
        and not seen.missing & NEEDED[OperatingMode.AUTHORISED]
        and authority_is_fresh(seen)
        and (seen.standing or quick_mps <= seen.full_mps)
    )


def lacks_at_rest(seen: GuardInputs) -> bool:
    """The quick sign of standstill is enough to hold a train. Releasing it needs the proof."""
    return seen.standing and bool(seen.missing & NEEDED[seen.mode])


def person_gone_at_rest(seen: GuardInputs) -> bool:
    return seen.standing and not seen.person_at_desk


def creep_over_at_rest(seen: GuardInputs) -> bool:
    return seen.standing and not seen.creep_ordered


def jog_granted(seen: GuardInputs) -> bool:
    return seen.standing and seen.jog_granted


def jog_over_at_rest(seen: GuardInputs) -> bool:
    return seen.standing and not seen.jog_granted


_ENDS: Final = (
    (emergency_at_rest, OperatingMode.STANDBY),
    (told_to_sleep, OperatingMode.ASLEEP),
    (lacks_at_rest, OperatingMode.STANDBY),
)
"""Ends of every movement. They apply only at rest; supervision handles a moving train."""

TRANSITIONS: Final[Mapping[OperatingMode, tuple[tuple[Guard, OperatingMode], ...]]] = {
    OperatingMode.ASLEEP: ((woken, OperatingMode.STANDBY),),
    OperatingMode.STANDBY: (
        (told_to_sleep, OperatingMode.ASLEEP),
        (ready_at_standstill, OperatingMode.AUTHORISED),
        (creep_ordered, OperatingMode.CREEP),
        (sight_asked, OperatingMode.RESTRICTED),
    ),
    OperatingMode.RESTRICTED: (
        *_ENDS,
        (place_and_authority_found, OperatingMode.AUTHORISED),
        (person_gone_at_rest, OperatingMode.STANDBY),
    ),
    OperatingMode.CREEP: (
        *_ENDS,
        (place_and_authority_found, OperatingMode.AUTHORISED),
        (creep_over_at_rest, OperatingMode.STANDBY),
    ),
    OperatingMode.AUTHORISED: (
        *_ENDS,
        (jog_granted, OperatingMode.JOG),
    ),
    OperatingMode.JOG: (
        *_ENDS,
        (jog_over_at_rest, OperatingMode.AUTHORISED),
    ),
}
"""A moving train can only change to full supervision."""


def next_mode(mode: OperatingMode, seen: GuardInputs) -> OperatingMode:
    """Follow the first guard that holds. If none holds, the mode stays."""
    for guard, target in TRANSITIONS[mode]:
        if guard(seen):
            return target
    return mode
