"""What the controller passes from part to part, with odometry and protection that say one thing."""

import math
from dataclasses import replace
from typing import Any

import pytest

from can_dbc.brake import BrakeStatus
from can_dbc.cab import CabMode
from can_dbc.diagnostics import TcmsStatus
from can_dbc.doors import DoorState, DoorStatus
from can_dbc.energy import LineSupply
from can_dbc.traction import TractionStatus
from can_dbc.vobc import Inhibit, Missing, OperatingMode, Supervision
from firmware_py.trackdb import LineMap, PlatformSide
from hil_tests.unit.vobc.atp.heard_rig import DESK, NO_ORDERS, SILENCE
from hil_tests.unit.vobc.test_vobc_controller import (
    CONFIG,
    CYCLE_S,
    LINE,
    NOMINAL_M,
    ControllerRig,
    Driver,
)
from vobc.ato import Ato
from vobc.atp import ProtectionVerdict
from vobc.atp.doors import DoorEnable
from vobc.config import VobcConfig, plan_mission
from vobc.controller import Controller, _within_service_brake
from vobc.vocabulary import (
    AtoInput,
    Authority,
    Ceiling,
    CycleInput,
    CycleOutput,
    Interval,
    Motion,
    OdometryRecord,
)

FRONT_M = LINE.stations[1].stop_m
MOTION = Motion(
    Interval(FRONT_M - 1.0, FRONT_M, FRONT_M + 2.5), Interval(4.9, 5.0, 5.1), 0.1, 50.0,
    standing=False, standstill=False, localised=True, slip=False, accepted_tag_ids=(7,),
)  # fmt: skip
NOMINAL = ProtectionVerdict(
    Supervision.NOMINAL, "", Missing.NOTHING, Ceiling(15.0, 16.0, 17.0, 18.0, 400.0),
    doors_locked=True, emergency_released=True, service_brake=False, traction_permitted=True,
    hold=False, doors=DoorEnable(left=False, right=False), mode=OperatingMode.AUTHORISED,
)  # fmt: skip
INPUTS = replace(SILENCE, now_ns=7_000_000_000, desk=DESK)


class Saying:
    """Stands for odometry and protection: whatever comes in, it says the same."""

    usable = True
    rejected_tags = 3

    def __init__(self, said: Any) -> None:
        self.said = said
        self.given: dict[str, Any] = {}

    def step(self, *_inputs: Any, **given: Any) -> Any:
        self.given = given
        return self.said


class Between:
    """A controller between an odometry, a protection and an operation that the test sets."""

    def __init__(self, config: VobcConfig = CONFIG, line: LineMap = LINE) -> None:
        first, last = line.stations[0].name, line.stations[-1].name
        self.driver = Driver()
        self.controller = Controller(
            config, line, plan_mission(line, first, last),
            OdometryRecord(FRONT_M, 0.2, NOMINAL_M), self.driver,
        )  # fmt: skip
        self.odometry, self.protection = Saying(MOTION), Saying(NOMINAL)
        self.controller._odometry = self.odometry  # type: ignore[assignment]
        self.controller._protection = self.protection  # type: ignore[assignment]

    def step(self, inputs: CycleInput = INPUTS, **verdict: Any) -> CycleOutput:
        if verdict:
            self.protection.said = replace(NOMINAL, **verdict)
        return self.controller.step(inputs)

    def seen(self, inputs: CycleInput = INPUTS, **verdict: Any) -> AtoInput:
        self.step(inputs, **verdict)
        return self.driver.seen[-1]


def test_the_state_of_the_parts_can_be_read() -> None:
    between = Between()
    assert between.controller.verdict is None

    between.step()

    assert between.controller.verdict is NOMINAL
    assert between.controller.rejected_tags == 3
    kept = ControllerRig().controller.record()
    assert kept.front_m == plan_mission(LINE, "II", "III").start.stop_m


def test_without_another_operation_the_configured_one_drives() -> None:
    mission = plan_mission(LINE, "II", "III")

    controller = Controller(CONFIG, LINE, mission, OdometryRecord(0.0, 0.2, NOMINAL_M))

    assert isinstance(controller._operation, Ato)


@pytest.mark.parametrize(("most_mps2", "taken_mps2"), [(0.7, 0.7), (1.9, 1.0)])
def test_operation_demands_no_more_brake_than_the_train_has(
    most_mps2: float, taken_mps2: float
) -> None:
    limits = replace(CONFIG.ato.limits, brake_demand_max_mps2=most_mps2)
    config = replace(CONFIG, ato=replace(CONFIG.ato, limits=limits))
    assert CONFIG.train.service_decel_max_mps2 == 1.0

    found = _within_service_brake(config)

    assert found.limits.brake_demand_max_mps2 == taken_mps2


def test_protection_knows_where_operation_stopped_or_is_about_to() -> None:
    between = Between()
    between.driver.demand = replace(between.driver.demand, stopping_at_m=812.5)
    between.step()
    assert between.protection.given["stopping_at_m"] is None

    between.step()
    assert between.protection.given["stopping_at_m"] == 812.5

    between.step(replace(INPUTS, desk=None))
    between.step()
    assert between.protection.given["stopping_at_m"] is None


def test_a_number_that_is_not_finite_is_said_in_the_next_cycle_only() -> None:
    between = Between()
    between.driver.demand = replace(between.driver.demand, accel_mps2=math.nan)
    assert between.step().motion is None
    assert between.protection.given["not_finite"] is False

    between.driver.demand = replace(between.driver.demand, accel_mps2=0.5)
    between.step()
    assert between.protection.given["not_finite"] is True
    between.step()
    assert between.protection.given["not_finite"] is False


def test_without_motion_or_desk_the_train_is_braked_and_operation_rests() -> None:
    between = Between()
    outputs = [between.step(replace(INPUTS, desk=None))]
    between.odometry.said = None
    outputs.append(between.step(ceiling=None))

    for output in outputs:
        assert output.service_decel_mps2 == CONFIG.train.service_decel_max_mps2
        assert not output.holding_released
        assert output.force_n == 0.0
    assert between.driver.seen == []


def test_a_train_with_current_loops_gets_its_demand_as_currents() -> None:
    stage = replace(CONFIG.ato.output, stage="current_loop")
    between = Between(replace(CONFIG, ato=replace(CONFIG.ato, output=stage)))

    pulling = between.step()
    between.driver.demand = replace(between.driver.demand, accel_mps2=math.nan)
    unsafe = between.step()

    assert pulling.currents is not None
    assert pulling.currents.traction_ma > 4.0
    assert unsafe.currents is None
    assert Between().step().currents is None


def test_the_lever_starts_from_nothing_each_time_that_it_takes_over() -> None:
    between = Between()
    manual = replace(INPUTS, desk=replace(DESK, mode=CabMode.MANUAL, lever_percent=100.0))
    step_mps2 = CONFIG.manual_jerk_mps3 * CYCLE_S

    first, second = (between.step(manual).accel_demand_mps2 for _ in range(2))
    between.step()
    again = between.step(manual).accel_demand_mps2
    slow = between.step(replace(manual, dt_s=10.0)).accel_demand_mps2
    quick = between.step(replace(manual, dt_s=0.01)).accel_demand_mps2

    assert (first, second, again) == pytest.approx((step_mps2, 2 * step_mps2, step_mps2))
    assert slow == pytest.approx(2 * step_mps2)
    assert quick == pytest.approx(2 * step_mps2 + CONFIG.manual_jerk_mps3 * 0.01)


def test_the_load_is_that_of_the_last_stand_or_the_first_one_reported() -> None:
    between = Between()

    def load_kg(reported_kg: float | None, motion: Motion | None) -> float:
        between.odometry.said = motion
        load = None if reported_kg is None else TcmsStatus(reported_kg, 4)
        between.step(replace(INPUTS, load=load), ceiling=None if motion is None else CEILING)
        return between.controller._weighed_kg

    standing = replace(MOTION, standing=True)
    assert load_kg(None, MOTION) == CONFIG.train.full_load_kg
    assert load_kg(None, standing) == CONFIG.train.full_load_kg
    assert load_kg(10_000.0, MOTION) == 10_000.0
    assert load_kg(20_000.0, MOTION) == 10_000.0
    assert load_kg(20_000.0, standing) == 20_000.0
    assert load_kg(None, standing) == 20_000.0
    assert load_kg(30_000.0, None) == 30_000.0
    assert load_kg(5_000.0, MOTION) == 30_000.0


CEILING = NOMINAL.ceiling
AT_DESK = replace(INPUTS, desk=replace(DESK, mode=CabMode.MANUAL))


@pytest.mark.parametrize(
    ("inputs", "verdict", "enabled"),
    [
        (INPUTS, {}, True),
        (AT_DESK, {}, False),
        (replace(INPUTS, desk=replace(DESK, mode=CabMode.OFF)), {}, False),
        (INPUTS, {"supervision": Supervision.WARNING}, True),
        (INPUTS, {"supervision": Supervision.SERVICE}, True),
        (INPUTS, {"supervision": Supervision.EMERGENCY}, False),
        (INPUTS, {"supervision": Supervision.EMERGENCY, "creep": True}, False),
        (INPUTS, {"supervision": Supervision.NO_AUTHORITY}, False),
        (INPUTS, {"missing": Missing.DOORS}, True),
        (INPUTS, {"missing": Missing.ALARMS}, True),
        (INPUTS, {"missing": Missing.DOORS | Missing.ALARMS}, True),
        (INPUTS, {"missing": Missing.BRAKE}, False),
        (INPUTS, {"missing": Missing.BRAKE | Missing.DOORS}, False),
        (INPUTS, {"missing": Missing.BRAKE, "creep": True}, True),
        (AT_DESK, {"creep": True}, False),
    ],
)
def test_operation_is_enabled_under_its_desk_its_supervision_and_its_units(
    inputs: CycleInput, verdict: dict[str, Any], *, enabled: bool
) -> None:
    assert Between().seen(inputs, **verdict).enabled is enabled


def test_operation_sees_place_authority_and_traction_of_the_worse_end() -> None:
    traction = TractionStatus(0.0, 0.5, True, True)
    given = replace(INPUTS, traction=traction, authority=Authority(FRONT_M + 100.0, 1, 1))
    seen, alone = Between().seen(given), Between().seen()

    assert (seen.front_m, seen.ahead_m) == (FRONT_M, 2.5)
    assert seen.authority_end_m == FRONT_M + 100.0
    assert seen.gradient_permille == LINE.mean_gradient_permille(
        FRONT_M - CONFIG.train.length_m, FRONT_M
    )
    train = CONFIG.train
    mass_kg = train.tare_kg * (1.0 + train.rotating_mass_ratio) + train.full_load_kg
    assert seen.traction_mps2 == pytest.approx(0.5 * train.rated_force_n / mass_kg)
    assert seen.traction_ratio == 0.5
    assert (alone.authority_end_m, alone.traction_ratio, alone.traction_mps2) == (FRONT_M, 0.0, 0.0)
    beyond = replace(INPUTS, authority=Authority(LINE.end_m + 50.0, 1, 1))
    assert Between().seen(beyond).authority_end_m == LINE.end_m


@pytest.mark.parametrize("locked", [True, False])
@pytest.mark.parametrize("bypass", [True, False])
def test_bypassed_doors_count_as_locked_but_not_as_shut(*, locked: bool, bypass: bool) -> None:
    opened = DoorStatus(False, DoorState.OPEN, DoorState.OPEN, True)

    seen = Between().seen(replace(INPUTS, doors=opened), doors_locked=locked, door_bypass=bypass)

    assert seen.doors_locked is (locked or bypass)
    assert seen.doors_open is (not locked)


@pytest.mark.parametrize("left", [True, False])
@pytest.mark.parametrize("right", [True, False])
def test_a_door_is_enabled_on_either_side(*, left: bool, right: bool) -> None:
    assert Between().seen(doors=DoorEnable(left, right)).door_enabled is (left or right)


@pytest.mark.parametrize("side", list(PlatformSide))
@pytest.mark.parametrize("left", [True, False])
@pytest.mark.parametrize("right", [True, False])
def test_doors_are_open_where_a_side_with_a_platform_is(
    side: PlatformSide, *, left: bool, right: bool
) -> None:
    """The nearest station counts, whether before or behind the front."""
    dwell_s = 0.0 if side is PlatformSide.NONE else LINE.stations[1].dwell_s
    here = replace(LINE.stations[1], side=side, dwell_s=dwell_s)
    line = replace(LINE, stations=(LINE.stations[0], here, *LINE.stations[2:]))
    shut, opened = DoorState.LOCKED, DoorState.OPEN
    doors = DoorStatus(False, opened if left else shut, opened if right else shut, True)
    inputs = replace(INPUTS, doors=doors)

    seen = Between(line=line).seen(inputs, doors_locked=False)

    assert seen.doors_open is ((side.left and left) or (side.right and right))
    assert Between(line=line).seen(doors_locked=False).doors_open is False


@pytest.mark.parametrize(
    ("brake", "applied"),
    [(None, False), (BrakeStatus(0.0, 0.0, False, True, False, True), True),
     (BrakeStatus(0.0, 0.0, False, False, False, True), False)],
)  # fmt: skip
def test_a_silent_brake_does_not_hold(brake: BrakeStatus | None, *, applied: bool) -> None:
    assert Between().seen(replace(INPUTS, brake=brake)).holding_applied is applied


@pytest.mark.parametrize(("skip", "stop", "seen"), [(True, False, True), (False, False, False),
                                                    (True, True, False)])  # fmt: skip
def test_a_station_is_skipped_by_order_unless_the_train_has_to_stop(
    *, skip: bool, stop: bool, seen: bool
) -> None:
    ordered = replace(INPUTS, orders=replace(NO_ORDERS, skip_next=skip))

    assert Between().seen(ordered, stop_next=stop).skip_next is seen
    assert Between().seen(INPUTS).skip_next is False


@pytest.mark.parametrize(
    ("inhibits", "departs", "kept"),
    [
        (Inhibit.NONE, True, False),
        (Inhibit.DOORS, False, False),
        (Inhibit.PLATFORM_DOORS, False, False),
        (Inhibit.AUTHORITY, False, False),
        (Inhibit.DOORS | Inhibit.PLATFORM_DOORS | Inhibit.AUTHORITY, False, False),
        (Inhibit.HOLD, False, True),
        (Inhibit.HOLD | Inhibit.DOORS, False, True),
    ],
)
def test_doors_and_authority_end_no_dwell(inhibits: Inhibit, *, departs: bool, kept: bool) -> None:
    seen = Between().seen(departure_inhibits=inhibits)

    assert (seen.departure_permitted, seen.kept_at_platform) == (departs, kept)


@pytest.mark.parametrize(
    ("supply", "age_s", "volts"),
    [
        (None, 0.0, None),
        (LineSupply(750.0, 100.0, True), 0.5, 750.0),
        (LineSupply(750.0, 100.0, True), 0.51, None),
        (LineSupply(750.0, 100.0, False), 0.1, None),
    ],
)
def test_the_line_voltage_counts_while_it_is_fresh_and_the_breaker_closed(
    supply: LineSupply | None, age_s: float, volts: float | None
) -> None:
    seen = Between().seen(replace(INPUTS, supply=supply, supply_age_s=age_s))

    assert seen.line_voltage_v == volts


@pytest.mark.parametrize(
    ("ahead_mps", "less_mps"), [(0.5, 0.0), (1.2, 0.0), (1.5, 1.2), (1.92, 2.88), (4.0, 6.0)]
)
def test_operation_stays_below_the_ceiling_by_what_its_speed_may_be_higher(
    ahead_mps: float, less_mps: float
) -> None:
    """The margins of operation cover up to 1.2 m/s; from 1.92 m/s on it counts 1.5 times."""
    between = Between()
    usual_mps = between.seen().ceiling_mps
    speed_mps = Interval(8.0, 10.0, 10.0 + ahead_mps)
    between.odometry.said = replace(MOTION, speed_mps=speed_mps)

    assert between.seen().ceiling_mps == pytest.approx(usual_mps - less_mps)
    assert between.seen(jog_to_tag=True).jog_to_tag
