"""The train model's own speed estimate while the odometry's speed filter lags."""

import math
from dataclasses import replace

import pytest

from vobc.ato.model.train_model import TrainModel
from vobc.ato.settings.ato import BrakeBelief, TractionBelief
from vobc.odometry.tracking import SpeedTrack
from vobc.vocabulary import BrakeFinding

CYCLE_S = 0.05
STEPS = 4
PULSE_M = 0.0105
DEAD_CYCLES = 13
LAG_S = 0.35
BANDWIDTH_RAD_S = 8.0
COASTING_S = 2.0
STEADY_S = 5.0
EASED_MPS3 = 0.1


def asked_mps2(cycle: int) -> float:
    """No brake demand at first, then 0.5 m/s² for some seconds, then a falling demand."""
    at_s = cycle * CYCLE_S
    if at_s < COASTING_S:
        return 0.0
    return 0.5 - EASED_MPS3 * max(0.0, at_s - STEADY_S)


def bias_mps(brake: BrakeBelief) -> float:
    """Mean of estimated minus true speed while the brake eases off, measured through pulses."""
    model = TrainModel(brake, TractionBelief(), CYCLE_S)
    track = SpeedTrack(bandwidth_rad_s=BANDWIDTH_RAD_S, window_s=0.2)
    speed_mps, front_m, braked_mps2 = 4.0, 0.0, 0.0
    errors_mps = []
    for cycle in range(round((STEADY_S + 4.0) / CYCLE_S)):
        model.issue(-asked_mps2(cycle))
        for part in range(STEPS):
            bites_mps2 = asked_mps2(cycle - DEAD_CYCLES)
            braked_mps2 += (bites_mps2 - braked_mps2) * (1.0 - math.exp(-CYCLE_S / STEPS / LAG_S))
            speed_mps -= braked_mps2 * CYCLE_S / STEPS
            front_m += speed_mps * CYCLE_S / STEPS
            now_s = (cycle + (part + 1) / STEPS) * CYCLE_S
            if part % 2:
                track.add(now_s, math.floor(front_m / PULSE_M))
        measured_mps = track.limited_rate_pulses_per_s(now_s) * PULSE_M
        if now_s < COASTING_S:
            model.meet(measured_mps)
        model.step(measured_mps, 0.0, 1)
        if now_s > STEADY_S + 2.0:
            errors_mps.append(model.speed_mps - speed_mps)
    return math.fsum(errors_mps) / len(errors_mps)


def test_an_easing_brake_does_not_bias_the_speed_estimate() -> None:
    assert bias_mps(BrakeBelief()) == pytest.approx(0.0, abs=0.0025)


def test_ignoring_the_speed_filter_biases_the_estimate() -> None:
    quick = replace(BrakeBelief(), speed_filter_rad_s=1000.0)

    assert bias_mps(quick) < -0.004


class Again:
    """A train that brakes lightly, releases for a moment and brakes again with another dead
    time."""

    def __init__(self, first_dead_s: float, second_dead_s: float, released_s: float) -> None:
        self.model = TrainModel(BrakeBelief(speed_filter_rad_s=1000.0), TractionBelief(), CYCLE_S)
        self._dead_s = (first_dead_s, second_dead_s)
        self._again_s = LIGHT_S + released_s
        self._sent: list[tuple[float, float]] = []
        self._asked_mps2 = self.braked_mps2 = 0.0
        self.now_s, self.speed_mps, self.front_m = 0.0, 12.0, 0.0
        self.model.meet(self.speed_mps)

    def _demand_mps2(self) -> float:
        if self.now_s < LIGHT_S - EPSILON_S:
            return 0.2
        return 0.5 if self.now_s >= self._again_s - EPSILON_S else 0.0

    def _arrived_mps2(self) -> float:
        """The demand that has reached the brake. A later demand never overtakes an earlier one."""
        return ([0.0] + [value for due_s, value in self._sent if due_s <= self.now_s])[-1]

    def run(self, until_s: float) -> None:
        while self.now_s < until_s - EPSILON_S:
            demand_mps2 = self._demand_mps2()
            if demand_mps2 != self._asked_mps2:
                dead_s = self._dead_s[self.now_s >= self._again_s - EPSILON_S]
                due_s = max([self.now_s + dead_s, *(due_s for due_s, _ in self._sent)])
                self._sent.append((due_s, demand_mps2))
                self._asked_mps2 = demand_mps2
            self.model.issue(-demand_mps2)
            for _ in range(FINE_STEPS):
                self.now_s += CYCLE_S / FINE_STEPS
                ratio = 1.0 - math.exp(-CYCLE_S / FINE_STEPS / BrakeBelief().lag_s)
                self.braked_mps2 += (self._arrived_mps2() - self.braked_mps2) * ratio
                before_mps = self.speed_mps
                self.speed_mps -= self.braked_mps2 * CYCLE_S / FINE_STEPS
                self.front_m += (before_mps + self.speed_mps) / 2.0 * CYCLE_S / FINE_STEPS
            self.model.step(self.speed_mps, 0.0, 1)


LIGHT_S = 4.0
FINE_STEPS = 50
EPSILON_S = 1e-6


@pytest.mark.parametrize("released_s", [0.05, 0.4, 1.0])
@pytest.mark.parametrize(("first_s", "second_s"), [(0.45, 1.35), (1.35, 0.45), (0.65, 0.75)])
def test_each_brake_application_has_its_own_dead_time(
    first_s: float, second_s: float, released_s: float
) -> None:
    train = Again(first_s, second_s, released_s)

    train.run(LIGHT_S)
    assert train.model.dead_time_s == pytest.approx(first_s, abs=0.06)
    train.run(LIGHT_S + released_s + second_s + 2.0)

    # The second application acts later when the release of the first one arrives only after it.
    held_back_s = max(0.0, first_s - released_s - second_s)
    assert train.model.dead_time_s == pytest.approx(second_s + held_back_s, abs=0.1)
    assert train.model.brake_mps2 == pytest.approx(train.braked_mps2, abs=0.01)


@pytest.mark.parametrize("released_s", [0.4, 1.0])
def test_the_model_includes_the_decaying_earlier_application(released_s: float) -> None:
    train = Again(1.05, 0.95, released_s)
    train.run(LIGHT_S + released_s + 2 * CYCLE_S)

    ahead = train.model.ahead_of_brake(train.front_m, 0.0)
    then_s = train.now_s + train.model.dead_time_s
    train.run(then_s)
    front_m = train.front_m - train.speed_mps * (train.now_s - then_s)

    assert ahead.speed_mps == pytest.approx(train.speed_mps, abs=0.02)
    assert ahead.front_m == pytest.approx(front_m, abs=0.03)


@pytest.mark.parametrize("weak_ratio", [-0.05, -0.16, -0.4])
def test_before_the_first_braking_the_gain_is_as_weak_as_the_parameter_says(
    weak_ratio: float,
) -> None:
    model = TrainModel(BrakeBelief(), TractionBelief(), CYCLE_S, weak_ratio=weak_ratio)

    assert model.least_gain_ratio == pytest.approx(weak_ratio)


def finding(dead_time_s: float, gain_ratio: float) -> BrakeFinding | None:
    """The finding at the end of 6 s of braking with 0.6 m/s² from 14 m/s."""
    model = TrainModel(BrakeBelief(speed_filter_rad_s=1000.0), TractionBelief(), CYCLE_S)
    speed_mps, braked_mps2 = 14.0, 0.0
    sent_mps2: list[float] = []
    model.meet(speed_mps)
    for cycle in range(round(8.0 / CYCLE_S)):
        model.step(speed_mps, 0.0, 1)
        demand_mps2 = min(0.6, 0.45 * cycle * CYCLE_S)
        model.issue(-demand_mps2)
        sent_mps2.append(demand_mps2)
        late = cycle - round(dead_time_s / CYCLE_S)
        acts_mps2 = (1.0 + gain_ratio) * (sent_mps2[late] if late >= 0 else 0.0)
        braked_mps2 += (acts_mps2 - braked_mps2) * (1.0 - math.exp(-CYCLE_S / LAG_S))
        speed_mps -= braked_mps2 * CYCLE_S
    return model.finding()


@pytest.mark.parametrize(
    ("dead_time_s", "gain_ratio"), [(0.0, -0.15), (0.5, 0.15), (1.0, 0.0), (1.8, -0.15), (2.6, 0.0)]
)
def test_a_brake_within_the_belief_gives_no_finding(dead_time_s: float, gain_ratio: float) -> None:
    assert finding(dead_time_s, gain_ratio) is None


@pytest.mark.parametrize("gain_ratio", [-0.2, -0.4])
def test_a_weak_brake_is_found_with_its_gain(gain_ratio: float) -> None:
    found = finding(0.8, gain_ratio)

    assert found is not None
    assert not found.late
    assert found.gain_ratio == pytest.approx(max(gain_ratio, -0.3), abs=0.02)


@pytest.mark.parametrize("dead_time_s", [3.0, 3.4])
def test_a_brake_at_the_last_dead_time_or_beyond_is_late_and_not_called_weak(
    dead_time_s: float,
) -> None:
    found = finding(dead_time_s, 0.0)

    assert found is not None
    assert found.late
    assert found.dead_time_s == pytest.approx(3.0, abs=0.05)
