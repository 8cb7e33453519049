"""Phases of the automatic operation as a table of named guards. Pure functions."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Final

from can_dbc.vobc import AtoPhase


@dataclass(slots=True)
class PhaseGuardInputs:
    """Inputs of the guards. They are refilled in each cycle."""

    enabled: bool = False
    resting: bool = False
    """Standstill is proven and the holding brake is commanded."""
    under_way: bool = False
    """The train clearly moves forwards."""
    braking: bool = False
    """The strategy brakes towards the target."""
    in_stopping_zone: bool = False
    at_stop: bool = False
    served: bool = False
    """The station work at the present stop is done, and the next stop is the goal."""
    has_door_work: bool = False
    may_go: bool = False
    """There is a goal ahead, the authority is long enough and no attempt limit is used up."""
    dwell_over: bool = False
    released: bool = False
    """The service brake is fully released."""
    doors_locked: bool = False
    doors_enabled: bool = False
    departure_permitted: bool = False
    keep_doors_open: bool = False
    """A person on board needs help: doors open here and stay open."""
    stays: bool = False
    """An order or an alarm keeps the train at this platform."""
    may_jog: bool = False
    """The train is off its stopping point. A jog can correct this, protection permits it, and an
    attempt is left."""
    jog_over: bool = False
    """The train has come to rest again, or has never moved."""
    creep: bool = False
    """Drive on sight. The place may be unknown."""


Guard = Callable[[PhaseGuardInputs], bool]


def disabled(seen: PhaseGuardInputs) -> bool:
    return not seen.enabled


def creeps_in_motion(seen: PhaseGuardInputs) -> bool:
    return seen.enabled and seen.under_way and seen.creep


def enabled_at_rest(seen: PhaseGuardInputs) -> bool:
    return seen.enabled and seen.resting


def enabled_in_motion(seen: PhaseGuardInputs) -> bool:
    return seen.enabled and seen.under_way


def work_waits(seen: PhaseGuardInputs) -> bool:
    return seen.resting and seen.at_stop and not seen.served


def ready_to_depart(seen: PhaseGuardInputs) -> bool:
    return seen.doors_locked and seen.departure_permitted and seen.may_go and seen.released


def ready_to_creep(seen: PhaseGuardInputs) -> bool:
    return seen.creep and ready_to_depart(seen)


def ready_to_jog(seen: PhaseGuardInputs) -> bool:
    return seen.may_jog and seen.doors_locked and seen.released


def jog_over_at_stop(seen: PhaseGuardInputs) -> bool:
    return seen.jog_over and seen.at_stop


def jog_over(seen: PhaseGuardInputs) -> bool:
    return seen.jog_over


def creeps_no_more(seen: PhaseGuardInputs) -> bool:
    return not seen.creep and seen.under_way


def creep_rests(seen: PhaseGuardInputs) -> bool:
    """The train is at rest, and the creep order has ended or the ceiling fell to 0."""
    return seen.resting and not (seen.creep and seen.may_go)


def help_waits(seen: PhaseGuardInputs) -> bool:
    return seen.resting and seen.keep_doors_open and seen.doors_enabled


def doors_not_locked(seen: PhaseGuardInputs) -> bool:
    return not seen.doors_locked


def departure_forbidden(seen: PhaseGuardInputs) -> bool:
    return not seen.departure_permitted and not seen.under_way


def nowhere_to_go(seen: PhaseGuardInputs) -> bool:
    return not seen.may_go and not seen.under_way


def under_way(seen: PhaseGuardInputs) -> bool:
    return seen.under_way


def rests_at_stop(seen: PhaseGuardInputs) -> bool:
    return seen.resting and seen.at_stop


def rests_elsewhere(seen: PhaseGuardInputs) -> bool:
    return seen.resting and not seen.at_stop


def brakes_in_stopping_zone(seen: PhaseGuardInputs) -> bool:
    return seen.braking and seen.in_stopping_zone


def brakes(seen: PhaseGuardInputs) -> bool:
    return seen.braking


def brakes_no_more(seen: PhaseGuardInputs) -> bool:
    return not seen.braking and not seen.resting


def nothing_to_do(seen: PhaseGuardInputs) -> bool:
    return seen.served


def stop_given_up(seen: PhaseGuardInputs) -> bool:
    return not seen.at_stop


def doors_may_open(seen: PhaseGuardInputs) -> bool:
    return seen.has_door_work and seen.doors_enabled


def dwell_done(seen: PhaseGuardInputs) -> bool:
    return seen.dwell_over and seen.may_go and not seen.stays and not seen.keep_doors_open


def locked(seen: PhaseGuardInputs) -> bool:
    return seen.doors_locked


_REST: Final = (
    (rests_at_stop, AtoPhase.STOPPED),
    (rests_elsewhere, AtoPhase.HOLDING),
)

TRANSITIONS: Final[Mapping[AtoPhase, tuple[tuple[Guard, AtoPhase], ...]]] = {
    AtoPhase.OFF: (
        (enabled_at_rest, AtoPhase.HOLDING),
        (creeps_in_motion, AtoPhase.CREEPING),
        (enabled_in_motion, AtoPhase.RUNNING),
    ),
    AtoPhase.HOLDING: (
        (disabled, AtoPhase.OFF),
        (help_waits, AtoPhase.DOORS_OPEN),
        (ready_to_jog, AtoPhase.JOGGING),
        (work_waits, AtoPhase.STOPPED),
        (ready_to_creep, AtoPhase.CREEPING),
        (ready_to_depart, AtoPhase.DEPARTING),
    ),
    AtoPhase.DEPARTING: (
        (disabled, AtoPhase.OFF),
        (under_way, AtoPhase.RUNNING),
        # Until the train moves, any missing condition cancels the departure.
        (doors_not_locked, AtoPhase.HOLDING),
        (departure_forbidden, AtoPhase.HOLDING),
        (nowhere_to_go, AtoPhase.HOLDING),
    ),
    AtoPhase.JOGGING: (
        (disabled, AtoPhase.OFF),
        (jog_over_at_stop, AtoPhase.STOPPED),
        (jog_over, AtoPhase.HOLDING),
    ),
    AtoPhase.CREEPING: (
        (disabled, AtoPhase.OFF),
        (creeps_no_more, AtoPhase.RUNNING),
        (creep_rests, AtoPhase.HOLDING),
    ),
    AtoPhase.RUNNING: (
        (disabled, AtoPhase.OFF),
        *_REST,
        (brakes_in_stopping_zone, AtoPhase.STOPPING),
        (brakes, AtoPhase.APPROACHING),
    ),
    AtoPhase.APPROACHING: (
        (disabled, AtoPhase.OFF),
        *_REST,
        (brakes_no_more, AtoPhase.RUNNING),
        (brakes_in_stopping_zone, AtoPhase.STOPPING),
    ),
    AtoPhase.STOPPING: (
        (disabled, AtoPhase.OFF),
        *_REST,
        (brakes_no_more, AtoPhase.RUNNING),
    ),
    AtoPhase.STOPPED: (
        (disabled, AtoPhase.OFF),
        (nothing_to_do, AtoPhase.HOLDING),
        (stop_given_up, AtoPhase.HOLDING),
        (help_waits, AtoPhase.DOORS_OPEN),
        (ready_to_jog, AtoPhase.JOGGING),
        (doors_may_open, AtoPhase.DOORS_OPEN),
    ),
    AtoPhase.DOORS_OPEN: (
        (disabled, AtoPhase.OFF),
        (dwell_done, AtoPhase.DOORS_CLOSING),
    ),
    AtoPhase.DOORS_CLOSING: (
        (disabled, AtoPhase.OFF),
        (help_waits, AtoPhase.DOORS_OPEN),
        (ready_to_creep, AtoPhase.CREEPING),
        (ready_to_depart, AtoPhase.DEPARTING),
        (locked, AtoPhase.HOLDING),
    ),
}

DRIVING: Final = frozenset(
    {AtoPhase.DEPARTING, AtoPhase.RUNNING, AtoPhase.APPROACHING, AtoPhase.STOPPING}
)
"""Phases in which the strategy determines the demand."""

SETTING_OFF: Final = frozenset({AtoPhase.DEPARTING, AtoPhase.JOGGING, AtoPhase.CREEPING})
"""Phases that may begin against the holding brake."""


def next_phase(phase: AtoPhase, seen: PhaseGuardInputs) -> AtoPhase:
    """Follow the first guard that holds. If none holds, the phase stays."""
    for guard, target in TRANSITIONS[phase]:
        if guard(seen):
            return target
    return phase
