"""Arbitration: in every single output the more restrictive of protection and operation counts."""

import itertools
import math
from dataclasses import fields, replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from can_dbc.cab import CabMode, Desk
from can_dbc.nodes import Direction
from can_dbc.vobc import (
    AtoPhase,
    Cause,
    Inhibit,
    Missing,
    OperatingMode,
    ReasonCode,
    Supervision,
    Withheld,
)
from hil_tests.unit.vobc.atp.heard_rig import DESK
from vobc.arbitration import (
    BRAKED_DEMAND,
    arbitrate,
    effort,
    manual_demand,
    most_accel_mps2,
)
from vobc.atp import ProtectionVerdict
from vobc.atp.doors import DoorEnable
from vobc.config import load_config
from vobc.vocabulary import SAFE_OUTPUT, AtoDemand, Ceiling, CycleOutput, Interval, Motion

TRAIN = load_config("florence4").train
LOAD_KG = 20_000.0
MASS_KG = 130_000.0 * 1.08 + LOAD_KG

MOTION = Motion(
    Interval(99.0, 100.0, 101.0),
    Interval(9.8, 10.0, 10.2),
    0.1,
    50.0,
    False,
    False,
    True,
    False,
    (),
)
CEILING = Ceiling(15.0, 16.0, 17.0, 18.0, 400.0)
NUMBERS = [field.name for field in fields(Ceiling) if field.name != "target"]
FREE = ProtectionVerdict(
    supervision=Supervision.NOMINAL,
    cause="",
    missing=Missing.NOTHING,
    ceiling=CEILING,
    doors_locked=True,
    emergency_released=True,
    service_brake=False,
    traction_permitted=True,
    hold=False,
    doors=DoorEnable(False, False),
    mode=OperatingMode.AUTHORISED,
)
DRIVE = AtoDemand(0.5, False, False, AtoPhase.RUNNING, 12.0, 300.0)


def decided(
    verdict: ProtectionVerdict = FREE,
    demand: AtoDemand = DRIVE,
    motion: Motion | None = MOTION,
    desk: Desk | None = DESK,
    load_kg: float = LOAD_KG,
) -> CycleOutput:
    return arbitrate(verdict, demand, motion, desk, train=TRAIN, load_kg=load_kg)


def test_without_restrictions_operations_demand_is_sent() -> None:
    output = decided()

    assert output.force_n == pytest.approx(0.5 * MASS_KG)
    assert output.direction is Direction.FORWARD
    assert output.traction_permitted
    assert output.service_decel_mps2 == 0.0
    assert output.emergency_released
    assert output.holding_released


def test_a_negative_demand_sets_the_brake_alone() -> None:
    output = decided(demand=replace(DRIVE, accel_mps2=-0.7))

    assert output.service_decel_mps2 == 0.7
    assert output.force_n == 0.0


@given(st.floats(-3.0, 3.0), st.floats(0.0, 54_400.0))
def test_traction_and_brake_are_never_demanded_together_nor_beyond_their_maximum(
    accel_mps2: float, load_kg: float
) -> None:
    force_n, decel_mps2 = effort(accel_mps2, train=TRAIN, load_kg=load_kg)

    assert force_n == 0.0 or decel_mps2 == 0.0
    assert 0.0 <= force_n <= TRAIN.rated_force_n
    assert 0.0 <= decel_mps2 <= TRAIN.service_decel_max_mps2


@pytest.mark.parametrize(("speed_mps", "force_n"), [(0.0, 2e5), (12.0, 2e5), (20.0, 1.2e5)])
def test_at_speed_the_power_limits_traction(speed_mps: float, force_n: float) -> None:
    most_mps2 = most_accel_mps2(speed_mps, train=TRAIN, load_kg=LOAD_KG)

    assert most_mps2 * MASS_KG == pytest.approx(force_n)
    assert effort(3.0, train=TRAIN, load_kg=LOAD_KG) == (2e5, 0.0)


def test_a_train_that_rolls_backwards_has_its_rated_force() -> None:
    assert most_accel_mps2(-20.0, train=TRAIN, load_kg=LOAD_KG) == pytest.approx(2e5 / MASS_KG)


def test_the_effort_is_continuous_at_zero_demand() -> None:
    tiny = 1e-9

    assert effort(tiny, train=TRAIN, load_kg=0.0)[0] < 1.0
    assert effort(-tiny, train=TRAIN, load_kg=0.0)[1] <= tiny
    assert effort(0.0, train=TRAIN, load_kg=0.0) == (0.0, 0.0)


def test_protection_overrules_in_every_combination() -> None:
    """The test takes all 64 combinations of what protection may forbid and operation may ask
    for."""
    for released, brake, permitted, hold in itertools.product((False, True), repeat=4):
        for accel_mps2, asked_hold in itertools.product((0.5, -0.3), (False, True)):
            verdict = replace(
                FREE,
                emergency_released=released,
                service_brake=brake,
                traction_permitted=permitted,
                hold=hold,
            )
            demand = replace(DRIVE, accel_mps2=accel_mps2, hold=asked_hold)

            output = decided(verdict, demand)

            assert output.emergency_released is released
            assert output.holding_released is not (hold or asked_hold)
            if brake:
                assert output.service_decel_mps2 == TRAIN.service_decel_max_mps2
            else:
                assert output.service_decel_mps2 == max(0.0, -accel_mps2)
            if brake or not permitted or accel_mps2 < 0.0:
                assert output.force_n == 0.0
            else:
                assert output.force_n > 0.0
            if not permitted:
                assert not output.traction_permitted
                assert output.direction is Direction.NEUTRAL


def test_traction_of_a_held_train_is_cut_unless_it_departs() -> None:
    held = decided(demand=replace(DRIVE, accel_mps2=0.0, hold=True))
    sets_off = decided(demand=replace(DRIVE, accel_mps2=0.1, hold=True))

    assert not held.traction_permitted
    assert sets_off.traction_permitted
    assert not sets_off.holding_released


def test_without_a_driver_or_ato_the_output_is_full_brake_and_hold() -> None:
    output = decided(replace(FREE, doors=DoorEnable(True, True)), BRAKED_DEMAND)

    assert output.service_decel_mps2 == TRAIN.service_decel_max_mps2
    assert not output.holding_released
    assert math.isfinite(output.accel_demand_mps2)
    assert output.supervision is Supervision.NOMINAL
    assert (output.open_left, output.open_right) == (False, False)
    assert output.target_mps == 0.0


BAD = (math.nan, math.inf, -math.inf)


@pytest.mark.parametrize("bad", BAD)
@pytest.mark.parametrize("part", ["accel_mps2", "target_mps"])
def test_a_nan_demand_gives_the_safe_output(part: str, bad: float) -> None:
    changed = {part: bad}
    output = decided(demand=replace(DRIVE, **changed))  # type: ignore[arg-type]

    assert_safe(output)


@pytest.mark.parametrize("bad", BAD)
@pytest.mark.parametrize(
    "part", [field.name for field in fields(Ceiling) if field.name != "target"]
)
def test_a_nan_ceiling_gives_the_safe_output(part: str, bad: float) -> None:
    ceiling = replace(CEILING, **{part: bad})  # type: ignore[arg-type]
    output = decided(replace(FREE, ceiling=ceiling))

    assert_safe(output)


@pytest.mark.parametrize("bad", BAD)
@pytest.mark.parametrize("end", ["low", "best", "high"])
@pytest.mark.parametrize("part", ["front_m", "speed_mps"])
def test_a_nan_motion_gives_the_safe_output(part: str, end: str, bad: float) -> None:
    interval = replace(getattr(MOTION, part), **{end: bad})
    changed = {part: interval}

    assert_safe(decided(motion=replace(MOTION, **changed)))


@pytest.mark.parametrize("bad", BAD)
def test_a_nan_acceleration_or_load_gives_the_safe_output(bad: float) -> None:
    assert_safe(decided(motion=replace(MOTION, accel_mps2=bad)))
    assert_safe(decided(motion=replace(MOTION, travel_m=bad)))
    assert_safe(decided(motion=replace(MOTION, pulses_m=bad)))
    assert_safe(decided(load_kg=bad))


def test_a_missing_stop_is_no_error_but_a_nan_stop_is() -> None:
    assert decided(demand=replace(DRIVE, distance_to_stop_m=math.inf)).force_n > 0.0
    assert_safe(decided(demand=replace(DRIVE, distance_to_stop_m=math.nan)))


def assert_safe(output: CycleOutput) -> None:
    assert output == replace(
        SAFE_OUTPUT,
        cause="a number was not finite",
        mode=FREE.mode,
        emergency_cause=Cause.NOT_FINITE,
        reason=ReasonCode.NOT_FINITE,
    )
    assert not output.emergency_released
    assert output.force_n == 0.0
    assert not output.traction_permitted
    assert not output.holding_released
    assert output.service_decel_mps2 >= 1.0


@pytest.mark.parametrize("enabled", [(False, False), (True, False), (False, True)])
@pytest.mark.parametrize("mode", [CabMode.AUTO, CabMode.MANUAL])
def test_doors_open_only_where_enabled_and_requested_by_driver_or_ato(
    enabled: tuple[bool, bool], mode: CabMode
) -> None:
    for asked, left_button, right_button in itertools.product((False, True), repeat=3):
        desk = replace(
            DESK, mode=mode, open_left_requested=left_button, open_right_requested=right_button
        )
        output = decided(
            replace(FREE, doors=DoorEnable(*enabled)), replace(DRIVE, open_doors=asked), desk=desk
        )

        want = (left_button, right_button) if mode is CabMode.MANUAL else (asked, asked)
        assert (output.enable_left, output.enable_right) == enabled
        assert (output.open_left, output.open_right) == (
            enabled[0] and want[0],
            enabled[1] and want[1],
        )


def test_the_lever_moves_the_demand_no_faster_than_the_jerk_limit() -> None:
    desk = replace(DESK, mode=CabMode.MANUAL, lever_percent=100.0)

    first = manual_demand(desk, 0.0, False, train=TRAIN, jerk_mps=0.03)
    later = manual_demand(desk, 5.0, False, train=TRAIN, jerk_mps=0.03)

    assert first.accel_mps2 == pytest.approx(0.03)
    assert later.accel_mps2 == pytest.approx(4.97)


@pytest.mark.parametrize(
    ("lever", "standing", "accel_mps2", "hold"),
    [
        (100.0, True, 200_000.0 / (130_000.0 * 1.08), False),
        (50.0, False, 100_000.0 / (130_000.0 * 1.08), False),
        (0.0, True, 0.0, True),
        (0.0, False, 0.0, False),
        (-50.0, True, -0.5, True),
        (-100.0, False, -1.0, False),
        (-900.0, False, -1.0, False),
        (900.0, False, 200_000.0 / (130_000.0 * 1.08), False),
    ],
)
def test_the_lever_as_a_demand(lever: float, standing: bool, accel_mps2: float, hold: bool) -> None:
    desk = replace(DESK, mode=CabMode.MANUAL, lever_percent=lever)

    demand = manual_demand(desk, 0.0, standing, train=TRAIN, jerk_mps=10.0)

    assert demand.accel_mps2 == pytest.approx(accel_mps2)
    assert demand.hold is hold
    assert demand.phase is AtoPhase.OFF


@pytest.mark.parametrize("permitted", [False, True])
def test_traction_drives_backwards_only_where_protection_permits_it(permitted: bool) -> None:
    verdict = replace(FREE, reverse_permitted=permitted)

    output = decided(verdict, replace(DRIVE, reverse=True))

    assert output.direction is (Direction.REVERSE if permitted else Direction.NEUTRAL)
    assert output.traction_permitted is permitted
    assert (output.force_n > 0.0) is permitted
    assert decided(verdict).direction is Direction.FORWARD


def test_a_driver_never_drives_backwards() -> None:
    desk = replace(DESK, mode=CabMode.MANUAL, lever_percent=100.0)

    assert not manual_demand(desk, 0.0, True, train=TRAIN, jerk_mps=1.0).reverse


@pytest.mark.parametrize(("by_protection", "by_operation"), [(True, False), (False, True)])
def test_every_call_for_a_person_is_sent(by_protection: bool, by_operation: bool) -> None:
    verdict = replace(FREE, alarm_raised=by_protection)

    assert decided(verdict, replace(DRIVE, calls_for_help=by_operation)).alarm_raised
    assert not decided().alarm_raised


def test_the_findings_of_protection_are_sent_unchanged() -> None:
    verdict = replace(
        FREE,
        mode=OperatingMode.JOG,
        emergency_cause=Cause.BUTTON,
        departure_inhibits=Inhibit.HOLD,
        doors_withheld=Withheld.MOVING,
        jog_attempts=2,
        replicas_agree=False,
        door_bypass=True,
    )

    output = decided(verdict)

    assert output.mode is OperatingMode.JOG
    assert output.emergency_cause is Cause.BUTTON
    assert output.departure_inhibits is Inhibit.HOLD
    assert output.doors_withheld is Withheld.MOVING
    assert output.jog_attempts == 2
    assert not output.replicas_agree
    assert output.door_bypass
