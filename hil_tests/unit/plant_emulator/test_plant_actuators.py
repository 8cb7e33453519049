"""Traction, brakes, doors and wheels: when they act, how much, and their reaction to silence."""

import itertools
import math
from dataclasses import replace
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from can_dbc.brake import BrakeCommand
from can_dbc.doors import DoorCars, DoorCommand, DoorState
from can_dbc.nodes import Direction
from can_dbc.traction import TractionCommand
from firmware_py.settings import shipped_names
from plant_emulator.actuators.adhesion import WheelGroup
from plant_emulator.actuators.brake import BrakeUnit
from plant_emulator.actuators.doors import DoorUnit
from plant_emulator.actuators.response import DeadTime, DelayLine, Lag
from plant_emulator.actuators.traction import TractionUnit
from plant_emulator.noise import Generators
from plant_emulator.train_config import (
    PACKAGE,
    BrakeConfig,
    DeadTimeKind,
    Spread,
    load_train,
)

STEP_NS = 10_000_000
STEP_S = 0.01
TRAIN = load_train("florence4")
IDEAL = load_train("florence4_ideal")
VITAL_TIMEOUT_NS = 150_000_000
DOOR_TIMEOUT_NS = 300_000_000
INERTIA_KG = 170_000.0
MOTOR_RATIO = 0.52
RELEASED = BrakeCommand(service_decel_mps2=0.0, emergency_released=True, holding_released=True)


def braking(decel_mps2: float) -> BrakeCommand:
    return BrakeCommand(
        service_decel_mps2=decel_mps2, emergency_released=True, holding_released=True
    )


def fixed(value: float) -> Spread:
    return Spread(value, value)


def exact_brake(dead_time_s: float = 0.5, lag_s: float = 0.3) -> BrakeConfig:
    """The brake of florence4 without random parameters."""
    service = replace(
        TRAIN.brake.service,
        dead_time_s=fixed(dead_time_s),
        lag_s=fixed(lag_s),
        gain_ratio=fixed(1.0),
    )
    return replace(TRAIN.brake, service=service)


class BrakeStand:
    """A brake unit that receives a command every 50 ms and runs step by step."""

    def __init__(self, config: BrakeConfig, seed: int = 1, speed_mps: float = 10.0) -> None:
        self.unit = BrakeUnit(
            config,
            Generators(seed),
            step_s=STEP_S,
            timeout_ns=VITAL_TIMEOUT_NS,
            inertia_kg=INERTIA_KG,
            motor_ratio=MOTOR_RATIO,
        )
        self.now_ns = 0
        self.speed_mps = speed_mps
        self.electric_possible = True

    @property
    def decel_mps2(self) -> float:
        return (self.unit.motor_n + self.unit.trailer_n) / INERTIA_KG

    def step(self) -> float:
        self.unit.step(
            self.now_ns,
            self.now_ns + STEP_NS,
            self.speed_mps,
            electric_possible=self.electric_possible,
        )
        self.now_ns += STEP_NS
        return self.decel_mps2

    def run(self, duration_s: float, command: BrakeCommand | None) -> list[float]:
        """Deceleration of every step; a command of None means silence."""
        decels_mps2 = []
        for step in range(round(duration_s / STEP_S)):
            if command is not None and step % 5 == 0:
                self.unit.hear(command, self.now_ns)
            decels_mps2.append(self.step())
        return decels_mps2


def released_stand(config: BrakeConfig, seed: int = 1, speed_mps: float = 10.0) -> BrakeStand:
    stand = BrakeStand(config, seed, speed_mps)
    stand.run(10.0, RELEASED)
    assert stand.decel_mps2 == 0.0
    return stand


@given(
    instants_ms=st.lists(st.integers(0, 500), min_size=1, max_size=12, unique=True),
    dead_ms=st.integers(0, 200),
)
def test_dead_time_delays_every_instant_exactly(instants_ms: list[int], dead_ms: int) -> None:
    """The mean over all steps equals the integral of the delayed demand, wherever the steps
    fall."""
    dead_time = DeadTime()
    instants_ns = [1_000_000 * ms + 123 for ms in sorted(instants_ms)]
    for number, instant_ns in enumerate(instants_ns, start=1):
        dead_time.ask(instant_ns + dead_ms * 1_000_000, float(number))

    area = sum(
        dead_time.mean(start_ns, start_ns + STEP_NS) * STEP_NS
        for start_ns in range(0, 800_000_000, STEP_NS)
    )

    expected = sum(800_000_000 - (at_ns + dead_ms * 1_000_000) for at_ns in instants_ns)
    assert area == pytest.approx(expected, rel=1e-12)
    assert dead_time.settled


def test_a_demand_never_overtakes_an_earlier_one() -> None:
    dead_time = DeadTime()

    dead_time.ask(100_000_000, 1.0)
    dead_time.ask(50_000_000, 2.0)

    assert dead_time.mean(0, 100_000_000) == 0.0
    assert dead_time.mean(100_000_000, 110_000_000) == 2.0


def test_a_lag_follows_the_exponential() -> None:
    lag = Lag(0.3, STEP_S)

    for _ in range(60):
        lag.step(1.0)

    assert lag.value == pytest.approx(1.0 - math.exp(-0.6 / 0.3), rel=1e-12)


def test_a_lag_settles_exactly() -> None:
    lag = Lag(0.3, STEP_S)
    for _ in range(1500):
        lag.step(1.0)
    assert lag.value == 1.0


def test_a_shift_delays_by_whole_steps() -> None:
    shift = DelayLine(0.03, STEP_S)
    assert [shift.step(float(value)) for value in range(6)] == [0.0, 0.0, 0.0, 0.0, 1.0, 2.0]


def test_the_service_brake_acts_exactly_one_dead_time_after_the_demand() -> None:
    """The command comes 3.7 ms into a step, so the brake begins 3.7 ms into another."""
    stand = released_stand(exact_brake(dead_time_s=0.5, lag_s=0.3))
    heard_ns = stand.now_ns + 3_700_000
    stand.unit.hear(braking(0.8), heard_ns)
    decels = []
    for step in range(150):
        decels.append(stand.step())
        if step % 5 == 4:
            stand.unit.hear(braking(0.8), stand.now_ns)

    bite_s = 0.5 + 0.0037
    for step, decel_mps2 in enumerate(decels):
        end_s = (step + 1) * STEP_S
        if end_s <= bite_s:
            assert decel_mps2 == 0.0
        elif end_s - STEP_S > bite_s:
            middle_s = end_s - STEP_S / 2.0 - bite_s
            assert decel_mps2 == pytest.approx(0.8 * (1.0 - math.exp(-middle_s / 0.3)), abs=3e-4)
        else:
            assert 0.0 < decel_mps2 < 0.8 * STEP_S / 0.3
    assert sum(d > 0.0 for d in decels[:51]) == 1


def test_every_change_within_one_application_has_the_same_dead_time() -> None:
    stand = released_stand(replace(exact_brake(lag_s=0.0)), seed=3)
    stand.run(1.0, braking(0.5))
    stand.run(0.2, braking(0.9))
    later = stand.run(1.0, braking(0.2))

    dead_steps = round(stand.unit.service.dead_time_s / STEP_S)
    assert later[dead_steps - 21] == pytest.approx(0.5)
    assert later[dead_steps - 20] == pytest.approx(0.9)
    assert later[dead_steps - 1] == pytest.approx(0.9)
    assert later[dead_steps] == pytest.approx(0.2)


def drawn_dead_times_s(seed: int, count: int) -> list[float]:
    stand = released_stand(TRAIN.brake, seed=seed)
    found = []
    for _ in range(count):
        stand.run(0.05, braking(0.4))
        found.append(stand.unit.service.dead_time_s)
        stand.run(0.05, braking(0.6))
        assert stand.unit.service.dead_time_s == found[-1]
        stand.run(0.05, RELEASED)
    return found


def test_each_application_samples_its_own_dead_time() -> None:
    found_s = drawn_dead_times_s(seed=5, count=200)

    assert len(set(found_s)) == 200
    assert 0.4 <= min(found_s) < 0.42
    assert 0.98 < max(found_s) <= 1.0
    assert sum(found_s) / 200 == pytest.approx(0.7, abs=0.04)
    assert found_s == drawn_dead_times_s(seed=5, count=200)
    assert found_s != drawn_dead_times_s(seed=6, count=200)


def test_the_fixed_delay_consist_always_takes_one_second() -> None:
    stand = released_stand(load_train("florence4_fixed_delay").brake)
    for _ in range(3):
        decels = stand.run(1.2, braking(0.5))
        assert not any(decels[:100])
        assert decels[101] > 0.0
        stand.run(12.0, RELEASED)
        assert stand.unit.service.dead_time_s == 1.0


def test_with_delay_on_application_a_brake_that_is_on_follows_at_once() -> None:
    config = exact_brake(dead_time_s=1.0, lag_s=0.0)
    service = replace(config.service, dead_time_kind=DeadTimeKind.APPLICATION)
    stand = released_stand(replace(config, service=service))

    first = stand.run(1.5, braking(0.5))
    second = stand.run(0.2, braking(0.8))

    assert not any(first[:100])
    assert first[100] == pytest.approx(0.5)
    assert second[0] == pytest.approx(0.8)


def test_the_service_brake_has_a_maximum() -> None:
    stand = released_stand(exact_brake())
    stand.run(5.0, braking(2.0))
    assert stand.decel_mps2 == pytest.approx(TRAIN.brake.service.max_decel_mps2)


def test_the_gain_error_affects_the_train_and_not_the_units_report() -> None:
    service = replace(exact_brake().service, gain_ratio=fixed(0.95))
    stand = released_stand(replace(exact_brake(), service=service))

    stand.run(5.0, braking(0.6))

    assert stand.decel_mps2 == pytest.approx(0.57)
    assert stand.unit.status().applied_decel_mps2 == pytest.approx(0.6)


@pytest.mark.parametrize("name", shipped_names(PACKAGE))
def test_the_emergency_brake_builds_up_in_time(name: str) -> None:
    """For every shipped train, 10 % of the deceleration is reached within 0.5 s and 90 % within
    1.6 s."""
    config = load_train(name).brake
    stand = released_stand(config)
    command = replace(RELEASED, emergency_released=False)

    decels = stand.run(4.0, command)

    full_mps2 = config.emergency.decel_mps2
    tenth = next(step for step, decel in enumerate(decels) if decel >= 0.1 * full_mps2)
    most = next(step for step, decel in enumerate(decels) if decel >= 0.9 * full_mps2)
    assert (tenth + 1) * STEP_S <= 0.5
    assert (most + 1) * STEP_S <= 1.6
    assert decels[-1] == pytest.approx(full_mps2, rel=1e-3)
    assert stand.unit.status().emergency_applied


@pytest.mark.parametrize("speed_mps", [5.0, 15.0, 22.0])
def test_the_emergency_stopping_distance_is_the_closed_form_one(speed_mps: float) -> None:
    """The closed form: run on, build up exponentially, brake; v and x integrated, solved for v =
    0."""
    emergency = TRAIN.brake.emergency
    stand = released_stand(exact_brake())
    command = replace(RELEASED, emergency_released=False)
    at_mps, way_m, step = speed_mps, 0.0, 0
    while at_mps > 0.0:
        if step % 5 == 0:
            stand.unit.hear(command, stand.now_ns)
        decel_mps2 = stand.step()
        way_m += STEP_S * (at_mps - decel_mps2 * STEP_S / 2.0)
        at_mps -= decel_mps2 * STEP_S
        step += 1

    dead_s, lag_s, full = emergency.dead_time_s, emergency.lag_s, emergency.decel_mps2

    def speed_after(t: float) -> float:
        return speed_mps - full * (t - lag_s * (1.0 - math.exp(-t / lag_s)))

    low_s, high_s = 0.0, 100.0
    for _ in range(80):
        middle_s = (low_s + high_s) / 2.0
        low_s, high_s = (middle_s, high_s) if speed_after(middle_s) > 0.0 else (low_s, middle_s)
    t = low_s
    braked_m = speed_mps * t - full * (
        t * t / 2.0 - lag_s * t + lag_s * lag_s * (1.0 - math.exp(-t / lag_s))
    )
    assert way_m == pytest.approx(speed_mps * dead_s + braked_m, abs=0.01)


def test_silence_beyond_the_timeout_applies_the_emergency_brake() -> None:
    stand = released_stand(exact_brake())
    stand.unit.hear(RELEASED, stand.now_ns)
    wanted_after = []
    for step in range(30):
        stand.step()
        if stand.unit.emergency_wanted:
            wanted_after.append(step + 1)

    assert wanted_after[0] == 16
    assert stand.unit.losses == 1
    assert stand.unit.silent


def test_the_unit_reports_its_own_emergency_from_request_to_release() -> None:
    """The silence exceeds the timeout by 20 ms; every status in between must report the
    emergency."""
    stand = released_stand(exact_brake())
    stand.unit.hear(RELEASED, stand.now_ns)
    stand.speed_mps = 0.0
    stand.run(0.17, None)
    told = []
    for step in range(200):
        if step % 5 == 0:
            stand.unit.hear(RELEASED, stand.now_ns)
        stand.step()
        told.append(stand.unit.status().emergency_applied)

    applied = told.index(False)
    assert applied * STEP_S >= 0.5, "until the brake, which bites after 0.3 s, has let go again"
    assert not any(told[applied:])
    assert stand.unit.losses == 1


def test_the_emergency_brake_releases_only_on_command() -> None:
    stand = released_stand(exact_brake())
    stand.run(5.0, None)
    assert stand.decel_mps2 == pytest.approx(1.2, rel=1e-3)
    assert stand.unit.losses == 1

    stand.speed_mps = 0.0
    stand.step()
    stand.run(10.0, RELEASED)

    assert stand.decel_mps2 == 0.0
    assert not stand.unit.silent


def test_a_unit_without_any_command_brakes() -> None:
    stand = BrakeStand(TRAIN.brake, speed_mps=0.0)
    decels = stand.run(3.0, None)
    assert min(decels) == pytest.approx(1.2)
    status = stand.unit.status()
    assert status.emergency_applied
    assert status.holding_applied
    assert not status.released


def test_a_short_release_does_not_delay_the_next_emergency() -> None:
    """The release is still in transit when the emergency comes again, so the brake never
    releases."""
    stand = BrakeStand(exact_brake())
    emergency = replace(RELEASED, emergency_released=False)
    stand.run(0.3, RELEASED)
    decels = stand.run(3.0, emergency)
    assert min(decels) == pytest.approx(1.2)


def test_service_and_emergency_do_not_add() -> None:
    stand = released_stand(exact_brake())
    decels = stand.run(5.0, replace(braking(1.0), emergency_released=False))
    assert max(decels) <= 1.2 + 1e-9
    assert decels[-1] == pytest.approx(1.2, rel=1e-3)


def test_a_running_train_ignores_the_holding_brake_command() -> None:
    """The holding brake applies by itself under the same command once the train has become slow."""
    stand = released_stand(exact_brake(), speed_mps=1.0)
    holding = replace(RELEASED, holding_released=False)
    decels = stand.run(2.0, holding)
    assert not any(decels)
    assert not stand.unit.status().holding_applied

    stand.speed_mps = 0.1
    stand.run(1.0, holding)

    assert stand.decel_mps2 == pytest.approx(TRAIN.brake.holding.decel_mps2, rel=0.01)
    assert stand.unit.status().holding_applied


def test_an_applied_holding_brake_stays_on_at_any_speed() -> None:
    stand = released_stand(exact_brake(), speed_mps=0.0)
    holding = replace(RELEASED, holding_released=False)
    stand.run(1.0, holding)
    stand.speed_mps = 2.0
    stand.run(1.0, holding)
    assert stand.decel_mps2 > 0.7


def test_released_means_that_no_brake_acts() -> None:
    stand = released_stand(exact_brake(), speed_mps=0.0)
    assert stand.unit.status().released
    stand.run(1.0, braking(0.3))
    assert not stand.unit.status().released


@pytest.mark.parametrize("speed_mps", [20.0, 2.0, 1.5, 0.9, 0.5])
def test_ideal_blending_keeps_the_total(speed_mps: float) -> None:
    stand = released_stand(exact_brake(), speed_mps=speed_mps)
    stand.run(6.0, braking(0.7))
    electric = TRAIN.brake.service.electric

    assert stand.decel_mps2 == pytest.approx(0.7, rel=1e-4)
    if speed_mps <= electric.fade_end_mps:
        assert stand.unit.electric_n == 0.0
    elif speed_mps >= electric.fade_begin_mps:
        total_n = 0.7 * INERTIA_KG
        assert stand.unit.electric_n == pytest.approx(electric.share_ratio * total_n, rel=1e-3)


def test_a_late_friction_brake_dips_while_it_takes_over() -> None:
    """With a blending delay of 0.8 s and a gain of 80 %, there is a dip while the motors fade
    and 80 % afterwards."""
    electric = replace(TRAIN.brake.service.electric, share_ratio=1.0, max_force_n=200_000.0)
    pneumatic = replace(
        TRAIN.brake.service.pneumatic, dead_time_s=fixed(0.8), lag_s=0.2, gain_ratio=fixed(0.8)
    )
    service = replace(exact_brake().service, electric=electric, pneumatic=pneumatic)
    stand = released_stand(replace(exact_brake(), service=service))
    stand.run(6.0, braking(0.6))
    assert stand.decel_mps2 == pytest.approx(0.6, rel=1e-3)

    decels = []
    for step in range(400):
        stand.speed_mps = max(0.0, stand.speed_mps - 0.6 * STEP_S) if step else 2.5
        if step % 5 == 0:
            stand.unit.hear(braking(0.6), stand.now_ns)
        decels.append(stand.step())

    assert min(decels) < 0.35
    assert stand.decel_mps2 <= 0.6 * 0.8 + 1e-3


def test_delayed_friction_still_acts_after_the_release() -> None:
    """A pulse of 0.3 s comes 0.8 s late; the brake must not become idle in between."""
    pneumatic = replace(TRAIN.brake.service.pneumatic, dead_time_s=fixed(0.8))
    service = replace(exact_brake(dead_time_s=0.0, lag_s=0.0).service, pneumatic=pneumatic)
    stand = released_stand(replace(exact_brake(), service=service), speed_mps=0.5)
    decels = stand.run(0.3, braking(0.5)) + stand.run(1.5, RELEASED)
    assert decels[:80] == [0.0] * 80
    assert decels[80:110] == pytest.approx([0.5] * 30)
    assert decels[110:] == [0.0] * 70


def test_the_electric_brake_respects_its_power_limit() -> None:
    electric = replace(TRAIN.brake.service.electric, max_power_w=800_000.0)
    service = replace(exact_brake().service, electric=electric)
    stand = released_stand(replace(exact_brake(), service=service), speed_mps=20.0)
    stand.run(6.0, braking(1.0))
    assert stand.unit.electric_n == pytest.approx(40_000.0)
    assert stand.decel_mps2 == pytest.approx(1.0, rel=1e-3)


def test_without_motors_friction_gives_all_of_the_brake() -> None:
    stand = released_stand(exact_brake())
    stand.electric_possible = False
    stand.run(6.0, braking(0.7))
    assert stand.unit.electric_n == 0.0
    assert stand.decel_mps2 == pytest.approx(0.7, rel=1e-3)


class TractionStand:
    def __init__(self, **changes: Any) -> None:
        self.config = replace(TRAIN.traction, **changes)
        self.unit = TractionUnit(self.config, step_s=STEP_S, timeout_ns=VITAL_TIMEOUT_NS)
        self.now_ns = 0
        self.speed_mps = 0.0
        self.emergency = False
        self.doors_locked = True

    def run(self, duration_s: float, command: TractionCommand | None) -> list[float]:
        forces_n = []
        for step in range(round(duration_s / STEP_S)):
            if command is not None and step % 5 == 0:
                self.unit.hear(command, self.now_ns)
            end_ns = self.now_ns + STEP_NS
            forces_n.append(
                self.unit.step(
                    self.now_ns,
                    end_ns,
                    self.speed_mps,
                    emergency=self.emergency,
                    doors_locked=self.doors_locked,
                )
            )
            self.now_ns = end_ns
        return forces_n


def driving(force_n: float, direction: Direction = Direction.FORWARD) -> TractionCommand:
    return TractionCommand(force_n=force_n, direction=direction, traction_permitted=True)


def test_effort_comes_after_dead_time_and_builds_up_by_its_lag() -> None:
    stand = TractionStand(slew_n_per_s=1.0e12)
    forces_n = stand.run(1.0, driving(50_000.0))

    assert not any(forces_n[:10])
    for step in (11, 20, 50, 90):
        middle_s = (step + 0.5) * STEP_S - 0.1
        expected_n = 50_000.0 * (1.0 - math.exp(-middle_s / 0.3))
        assert forces_n[step] == pytest.approx(expected_n, abs=15.0)


def test_effort_changes_no_faster_than_its_slew() -> None:
    stand = TractionStand(lag_s=0.0, slew_n_per_s=100_000.0)
    forces_n = stand.run(3.0, driving(150_000.0))
    steps_n = [later - earlier for earlier, later in itertools.pairwise(forces_n)]
    assert max(steps_n) <= 1000.0 + 1e-6
    assert forces_n[-1] == pytest.approx(150_000.0)


@pytest.mark.parametrize(
    ("speed_mps", "expected_n"), [(0.0, 200_000.0), (11.9, 200_000.0), (20.0, 120_000.0)]
)
def test_effort_is_limited_by_force_and_by_power(speed_mps: float, expected_n: float) -> None:
    stand = TractionStand()
    stand.speed_mps = speed_mps
    assert stand.run(6.0, driving(400_000.0))[-1] == pytest.approx(expected_n, rel=1e-6)


def test_low_voltage_reduces_effort() -> None:
    stand = TractionStand(effort_ratio=0.75)
    stand.unit.feed(0.5)
    assert stand.run(6.0, driving(200_000.0))[-1] == pytest.approx(75_000.0)
    assert stand.unit.status(0.0).effort_available_ratio == pytest.approx(0.375)


def test_the_direction_of_the_command_is_that_of_the_effort() -> None:
    stand = TractionStand()
    assert stand.run(6.0, driving(50_000.0, Direction.REVERSE))[-1] == pytest.approx(-50_000.0)
    assert stand.run(6.0, driving(50_000.0, Direction.NEUTRAL))[-1] == pytest.approx(0.0, abs=1e-3)


@pytest.mark.parametrize("reason", ["not permitted", "emergency", "door", "silence"])
def test_effort_is_gone_within_three_tenths_of_a_second_whatever_the_reason(reason: str) -> None:
    stand = TractionStand()
    stand.run(3.0, driving(100_000.0))
    command: TractionCommand | None = driving(100_000.0)
    silent_s = 0.0
    if reason == "not permitted":
        command = replace(driving(100_000.0), traction_permitted=False)
    elif reason == "emergency":
        stand.emergency = True
    elif reason == "door":
        stand.doors_locked = False
    else:
        command, silent_s = None, 0.15
    forces_n = stand.run(silent_s + 0.31, command)

    assert forces_n[-1] == 0.0
    assert stand.unit.traction_cut
    assert stand.unit.status(0.0).traction_cut
    assert stand.unit.losses == (1 if reason == "silence" else 0)


def test_rising_effort_stops_rising_once_traction_is_forbidden() -> None:
    stand = TractionStand()
    rising_n = stand.run(0.25, driving(200_000.0))
    falling_n = stand.run(0.14, replace(driving(200_000.0), traction_permitted=False))
    assert rising_n[-1] > 10_000.0
    assert not stand.unit.traction_cut
    assert all(later < earlier for earlier, later in itertools.pairwise(falling_n[1:]))


def test_unlocked_doors_cut_traction_but_not_the_electric_brake() -> None:
    stand = TractionStand()
    stand.doors_locked = False
    stand.run(1.0, driving(100_000.0))
    assert stand.unit.traction_cut
    assert stand.unit.electric_brake_possible


def test_an_emergency_cuts_the_electric_brake_too() -> None:
    stand = TractionStand()
    stand.emergency = True
    stand.run(0.31, driving(100_000.0))
    assert not stand.unit.electric_brake_possible


def test_traction_without_any_command_is_cut() -> None:
    stand = TractionStand()
    assert not any(stand.run(1.0, None))
    assert stand.unit.traction_cut


def test_effort_demanded_before_the_cut_does_not_return_after_it() -> None:
    stand = TractionStand()
    stand.run(3.0, driving(100_000.0))
    stand.run(1.0, replace(driving(0.0), traction_permitted=False))
    forces_n = stand.run(1.0, driving(0.0))
    assert not any(forces_n)


def test_motors_that_brake_are_reported_as_negative_effort() -> None:
    assert TractionStand().unit.status(30_000.0).force_n == -30_000.0


def wheels(rotating_kg: float = 8000.0) -> WheelGroup:
    return WheelGroup(TRAIN.rail, step_s=STEP_S, weight_n=800_000.0, rotating_kg=rotating_kg)


def test_force_within_adhesion_reaches_the_rail() -> None:
    group = wheels()
    assert group.driven(200_000.0, 0.28, 10.0) == 200_000.0
    assert group.braked(200_000.0, 0.28, 10.0) == 200_000.0
    assert group.slip_mps == 0.0


def test_traction_beyond_adhesion_spins_the_wheels_until_they_are_caught() -> None:
    group = wheels()
    passed_n = [group.driven(120_000.0, 0.1, 10.0) for _ in range(50)]
    assert passed_n == [80_000.0] * 50
    assert group.slip_mps == pytest.approx(2.0)

    for _ in range(101):
        group.driven(50_000.0, 0.1, 10.0)
    assert group.slip_mps == 0.0


def test_the_first_slip_follows_from_the_excess_force_on_the_wheels() -> None:
    group = wheels(rotating_kg=8000.0)
    group.driven(120_000.0, 0.1, 10.0)
    assert group.slip_mps == pytest.approx(40_000.0 / 8000.0 * STEP_S)


def test_braking_beyond_adhesion_slides_but_never_turns_wheels_backwards() -> None:
    group = wheels()
    for _ in range(200):
        assert group.braked(160_000.0, 0.05, 0.3) == 40_000.0
    assert group.slip_mps == -0.3
    for _ in range(200):
        group.braked(160_000.0, 0.05, -10.0)
    assert group.slip_mps == pytest.approx(2.0)


def test_a_train_that_stands_does_not_slide() -> None:
    group = wheels()
    assert group.braked(160_000.0, 0.05, 0.0) == 40_000.0
    assert group.slip_mps == 0.0


class DoorStand:
    def __init__(self, obstructed_closings: int = 0) -> None:
        config = replace(TRAIN.doors, obstructed_closings=obstructed_closings)
        self.unit = DoorUnit(config, cars=4, step_s=STEP_S, timeout_ns=DOOR_TIMEOUT_NS)
        self.now_ns = 0

    def run(
        self, duration_s: float, command: DoorCommand | None, cars: DoorCars | None = None
    ) -> list[DoorState]:
        states = []
        for step in range(round(duration_s / STEP_S)):
            if command is not None and step % 10 == 0:
                self.unit.hear(command, self.now_ns)
            if cars is not None and step % 10 == 0:
                self.unit.hear_cars(cars, self.now_ns)
            self.now_ns += STEP_NS
            self.unit.step(self.now_ns)
            states.append(self.unit.right.state)
        return states


CLOSE = DoorCommand(enable_left=False, enable_right=True, open_left=False, open_right=False)
OPEN = DoorCommand(enable_left=False, enable_right=True, open_left=False, open_right=True)
OPEN_WITHOUT_ENABLE = DoorCommand(
    enable_left=True, enable_right=False, open_left=False, open_right=True
)


def test_doors_take_their_time_to_open_and_to_close() -> None:
    stand = DoorStand()
    opening = stand.run(4.0, OPEN)
    closing = stand.run(4.0, CLOSE)

    assert opening.index(DoorState.OPENING) * STEP_S == pytest.approx(0.3, abs=0.02)
    assert opening.index(DoorState.OPEN) * STEP_S == pytest.approx(2.8, abs=0.03)
    assert closing[0] is DoorState.CLOSING
    assert closing.index(DoorState.LOCKED) * STEP_S == pytest.approx(2.5, abs=0.03)
    assert stand.unit.locked


def test_only_the_side_that_is_commanded_opens() -> None:
    stand = DoorStand()
    stand.run(4.0, OPEN)
    assert stand.unit.right.state is DoorState.OPEN
    assert stand.unit.left.state is DoorState.LOCKED
    assert not stand.unit.status().closed_and_locked


def test_a_side_without_enable_stays_locked_and_closes() -> None:
    stand = DoorStand()
    assert set(stand.run(4.0, OPEN_WITHOUT_ENABLE)) == {DoorState.LOCKED}
    assert stand.unit.left.state is DoorState.LOCKED

    stand.run(4.0, OPEN)
    stand.run(4.0, OPEN_WITHOUT_ENABLE)
    assert stand.unit.status().closed_and_locked


def test_doors_close_by_themselves_when_their_command_goes_missing() -> None:
    stand = DoorStand()
    stand.run(4.0, OPEN)
    states = stand.run(4.0, None)
    # The last command came 100 ms before the test began to count.
    assert states.index(DoorState.CLOSING) * STEP_S == pytest.approx(0.2, abs=0.02)
    assert states[-1] is DoorState.LOCKED
    assert stand.unit.losses == 1


OPEN_ALONE = DoorCommand(enable_left=False, enable_right=False, open_left=False, open_right=True)
MIDDLE = DoorCars(left_cars=0, right_cars=0b0110)


def test_single_cars_open_while_both_frames_agree_and_no_other_car() -> None:
    stand = DoorStand()

    assert stand.run(4.0, OPEN_ALONE)[-1] is DoorState.LOCKED
    assert stand.run(4.0, OPEN_ALONE, MIDDLE)[-1] is DoorState.OPEN
    assert (stand.unit.left.cars, stand.unit.right.cars) == (0, 0b0110)
    assert not stand.unit.locked
    # Without the demand to open, an enabled car closes.
    assert stand.run(4.0, replace(OPEN_ALONE, open_right=False), MIDDLE)[-1] is DoorState.LOCKED
    assert stand.unit.right.cars == 0
    assert stand.unit.locked


def test_an_enabled_side_opens_all_cars_that_the_train_has() -> None:
    stand = DoorStand()
    stand.run(4.0, OPEN)

    assert stand.unit.right.cars == 0b1111


def test_single_cars_close_when_their_frame_goes_missing_or_names_no_car() -> None:
    stand = DoorStand()
    stand.run(4.0, OPEN_ALONE, MIDDLE)
    states = stand.run(1.0, OPEN_ALONE)

    assert states[round(0.19 / STEP_S)] is DoorState.OPEN
    assert states[round(0.32 / STEP_S)] is DoorState.CLOSING
    stand.run(4.0, OPEN_ALONE, MIDDLE)
    states = stand.run(0.1, OPEN_ALONE, DoorCars(left_cars=0, right_cars=0))
    assert states[0] is DoorState.CLOSING


def test_a_car_that_is_no_longer_enabled_closes_the_side_and_one_more_waits() -> None:
    stand = DoorStand()
    stand.run(4.0, OPEN_ALONE, MIDDLE)

    stand.run(1.0, OPEN_ALONE, DoorCars(left_cars=0, right_cars=0b1111))
    assert (stand.unit.right.state, stand.unit.right.cars) == (DoorState.OPEN, 0b0110)
    stand.run(0.1, OPEN_ALONE, DoorCars(left_cars=0, right_cars=0b0010))
    assert stand.unit.right.state is DoorState.CLOSING
    stand.run(8.0, OPEN_ALONE, DoorCars(left_cars=0, right_cars=0b0010))
    assert (stand.unit.right.state, stand.unit.right.cars) == (DoorState.OPEN, 0b0010)


def test_a_car_that_the_train_does_not_have_opens_nothing() -> None:
    stand = DoorStand()

    states = stand.run(4.0, OPEN_ALONE, DoorCars(left_cars=0, right_cars=0b110000))
    assert set(states) == {DoorState.LOCKED}


def test_an_obstacle_opens_the_doors_again_and_they_try_once_more() -> None:
    stand = DoorStand(obstructed_closings=1)
    stand.run(4.0, OPEN)
    stand.unit.hear(CLOSE, stand.now_ns)
    states = stand.run(12.0, CLOSE)

    order = [
        state for state, before in zip(states, [None, *states], strict=False) if state is not before
    ]
    assert order == [
        DoorState.CLOSING,
        DoorState.OBSTRUCTED,
        DoorState.CLOSING,
        DoorState.LOCKED,
    ]
    first_obstructed = states.index(DoorState.OBSTRUCTED)
    assert states[first_obstructed : first_obstructed + 300] == [DoorState.OBSTRUCTED] * 300
    assert stand.unit.status().no_obstruction


def test_closing_doors_open_again_on_request() -> None:
    stand = DoorStand()
    stand.run(4.0, OPEN)
    stand.run(1.0, CLOSE)
    states = stand.run(2.0, OPEN)
    assert states[0] is DoorState.OPENING
    assert states[-1] is DoorState.OPEN


@given(
    commands=st.lists(
        st.tuples(st.booleans(), st.booleans(), st.booleans(), st.booleans(), st.integers(1, 40)),
        max_size=12,
    )
)
def test_the_lock_line_reports_locked_only_with_both_sides_locked(
    commands: list[tuple[bool, bool, bool, bool, int]],
) -> None:
    """A side leaves the locked state only while it is enabled and requested to open."""
    stand = DoorStand()
    unit = stand.unit
    for enable_left, enable_right, open_left, open_right, tenths in commands:
        command = DoorCommand(enable_left, enable_right, open_left, open_right)
        for _ in range(tenths):
            before = unit.left.state
            stand.run(0.1, command)
            both = unit.left.state is unit.right.state is DoorState.LOCKED
            assert unit.locked == both
            if before is DoorState.LOCKED and unit.left.state is not DoorState.LOCKED:
                assert enable_left
                assert open_left
