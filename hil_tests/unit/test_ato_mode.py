"""The phase table: every way between phases walked, and what must never be possible."""

import dataclasses
import itertools

import pytest

from can_dbc.vobc import AtoPhase
from vobc.ato import mode
from vobc.ato.mode import Situation, next_phase

FLAGS = [field.name for field in dataclasses.fields(Situation)]
P = AtoPhase


@pytest.mark.parametrize(
    ("phase", "flags", "expected"),
    [
        (P.OFF, "enabled resting", P.HOLDING),
        (P.OFF, "enabled under_way", P.RUNNING),
        (P.OFF, "enabled", P.OFF),
        (P.HOLDING, "enabled resting at_stop", P.STOPPED),
        (P.HOLDING, "enabled resting at_stop served doors_locked may_go released", P.DEPARTING),
        (P.HOLDING, "enabled resting doors_locked may_go released", P.DEPARTING),
        (P.HOLDING, "enabled resting doors_locked may_go", P.HOLDING),
        (P.HOLDING, "enabled resting may_go", P.HOLDING),
        (P.HOLDING, "enabled resting doors_locked", P.HOLDING),
        (P.DEPARTING, "enabled doors_locked may_go released", P.DEPARTING),
        (P.DEPARTING, "enabled doors_locked may_go under_way", P.RUNNING),
        (P.DEPARTING, "enabled may_go", P.HOLDING),
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
        (P.DOORS_OPEN, "enabled resting at_stop dwell_over", P.DOORS_OPEN),
        (P.DOORS_OPEN, "enabled resting at_stop may_go", P.DOORS_OPEN),
        (P.DOORS_OPEN, "enabled resting at_stop dwell_over may_go", P.DOORS_CLOSING),
        (P.DOORS_CLOSING, "enabled resting served may_go", P.DOORS_CLOSING),
        (P.DOORS_CLOSING, "enabled resting served may_go doors_locked released", P.DEPARTING),
        (P.DOORS_CLOSING, "enabled resting served doors_locked", P.HOLDING),
    ],
)
def test_the_table_leads_where_the_domain_says(phase: P, flags: str, expected: P) -> None:
    seen = Situation(**dict.fromkeys(flags.split(), True))

    assert next_phase(phase, seen) is expected


@pytest.mark.parametrize("phase", [phase for phase in P if phase is not P.OFF])
def test_every_phase_goes_off_when_the_operation_is_disabled(phase: P) -> None:
    for values in itertools.product([False, True], repeat=len(FLAGS) - 1):
        others = [flag for flag in FLAGS if flag != "enabled"]
        seen = Situation(enabled=False, **dict(zip(others, values, strict=True)))
        if next_phase(phase, seen) is not P.OFF:
            pytest.fail(f"{phase.name} ignores the loss of the enabling: {seen}")


def test_nothing_departs_with_unlocked_doors() -> None:
    for phase in P:
        if phase is P.DEPARTING:
            continue
        for values in itertools.product([False, True], repeat=len(FLAGS) - 1):
            others = [flag for flag in FLAGS if flag != "doors_locked"]
            seen = Situation(doors_locked=False, **dict(zip(others, values, strict=True)))
            assert next_phase(phase, seen) is not P.DEPARTING


def test_every_phase_is_in_the_table_and_can_be_reached() -> None:
    reached = {target for rows in mode.TRANSITIONS.values() for _, target in rows}

    assert set(mode.TRANSITIONS) == set(P)
    assert reached == set(P)
