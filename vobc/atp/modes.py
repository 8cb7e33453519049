"""Operating modes: which kind of movement is supervised, and what it needs. A table."""

from collections.abc import Callable, Mapping
from typing import Final

from can_dbc.vobc import Inhibit, OperatingMode
from vobc.atp.departure import NOT_AGAINST_JOG
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
from vobc.atp.seen import GuardInputs

Guard = Callable[[GuardInputs], bool]

ON_SIGHT: Final = BRAKE | TRACTION | ODOMETER | DOORS | DESK
"""Without these nothing ever moves."""
PLACED: Final = ON_SIGHT | ALARMS | TAG_READER | AUTHORITY | LOCALISATION

NEEDED: Final[Mapping[OperatingMode, int]] = {
    OperatingMode.RESTRICTED: ON_SIGHT,
    # Nobody looks out of the front window.
    OperatingMode.CREEP: ON_SIGHT | ALARMS,
    OperatingMode.AUTHORISED: PLACED,
    OperatingMode.JOG: PLACED,
}
"""What must not be missing when a movement begins, as flags of `Missing`. A mode that is not in
here does not move."""

SUPERVISED: Final = frozenset({OperatingMode.AUTHORISED, OperatingMode.JOG})
"""Modes that rest on a movement authority and on knowing the place."""

UNHEEDED: Final[Mapping[OperatingMode, Inhibit]] = {
    OperatingMode.ASLEEP: Inhibit.NONE,
    OperatingMode.STANDBY: Inhibit.NONE,
    OperatingMode.RESTRICTED: Inhibit.AUTHORITY | Inhibit.CENTRE_SILENT,
    OperatingMode.CREEP: Inhibit.AUTHORITY,
    OperatingMode.AUTHORISED: Inhibit.NONE,
    OperatingMode.JOG: NOT_AGAINST_JOG,
}
"""What keeps a train from departing, but not from moving in this mode."""


def told_to_sleep(seen: GuardInputs) -> bool:
    return seen.sleep_ordered and seen.at_rest


def woken(seen: GuardInputs) -> bool:
    return not seen.sleep_ordered


def emergency_at_rest(seen: GuardInputs) -> bool:
    """What was permitted before an emergency has to be asked for again."""
    return seen.standing and bool(seen.latched)


def ready_at_standstill(seen: GuardInputs) -> bool:
    """On an authority that the next moment makes too old nothing begins."""
    return _may_begin(seen, OperatingMode.AUTHORISED) and authority_is_fresh(seen)


def creep_ordered(seen: GuardInputs) -> bool:
    return seen.creep_ordered and _may_begin(seen, OperatingMode.CREEP)


def sight_asked(seen: GuardInputs) -> bool:
    return seen.sight_asked and _may_begin(seen, OperatingMode.RESTRICTED)


def _may_begin(seen: GuardInputs, mode: OperatingMode) -> bool:
    return seen.at_rest and not seen.latched and not seen.missing & NEEDED[mode]


def authority_is_fresh(seen: GuardInputs) -> bool:
    """Far from too old: it asks for no service brake yet."""
    limits = seen.limits
    return seen.authority_age_s < limits.authority_service_ratio * limits.authority_age_max_s


def place_and_authority_found(seen: GuardInputs) -> bool:
    """Full supervision takes over only from a train that is already well within it."""
    quick_mps = seen.speed_mps.high + seen.limits.takeover_margin_mps
    return (
        not seen.latched
        and not seen.missing & NEEDED[OperatingMode.AUTHORISED]
        and authority_is_fresh(seen)
        and (seen.standing or quick_mps <= seen.full_mps)
    )


def lacks_at_rest(seen: GuardInputs) -> bool:
    """The quick sign is enough to hold a train; only letting it go takes the proof."""
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
"""Of every movement, and only at rest: what happens to a moving train is for supervision to say."""

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
"""The only ways up without standing still lead into full supervision."""


def next_mode(mode: OperatingMode, seen: GuardInputs) -> OperatingMode:
    """The first guard that holds decides; when none holds the mode stays."""
    for guard, target in TRANSITIONS[mode]:
        if guard(seen):
            return target
    return mode
