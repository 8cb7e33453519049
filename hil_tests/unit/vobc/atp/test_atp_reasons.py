"""What protection reports as its intervention, and why. No decision depends on it."""

import pytest

from can_dbc.vobc import (
    Cause,
    Intervention,
    Missing,
    OperatingMode,
    ReasonCode,
    Supervision,
)
from hil_tests.unit.vobc.atp.guard_inputs_rig import CONFIG, RUNNING, STANDING
from vobc.atp.emergencies import in_cause_words
from vobc.atp.guard_inputs import GuardInputs
from vobc.atp.reasons import reason_of, shown_intervention, words_of

OLD_S = CONFIG.restrictions_age_max_s
SERVICE_S = CONFIG.authority_service_ratio * CONFIG.authority_age_max_s


@pytest.mark.parametrize(
    ("state", "inputs", "reason", "words"),
    [
        (Supervision.NOMINAL, RUNNING, ReasonCode.NONE, ""),
        (
            Supervision.WARNING,
            RUNNING,
            ReasonCode.OVER_WARNING_LIMIT,
            "speed over the warning limit",
        ),
        (
            Supervision.SERVICE,
            RUNNING,
            ReasonCode.OVER_SERVICE_LIMIT,
            "speed over the service brake limit",
        ),
        (
            Supervision.SERVICE,
            RUNNING._replace(authority_age_s=SERVICE_S),
            ReasonCode.AUTHORITY_AGES,
            "movement authority is getting old",
        ),
        (
            Supervision.SERVICE,
            RUNNING._replace(restrictions_age_s=OLD_S),
            ReasonCode.RESTRICTIONS_AGE,
            "restrictions are getting old",
        ),
        (
            Supervision.SERVICE,
            RUNNING._replace(mode=OperatingMode.CREEP),
            ReasonCode.SIGHT_NOT_PERMITTED,
            "driving on sight is no longer permitted",
        ),
        (
            Supervision.SERVICE,
            RUNNING._replace(stop_by_mps=1.0),
            ReasonCode.STOP_NOT_OBEYED,
            "operation does not stop as asked",
        ),
        (
            Supervision.NO_AUTHORITY,
            STANDING._replace(mode=OperatingMode.ASLEEP, missing=int(Missing.DOORS)),
            ReasonCode.TRAIN_ASLEEP,
            "asleep",
        ),
        (
            Supervision.NO_AUTHORITY,
            STANDING._replace(missing=int(Missing.DOORS), restrictions_age_s=OLD_S),
            ReasonCode.INPUT_MISSING,
            "waits for door unit, orders of the centre",
        ),
        (
            Supervision.NO_AUTHORITY,
            STANDING._replace(authority_age_s=CONFIG.authority_age_max_s),
            ReasonCode.AUTHORITY_MISSING,
            "waits for a fresh movement authority",
        ),
        (
            Supervision.NO_AUTHORITY,
            STANDING,
            ReasonCode.STANDSTILL_NOT_PROVEN,
            "waits until standstill is proven",
        ),
    ],
)
def test_each_state_has_a_reason_with_its_text(
    state: Supervision, inputs: GuardInputs, reason: ReasonCode, words: str
) -> None:
    assert reason_of(state, inputs) is reason
    assert words_of(reason, inputs) == words


@pytest.mark.parametrize("cause", [cause for cause in Cause if cause is not Cause.NONE])
def test_a_latched_cause_is_the_reason_in_every_state(cause: Cause) -> None:
    inputs = RUNNING._replace(latched=(cause, Cause.BUTTON))

    for state in Supervision:
        reason = reason_of(state, inputs)
        assert (reason.name, reason.value) == (cause.name, cause.value)
        assert words_of(reason, inputs) == in_cause_words(cause)


@pytest.mark.parametrize(
    ("state", "kept", "locked", "shown"),
    [
        (
            Supervision.NOMINAL,
            True,
            False,
            (Intervention.NO_TRACTION, ReasonCode.DEPARTURE_INHIBITED),
        ),
        (
            Supervision.NOMINAL,
            False,
            False,
            (Intervention.NO_TRACTION, ReasonCode.DOORS_NOT_LOCKED),
        ),
        (
            Supervision.WARNING,
            False,
            True,
            (Intervention.NO_TRACTION, ReasonCode.NO_SPEED_PERMITTED),
        ),
        (Supervision.SERVICE, True, False, (Intervention.SERVICE_BRAKE, ReasonCode.BUTTON)),
        (
            Supervision.EMERGENCY,
            True,
            False,
            (Intervention.EMERGENCY_BRAKE, ReasonCode.BUTTON),
        ),
        (Supervision.NO_AUTHORITY, True, False, (Intervention.HELD, ReasonCode.BUTTON)),
    ],
)
def test_traction_that_is_withheld_is_shown_unless_the_train_is_braked(
    state: Supervision, kept: bool, locked: bool, shown: tuple[Intervention, ReasonCode]
) -> None:
    assert (
        shown_intervention(state, ReasonCode.BUTTON, permitted=False, kept=kept, locked=locked)
        == shown
    )


def test_with_traction_the_state_alone_is_shown() -> None:
    for state, intervention in (
        (Supervision.NOMINAL, Intervention.NONE),
        (Supervision.WARNING, Intervention.WARNING),
    ):
        assert shown_intervention(
            state, ReasonCode.BUTTON, permitted=True, kept=False, locked=True
        ) == (intervention, ReasonCode.BUTTON)
