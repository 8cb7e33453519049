"""What protection does in a cycle and why, as codes for the bus and as text for log and desk."""

from collections.abc import Mapping
from typing import Final

from can_dbc.vobc import Cause, Intervention, OperatingMode, ReasonCode, Supervision
from vobc.atp.emergencies import in_cause_words
from vobc.atp.guard_inputs import GuardInputs
from vobc.atp.inputs import FLAGS, in_words
from vobc.atp.modes import NEEDED, authority_is_fresh, restrictions_are_fresh
from vobc.atp.supervision import authority_ages, permission_gone, stops_not

OF_CAUSE: Final = tuple(ReasonCode(cause) for cause in Cause)
"""Reason by the number of the cause of an emergency."""
INTERVENTIONS: Final[Mapping[Supervision, Intervention]] = {
    Supervision.NO_AUTHORITY: Intervention.HELD,
    Supervision.NOMINAL: Intervention.NONE,
    Supervision.WARNING: Intervention.WARNING,
    Supervision.SERVICE: Intervention.SERVICE_BRAKE,
    Supervision.EMERGENCY: Intervention.EMERGENCY_BRAKE,
}
"""Intervention of each state, while traction is permitted."""
WORDS: Final[Mapping[ReasonCode, str]] = {
    ReasonCode.NONE: "",
    ReasonCode.OVER_WARNING_LIMIT: "speed over the warning limit",
    ReasonCode.OVER_SERVICE_LIMIT: "speed over the service brake limit",
    ReasonCode.AUTHORITY_AGES: "movement authority is getting old",
    ReasonCode.RESTRICTIONS_AGE: "restrictions are getting old",
    ReasonCode.SIGHT_NOT_PERMITTED: "driving on sight is no longer permitted",
    ReasonCode.STOP_NOT_OBEYED: "operation does not stop as asked",
    ReasonCode.AUTHORITY_MISSING: "waits for a fresh movement authority",
    ReasonCode.STANDSTILL_NOT_PROVEN: "waits until standstill is proven",
    ReasonCode.TRAIN_ASLEEP: "asleep",
}


def reason_of(state: Supervision, inputs: GuardInputs) -> ReasonCode:
    """Why protection holds, warns or brakes in this state."""
    if inputs.latched:
        return OF_CAUSE[inputs.latched[0]]
    if state is Supervision.NO_AUTHORITY:
        return _waiting(inputs)
    if state is Supervision.SERVICE:
        return _why_service(inputs)
    return ReasonCode.OVER_WARNING_LIMIT if state is Supervision.WARNING else ReasonCode.NONE


def words_of(reason: ReasonCode, inputs: GuardInputs) -> str:
    """Text of a reason. Missing inputs are named. Empty: protection neither holds nor brakes."""
    if inputs.latched:
        return in_cause_words(inputs.latched[0])
    if reason is ReasonCode.INPUT_MISSING:
        orders = ", orders of the centre" if not restrictions_are_fresh(inputs) else ""
        return f"waits for {in_words(FLAGS[_lacking(inputs)])}{orders}"
    return WORDS[reason]


def shown_intervention(
    state: Supervision, reason: ReasonCode, *, permitted: bool, kept: bool, locked: bool
) -> tuple[Intervention, ReasonCode]:
    """Intervention and reason on the bus. They include traction that protection withholds.

    Args:
        permitted: protection permits traction.
        kept: the train must not depart.
        locked: the doors are locked or bypassed.
    """
    intervention = INTERVENTIONS[state]
    if permitted or intervention > Intervention.NO_TRACTION:
        return intervention, reason
    if kept:
        return Intervention.NO_TRACTION, ReasonCode.DEPARTURE_INHIBITED
    if not locked:
        return Intervention.NO_TRACTION, ReasonCode.DOORS_NOT_LOCKED
    return Intervention.NO_TRACTION, ReasonCode.NO_SPEED_PERMITTED


def _lacking(inputs: GuardInputs) -> int:
    """Missing inputs that full supervision needs."""
    return inputs.missing & NEEDED[OperatingMode.AUTHORISED]


def _waiting(inputs: GuardInputs) -> ReasonCode:
    if inputs.mode is OperatingMode.ASLEEP:
        return ReasonCode.TRAIN_ASLEEP
    if _lacking(inputs):
        return ReasonCode.INPUT_MISSING
    if not authority_is_fresh(inputs):
        return ReasonCode.AUTHORITY_MISSING
    return ReasonCode.STANDSTILL_NOT_PROVEN


def _why_service(inputs: GuardInputs) -> ReasonCode:
    if authority_ages(inputs):
        fresh = restrictions_are_fresh(inputs)
        return ReasonCode.AUTHORITY_AGES if fresh else ReasonCode.RESTRICTIONS_AGE
    if permission_gone(inputs):
        return ReasonCode.SIGHT_NOT_PERMITTED
    if stops_not(inputs):
        return ReasonCode.STOP_NOT_OBEYED
    return ReasonCode.OVER_SERVICE_LIMIT
