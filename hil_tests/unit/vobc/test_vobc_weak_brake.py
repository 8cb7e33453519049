"""Operation of a train with a weak emergency brake plans below the permitted speed."""

from collections import deque
from dataclasses import replace
from typing import Final

import pytest
from hypothesis import Phase, assume, given, settings
from hypothesis import strategies as st

from can_dbc.vobc import OperatingMode
from hil_tests.unit.vobc.atp.heard_rig import NO_ORDERS, SILENCE
from hil_tests.unit.vobc.test_vobc_controller import CONFIG
from hil_tests.unit.vobc.test_vobc_controller_edges import INPUTS, MOTION, Between
from metro_hil.metrics.worst_motion import CYCLE_S, line_of
from vobc.atp import Protection
from vobc.vocabulary import Authority, CycleInput, Interval, Restriction

LENGTH_M: Final = 64.0
STEP_S: Final = 0.1
BRAKE_ACTS_S: Final = 3.6
"""1.85 s of the first dead time, 0.35 s of build-up and 1.4 s of smoothing."""
MARGIN_MPS: Final = CONFIG.ato.speed.margin_mps
GRID_MPS: Final = 0.1
"""Greatest fall of the permitted speed within one step of the replay: 1 m/s² for 0.1 s."""
START_M: Final = 300.0


def protection_of(
    guaranteed_decel_mps2: float,
    gradients: tuple[tuple[float, float, float], ...],
    limits: tuple[tuple[float, float, float], ...],
) -> Protection:
    config = replace(CONFIG.atp, guaranteed_decel_mps2=guaranteed_decel_mps2)
    line = line_of(gradients, limits)
    return Protection(config, line, train_length_m=LENGTH_M, cycle_s=CYCLE_S)


def at(front_m: float) -> Interval:
    return Interval(front_m - 1.0, front_m, front_m + 1.5)


@settings(max_examples=6, derandomize=True, deadline=None, phases=[Phase.explicit, Phase.generate])
@given(
    guaranteed_decel_mps2=st.floats(0.45, 0.99),
    falls_permille=st.lists(st.floats(-30.0, 20.0), min_size=4, max_size=4),
    lower_mps=st.floats(5.0, 20.0),
    end_m=st.floats(1900.0, 2600.0),
    start_mps=st.floats(12.0, 33.0),
)
def test_a_brake_that_acts_late_keeps_the_train_below_the_permitted_speed(
    guaranteed_decel_mps2: float,
    falls_permille: list[float],
    lower_mps: float,
    end_m: float,
    start_mps: float,
) -> None:
    """Replay a cruising train that gets the speed that operation asked for 3.6 s earlier.

    It approaches a lower limit, and then the end of its authority.
    """
    gradients = tuple((500.0 * i, 500.0 * i + 450.0, g) for i, g in enumerate(falls_permille, 1))
    limits = ((0.0, 1700.0, 34.0), (1700.0, 6000.0, lower_mps))
    protection = protection_of(guaranteed_decel_mps2, gradients, limits)
    image = replace(SILENCE, authority=Authority(end_m, 1, 1))

    def permitted_mps(front_m: float, way_m: float = 0.0) -> float:
        return protection.permitted_ahead_mps(image, at(front_m), way_m)

    reach_m = start_mps * BRAKE_ACTS_S
    assume(min(permitted_mps(START_M + reach_m * i / 8) for i in range(9)) > start_mps + MARGIN_MPS)
    front_m, speed_mps = START_M, start_mps
    asked_mps = deque([start_mps] * round(BRAKE_ACTS_S / STEP_S))
    spare_mps: list[float] = []

    while speed_mps > 0.5:
        here_mps = permitted_mps(front_m)
        spare_mps.append(here_mps - speed_mps)
        ahead_mps = permitted_mps(front_m, speed_mps * BRAKE_ACTS_S)
        asked_mps.append(min(here_mps, ahead_mps) - MARGIN_MPS)
        speed_mps = min(speed_mps, asked_mps.popleft())
        front_m += speed_mps * STEP_S

    assert min(spare_mps) >= MARGIN_MPS - GRID_MPS
    assert 1700.0 < front_m < end_m


@pytest.mark.parametrize("way_m", [0.0, 80.0, 250.0])
def test_the_permitted_speed_ahead_is_the_one_that_protection_will_give_there(way_m: float) -> None:
    protection = protection_of(0.6, ((400.0, 900.0, -20.0),), ((0.0, 6000.0, 25.0),))
    restriction = Restriction(800.0, 900.0, 8.0)
    orders = replace(NO_ORDERS, restrictions=(restriction,))
    image = replace(SILENCE, authority=Authority(1500.0, 1, 1), orders=orders)
    there = protection._ceilings.at(at(600.0 + way_m), 1500.0, (restriction,))

    assert protection.permitted_ahead_mps(image, at(600.0), way_m) == there.permitted_mps
    assert there.permitted_mps < 25.0


@pytest.mark.parametrize(("way_m", "permitted_mps"), [(60.0, 10.0), (61.0, 25.0), (100.0, 25.0)])
def test_a_limit_holds_ahead_until_the_rear_is_surely_clear_of_it_there(
    way_m: float, permitted_mps: float
) -> None:
    """The limit ends at 500 m. The rear is 65 m behind the likeliest place of the front."""
    protection = protection_of(0.6, (), ((0.0, 500.0, 10.0), (500.0, 6000.0, 25.0)))
    image = replace(SILENCE, authority=Authority(3000.0, 1, 1))

    assert protection.permitted_ahead_mps(image, at(504.5), way_m) == permitted_mps


def test_without_an_authority_nothing_is_permitted_ahead() -> None:
    protection = protection_of(0.6, (), ((0.0, 6000.0, 25.0),))

    assert protection.permitted_ahead_mps(SILENCE, at(600.0), 10.0) == 0.0


class Ahead:
    """Stands for protection that permits a set speed further on."""

    def __init__(self, between: Between, ahead_mps: float) -> None:
        self._says = between.protection.step
        self._ahead_mps = ahead_mps
        self.ways_m: list[float] = []

    def step(self, *inputs: object, **given_to: object) -> object:
        return self._says(*inputs, **given_to)

    def permitted_ahead_mps(self, _image: CycleInput, front_m: Interval, way_m: float) -> float:
        assert front_m == MOTION.front_m
        self.ways_m.append(way_m)
        return self._ahead_mps


@pytest.mark.parametrize(
    ("guaranteed_decel_mps2", "mode", "ahead_mps", "seen_mps"),
    [
        (0.64, OperatingMode.AUTHORISED, 11.0, 11.0),
        (0.999, OperatingMode.AUTHORISED, 11.0, 11.0),
        (0.64, OperatingMode.AUTHORISED, 15.5, 15.0),
        (0.64, OperatingMode.CREEP, 11.0, 15.0),
        (1.0, OperatingMode.AUTHORISED, 11.0, 15.0),
    ],
)
def test_operation_looks_ahead_only_with_a_weak_brake_under_full_supervision(
    guaranteed_decel_mps2: float, mode: OperatingMode, ahead_mps: float, seen_mps: float
) -> None:
    atp = replace(CONFIG.atp, guaranteed_decel_mps2=guaranteed_decel_mps2)
    between = Between(replace(CONFIG, atp=atp))
    between.protection.said = replace(between.protection.said, mode=mode)
    ahead = Ahead(between, ahead_mps)
    between.controller._protection = ahead  # type: ignore[assignment]

    between.controller.step(INPUTS)

    assert between.driver.seen[-1].ceiling_mps == seen_mps
    looks = guaranteed_decel_mps2 < 1.0 and mode is OperatingMode.AUTHORISED
    assert ahead.ways_m == ([pytest.approx(5.0 * BRAKE_ACTS_S)] if looks else [])


def test_a_train_that_rolls_back_looks_at_its_own_place() -> None:
    between = Between(replace(CONFIG, atp=replace(CONFIG.atp, guaranteed_decel_mps2=0.64)))
    between.odometry.said = replace(MOTION, speed_mps=Interval(-0.4, -0.3, -0.2))
    ahead = Ahead(between, 15.0)
    between.controller._protection = ahead  # type: ignore[assignment]

    between.controller.step(INPUTS)

    assert ahead.ways_m == [0.0]


@pytest.mark.parametrize(
    ("strategy", "feed_forward", "kp_per_s", "acts_s"),
    [
        ("predictive", False, 0.5, 3.6),
        ("pid_literal", True, 0.5, 3.6),
        ("pid_literal", False, 0.5, 5.6),
        ("pid_literal", False, 0.0, 13.6),
    ],
)
def test_a_printed_pid_without_feed_forward_looks_further_ahead(
    strategy: str, feed_forward: bool, kp_per_s: float, acts_s: float
) -> None:
    printed = CONFIG.ato.pid_literal
    printed = replace(
        printed,
        feed_forward=feed_forward,
        falling=replace(printed.falling, kp_per_s=kp_per_s),
    )

    config = replace(CONFIG.ato, strategy=strategy, pid_literal=printed)

    assert config.brake_acts_s == pytest.approx(acts_s)
