"""Predictor and delay identification, tested against actuators simulated in fine steps."""

import math
import random

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from vobc.ato.model.motion_filter import MotionFilter
from vobc.ato.model.predictor import MeanInputLag, Pipeline, response
from vobc.ato.model.train_model import TrainModel
from vobc.ato.settings.ato import BrakeBelief, TractionBelief

DT_S = 0.05
FINE = 100
"""Simulation steps in one control cycle."""


def demand_before(demands: list[float], at_s: float) -> float:
    """Demand at a time counted from the start of the first cycle; zero before that."""
    index = math.floor(at_s / DT_S + 1e-9)
    return demands[index] if 0 <= index < len(demands) else 0.0


@settings(max_examples=30, deadline=None)
@given(
    demands=st.lists(st.floats(0.0, 0.8), min_size=10, max_size=80),
    dead_time_s=st.floats(0.0, 1.5),
    lag_s=st.floats(0.1, 0.6),
)
def test_the_response_of_delay_and_lag_is_predicted_exactly(
    demands: list[float], dead_time_s: float, lag_s: float
) -> None:
    """The oracle simulates the actuator in steps of half a millisecond."""
    pipeline, undelayed = Pipeline(DT_S, 2.0), MeanInputLag(lag_s, DT_S)
    for demand in demands:
        pipeline.push(demand)
        undelayed.step(demand)
    step_s, now_s = DT_S / FINE, len(demands) * DT_S
    keep_ratio = math.exp(-step_s / lag_s)
    output, at_s = 0.0, 0.0
    output_now = single = double = 0.0
    steps = round((now_s + dead_time_s) / step_s)
    for index in range(steps):
        at_s = index * step_s
        if index == round(now_s / step_s):
            output_now = output
        asked = demand_before(demands, at_s + step_s / 2.0 - dead_time_s)
        after = asked + (output - asked) * keep_ratio
        if at_s >= now_s - 1e-9:
            double += (single + (output + after) / 4.0 * step_s) * step_s
            single += (output + after) / 2.0 * step_s
        output = after
    if steps <= round(now_s / step_s):
        output_now = output

    predicted = response(
        pipeline,
        dead_time_s=dead_time_s,
        lag_s=lag_s,
        output_now=output_now,
        output_then=undelayed.value,
    )

    assert predicted[0] == pytest.approx(single, abs=3e-3)
    assert predicted[1] == pytest.approx(double, abs=3e-3)


@settings(max_examples=40, deadline=None)
@given(demands=st.lists(st.floats(0.0, 0.8), min_size=40, max_size=90), age_s=st.floats(0.0, 1.5))
def test_the_mean_of_a_past_cycle_is_the_mean_of_its_demands(
    demands: list[float], age_s: float
) -> None:
    pipeline = Pipeline(DT_S, 1.6)
    for demand in demands:
        pipeline.push(demand)

    mean = pipeline.mean(pipeline.tap(age_s))

    end_s = len(demands) * DT_S - age_s
    instants = [end_s - DT_S + (index + 0.5) * DT_S / 2000 for index in range(2000)]
    oracle = sum(demand_before(demands, at_s) for at_s in instants) / len(instants)
    assert mean == pytest.approx(oracle, abs=1e-3)


class SimulatedTrain:
    """A point mass behind a delayed brake with lag, simulated in steps of 5 ms."""

    def __init__(self, speed_mps: float, dead_time_s: float, gain: float, resistance_mps2: float):
        self.speed_mps, self.front_m = speed_mps, 0.0
        self.gain, self.resistance_mps2 = gain, resistance_mps2
        self.dead_steps = round(dead_time_s / 0.005)
        self.asked = [0.0] * self.dead_steps
        self.output = 0.0

    def cycle(self, brake_mps2: float, lag_s: float = 0.35) -> None:
        for _ in range(10):
            self.asked.append(brake_mps2)
            arrived = self.asked.pop(0)
            self.output += (arrived - self.output) * (1.0 - math.exp(-0.005 / lag_s))
            accel = -self.output * self.gain - self.resistance_mps2
            self.front_m += self.speed_mps * 0.005 + accel * 0.005**2 / 2.0
            self.speed_mps += accel * 0.005


def brake_a_train(
    dead_time_s: float, *, gain: float = 1.0, resistance_mps2: float = 0.0, noise_mps: float = 0.01
) -> tuple[TrainModel, SimulatedTrain, list[tuple[float, float, float]]]:
    """Cruise, ramp the brake up and ease it; return each prediction with its instant."""
    draw = random.Random(7)
    model = TrainModel(BrakeBelief(), TractionBelief(), DT_S)
    train = SimulatedTrain(18.0, dead_time_s, gain, resistance_mps2)
    model.meet(18.0)
    predictions = []
    for cycle in range(320):
        at_s = cycle * DT_S
        brake_mps2 = min(0.65, max(0.0, 0.6 * (at_s - 3.0)), max(0.15, 0.65 - 0.1 * (at_s - 10.0)))
        model.step(train.speed_mps + draw.gauss(0.0, noise_mps), 0.0, 1)
        model.issue(-brake_mps2)
        ahead = model.ahead_of_brake(train.front_m, 0.0)
        predictions.append((at_s + model.dead_time_s, ahead.front_m, ahead.speed_mps))
        train.cycle(brake_mps2)
    return model, train, predictions


@pytest.mark.parametrize("dead_time_s", [0.4, 0.5, 0.65, 0.8, 1.0, 1.3])
def test_the_dead_time_is_identified_from_the_first_braking(dead_time_s: float) -> None:
    """Hypotheses are 0.18 s apart, so the two nearest agree on a value within half of that."""
    model, _, _ = brake_a_train(dead_time_s)

    assert model.dead_time_s == pytest.approx(dead_time_s, abs=0.1)


@pytest.mark.parametrize("gain", [0.85, 1.0, 1.15])
def test_the_brake_s_gain_is_learnt(gain: float) -> None:
    model, _, _ = brake_a_train(1.02, gain=gain, resistance_mps2=0.03)

    assert 1.0 + model.gain_ratio == pytest.approx(gain, abs=0.03)


@pytest.mark.parametrize("dead_time_s", [0.48, 1.02])
def test_the_predicted_speed_is_reached(dead_time_s: float) -> None:
    """Once the delay is identified, the predicted speeds are right within a few cm/s."""
    _, _, predictions = brake_a_train(dead_time_s, gain=1.05, resistance_mps2=0.02)
    train = SimulatedTrain(18.0, dead_time_s, 1.05, 0.02)
    history = []
    for cycle in range(320):
        at_s = cycle * DT_S
        history.append((at_s, train.front_m, train.speed_mps))
        brake_mps2 = min(0.65, max(0.0, 0.6 * (at_s - 3.0)), max(0.15, 0.65 - 0.1 * (at_s - 10.0)))
        train.cycle(brake_mps2)

    for then_s, front_m, speed_mps in predictions[140:280]:
        index = then_s / DT_S
        low = int(index)
        share = index - low
        front_then_m = history[low][1] * (1.0 - share) + history[low + 1][1] * share
        speed_then_mps = history[low][2] * (1.0 - share) + history[low + 1][2] * share
        assert speed_mps == pytest.approx(speed_then_mps, abs=0.04)
        assert front_m == pytest.approx(front_then_m, abs=0.06)


def test_a_missed_cycle_does_not_disturb_the_prediction() -> None:
    """Two cycles with one demand end in the same estimate, in one step or in two."""
    once, twice = (TrainModel(BrakeBelief(), TractionBelief(), DT_S) for _ in range(2))
    for model in (once, twice):
        model.meet(10.0)
        model.issue(-0.3)

    once.step(10.0, 0.0, 2)
    twice.step(10.0, 0.0, 1)
    twice.step(10.0, 0.0, 1)

    assert once.ahead_of_brake(0.0, 0.0) == twice.ahead_of_brake(0.0, 0.0)


def test_the_filter_tells_a_gain_from_a_resistance() -> None:
    """A change of demand separates gain and resistance; afterwards both estimates are close."""
    motion, speed_mps = MotionFilter(DT_S), 20.0
    motion.start(20.0)
    for cycle in range(500):
        braked_mps2 = 0.0 if cycle < 200 else 0.6 if cycle < 400 else 0.2
        speed_mps += (-braked_mps2 * 1.1 - 0.03) * DT_S
        motion.step(speed_mps, push_mps2=0.0, braked_mps2=braked_mps2)

    assert motion.gain_ratio == pytest.approx(0.1, abs=0.02)
    assert motion.disturbance_mps2 == pytest.approx(-0.03, abs=0.01)
