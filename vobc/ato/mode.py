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


def disabled(inputs: PhaseGuardInputs) -> bool:
    return not inputs.enabled


def creeps_in_motion(inputs: PhaseGuardInputs) -> bool:
    return inputs.enabled and inputs.under_way and inputs.creep


def enabled_at_rest(inputs: PhaseGuardInputs) -> bool:
    return inputs.enabled and inputs.resting


def enabled_in_motion(inputs: PhaseGuardInputs) -> bool:
    return inputs.enabled and inputs.under_way


def work_waits(inputs: PhaseGuardInputs) -> bool:
    return inputs.resting and inputs.at_stop and not inputs.served


def ready_to_depart(inputs: PhaseGuardInputs) -> bool:
    return inputs.doors_locked and inputs.departure_permitted and inputs.may_go and inputs.released


def ready_to_creep(inputs: PhaseGuardInputs) -> bool:
    return inputs.creep and ready_to_depart(inputs)


def ready_to_jog(inputs: PhaseGuardInputs) -> bool:
    return inputs.may_jog and inputs.doors_locked and inputs.released


def jog_over_at_stop(inputs: PhaseGuardInputs) -> bool:
    return inputs.jog_over and inputs.at_stop


def jog_over(inputs: PhaseGuardInputs) -> bool:
    return inputs.jog_over


def creeps_no_more(inputs: PhaseGuardInputs) -> bool:
    return not inputs.creep and inputs.under_way


def creep_rests(inputs: PhaseGuardInputs) -> bool:
    """The train is at rest, and the creep order has ended or the ceiling fell to 0."""
    return inputs.resting and not (inputs.creep and inputs.may_go)


def help_waits(inputs: PhaseGuardInputs) -> bool:
    return inputs.resting and inputs.keep_doors_open and inputs.doors_enabled


def doors_not_locked(inputs: PhaseGuardInputs) -> bool:
    return not inputs.doors_locked


def departure_forbidden(inputs: PhaseGuardInputs) -> bool:
    return not inputs.departure_permitted and not inputs.under_way


def nowhere_to_go(inputs: PhaseGuardInputs) -> bool:
    return not inputs.may_go and not inputs.under_way


def under_way(inputs: PhaseGuardInputs) -> bool:
    return inputs.under_way


def rests_at_stop(inputs: PhaseGuardInputs) -> bool:
    return inputs.resting and inputs.at_stop


def rests_elsewhere(inputs: PhaseGuardInputs) -> bool:
    return inputs.resting and not inputs.at_stop


def brakes_in_stopping_zone(inputs: PhaseGuardInputs) -> bool:
    return inputs.braking and inputs.in_stopping_zone


def brakes(inputs: PhaseGuardInputs) -> bool:
    return inputs.braking


def brakes_no_more(inputs: PhaseGuardInputs) -> bool:
    return not inputs.braking and not inputs.resting


def nothing_to_do(inputs: PhaseGuardInputs) -> bool:
    return inputs.served


def stop_given_up(inputs: PhaseGuardInputs) -> bool:
    return not inputs.at_stop


def doors_may_open(inputs: PhaseGuardInputs) -> bool:
    return inputs.has_door_work and inputs.doors_enabled


def dwell_done(inputs: PhaseGuardInputs) -> bool:
    return inputs.dwell_over and inputs.may_go and not inputs.stays and not inputs.keep_doors_open


def locked(inputs: PhaseGuardInputs) -> bool:
    return inputs.doors_locked


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


def next_phase(phase: AtoPhase, inputs: PhaseGuardInputs) -> AtoPhase:
    """Follow the first guard that holds. If none holds, the phase stays."""
    for guard, target in TRANSITIONS[phase]:
        if guard(inputs):
            return target
    return phase
