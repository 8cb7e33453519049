"""One controller with hand-made inputs in every cycle."""

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pytest

from can_dbc.alarms import TrainAlarms
from can_dbc.brake import BrakeStatus
from can_dbc.cab import CabMode
from can_dbc.diagnostics import TcmsStatus
from can_dbc.doors import DoorState, DoorStatus
from can_dbc.nodes import Direction
from can_dbc.odometer import Doppler, Imu, Tacho
from can_dbc.tags import TagReaderHealth
from can_dbc.traction import TractionStatus
from can_dbc.vobc import AtoPhase, Missing, Supervision
from firmware_py.trackdb import load_line
from hil_tests.unit.vobc.atp.heard_rig import DESK, NO_ORDERS, SILENCE
from vobc.config import load_config, plan_mission
from vobc.controller import Controller
from vobc.vocabulary import (
    NEVER_S,
    AtoDemand,
    AtoInput,
    Authority,
    CycleOutput,
    OdometryRecord,
    TachoSample,
)

LINE = load_line("florence")
CONFIG = load_config("florence4")
CYCLE_S = 0.05
LEARN_S = CONFIG.odometry.learn_s
BLIND_MPS = 0.5
"""Speed below which the radar measures nothing, m/s."""
NOMINAL_M = CONFIG.train.nominal_m_per_pulse


ORDERS = replace(
    NO_ORDERS, awake=True, doors_left=True, doors_right=True, platform_doors_locked=True
)


class Driver:
    """A replacement for ATO that demands what the test sets."""

    def __init__(self) -> None:
        self.demand = AtoDemand(0.5, False, False, AtoPhase.RUNNING, 10.0, 100.0)
        self.seen: list[AtoInput] = []

    def step(self, seen: AtoInput) -> AtoDemand:
        self.seen.append(seen)
        return self.demand


class ControllerRig:
    """Supplies the inputs of every cycle; the true train moves as the test sets."""

    def __init__(self, start: str = "II", end: str = "III") -> None:
        mission = plan_mission(LINE, start, end)
        self.front_m = self.start_m = mission.start.stop_m
        self.driver = Driver()
        record = OdometryRecord(self.front_m, 0.2, NOMINAL_M)
        self.controller = Controller(CONFIG, LINE, mission, record, self.driver)
        self.now_s = 1.0
        self.speed_mps = 0.0
        self.image = replace(
            SILENCE,
            brake=BrakeStatus(0.0, 0.0, False, True, False, True),
            brake_age_s=0.02,
            traction=TractionStatus(0.0, 1.0, True, True),
            traction_age_s=0.02,
            doors=DoorStatus(True, DoorState.LOCKED, DoorState.LOCKED, True),
            doors_age_s=0.05,
            desk=DESK,
            desk_age_s=0.05,
            tag_reader=TagReaderHealth(True, 0, 0.0),
            tag_reader_age_s=0.1,
            load=TcmsStatus(27_200.0, 4),
            load_age_s=0.1,
            authority=Authority(self.front_m + 2000.0, 1, 1),
            authority_age_s=0.2,
            alarms=TrainAlarms(True, True),
            alarms_age_s=0.1,
            orders=ORDERS,
            orders_age_s=0.2,
        )
        self.odometer = True
        self.last: Tacho | None = None
        self.heard_s = -math.inf
        self.ran_mps = 0.0
        """Distance run in the previous cycle, m."""

    def change(self, **changes: Any) -> None:
        """Change the inputs from now on."""
        self.image = replace(self.image, **changes)

    def cycle(self) -> CycleOutput:
        samples = []
        if self.odometer:
            for before_s in (0.03, 0.01):
                at_m = self.front_m + self.speed_mps * (CYCLE_S - before_s) - self.start_m
                count = math.floor(at_m / NOMINAL_M) % 65536
                self.last = Tacho(count, count % 1024, Direction.FORWARD, True, True, 0)
                samples.append(TachoSample(self.last, before_s))
            self.heard_s = self.now_s + CYCLE_S - 0.01
        accel_mps2 = (self.speed_mps - self.ran_mps) / CYCLE_S
        self.ran_mps = self.speed_mps
        self.front_m += self.speed_mps * CYCLE_S
        self.now_s += CYCLE_S
        image = replace(
            self.image,
            now_ns=round(self.now_s * 1e9),
            tacho=self.last,
            tacho_age_s=self.now_s - self.heard_s,
            tacho_samples=tuple(samples),
            doppler=Doppler(
                self.speed_mps, 100.0 if abs(self.speed_mps) >= BLIND_MPS else 0.0, True
            ),
            doppler_age_s=0.02,
            imu=Imu(accel_mps2, True),
            imu_age_s=0.02,
        )
        return self.controller.step(image)

    def learn(self) -> None:
        """Run until just before odometry reports for the first time."""
        self.run(LEARN_S)

    def run(self, seconds: float) -> CycleOutput:
        for _ in range(round(seconds / CYCLE_S)):
            output = self.cycle()
        return output

    def set_off(self, speed_mps: float = 5.0) -> CycleOutput:
        """Wait for the proof of standstill, then accelerate at 1 m/s² to a steady speed."""
        output = self.run(2.5)
        assert output.supervision is Supervision.NOMINAL, output.cause
        steps = round(speed_mps / CYCLE_S)
        for share in range(1, steps + 1):
            self.speed_mps = speed_mps * share / steps
            output = self.cycle()
        return output

    def stop(self) -> None:
        """Brake at 1 m/s² to standstill."""
        while self.speed_mps > 0.0:
            self.speed_mps = max(0.0, self.speed_mps - CYCLE_S)
            self.cycle()


def assert_emergency(output: CycleOutput, cause: str) -> None:
    assert output.supervision is Supervision.EMERGENCY
    assert cause in output.cause
    assert not output.emergency_released
    assert not output.traction_permitted
    assert output.force_n == 0.0
    assert output.service_decel_mps2 >= 1.0


def test_with_every_input_present_the_train_departs_once_standstill_is_proven() -> None:
    bench = ControllerRig()

    early, late = bench.run(1.5), bench.run(1.0)

    assert early.supervision is Supervision.NO_AUTHORITY
    assert early.cause == "waits until standstill is proven"
    assert not early.emergency_released
    assert not early.traction_permitted
    assert not early.holding_released
    assert late.supervision is Supervision.NOMINAL
    assert late.force_n > 0.0
    assert late.holding_released


@pytest.mark.parametrize(
    ("part", "flag", "word"),
    [
        ("brake", Missing.BRAKE, "brake unit"),
        ("traction", Missing.TRACTION, "traction unit"),
        ("doors", Missing.DOORS, "door unit"),
        ("desk", Missing.DESK, "desk"),
        ("tag_reader", Missing.TAG_READER, "tag reader"),
        ("alarms", Missing.ALARMS, "obstacle and fire detection"),
        ("authority", Missing.AUTHORITY, "movement authority"),
    ],
)
def test_a_train_with_a_missing_input_stays_braked_and_names_it(
    part: str, flag: Missing, word: str
) -> None:
    bench = ControllerRig()
    changed = {part: None, f"{part}_age_s": NEVER_S}
    bench.change(**changed)

    output = bench.run(5.0)

    assert output.supervision is Supervision.NO_AUTHORITY
    assert output.missing == flag
    assert output.cause == f"waits for {word}"
    assert not output.emergency_released
    assert not output.traction_permitted
    assert output.force_n == 0.0


@pytest.mark.parametrize(
    ("change", "flag"),
    [
        ({"brake": BrakeStatus(0.0, 0.0, False, True, False, False)}, Missing.BRAKE),
        ({"traction": TractionStatus(0.0, 1.0, True, False)}, Missing.TRACTION),
        ({"tag_reader": TagReaderHealth(False, 0, 0.0)}, Missing.TAG_READER),
    ],
)
def test_a_unit_that_is_not_ready_holds_a_standing_train(
    change: dict[str, Any], flag: Missing
) -> None:
    bench = ControllerRig()
    bench.change(**change)

    output = bench.run(3.0)

    assert output.supervision is Supervision.NO_AUTHORITY
    assert output.missing == flag


def test_without_an_odometer_the_motion_is_unknown_and_the_train_braked() -> None:
    bench = ControllerRig()
    bench.odometer = False

    output = bench.run(3.0)

    assert output.missing == Missing.ODOMETER | Missing.LOCALISATION
    assert output.motion is None
    assert not output.emergency_released
    assert output.service_decel_mps2 >= 1.0
    assert not output.holding_released


AGES = {
    "brake_age_s": CONFIG.atp.timeouts.brake_s,
    "traction_age_s": CONFIG.atp.timeouts.traction_s,
    "desk_age_s": CONFIG.atp.timeouts.desk_s,
}


@pytest.mark.parametrize("age", list(AGES))
def test_a_vital_input_is_good_up_to_its_timeout_and_then_stops_the_train(age: str) -> None:
    bench = ControllerRig()
    bench.set_off()

    bench.change(**{age: AGES[age]})
    assert bench.cycle().supervision is Supervision.NOMINAL
    bench.change(**{age: AGES[age] + 1e-6})
    assert_emergency(bench.cycle(), "vital input lost")


def test_a_tacho_that_falls_silent_in_motion_stops_the_train() -> None:
    bench = ControllerRig()
    bench.set_off()
    bench.odometer = False

    states = [bench.cycle().supervision for _ in range(6)]

    assert states[3] is Supervision.NOMINAL
    assert states[-1] is Supervision.EMERGENCY


def test_an_ageing_authority_applies_the_service_brake_and_an_old_one_the_emergency_brake() -> None:
    bench = ControllerRig()
    bench.set_off()

    bench.change(authority_age_s=1.799)
    assert bench.cycle().supervision is Supervision.NOMINAL
    bench.change(authority_age_s=1.8)
    ageing = bench.cycle()
    bench.change(authority_age_s=3.0)
    old = bench.cycle()

    assert ageing.supervision is Supervision.SERVICE
    assert ageing.cause == "movement authority is getting old"
    assert ageing.service_decel_mps2 == CONFIG.train.service_decel_max_mps2
    assert ageing.force_n == 0.0
    assert ageing.emergency_released
    assert_emergency(old, "movement authority or its restrictions too old")


def test_between_stations_doors_that_are_not_locked_cut_traction_but_do_not_brake() -> None:
    bench = ControllerRig()
    bench.set_off()
    bench.run(20.0)

    bench.change(doors=DoorStatus(False, DoorState.LOCKED, DoorState.UNKNOWN, True))
    output = bench.cycle()

    assert output.supervision is Supervision.NOMINAL
    assert not output.traction_permitted
    assert output.force_n == 0.0
    assert output.emergency_released


def test_a_door_unit_that_is_silent_has_no_locked_doors() -> None:
    bench = ControllerRig()
    bench.set_off()
    bench.run(20.0)

    bench.change(doors_age_s=CONFIG.atp.timeouts.doors_s + 1e-6)

    assert not bench.cycle().traction_permitted


def test_the_emergency_speed_brings_the_emergency_brake_in_the_same_cycle() -> None:
    """An authority drawn back in front of a running train: 20 m are too few for 10 m/s."""
    bench = ControllerRig()
    bench.set_off(10.0)

    bench.change(authority=Authority(bench.front_m + 20.0, 1, 2))

    assert_emergency(bench.cycle(), "emergency limit")


def test_an_emergency_is_latched_until_standstill_and_a_fresh_reset() -> None:
    bench = ControllerRig()
    bench.set_off()
    bench.change(desk=replace(DESK, emergency_released=False))
    assert_emergency(bench.cycle(), "button")
    pressed_reset = replace(DESK, reset_requested=True)

    bench.change(desk=pressed_reset)
    assert_emergency(bench.cycle(), "button")
    bench.stop()
    assert_emergency(
        bench.run(5.0), "button"
    )  # The reset has been held since before the emergency.
    bench.change(desk=DESK)
    assert_emergency(bench.run(1.0), "button")
    bench.change(desk=pressed_reset)
    released = bench.cycle()

    assert released.supervision is Supervision.NO_AUTHORITY
    assert bench.cycle().supervision is Supervision.NOMINAL


def test_a_reset_held_from_the_start_resets_nothing() -> None:
    bench = ControllerRig()
    bench.change(desk=replace(DESK, reset_requested=True, emergency_released=False))
    assert_emergency(bench.run(3.0), "button")

    bench.change(desk=replace(DESK, reset_requested=True))

    assert_emergency(bench.run(3.0), "button")


def test_a_reset_that_was_pressed_behind_a_silent_desk_is_not_fresh() -> None:
    bench = ControllerRig()
    bench.change(desk=replace(DESK, emergency_released=False))
    bench.run(3.0)
    bench.change(desk=replace(DESK, reset_requested=True), desk_age_s=9.0)
    bench.run(1.0)

    bench.change(desk_age_s=0.05)

    assert_emergency(bench.run(1.0), "button")


def test_rolling_back_half_a_metre_brings_the_emergency_brake() -> None:
    bench = ControllerRig()
    bench.run(2.5)
    bench.speed_mps = -0.4
    moved_m, output = 0.0, bench.cycle()
    while output.supervision is not Supervision.EMERGENCY and moved_m < 3.0:
        output = bench.cycle()
        moved_m = bench.start_m - bench.front_m

    assert_emergency(output, "rolled back")
    assert moved_m < 0.6


def test_a_held_train_that_is_pushed_away_brings_the_emergency_brake() -> None:
    bench = ControllerRig()
    bench.change(authority=None, authority_age_s=NEVER_S)
    bench.run(1.0)
    bench.speed_mps = 0.5

    assert_emergency(bench.run(1.5), "to be held")


@pytest.mark.parametrize(("gap_m", "traction"), [(0.3, False), (3.5, True)])
def test_traction_is_cut_where_the_train_may_not_move_at_all(gap_m: float, traction: bool) -> None:
    bench = ControllerRig()
    bench.run(2.5)

    bench.change(authority=Authority(bench.front_m + gap_m, 1, 2))
    output = bench.cycle()

    assert output.supervision is Supervision.NOMINAL
    assert output.ceiling is not None
    assert 0.0 <= output.ceiling.permitted_mps < 1.0
    assert output.traction_permitted is traction


def test_a_train_is_held_where_it_came_to_rest() -> None:
    bench = ControllerRig()
    bench.set_off()
    bench.run(5.0)
    bench.stop()
    bench.run(3.0)

    bench.change(authority_age_s=9.0)
    output = bench.run(2.0)

    assert output.supervision is Supervision.NO_AUTHORITY
    assert output.cause == "waits for movement authority"


def test_the_holding_brake_comes_on_in_an_emergency_once_the_train_stands() -> None:
    bench = ControllerRig()
    bench.set_off()
    bench.change(desk=replace(DESK, emergency_released=False))

    moving = bench.cycle()
    bench.stop()
    standing = bench.run(3.0)

    assert moving.holding_released, "it would slide, not hold"
    assert not standing.holding_released


def test_more_than_two_missed_cycles_bring_the_emergency_brake() -> None:
    bench = ControllerRig()
    bench.set_off()

    bench.change(overruns=2)
    assert bench.cycle().supervision is Supervision.NOMINAL
    bench.change(overruns=3)
    assert_emergency(bench.cycle(), "cycles missed")


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
def test_an_invalid_demand_of_operation_is_an_emergency_at_once_and_latched(bad: float) -> None:
    bench = ControllerRig()
    bench.set_off()
    good = bench.driver.demand

    bench.driver.demand = replace(good, accel_mps2=bad)
    at_once = bench.cycle()
    bench.driver.demand = good
    after = bench.cycle()

    assert_emergency(at_once, "not finite")
    assert_emergency(after, "not finite")
    assert_emergency(bench.run(1.0), "not finite")


def test_a_nan_authority_gives_a_safe_output() -> None:
    bench = ControllerRig()
    bench.set_off()

    bench.change(authority=Authority(math.nan, 1, 2))

    assert_emergency(bench.cycle(), "not finite")


def test_operation_is_enabled_only_in_automatic_mode_with_no_input_missing() -> None:
    bench = ControllerRig()
    bench.run(1.0)
    bench.run(1.5)
    assert [bench.driver.seen[index].enabled for index in (19, -1)] == [False, True]

    bench.change(desk=replace(DESK, mode=CabMode.MANUAL))
    bench.cycle()
    assert not bench.driver.seen[-1].enabled
    bench.change(desk=replace(DESK, mode=CabMode.OFF))
    output = bench.cycle()

    assert not bench.driver.seen[-1].enabled
    assert output.service_decel_mps2 >= 1.0
    assert not output.holding_released


def test_the_lever_drives_in_manual_under_the_same_protection() -> None:
    bench = ControllerRig()
    bench.run(2.5)

    bench.change(desk=replace(DESK, mode=CabMode.MANUAL, lever_percent=60.0))
    forces = [bench.cycle().force_n for _ in range(60)]
    bench.change(authority_age_s=2.0)
    braked = bench.cycle()

    assert forces == sorted(forces)
    assert forces[0] < 10_000.0 < forces[-1]
    assert braked.force_n == 0.0
    assert braked.service_decel_mps2 >= 1.0


def test_a_clock_that_steps_moves_the_lever_no_further_than_one_cycle_does() -> None:
    bench = ControllerRig()
    bench.run(2.5)

    bench.change(desk=replace(DESK, mode=CabMode.MANUAL, lever_percent=100.0))
    steady = bench.cycle().force_n
    bench.change(dt_s=0.13)
    stepped = bench.cycle().force_n - steady

    assert stepped == pytest.approx(steady)


def at_platform(**changes: Any) -> ControllerRig:
    bench = ControllerRig("II", "III")
    bench.driver.demand = AtoDemand(0.0, True, True, AtoPhase.DOORS_OPEN, 0.0, 0.0)
    bench.change(**changes)
    return bench


def test_at_the_platform_only_its_side_opens() -> None:
    output = at_platform().run(2.6)

    assert (output.enable_left, output.enable_right) == (False, True)
    assert (output.open_left, output.open_right) == (False, True)
    assert not output.traction_permitted


Spoil = Callable[[ControllerRig], None]


def misaligned(bench: ControllerRig) -> None:
    bench.controller = Controller(
        CONFIG,
        LINE,
        plan_mission(LINE, "II", "III"),
        OdometryRecord(3000.3, 0.2, NOMINAL_M),
        bench.driver,
    )


def spoilt(**changes: Any) -> Spoil:
    def spoil(bench: ControllerRig) -> None:
        bench.change(**changes)

    return spoil


@pytest.mark.parametrize(
    "spoil",
    [
        spoilt(brake=BrakeStatus(0.0, 0.0, False, False, False, True)),
        spoilt(brake_age_s=0.3),
        spoilt(traction=TractionStatus(0.0, 1.0, False, True)),
        spoilt(traction_age_s=0.3),
        spoilt(desk=replace(DESK, emergency_released=False)),
        misaligned,
    ],
)
def test_no_door_is_enabled_when_one_term_fails(spoil: Spoil) -> None:
    bench = at_platform()
    spoil(bench)

    output = bench.run(3.0)

    assert not output.enable_left
    assert not output.enable_right
    assert not output.open_left
    assert not output.open_right


def test_no_door_is_enabled_before_zero_speed_is_proven() -> None:
    bench = at_platform()

    assert not bench.run(1.9).enable_right
    assert bench.run(0.3).enable_right


def test_a_lost_radio_does_not_lock_the_doors_at_a_platform() -> None:
    bench = at_platform(authority=None, authority_age_s=NEVER_S)

    output = bench.run(3.0)

    assert output.supervision is Supervision.NO_AUTHORITY
    assert output.enable_right


def test_the_operation_sees_the_true_state_of_its_platform_side() -> None:
    bench = at_platform(doors=DoorStatus(False, DoorState.OPEN, DoorState.OPENING, True))
    bench.learn()
    bench.run(0.1)

    bench.change(doors=DoorStatus(False, DoorState.LOCKED, DoorState.OPEN, True))
    bench.cycle()

    assert [seen.doors_open for seen in bench.driver.seen] == [False, False, True]
    assert not bench.driver.seen[-1].doors_locked


def test_an_unweighed_train_counts_as_full() -> None:
    bench = ControllerRig()
    bench.change(load=None, load_age_s=NEVER_S)
    bench.learn()

    bench.run(0.2)

    assert bench.driver.seen[-1].load_kg == CONFIG.train.full_load_kg


def test_a_moving_train_is_not_weighed_again() -> None:
    bench = ControllerRig()
    bench.run(0.5)
    bench.set_off()
    bench.run(3.0)
    assert bench.driver.seen[-1].speed_mps > 0.5

    bench.change(load=TcmsStatus(10_816.0, 4))
    bench.run(0.2)

    assert bench.driver.seen[-1].load_kg == 27_200.0


def test_a_weight_that_is_no_longer_reported_still_counts() -> None:
    bench = ControllerRig()
    bench.learn()
    bench.cycle()
    weighed_kg = bench.driver.seen[-1].load_kg

    bench.change(load=None, load_age_s=NEVER_S)
    bench.cycle()

    assert weighed_kg == 27_200.0
    assert bench.driver.seen[-1].load_kg == 27_200.0


def test_the_same_inputs_give_the_same_outputs() -> None:
    first, second = ControllerRig(), ControllerRig()
    first.set_off()
    second.set_off()

    assert [first.cycle() for _ in range(50)] == [second.cycle() for _ in range(50)]


@pytest.mark.parametrize("ratio", [0.0, 0.5, 1.0])
def test_operation_receives_the_available_traction_at_this_speed(ratio: float) -> None:
    bench = ControllerRig()
    bench.run(5)
    bench.change(traction=TractionStatus(0.0, ratio, True, True))
    bench.speed_mps = 2.0
    bench.run(5)

    seen = bench.driver.seen[-1]
    train = CONFIG.train
    mass_kg = train.tare_kg * (1.0 + train.rotating_mass_ratio) + seen.load_kg
    assert seen.traction_mps2 == pytest.approx(ratio * train.rated_force_n / mass_kg)
