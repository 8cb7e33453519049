"""The high-voltage box of a train that is connected to the network of its line."""

import pytest

from plant_emulator.power.box import Due, HighVoltageBox
from plant_emulator.train_config import load_train
from plant_emulator.world import STEP_S

STEPS = 20
INTERVAL_S = STEPS * STEP_S
TRAIN = load_train("typeB4")


def box() -> HighVoltageBox:
    made = HighVoltageBox(
        TRAIN.supply,
        step_s=STEP_S,
        traction_efficiency_ratio=0.8,
        electric_efficiency_ratio=0.5,
    )
    made.join()
    return made


def interval(power: HighVoltageBox, *, drive_w: float = 0.0, brake_w: float = 0.0) -> None:
    for _ in range(STEPS):
        if drive_w or brake_w:
            power.step(drive_w * STEP_S, brake_w * STEP_S)
        else:
            power.rest()


def test_the_energy_of_a_train_is_booked_when_the_network_has_answered() -> None:
    power = box()
    interval(power, drive_w=800_000.0)
    wish, due = power.take_load(INTERVAL_S)

    assert wish == pytest.approx((1_000_000.0, 0.0, 120_000.0))
    assert power.drawn_j == 0.0

    power.fed(700.0, 0.0, 1.0, due, INTERVAL_S)

    assert power.drawn_j == pytest.approx(1_120_000.0 * INTERVAL_S)
    assert power.voltage_v == 700.0
    assert power.current_a == pytest.approx(1600.0)
    assert power.supply().line_current_a == power.current_a


def test_a_high_voltage_leaves_a_share_of_the_braking_to_the_resistor() -> None:
    power = box()
    interval(power, brake_w=1_000_000.0)
    wish, due = power.take_load(INTERVAL_S)
    power.fed(890.0, 0.25, 1.0, due, INTERVAL_S)

    assert wish.regenerated_w == pytest.approx(500_000.0)
    assert power.resistor_j == pytest.approx(125_000.0 * INTERVAL_S)
    assert power.returned_j == pytest.approx((375_000.0 - 120_000.0) * INTERVAL_S)
    assert power.current_a < 0.0
    assert power.electric_limit_w == float("inf")


def test_the_energy_balance_closes_for_any_sequence() -> None:
    power = box()
    for number in range(40):
        interval(power, drive_w=4e5 * (number % 3), brake_w=3e5 * (number % 2))
        _, due = power.take_load(INTERVAL_S)
        power.fed(850.0, 0.1 * (number % 5), 1.0, due, INTERVAL_S)

    became_j = power.traction_j - power.braking_j + power.auxiliary_j + power.resistor_j
    assert power.drawn_j - power.returned_j == pytest.approx(became_j, rel=1e-12)


def test_at_low_voltage_effort_falls_at_once_and_recovers_slowly() -> None:
    power = box()
    nothing = Due()
    power.fed(550.0, 0.0, 0.5, nothing, INTERVAL_S)
    assert power.effort_ratio == 0.5

    seen = []
    for _ in range(6):
        power.fed(700.0, 0.0, 1.0, nothing, INTERVAL_S)
        seen.append(power.effort_ratio)

    assert seen == pytest.approx([0.6, 0.7, 0.8, 0.9, 1.0, 1.0])


def test_a_trains_requested_power_does_not_fall_with_the_power_it_gets() -> None:
    """Otherwise the voltage would recover, the whole effort would return, and the voltage would
    fall again."""
    power = box()
    power.fed(550.0, 0.0, 0.5, Due(), INTERVAL_S)
    interval(power, drive_w=400_000.0)

    wish, _ = power.take_load(INTERVAL_S)

    assert wish.traction_w == pytest.approx(1_000_000.0)


def test_a_hot_resistor_leaves_the_rest_to_friction() -> None:
    power = box()
    resistor = TRAIN.supply.resistor
    assert resistor is not None
    limits_w = []
    for _ in range(1500):
        interval(power, brake_w=3_000_000.0)
        _, due = power.take_load(INTERVAL_S)
        power.fed(899.0, 0.9, 1.0, due, INTERVAL_S)
        limits_w.append(power.electric_limit_w)

    assert limits_w[0] == float("inf")
    assert limits_w[-1] < 3_000_000.0


def test_a_train_off_the_network_requests_no_power_and_an_open_breaker_ends_all_current() -> None:
    power = box()
    power.connect(None, breaker_closed=False)
    interval(power)
    wish, due = power.take_load(INTERVAL_S)
    power.fed(830.0, 0.0, 1.0, due, INTERVAL_S)

    assert wish == (0.0, 0.0, 0.0)
    assert power.effort_ratio == 0.0
    assert power.electric_limit_w == 0.0
    assert not power.supply().breaker_closed

    power.connect(920.0, breaker_closed=True)
    interval(power, drive_w=800_000.0)
    assert power.take_load(INTERVAL_S)[0] == (0.0, 0.0, 0.0)
    assert 880.0 < power.voltage_v < 920.0


@pytest.mark.parametrize("on_network", [True, False])
def test_an_isolated_train_gets_nothing_and_afterwards_what_it_had_before(on_network: bool) -> None:
    power = box()
    power.connect(None if on_network else 700.0, breaker_closed=True)
    power.isolate(True)
    # A fault of the supply changes nothing inside, and acts behind the section.
    power.connect(None if on_network else 620.0, breaker_closed=True)
    drawn_j = power.drawn_j
    interval(power, brake_w=500_000.0)

    assert not power.live
    assert (power.voltage_v, power.electric_limit_w, power.effort_ratio) == (0.0, 0.0, 0.0)
    assert power.supply().breaker_closed
    assert power.drawn_j == drawn_j

    power.isolate(False)
    interval(power)

    assert power.live
    assert power.networked
    wish, _ = power.take_load(INTERVAL_S)
    assert (wish.auxiliary_w > 0.0) is on_network
    assert on_network or 600.0 < power.voltage_v < 620.0
