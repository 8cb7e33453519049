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


def told_to_sleep(inputs: GuardInputs) -> bool:
    return inputs.sleep_ordered and inputs.at_rest


def woken(inputs: GuardInputs) -> bool:
    return not inputs.sleep_ordered


def emergency_at_rest(inputs: GuardInputs) -> bool:
    """After an emergency the earlier permission must be requested again."""
    return inputs.standing and bool(inputs.latched)


def ready_at_standstill(inputs: GuardInputs) -> bool:
    """No movement begins on an authority that is about to expire."""
    return _may_begin(inputs, OperatingMode.AUTHORISED) and authority_is_fresh(inputs)


def creep_ordered(inputs: GuardInputs) -> bool:
    return inputs.creep_ordered and _may_begin(inputs, OperatingMode.CREEP)


def sight_asked(inputs: GuardInputs) -> bool:
    return inputs.sight_asked and _may_begin(inputs, OperatingMode.RESTRICTED)


def _may_begin(inputs: GuardInputs, mode: OperatingMode) -> bool:
    return inputs.at_rest and not inputs.latched and not inputs.missing & NEEDED[mode]


def authority_is_fresh(inputs: GuardInputs) -> bool:
    """The authority and its restrictions are young enough to need no service brake."""
    limits = inputs.limits
    return (
        inputs.authority_age_s < limits.authority_service_ratio * limits.authority_age_max_s
        and restrictions_are_fresh(inputs)
    )


def restrictions_are_fresh(inputs: GuardInputs) -> bool:
    limits = inputs.limits
    return (
        inputs.restrictions_age_s < limits.authority_service_ratio * limits.restrictions_age_max_s
    )


def place_and_authority_found(inputs: GuardInputs) -> bool:
    """Full supervision takes over a train only if its speed is well below the ceiling."""
    quick_mps = inputs.speed_mps.high + inputs.limits.takeover_margin_mps
    return (
        not inputs.latched
        and not inputs.missing & NEEDED[OperatingMode.AUTHORISED]
        and authority_is_fresh(inputs)
        and (inputs.standing or quick_mps <= inputs.full_mps)
    )


def lacks_at_rest(inputs: GuardInputs) -> bool:
    """The quick sign of standstill is enough to hold a train. Releasing it needs the proof."""
    return inputs.standing and bool(inputs.missing & NEEDED[inputs.mode])


def person_gone_at_rest(inputs: GuardInputs) -> bool:
    return inputs.standing and not inputs.person_at_desk


def creep_over_at_rest(inputs: GuardInputs) -> bool:
    return inputs.standing and not inputs.creep_ordered


def jog_granted(inputs: GuardInputs) -> bool:
    return inputs.standing and inputs.jog_granted


def jog_over_at_rest(inputs: GuardInputs) -> bool:
    return inputs.standing and not inputs.jog_granted


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


def next_mode(mode: OperatingMode, inputs: GuardInputs) -> OperatingMode:
    """Follow the first guard that holds. If none holds, the mode stays."""
    for guard, target in TRANSITIONS[mode]:
        if guard(inputs):
            return target
    return mode
