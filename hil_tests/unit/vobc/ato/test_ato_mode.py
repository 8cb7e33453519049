"""The table of phases: the tests take every transition and check what must never be possible."""

import dataclasses

import pytest
from hypothesis import given
from hypothesis import strategies as st

from can_dbc.vobc import AtoPhase
from vobc.ato import mode
from vobc.ato.mode import PhaseGuardInputs, next_phase

FLAGS = [field.name for field in dataclasses.fields(PhaseGuardInputs)]
P = AtoPhase


@pytest.mark.parametrize(
    ("phase", "flags", "expected"),
    [
        (P.OFF, "enabled resting", P.HOLDING),
        (P.OFF, "enabled under_way", P.RUNNING),
        (P.OFF, "enabled", P.OFF),
        (P.HOLDING, "enabled resting at_stop", P.STOPPED),
        (
            P.HOLDING,
            "enabled resting at_stop served doors_locked may_go released departure_permitted",
            P.DEPARTING,
        ),
        (
            P.HOLDING,
            "enabled resting doors_locked may_go released departure_permitted",
            P.DEPARTING,
        ),
        (P.HOLDING, "enabled resting doors_locked may_go released", P.HOLDING),
        (P.HOLDING, "enabled resting doors_locked may_go departure_permitted", P.HOLDING),
        (P.HOLDING, "enabled resting doors_locked may_jog released", P.JOGGING),
        (P.HOLDING, "enabled resting doors_locked may_jog", P.HOLDING),
        (P.HOLDING, "enabled resting may_jog released", P.HOLDING),
        (
            P.HOLDING,
            "enabled resting doors_locked may_go released departure_permitted creep",
            P.CREEPING,
        ),
        (P.HOLDING, "enabled resting keep_doors_open doors_enabled", P.DOORS_OPEN),
        (P.HOLDING, "enabled resting keep_doors_open", P.HOLDING),
        (P.OFF, "enabled under_way creep", P.CREEPING),
        (P.JOGGING, "enabled resting at_stop", P.JOGGING),
        (P.JOGGING, "enabled resting at_stop jog_over", P.STOPPED),
        (P.JOGGING, "enabled resting jog_over", P.HOLDING),
        (P.CREEPING, "enabled resting creep may_go", P.CREEPING),
        (P.CREEPING, "enabled resting creep", P.HOLDING),
        (P.CREEPING, "enabled under_way creep may_go", P.CREEPING),
        (P.CREEPING, "enabled under_way", P.RUNNING),
        (P.CREEPING, "enabled resting", P.HOLDING),
        (P.HOLDING, "enabled resting may_go", P.HOLDING),
        (P.HOLDING, "enabled resting doors_locked", P.HOLDING),
        (P.DEPARTING, "enabled doors_locked may_go released departure_permitted", P.DEPARTING),
        (P.DEPARTING, "enabled doors_locked may_go under_way", P.RUNNING),
        (P.DEPARTING, "enabled may_go", P.HOLDING),
        (P.DEPARTING, "enabled doors_locked may_go released", P.HOLDING),
        (P.DEPARTING, "enabled doors_locked", P.HOLDING),
        (P.RUNNING, "enabled under_way", P.RUNNING),
        (P.RUNNING, "enabled under_way braking", P.APPROACHING),
        (P.RUNNING, "enabled under_way braking in_stopping_zone", P.STOPPING),
        (P.RUNNING, "enabled resting", P.HOLDING),
        (P.APPROACHING, "enabled under_way braking in_stopping_zone", P.STOPPING),
        (P.APPROACHING, "enabled under_way", P.RUNNING),
        (P.APPROACHING, "enabled resting braking", P.HOLDING),
        (P.APPROACHING, "enabled resting braking at_stop", P.STOPPED),
        (P.STOPPING, "enabled braking in_stopping_zone", P.STOPPING),
        (P.STOPPING, "enabled resting at_stop braking", P.STOPPED),
        (P.STOPPING, "enabled resting braking", P.HOLDING),
        (P.STOPPING, "enabled under_way", P.RUNNING),
        (P.STOPPED, "enabled resting at_stop has_door_work", P.STOPPED),
        (P.STOPPED, "enabled resting at_stop has_door_work doors_enabled", P.DOORS_OPEN),
        (P.STOPPED, "enabled resting at_stop doors_enabled", P.STOPPED),
        (P.STOPPED, "enabled resting at_stop served", P.HOLDING),
        (P.STOPPED, "enabled resting has_door_work doors_enabled", P.HOLDING),
        (P.STOPPED, "enabled resting at_stop may_jog doors_locked released", P.JOGGING),
        (P.DOORS_OPEN, "enabled resting at_stop dwell_over", P.DOORS_OPEN),
        (P.DOORS_OPEN, "enabled resting at_stop may_go", P.DOORS_OPEN),
        (P.DOORS_OPEN, "enabled resting at_stop dwell_over may_go", P.DOORS_CLOSING),
        (P.DOORS_OPEN, "enabled resting at_stop dwell_over may_go stays", P.DOORS_OPEN),
        (P.DOORS_OPEN, "enabled resting at_stop dwell_over may_go keep_doors_open", P.DOORS_OPEN),
        (P.DOORS_CLOSING, "enabled resting keep_doors_open doors_enabled", P.DOORS_OPEN),
        (P.DOORS_CLOSING, "enabled resting served may_go", P.DOORS_CLOSING),
        (
            P.DOORS_CLOSING,
            "enabled resting served may_go doors_locked released departure_permitted",
            P.DEPARTING,
        ),
        (P.DOORS_CLOSING, "enabled resting served doors_locked", P.HOLDING),
    ],
)
def test_the_table_leads_to_the_specified_phase(phase: P, flags: str, expected: P) -> None:
    seen = PhaseGuardInputs(**dict.fromkeys(flags.split(), True))

    assert next_phase(phase, seen) is expected


def situations(**fixed: bool) -> st.SearchStrategy[PhaseGuardInputs]:
    flags = {flag: st.just(fixed[flag]) if flag in fixed else st.booleans() for flag in FLAGS}
    return st.builds(PhaseGuardInputs, **flags)


@pytest.mark.parametrize("phase", [phase for phase in P if phase is not P.OFF])
def test_every_phase_goes_off_when_the_operation_is_disabled(phase: P) -> None:
    """The first row of each phase leads to OFF when ATO is disabled, and the first row decides."""
    assert mode.TRANSITIONS[phase][0] == (mode.disabled, P.OFF)


@given(st.sampled_from(P), situations(enabled=False))
def test_a_disabled_operation_ends_in_off_from_every_phase(
    phase: P, seen: PhaseGuardInputs
) -> None:
    assert next_phase(phase, seen) is P.OFF


SETS_OFF = {P.DEPARTING, P.JOGGING, P.CREEPING}


@given(
    st.sampled_from([phase for phase in P if phase not in SETS_OFF]),
    situations(doors_locked=False, under_way=False),
)
def test_no_phase_departs_with_unlocked_doors(phase: P, seen: PhaseGuardInputs) -> None:
    assert next_phase(phase, seen) not in SETS_OFF


@given(
    st.sampled_from([phase for phase in P if phase not in SETS_OFF]),
    situations(departure_permitted=False, under_way=False),
)
def test_no_phase_departs_or_creeps_against_the_traction_interlock(
    phase: P, seen: PhaseGuardInputs
) -> None:
    assert next_phase(phase, seen) not in {P.DEPARTING, P.CREEPING}


@given(situations(keep_doors_open=True))
def test_doors_requested_to_stay_open_are_not_closed(seen: PhaseGuardInputs) -> None:
    assert next_phase(P.DOORS_OPEN, seen) is not P.DOORS_CLOSING


def test_every_guard_that_starts_the_train_requires_locked_doors() -> None:
    """The test evaluates every guard that leads out of rest with all flags true but the locked
    doors."""
    everything = dict.fromkeys(FLAGS, True) | {"doors_locked": False, "under_way": False}
    for phase, rows in mode.TRANSITIONS.items():
        for guard, target in rows:
            if target in SETS_OFF and phase is not P.OFF:
                assert not guard(PhaseGuardInputs(**everything)), (phase, target)


def test_every_phase_is_in_the_table_and_can_be_reached() -> None:
    reached = {target for rows in mode.TRANSITIONS.values() for _, target in rows}

    assert set(mode.TRANSITIONS) == set(P)
    assert reached == set(P)
