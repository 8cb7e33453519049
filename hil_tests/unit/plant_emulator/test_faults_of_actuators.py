"""Brakes and traction that are late, weak, stuck, failed or uncontrolled."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pytest

ATrain = Callable[..., Any]


def since(
    train: Any, condition: Callable[[Any], bool], *commands: Any, limit_s: float = 20.0
) -> float:
    """Seconds from now until the condition holds."""
    begin_ns = train.world.now_ns
    for world in train.each_step(limit_s, *commands):
        if condition(world):
            return float(world.now_ns - begin_ns) / 1e9
    raise AssertionError(f"not within {limit_s} s")


@pytest.mark.parametrize("delay_s", [0.0, 0.25, 1.0])
def test_a_late_brake_answers_later_by_the_delay(a_train: ATrain, delay_s: float) -> None:
    train = a_train({"kind": "brake_late", "delay_s": delay_s}, speed_mps=20.0)
    bites_s = since(train, lambda world: world.brake_n > 0.0, train.braking(0.8))
    assert bites_s == pytest.approx(0.5 + delay_s, abs=0.011)
    # The release is just as late.
    train.run(3.0, train.braking(0.8))
    full_n = train.world.brake_n
    eases_s = since(train, lambda world: world.brake_n < full_n, train.RELEASED)
    assert eases_s == pytest.approx(0.5 + delay_s, abs=0.011)


def test_demands_to_a_late_brake_arrive_when_the_fault_ends(a_train: ATrain) -> None:
    train = a_train({"kind": "brake_late", "delay_s": 5.0, "end_s": 1.0}, speed_mps=20.0)
    bites_s = since(train, lambda world: world.brake_n > 0.0, train.braking(0.8))
    assert bites_s == pytest.approx(1.01, abs=0.001)


def test_a_fault_also_delays_demands_in_transit(a_train: ATrain) -> None:
    train = a_train({"kind": "brake_late", "delay_s": 1.0, "start_s": 0.3}, speed_mps=20.0)
    bites_s = since(train, lambda world: world.brake_n > 0.0, train.braking(0.8))
    assert bites_s == pytest.approx(1.5, abs=0.011)


def test_a_weak_brake_gives_its_share_and_reports_the_demand(a_train: ATrain) -> None:
    fault = {"kind": "brake_weak", "gain_ratio": 0.5, "end_s": 5.0}
    train = a_train(fault, speed_mps=20.0)
    train.run(4.9, train.braking(0.8))
    assert train.decel_mps2 == pytest.approx(0.4, rel=1e-3)
    assert train.world.brake.status().applied_decel_mps2 == pytest.approx(0.8, rel=1e-3)
    train.run(0.5, train.braking(0.8))
    assert train.decel_mps2 == pytest.approx(0.8, rel=1e-3)


def test_a_stuck_brake_stays_on_and_then_releases(a_train: ATrain) -> None:
    train = a_train({"kind": "brake_stuck", "start_s": 3.0, "end_s": 8.0}, speed_mps=20.0)
    train.run(3.0, train.braking(0.6))
    train.run(4.0, train.RELEASED)
    assert train.decel_mps2 == pytest.approx(0.6, rel=1e-2)
    assert train.world.brake.status().applied_decel_mps2 == pytest.approx(0.6, rel=1e-2)
    train.run(6.0, train.RELEASED)
    assert train.decel_mps2 == pytest.approx(0.0, abs=1e-6)


def test_with_the_service_brake_stuck_released_the_emergency_brake_still_works(
    a_train: ATrain,
) -> None:
    train = a_train({"kind": "brake_stuck"}, speed_mps=20.0)
    train.run(3.0, train.braking(1.0))
    assert train.world.brake_n == 0.0
    train.run(5.0, replace(train.braking(1.0), emergency_released=False))
    assert train.decel_mps2 == pytest.approx(1.2, rel=1e-3)


@pytest.mark.parametrize("share_ratio", [0.25, 1.0])
def test_a_failed_unit_is_missing_in_all_brakes(a_train: ATrain, share_ratio: float) -> None:
    fault = {"kind": "brake_unit_failed", "share_ratio": share_ratio}
    rest = 1.0 - share_ratio
    service, emergency = a_train(fault, speed_mps=22.0), a_train(fault, speed_mps=22.0)
    service.run(4.0, service.braking(0.8))
    emergency.run(4.0, emergency.EMERGENCY)
    holding = a_train(fault, speed_mps=0.0)
    holding.run(2.0, holding.HOLDING)

    assert service.decel_mps2 == pytest.approx(0.8 * rest, rel=1e-3)
    assert emergency.decel_mps2 == pytest.approx(1.2 * rest, rel=1e-3)
    assert emergency.truth.emergency_mps2 == pytest.approx(1.2 * rest, rel=1e-3)
    assert holding.decel_mps2 == pytest.approx(0.8 * rest, rel=1e-3)
    assert holding.world.brake.status().holding_applied, "the unit does not know"
    pressure_kpa = emergency.world.brake.status().cylinder_pressure_kpa
    assert pressure_kpa == pytest.approx(380.0 * rest, rel=1e-3)


def test_failed_units_and_a_weak_brake_multiply_and_go_one_by_one(a_train: ATrain) -> None:
    train = a_train(
        {"kind": "brake_unit_failed", "share_ratio": 0.5, "end_s": 6.0},
        {"kind": "brake_unit_failed", "share_ratio": 0.5, "end_s": 4.0},
        {"kind": "brake_weak", "gain_ratio": 0.8, "end_s": 5.0},
        speed_mps=22.0,
    )
    seen = []
    for duration_s in (3.9, 1.0, 1.0, 1.0):
        train.run(duration_s, train.braking(0.8))
        seen.append(train.decel_mps2 / 0.8)
    assert seen == pytest.approx([0.2, 0.4, 0.5, 1.0], rel=2e-3)


@pytest.mark.parametrize("delay_s", [0.5, 2.0])
def test_a_late_emergency_brake_cuts_traction_in_time(a_train: ATrain, delay_s: float) -> None:
    train = a_train({"kind": "emergency_late", "delay_s": delay_s}, speed_mps=15.0)
    train.run(3.0, train.RELEASED, train.driving(100_000.0))
    begin_ns = train.world.now_ns
    cut_s = since(train, lambda world: world.drive_n == 0.0, train.EMERGENCY)
    since(train, lambda world: world.brake_n > 0.0, train.EMERGENCY)
    assert cut_s <= 0.3
    assert (train.world.now_ns - begin_ns) / 1e9 == pytest.approx(0.3 + delay_s, abs=0.011)


def test_a_late_emergency_brake_is_released_normally_even_before_it_acted(a_train: ATrain) -> None:
    train = a_train({"kind": "emergency_late", "delay_s": 2.0}, speed_mps=15.0)
    train.run(0.5, train.EMERGENCY)
    train.run(5.0, train.RELEASED)
    assert train.world.brake_n == 0.0
    assert train.world.speed_mps == pytest.approx(15.0, rel=1e-6)


def test_runaway_traction_acts_although_its_command_is_silent(a_train: ATrain) -> None:
    fault = {"kind": "traction_runaway", "accel_mps2": 0.7, "start_s": 1.0, "end_s": 6.0}
    train = a_train(fault, speed_mps=5.0)
    train.run(3.0, train.RELEASED, None)
    begin_mps = train.world.speed_mps
    train.run(2.0, train.RELEASED, None)

    assert train.world.traction.silent
    assert train.world.speed_mps - begin_mps == pytest.approx(2 * 0.7, rel=1e-3)
    status = train.world.traction.status(0.0)
    assert status.force_n == pytest.approx(0.7 * train.world.consist.inertia_kg, rel=1e-3)
    assert not status.traction_cut
    train.run(3.0, train.RELEASED, None)
    assert train.world.drive_n == 0.0
    assert train.world.traction.traction_cut


@pytest.mark.parametrize("obeys", [True, False])
def test_the_emergency_brake_cuts_off_a_runaway_unless_it_ignores_the_cut(
    a_train: ATrain, obeys: bool
) -> None:
    fault = {"kind": "traction_runaway", "accel_mps2": 0.5, "obeys_cut_off": obeys}
    train = a_train(fault, speed_mps=10.0)
    train.run(3.0, train.RELEASED, train.FORBIDDEN)
    assert train.truth.accel_mps2 == pytest.approx(0.5, rel=1e-2)
    if obeys:
        cut_s = since(train, lambda world: world.drive_n == 0.0, train.EMERGENCY, train.FORBIDDEN)
        assert cut_s <= 0.3
        train.run(4.0, train.EMERGENCY, train.FORBIDDEN)
        assert train.truth.accel_mps2 == pytest.approx(-1.2, rel=1e-2)
        train.run(3.0, train.RELEASED, train.FORBIDDEN)
        assert train.truth.accel_mps2 == pytest.approx(0.5, rel=1e-2), "it pushes on"
    else:
        train.run(4.0, train.EMERGENCY, train.FORBIDDEN)
        assert train.truth.accel_mps2 == pytest.approx(0.5 - 1.2, rel=1e-2)


def test_motors_in_runaway_do_not_brake_so_friction_does(a_train: ATrain) -> None:
    train = a_train({"kind": "traction_runaway", "accel_mps2": 0.3}, speed_mps=15.0)
    train.run(4.0, train.braking(0.8), train.FORBIDDEN)
    assert train.world.brake.electric_n == 0.0
    assert train.decel_mps2 == pytest.approx(0.8, rel=1e-3)
    assert train.truth.accel_mps2 == pytest.approx(0.3 - 0.8, rel=1e-2)


def test_a_runaway_has_no_effect_without_voltage(a_train: ATrain) -> None:
    train = a_train(
        {"kind": "traction_runaway", "accel_mps2": 0.5},
        {"kind": "breaker_open", "start_s": 3.0},
        speed_mps=5.0,
    )
    train.run(3.0)
    assert train.world.drive_n > 0.0
    train.run(0.1)
    assert train.world.drive_n == 0.0


def test_weak_traction_gives_its_share(a_train: ATrain) -> None:
    train = a_train({"kind": "traction_weak", "gain_ratio": 0.4, "end_s": 4.0})
    train.run(3.0, train.RELEASED, train.driving(100_000.0))
    weak_n = train.world.drive_n
    train.run(3.0, train.RELEASED, train.driving(100_000.0))
    assert weak_n == pytest.approx(40_000.0, rel=1e-3)
    assert train.world.drive_n == pytest.approx(100_000.0, rel=1e-3)


@pytest.mark.parametrize("delay_s", [0.5, 1.0, 3.0])
def test_late_traction_builds_up_on_time_and_fades_late(a_train: ATrain, delay_s: float) -> None:
    late = a_train({"kind": "traction_late", "delay_s": delay_s})
    well = a_train()
    pushes_s, goes_s = [], []
    for train in (well, late):
        command = (train.RELEASED, train.driving(80_000.0))
        pushes_s.append(since(train, lambda world: world.drive_n > 40_000.0, *command))
        train.run(4.0, *command)
        commands = (train.RELEASED, train.FORBIDDEN)
        goes_s.append(since(train, lambda world: world.drive_n < 40_000.0, *commands))

    assert pushes_s[1] == pushes_s[0]
    # A healthy unit blocks its inverters as soon as traction is forbidden, well before a demand
    # fades.
    assert delay_s - 0.05 <= goes_s[1] - goes_s[0] <= delay_s + 0.3


def test_late_traction_follows_rising_demands_and_delays_falling_ones(a_train: ATrain) -> None:
    train = a_train({"kind": "traction_late", "delay_s": 2.0, "end_s": 9.0})
    seen = []
    for force_n in (60_000.0, 20_000.0, 90_000.0, 0.0):
        train.run(1.9, train.RELEASED, train.driving(force_n))
        seen.append(train.world.drive_n / 1000.0)
    train.run(3.0, train.RELEASED, train.driving(0.0))
    assert seen == pytest.approx([60.0, 60.0, 90.0, 90.0], rel=0.02)
    assert train.world.drive_n == pytest.approx(0.0, abs=100.0)


def test_the_train_line_of_the_emergency_brake_takes_late_traction_in_time(
    a_train: ATrain,
) -> None:
    train = a_train({"kind": "traction_late", "delay_s": 10.0})
    train.run(4.0, train.RELEASED, train.driving(80_000.0))
    cut_s = since(train, lambda world: world.drive_n == 0.0, train.EMERGENCY, train.FORBIDDEN)
    assert cut_s <= 0.3


def test_a_late_holding_brake_delays_the_train_and_reports_it(a_train: ATrain) -> None:
    train = a_train({"kind": "holding_late", "delay_s": 2.0})
    begin_ns = train.world.now_ns
    since(train, lambda world: world.brake.holding_mps2 > 0.0, train.HOLDING)
    assert (train.world.now_ns - begin_ns) / 1e9 == pytest.approx(2.1, abs=0.011)
    assert not train.world.brake.status().holding_applied
    train.run(2.0, train.HOLDING)
    assert train.world.brake.status().holding_applied
    gone_s = since(train, lambda world: world.brake.holding_mps2 < 0.7, train.RELEASED)
    assert gone_s < 0.2, "it lets go as ever"


def test_a_sticking_holding_brake_releases_late(a_train: ATrain) -> None:
    train = a_train({"kind": "holding_sticks", "delay_s": 2.0})
    engaged_s = since(train, lambda world: world.brake.holding_mps2 > 0.0, train.HOLDING)
    train.run(2.0, train.HOLDING)
    gone_s = since(train, lambda world: world.brake.holding_mps2 < 0.8, train.RELEASED)
    assert engaged_s == pytest.approx(0.1, abs=0.011)
    assert gone_s == pytest.approx(2.1, abs=0.011)
    assert not train.world.brake.status().released
