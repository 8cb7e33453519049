"""One step of protection: its verdict on missing inputs, and the cost of a long cycle time."""

import math
from dataclasses import replace
from typing import Any

import pytest

from can_dbc.brake import BrakeStatus
from can_dbc.tags import TagReaderHealth
from can_dbc.traction import TractionStatus
from can_dbc.vobc import Missing, Supervision
from firmware_py.trackdb import load_line
from hil_tests.unit.vobc.atp.heard_rig import NO_ORDERS, SILENCE
from vobc.atp import Protection, ProtectionVerdict
from vobc.atp.braking import SafeBraking
from vobc.atp.inputs import FLAGS, in_words, silent, unready
from vobc.config import load_config
from vobc.vocabulary import Authority, CycleInput, Interval, Motion

LINE = load_line("florence")
CONFIG = load_config("florence4").atp
AT_300 = Motion(
    Interval(299.0, 300.0, 301.0),
    Interval(9.9, 10.0, 10.1),
    0.0,
    0.0,
    False,
    False,
    True,
    False,
    (),
)


def protection(cycle_s: float = 0.05) -> Protection:
    return Protection(CONFIG, LINE, train_length_m=68.59, cycle_s=cycle_s)


def verdict_on(
    motion: Motion | None, seen: CycleInput = SILENCE, cycle_s: float = 0.05
) -> ProtectionVerdict:
    return protection(cycle_s).step(seen, motion, odometer_usable=True, not_finite=False)


def test_without_odometry_protection_permits_nothing() -> None:
    verdict = verdict_on(None)

    assert verdict.supervision is Supervision.NO_AUTHORITY
    assert verdict.missing == Missing(511)
    assert verdict.ceiling is None
    assert verdict.service_brake
    assert verdict.hold
    assert not verdict.emergency_released
    assert not verdict.traction_permitted
    assert not verdict.doors_locked
    assert verdict.doors == (False, False)


@pytest.mark.parametrize(("cycle_s", "runaway_s"), [(0.05, 0.48), (0.02, 0.39), (0.2, 0.93)])
def test_a_longer_cycle_lengthens_the_assumed_reaction_time(
    cycle_s: float, runaway_s: float
) -> None:
    """Reaction: three cycles (two may be missed), 0.03 s of sensing and 0.30 s until traction is
    cut."""
    seen = replace(SILENCE, authority=Authority(401.0, 1, 1))

    verdict = verdict_on(AT_300, seen, cycle_s)

    curve = SafeBraking(1.0, 1.0, runaway_s, 1.05).on(0.0)
    assert verdict.ceiling is not None
    assert verdict.ceiling.emergency_mps == pytest.approx(curve.speed_mps(100.0, target_mps=0.0))


TIMEOUTS = {
    "brake_age_s": (CONFIG.timeouts.brake_s, Missing.BRAKE),
    "traction_age_s": (CONFIG.timeouts.traction_s, Missing.TRACTION),
    "tacho_age_s": (CONFIG.timeouts.tacho_s, Missing.ODOMETER),
    "doors_age_s": (CONFIG.timeouts.doors_s, Missing.DOORS),
    "desk_age_s": (CONFIG.timeouts.desk_s, Missing.DESK),
    "tag_reader_age_s": (CONFIG.timeouts.tag_reader_s, Missing.TAG_READER),
    "alarms_age_s": (CONFIG.timeouts.alarms_s, Missing.ALARMS),
    "authority_age_s": (CONFIG.authority_age_max_s, Missing.AUTHORITY),
    "orders_age_s": (CONFIG.restrictions_age_max_s, Missing.AUTHORITY),
}
NO_AGES: dict[str, Any] = dict.fromkeys(TIMEOUTS, 0.0)
FRESH = replace(SILENCE, authority=Authority(500.0, 1, 1), orders=NO_ORDERS, **NO_AGES)


def changed(name: str, value: float) -> dict[str, Any]:
    return {name: value}


@pytest.mark.parametrize("age", list(TIMEOUTS))
def test_an_input_is_silent_just_after_its_timeout_and_not_before(age: str) -> None:
    timeout_s, flag = TIMEOUTS[age]
    at_timeout = replace(FRESH, **changed(age, timeout_s))
    after = replace(FRESH, **changed(age, timeout_s + 1e-9))
    no_number = replace(FRESH, **changed(age, math.nan))

    assert silent(at_timeout, CONFIG, odometer_usable=True) == 0
    assert silent(after, CONFIG, odometer_usable=True) == flag
    assert silent(no_number, CONFIG, odometer_usable=True) == flag


@pytest.mark.parametrize("absent", [{"authority": None}, {"orders": None}])
def test_an_absent_authority_or_restrictions_are_missing_whatever_their_age(
    absent: dict[str, Any],
) -> None:
    seen = replace(FRESH, **absent)

    assert silent(seen, CONFIG, odometer_usable=True) == Missing.AUTHORITY


def test_an_unusable_odometer_counts_as_silent() -> None:
    assert silent(FRESH, CONFIG, odometer_usable=False) == Missing.ODOMETER


def test_missing_inputs_are_named_in_a_fixed_order() -> None:
    words = in_words(Missing.LOCALISATION | Missing.BRAKE | Missing.DOORS)

    assert words == "brake unit, door unit, localisation"


def test_every_missing_input_has_a_text() -> None:
    everything = Missing(511)

    assert in_words(everything) == (
        "brake unit, traction unit, odometer, door unit, desk, tag reader, movement authority, "
        "localisation, obstacle and fire detection"
    )
    assert in_words(Missing.NOTHING) == ""


def test_the_table_of_missing_inputs_holds_every_combination_at_its_index() -> None:
    assert [int(flags) for flags in FLAGS] == list(range(2 ** len(Missing)))


BRAKE = BrakeStatus(0.0, 0.0, False, False, True, True)
TRACTION = TractionStatus(0.0, 1.0, True, True)
TAG_READER = TagReaderHealth(True, 0, 0.0)
READY = replace(SILENCE, brake=BRAKE, traction=TRACTION, tag_reader=TAG_READER)
LOST = replace(AT_300, localised=False)


@pytest.mark.parametrize(
    ("changes", "motion", "flags"),
    [
        ({}, AT_300, Missing.NOTHING),
        ({"brake": None}, AT_300, Missing.BRAKE),
        ({"brake": replace(BRAKE, ready=False)}, AT_300, Missing.BRAKE),
        ({"traction": None}, AT_300, Missing.TRACTION),
        ({"traction": replace(TRACTION, ready=False)}, AT_300, Missing.TRACTION),
        ({"tag_reader": None}, AT_300, Missing.TAG_READER),
        ({"tag_reader": replace(TAG_READER, antenna_ok=False)}, AT_300, Missing.TAG_READER),
        ({}, LOST, Missing.LOCALISATION),
        ({}, None, Missing.LOCALISATION),
        (
            {"brake": None, "tag_reader": None},
            LOST,
            Missing.BRAKE | Missing.TAG_READER | Missing.LOCALISATION,
        ),
    ],
)
def test_a_unit_that_reports_not_ready_counts_as_missing(
    changes: dict[str, Any], motion: Motion | None, flags: Missing
) -> None:
    assert unready(replace(READY, **changes), motion) == flags


def test_without_an_authority_nothing_is_permitted() -> None:
    verdict = verdict_on(AT_300)

    assert verdict.ceiling is not None
    assert verdict.ceiling.emergency_mps == 0.0
