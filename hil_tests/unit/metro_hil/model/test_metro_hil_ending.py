"""When a run ends by itself: its train stands for good, in emergency or behind closed doors."""

import pytest

from can_dbc.vobc import AtoPhase, Cause, Supervision, Withheld
from metro_hil.model.end_condition import (
    MENDED_BY_MOVING,
    UNATTENDED_S,
    HeldEmergencyCondition,
    ShutDoorsCondition,
)

S = 1_000_000_000
LONG_NS = round(UNATTENDED_S * S)


def asked(watch: HeldEmergencyCondition, now_ns: int, supervision: Supervision) -> str | None:
    return watch.stands_for_good(now_ns, supervision, Cause.VITAL_INPUT_LOST)


def test_an_emergency_that_stays_ends_the_run_and_names_its_cause() -> None:
    watch = HeldEmergencyCondition()

    assert asked(watch, 5 * S, Supervision.EMERGENCY) is None
    assert asked(watch, 5 * S + LONG_NS - 1, Supervision.EMERGENCY) is None
    words = asked(watch, 5 * S + LONG_NS, Supervision.EMERGENCY)

    assert words is not None
    assert "vital input lost" in words
    assert "30 s" in words


def test_an_emergency_released_in_time_does_not_end_the_run_and_the_next_restarts_the_wait() -> (
    None
):
    watch = HeldEmergencyCondition()

    asked(watch, 0, Supervision.EMERGENCY)
    assert asked(watch, LONG_NS - 1, Supervision.NOMINAL) is None
    assert asked(watch, LONG_NS, Supervision.EMERGENCY) is None
    assert asked(watch, 2 * LONG_NS - 1, Supervision.EMERGENCY) is None
    assert asked(watch, 2 * LONG_NS, Supervision.EMERGENCY) is not None


@pytest.mark.parametrize("state", sorted({*Supervision} - {Supervision.EMERGENCY}))
def test_no_other_state_ends_it(state: Supervision) -> None:
    watch = HeldEmergencyCondition()

    assert asked(watch, 0, state) is None
    assert asked(watch, 10 * LONG_NS, state) is None


def test_doors_that_stay_closed_at_a_stop_end_the_run_with_the_reason() -> None:
    watch, reasons = ShutDoorsCondition(), Withheld.MISALIGNED | Withheld.CENTRE_SILENT

    assert watch.shut_for_good(5 * S, AtoPhase.STOPPED, reasons) is None
    assert watch.shut_for_good(5 * S + LONG_NS - 1, AtoPhase.STOPPED, reasons) is None
    words = watch.shut_for_good(5 * S + LONG_NS, AtoPhase.STOPPED, reasons)

    assert words is not None
    assert words.endswith(": misaligned")
    assert "30 s" in words


@pytest.mark.parametrize(
    ("phase", "withheld"),
    [(AtoPhase.STOPPED, Withheld.NONE), (AtoPhase.JOGGING, Withheld.MISALIGNED)],
)
def test_enabled_doors_and_a_jog_restart_the_wait(phase: AtoPhase, withheld: Withheld) -> None:
    watch, stays = ShutDoorsCondition(), (AtoPhase.STOPPED, Withheld.MISALIGNED)

    watch.shut_for_good(0, *stays)
    assert watch.shut_for_good(LONG_NS, phase, withheld) is None
    assert watch.shut_for_good(LONG_NS + 1, *stays) is None
    assert watch.shut_for_good(2 * LONG_NS, *stays) is None
    assert watch.shut_for_good(2 * LONG_NS + 1, *stays) is not None


@pytest.mark.parametrize("reason", sorted({*Withheld} - {*MENDED_BY_MOVING}))
def test_the_run_waits_for_conditions_that_may_end(reason: Withheld) -> None:
    watch = ShutDoorsCondition()

    assert watch.shut_for_good(0, AtoPhase.STOPPED, reason) is None
    assert watch.shut_for_good(10 * LONG_NS, AtoPhase.STOPPED, reason) is None


@pytest.mark.parametrize("phase", sorted({*AtoPhase} - {AtoPhase.STOPPED}))
def test_doors_matter_in_no_other_phase(phase: AtoPhase) -> None:
    watch = ShutDoorsCondition()

    assert watch.shut_for_good(0, phase, Withheld.MISALIGNED) is None
    assert watch.shut_for_good(10 * LONG_NS, phase, Withheld.MISALIGNED) is None
