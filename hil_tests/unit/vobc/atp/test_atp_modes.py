"""Operating modes: every transition of the table, and every guard on both sides."""

import math
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from can_dbc.vobc import Cause, Inhibit, Missing, OperatingMode
from vobc.atp.guard_inputs import GuardInputs
from vobc.atp.modes import NEEDED, SUPERVISED, TRANSITIONS, UNHEEDED, next_mode
from vobc.config import load_config
from vobc.vocabulary import Ceiling, Interval

CONFIG = load_config("florence4").atp
RUNNING = GuardInputs(
    CONFIG,
    speed_mps=Interval(8.8, 9.0, 9.2),
    ceiling=Ceiling(10.0, 11.0, 12.0, 13.0, 500.0),
    full_mps=10.0,
    authority_age_s=0.2,
    mode=OperatingMode.AUTHORISED,
)
STANDING = RUNNING._replace(speed_mps=Interval(-0.2, 0.0, 0.2), standing=True, standstill=True)
ASLEEP, STANDBY = OperatingMode.ASLEEP, OperatingMode.STANDBY
RESTRICTED, CREEP = OperatingMode.RESTRICTED, OperatingMode.CREEP
AUTHORISED, JOG = OperatingMode.AUTHORISED, OperatingMode.JOG
MOVING = (RESTRICTED, CREEP, AUTHORISED, JOG)
UNPLACED = int(Missing.AUTHORITY | Missing.LOCALISATION)
FLAGS = [flag for flag in Missing if flag]


def at_rest(mode: OperatingMode, **changes: Any) -> GuardInputs:
    return STANDING._replace(mode=mode, **changes)


def after(seen: GuardInputs) -> OperatingMode:
    return next_mode(seen.mode, seen)


def test_every_mode_has_its_rows() -> None:
    assert set(TRANSITIONS) == set(OperatingMode) == set(UNHEEDED)
    assert set(NEEDED) == set(MOVING)
    assert {AUTHORISED, JOG} == SUPERVISED


@pytest.mark.parametrize("mode", [STANDBY, *MOVING])
def test_an_order_to_sleep_waits_for_standstill(mode: OperatingMode) -> None:
    keeps = {"jog_granted": True, "person_at_desk": True, "creep_ordered": True}
    moving = RUNNING._replace(mode=mode, sleep_ordered=True, **keeps)  # type: ignore[arg-type]

    assert after(at_rest(mode, sleep_ordered=True)) is ASLEEP
    assert after(moving) is mode
    assert after(moving._replace(standstill=True)) is mode


def test_a_sleeping_train_reacts_only_to_the_order_to_wake() -> None:
    asked = {"sight_asked": True, "creep_ordered": True, "jog_granted": True}

    assert after(at_rest(ASLEEP, sleep_ordered=True, **asked)) is ASLEEP
    assert after(at_rest(ASLEEP, **asked)) is STANDBY


def test_with_every_input_present_a_standing_train_is_authorised() -> None:
    assert after(at_rest(STANDBY)) is AUTHORISED
    assert after(at_rest(STANDBY, standstill=False)) is STANDBY
    assert after(at_rest(STANDBY, standing=False)) is STANDBY
    assert after(at_rest(STANDBY, latched=(Cause.BUTTON,))) is STANDBY


@pytest.mark.parametrize(
    ("age_s", "begins"),
    [(0.0, True), (1.799, True), (1.8, False), (2.99, False), (math.nan, False)],
)
def test_no_train_is_authorised_on_an_authority_old_enough_for_the_service_brake(
    age_s: float, begins: bool
) -> None:
    """The authority lasts 3 s and the service brake acts from 1.8 s. An authorised train stays
    authorised until 3 s."""
    assert after(at_rest(STANDBY, authority_age_s=age_s)) is (AUTHORISED if begins else STANDBY)
    assert after(at_rest(AUTHORISED, authority_age_s=age_s)) is AUTHORISED


@pytest.mark.parametrize("flag", FLAGS)
def test_any_missing_input_keeps_a_train_from_being_authorised(flag: Missing) -> None:
    assert after(at_rest(STANDBY, missing=int(flag))) is STANDBY
    assert after(at_rest(AUTHORISED, missing=int(flag))) is STANDBY
    assert after(at_rest(JOG, missing=int(flag), jog_granted=True)) is STANDBY


NEEDED_ON_SIGHT = {
    Missing.BRAKE,
    Missing.TRACTION,
    Missing.ODOMETER,
    Missing.DOORS,
    Missing.DESK,
}


@pytest.mark.parametrize("flag", FLAGS)
@pytest.mark.parametrize(
    ("mode", "asks", "needed"),
    [
        (RESTRICTED, {"sight_asked": True, "person_at_desk": True}, NEEDED_ON_SIGHT),
        (CREEP, {"creep_ordered": True}, NEEDED_ON_SIGHT | {Missing.ALARMS}),
    ],
)
def test_on_sight_a_train_does_without_place_and_authority_but_not_without_its_units(
    mode: OperatingMode, asks: dict[str, bool], needed: set[Missing], flag: Missing
) -> None:
    missing = int(flag) | int(Missing.AUTHORITY)
    found = after(at_rest(STANDBY, missing=missing, **asks))
    kept = after(at_rest(mode, missing=missing, **asks))

    assert found is kept is (STANDBY if flag in needed else mode)


@pytest.mark.parametrize(
    ("mode", "asks"),
    [(RESTRICTED, {"sight_asked": True}), (CREEP, {"creep_ordered": True})],
)
def test_driving_on_sight_begins_only_when_asked_at_standstill_without_emergency(
    mode: OperatingMode, asks: dict[str, bool]
) -> None:
    seen = at_rest(STANDBY, missing=UNPLACED, **asks)

    assert after(seen) is mode
    assert after(at_rest(STANDBY, missing=UNPLACED)) is STANDBY
    assert after(seen._replace(standstill=False)) is STANDBY
    assert after(seen._replace(standing=False)) is STANDBY
    assert after(seen._replace(latched=(Cause.REMOTE,))) is STANDBY


def test_with_position_and_authority_no_train_runs_on_sight() -> None:
    assert after(at_rest(STANDBY, sight_asked=True, creep_ordered=True)) is AUTHORISED


@pytest.mark.parametrize("mode", MOVING)
def test_an_emergency_takes_every_permission_back_once_the_train_stands(
    mode: OperatingMode,
) -> None:
    keeps = {"jog_granted": True, "person_at_desk": True, "creep_ordered": True}
    latched = (Cause.OVERSPEED,)
    unplaced = UNPLACED if mode in (RESTRICTED, CREEP) else 0
    moving = RUNNING._replace(mode=mode, latched=latched, missing=unplaced, **keeps)  # type: ignore[arg-type]

    assert after(at_rest(mode, latched=latched, missing=unplaced, **keeps)) is STANDBY
    assert after(moving) is mode


@pytest.mark.parametrize(
    ("mode", "answer"), [(RESTRICTED, "person_at_desk"), (CREEP, "creep_ordered")]
)
def test_driving_on_sight_ends_when_its_requester_withdraws(
    mode: OperatingMode, answer: str
) -> None:
    assert after(at_rest(mode, missing=UNPLACED, **{answer: True})) is mode
    assert after(at_rest(mode, missing=UNPLACED)) is STANDBY
    assert after(RUNNING._replace(mode=mode, missing=UNPLACED)) is mode


AGED_S = CONFIG.authority_service_ratio * CONFIG.authority_age_max_s
TOP_MPS = 10.0 - CONFIG.takeover_margin_mps


@pytest.mark.parametrize("mode", [RESTRICTED, CREEP])
@pytest.mark.parametrize(
    ("changes", "takes_over"),
    [
        ({}, True),
        ({"speed_mps": Interval(9.0, 9.1, TOP_MPS + 1e-9)}, False),
        ({"speed_mps": Interval(9.0, 9.1, math.nan)}, False),
        ({"full_mps": math.nan}, False),
        ({"authority_age_s": AGED_S}, False),
        ({"authority_age_s": AGED_S - 1e-9}, True),
        ({"authority_age_s": math.nan}, False),
        ({"latched": (Cause.BUTTON,)}, False),
        *(({"missing": int(flag)}, False) for flag in FLAGS),
    ],
)
def test_full_supervision_takes_over_in_motion_only_from_a_train_well_within_it(
    mode: OperatingMode, changes: dict[str, Any], takes_over: bool
) -> None:
    seen = RUNNING._replace(
        mode=mode,
        speed_mps=Interval(9.0, 9.1, TOP_MPS),
        person_at_desk=True,
        creep_ordered=True,
    )

    assert after(seen._replace(**changes)) is (AUTHORISED if takes_over else mode)


@pytest.mark.parametrize("mode", [RESTRICTED, CREEP])
def test_a_train_that_stands_is_within_every_limit(mode: OperatingMode) -> None:
    seen = at_rest(mode, full_mps=0.0, person_at_desk=True, creep_ordered=True)

    assert after(seen) is AUTHORISED


def test_a_jog_begins_and_ends_at_rest() -> None:
    assert after(at_rest(AUTHORISED)) is AUTHORISED
    assert after(at_rest(AUTHORISED, jog_granted=True)) is JOG
    assert after(RUNNING._replace(jog_granted=True)) is AUTHORISED
    assert after(at_rest(JOG, jog_granted=True)) is JOG
    assert after(at_rest(JOG)) is AUTHORISED
    assert after(RUNNING._replace(mode=JOG)) is JOG


def test_departure_ignores_only_the_terms_that_a_mode_cannot_have() -> None:
    unheeded = {mode: flags for mode, flags in UNHEEDED.items() if flags}

    assert unheeded == {
        RESTRICTED: Inhibit.AUTHORITY | Inhibit.CENTRE_SILENT,
        CREEP: Inhibit.AUTHORITY,
        JOG: Inhibit.AUTHORITY | Inhibit.HOLD,
    }
    for flags in UNHEEDED.values():
        assert not flags & (Inhibit.DOORS | Inhibit.OBSTACLE | Inhibit.EMERGENCY | Inhibit.ASLEEP)


BOOLS = st.booleans()


@given(
    mode=st.sampled_from(list(OperatingMode)),
    missing=st.integers(0, 511),
    standing=BOOLS,
    standstill=BOOLS,
    sleep_ordered=BOOLS,
    person_at_desk=BOOLS,
    sight_asked=BOOLS,
    creep_ordered=BOOLS,
    jog_granted=BOOLS,
    latched=st.sampled_from([(), (Cause.BUTTON,)]),
    authority_age_s=st.floats(0.0, 5.0),
    speed_mps=st.floats(0.0, 20.0).map(lambda v: Interval(v, v, v)),
)
def test_a_less_restrictive_mode_needs_position_and_fresh_authority_or_standstill(
    mode: OperatingMode, **changes: Any
) -> None:
    seen = RUNNING._replace(mode=mode, **changes)

    found = after(seen)

    if found is mode:
        return
    if found in SUPERVISED:
        assert not seen.missing
        assert not seen.latched or mode in SUPERVISED
        if not seen.standing and mode not in SUPERVISED and not seen.standstill:
            assert seen.authority_age_s < AGED_S
            assert seen.speed_mps.high <= TOP_MPS
    if found in (RESTRICTED, CREEP):
        assert mode is STANDBY
        assert seen.standstill
    if found in (ASLEEP, STANDBY) and mode is not ASLEEP:
        assert seen.standing or seen.standstill
