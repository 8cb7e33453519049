"""Supervision: from what protection sees to its state. Two tables and the guards they name."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Final

from can_dbc.vobc import Cause, Supervision
from vobc.atp.config import AtpConfig
from vobc.atp.inputs import LOCALISATION, VITAL_IN_MOTION
from vobc.vocabulary import Ceiling, Interval


@dataclass(frozen=True, slots=True)
class Seen:
    """Everything that the guards look at."""

    limits: AtpConfig
    speed_mps: Interval
    ceiling: Ceiling
    standing: bool
    """The tacho's samples show no pulse any more: quick, but no proof."""
    standstill: bool
    """Proven."""
    missing: int
    """What is silent or not ready, as flags of `Missing`."""
    silent: int
    """What is not heard."""
    authority_age_s: float
    rollback_m: float
    """How far the train went back from its foremost place."""
    held_movement_m: float
    """How far it moved, either way, since it was last to be held."""
    button_pressed: bool
    overruns: int
    not_finite: bool
    """The cycle before made a number that is none."""
    reset: bool
    """The reset was pressed in this cycle, not held from before."""


Guard = Callable[[Seen], bool]


WORDS: Final[Mapping[Cause, str]] = {
    Cause.OVERSPEED: "speed at or over the emergency limit",
    Cause.AUTHORITY_OLD: "movement authority too old",
    Cause.ROLLBACK: "train rolled back",
    Cause.HELD_TRAIN_MOVED: "train moved while it was to be held",
    Cause.VITAL_INPUT_LOST: "vital input lost while moving",
    Cause.LOCALISATION_LOST: "localisation lost while moving",
    Cause.BUTTON: "emergency button pressed",
    Cause.OVERRUN: "control cycles missed",
    Cause.NOT_FINITE: "a number was not finite",
    Cause.BRAKE_UNIT: "the brake unit braked by itself",
    Cause.REMOTE: "ordered by the centre",
    Cause.OBSTACLE: "obstacle touched",
    Cause.DOOR_UNLOCKED: "doors not locked at or leaving a platform",
    Cause.PASSENGER_ALARM: "passenger alarm at or leaving a platform",
    Cause.OVERSHOT: "stopping point overshot",
    Cause.WRONG_DIRECTION: "train moves against its direction",
    Cause.REPLICAS_DISAGREE: "the two computations of protection disagree",
    Cause.CLOCK_STEPPED: "the clock stepped",
    Cause.JOG_EXCEEDED: "jog too far, too fast or once too often",
    Cause.PAST_AUTHORITY: "front may be beyond the end of authority",
    Cause.ASLEEP_MOVED: "train moved while asleep",
}
"""Why the emergency brake is on, for the log and the person at the desk."""


def in_cause_words(cause: Cause) -> str:
    return WORDS[cause]


def over_emergency(seen: Seen) -> bool:
    """The upper speed bound reaches the limit; a train that stands exceeds nothing."""
    return not seen.standing and seen.speed_mps.high >= seen.ceiling.emergency_mps


def over_service(seen: Seen) -> bool:
    return not seen.standing and seen.speed_mps.high >= seen.ceiling.service_mps


def over_warning(seen: Seen) -> bool:
    """The best estimate: a warning that came by uncertainty alone would not be heeded for long."""
    return not seen.standing and seen.speed_mps.best >= seen.ceiling.warning_mps


def authority_ages(seen: Seen) -> bool:
    limits = seen.limits
    return seen.authority_age_s >= limits.authority_service_ratio * limits.authority_age_max_s


def authority_too_old_in_motion(seen: Seen) -> bool:
    return not seen.standing and seen.authority_age_s >= seen.limits.authority_age_max_s


def rolled_back(seen: Seen) -> bool:
    return seen.rollback_m >= seen.limits.rollback_m


def moved_while_held(seen: Seen) -> bool:
    return seen.held_movement_m >= seen.limits.held_movement_m


def vital_lost_in_motion(seen: Seen) -> bool:
    """Silence counts; a unit that says it is not ready still answers, and the train may coast."""
    return not seen.standing and bool(seen.silent & VITAL_IN_MOTION)


def localisation_lost_in_motion(seen: Seen) -> bool:
    return not seen.standing and bool(seen.missing & LOCALISATION)


def button(seen: Seen) -> bool:
    return seen.button_pressed


def overrun(seen: Seen) -> bool:
    return not seen.standing and seen.overruns > seen.limits.overruns_max


def not_finite(seen: Seen) -> bool:
    return seen.not_finite


CAUSES: Final[Mapping[Cause, Guard]] = {
    Cause.NOT_FINITE: not_finite,
    Cause.BUTTON: button,
    Cause.VITAL_INPUT_LOST: vital_lost_in_motion,
    Cause.LOCALISATION_LOST: localisation_lost_in_motion,
    Cause.AUTHORITY_OLD: authority_too_old_in_motion,
    Cause.OVERSPEED: over_emergency,
    Cause.ROLLBACK: rolled_back,
    Cause.OVERRUN: overrun,
}
"""For a train that may move. The first guard that holds names the cause."""

HELD_CAUSES: Final[Mapping[Cause, Guard]] = {
    Cause.NOT_FINITE: not_finite,
    Cause.BUTTON: button,
    Cause.HELD_TRAIN_MOVED: moved_while_held,
}
"""For a train that is held, and for one whose emergency waits for its reset."""


def emergency(seen: Seen) -> bool:
    return _any_of(CAUSES, seen)


def emergency_while_held(seen: Seen) -> bool:
    return _any_of(HELD_CAUSES, seen)


def _any_of(causes: Mapping[Cause, Guard], seen: Seen) -> bool:
    return any(guard(seen) for guard in causes.values())


def incomplete_while_standing(seen: Seen) -> bool:
    """The quick sign is enough to hold a train; only letting it go takes the proof."""
    return seen.standing and seen.missing != 0


def complete_at_standstill(seen: Seen) -> bool:
    return seen.standstill and seen.missing == 0


def service_needed(seen: Seen) -> bool:
    return over_service(seen) or authority_ages(seen)


def under_ceiling(seen: Seen) -> bool:
    """Back where nothing is exceeded, with an authority that is fresh."""
    under = seen.standing or seen.speed_mps.best < seen.ceiling.permitted_mps
    return under and not authority_ages(seen) and not over_service(seen)


def reset_at_standstill(seen: Seen) -> bool:
    """Only a person lets the train go, only once it stands, only when the cause is gone."""
    return seen.reset and seen.standstill and not emergency_while_held(seen)


TRANSITIONS: Final[Mapping[Supervision, tuple[tuple[Guard, Supervision], ...]]] = {
    Supervision.NO_AUTHORITY: (
        (emergency_while_held, Supervision.EMERGENCY),
        (complete_at_standstill, Supervision.NOMINAL),
    ),
    Supervision.NOMINAL: (
        (emergency, Supervision.EMERGENCY),
        (incomplete_while_standing, Supervision.NO_AUTHORITY),
        (service_needed, Supervision.SERVICE),
        (over_warning, Supervision.WARNING),
    ),
    Supervision.WARNING: (
        (emergency, Supervision.EMERGENCY),
        (incomplete_while_standing, Supervision.NO_AUTHORITY),
        (service_needed, Supervision.SERVICE),
        (under_ceiling, Supervision.NOMINAL),
    ),
    Supervision.SERVICE: (
        (emergency, Supervision.EMERGENCY),
        (incomplete_while_standing, Supervision.NO_AUTHORITY),
        (under_ceiling, Supervision.NOMINAL),
    ),
    Supervision.EMERGENCY: ((reset_at_standstill, Supervision.NO_AUTHORITY),),
}
"""Emergency is latched. It leads back only to the held state, which lets the train go by itself as
soon as nothing is missing; so does the state at start, where nothing is latched."""


def next_state(state: Supervision, seen: Seen) -> Supervision:
    """The first guard that holds decides; when none holds the state stays."""
    for guard, target in TRANSITIONS[state]:
        if guard(seen):
            return target
    return state


def cause_of(state: Supervision, seen: Seen) -> Cause:
    """Why `state` was left for EMERGENCY just now."""
    causes = HELD_CAUSES if state is Supervision.NO_AUTHORITY else CAUSES
    return next(cause for cause, guard in causes.items() if guard(seen))
