"""Model bank and late friction brake, tested against a train that is simulated in fine steps."""

import math
import random
from collections import deque

import pytest

from vobc.ato.model.model_bank import ModelBank
from vobc.ato.model.motion_filter import GAIN_MAX_RATIO, MotionFilter
from vobc.ato.model.train_model import TrainModel
from vobc.ato.settings.ato import BrakeBelief, TractionBelief

DT_S = 0.05
MAY_BE_LATE = BrakeBelief(air_delays_s=(0.0, 0.45, 0.6, 0.7, 0.8, 0.9, 1.0, 1.15))
FINE_S = 0.005
DEAD_S, LAG_S, AIR_LAG_S = 0.4, 0.3, 0.2
FADE_BEGIN_MPS, FADE_END_MPS, MOTORS_MPS2 = 8.0 / 3.6, 3.0 / 3.6, 1.2


class BlendedTrain:
    """A point mass with blended braking: a late friction brake adds what the motors can no
    longer give."""

    def __init__(self, speed_mps: float, air_s: float, friction_gain: float) -> None:
        self.speed_mps, self.front_m = speed_mps, 0.0
        self.friction_gain = friction_gain
        self.asked = deque([0.0] * round(DEAD_S / FINE_S))
        self.air = deque([0.0] * round(air_s / FINE_S))
        self.air_lag_s = AIR_LAG_S if air_s > 0.0 else 0.0
        self.unit = self.friction = 0.0

    def cycle(self, brake_mps2: float) -> None:
        for _ in range(round(DT_S / FINE_S)):
            self.asked.append(brake_mps2)
            self.unit += (self.asked.popleft() - self.unit) * (1.0 - math.exp(-FINE_S / LAG_S))
            share = (self.speed_mps - FADE_END_MPS) / (FADE_BEGIN_MPS - FADE_END_MPS)
            motors = min(self.unit, MOTORS_MPS2 * min(1.0, max(0.0, share)))
            self.air.append(self.unit - motors)
            late = self.air.popleft()
            keep = math.exp(-FINE_S / self.air_lag_s) if self.air_lag_s else 0.0
            self.friction = late + (self.friction - late) * keep
            decel = motors + self.friction_gain * self.friction
            self.front_m += self.speed_mps * FINE_S
            self.speed_mps = max(0.0, self.speed_mps - decel * FINE_S)


def braked(
    air_s: float, friction_gain: float, model: TrainModel | None = None
) -> tuple[TrainModel, list[tuple[float, float]]]:
    """Brake the train once to 0.4 m/s; return pairs of predicted and true speed."""
    draw = random.Random(3)
    model = model or TrainModel(MAY_BE_LATE, TractionBelief(), DT_S)
    train = BlendedTrain(7.0, air_s, friction_gain)
    model.meet(7.0)
    told: list[tuple[float, float]] = []
    history: list[tuple[float, float]] = []
    now_s = 0.0
    while train.speed_mps > 0.4:
        brake_mps2 = 0.6 if train.speed_mps > 2.6 else 0.18
        model.step(train.speed_mps + draw.gauss(0.0, 0.01), 0.0, 1)
        model.issue(-brake_mps2)
        ahead = model.ahead_of_brake(train.front_m, 0.0)
        history.append((train.front_m, train.speed_mps))
        told.append((ahead.front_m, ahead.speed_mps))
        train.cycle(brake_mps2)
        now_s += DT_S
    fronts = [front_m for front_m, _ in history]
    compared = []
    for front_m, speed_mps in told[-60:]:
        later = next((i for i, at_m in enumerate(fronts) if at_m >= front_m), None)
        if later is not None:
            compared.append((speed_mps, history[later][1]))
    return model, compared


@pytest.mark.parametrize("air_s", [0.6, 0.8, 1.0])
@pytest.mark.parametrize("friction_gain", [0.8, 1.0, 1.2])
def test_late_friction_and_its_delay_are_identified(air_s: float, friction_gain: float) -> None:
    model, _ = braked(air_s, friction_gain)

    assert model.friction_may_be_late
    assert model._handover.air_s == pytest.approx(air_s, abs=0.2)


def test_the_speed_is_predicted_through_the_handover_to_friction() -> None:
    _, compared = braked(0.8, 1.0)

    assert len(compared) > 20
    assert max(abs(told - came) for told, came in compared) <= 0.06


def test_one_braking_tells_timely_from_late_friction_and_late_friction_is_remembered() -> None:
    belief, traction = MAY_BE_LATE, TractionBelief()
    assert TrainModel(belief, traction, DT_S).friction_may_be_late

    for air_s, expected in ((0.0, False), (0.8, True)):
        model, _ = braked(air_s, 1.0)
        for _ in range(100):
            model.issue(0.0)
            model.step(0.0, 0.0, 1)
        assert model.friction_may_be_late is expected
        gap_m = model.gap_m(3.0, 0.15)
        assert (gap_m > 0.5) is expected


def test_the_gap_before_a_handover_is_the_distance_run_during_the_friction_delay() -> None:
    model, _ = braked(0.8, 1.0)
    for _ in range(100):
        model.issue(0.0)
        model.step(0.0, 0.0, 1)

    # Mean speed between the fade-out's end (0.83 m/s) and the speed at which the motors just give
    # 0.15 m/s², times the delay and the build-up of the friction brake.
    middle_mps = FADE_END_MPS + 0.15 / MOTORS_MPS2 * (FADE_BEGIN_MPS - FADE_END_MPS) / 2.0
    assert model.gap_m(3.0, 0.15) == pytest.approx(middle_mps * (0.8 + AIR_LAG_S), abs=0.2)
    assert model.gap_m(0.5, 0.15) == 0.0


def test_the_bank_gives_the_weight_to_the_hypothesis_that_fits() -> None:
    bank, motion = ModelBank(3, DT_S), MotionFilter(DT_S)
    motion.start(10.0)
    bank.begin(motion)
    speed_mps = 10.0
    for _ in range(60):
        speed_mps -= 0.5 * DT_S
        for index, braked_mps2 in enumerate((0.0, 0.5, 1.0)):
            bank.step(
                index,
                speed_mps,
                push_mps2=0.0,
                braked_mps2=braked_mps2,
                friction_mps2=0.0,
                blur_m2_per_s2=0.0,
            ) if index in bank.alive else None
        bank.weigh()

    assert bank.weights[1] == pytest.approx(1.0, abs=0.2)
    assert sum(bank.weights) == pytest.approx(1.0)


def test_an_implausible_brake_gain_is_discarded_before_the_next_application() -> None:
    """A brake that gives half of the demand is a fault, so the model discards the learnt gain."""
    motion = MotionFilter(DT_S)
    motion.start(20.0)
    speed_mps = 20.0
    for _ in range(200):
        speed_mps -= 0.3 * DT_S
        motion.step(speed_mps, push_mps2=0.0, braked_mps2=0.6)
    learnt = motion.gain_ratio
    motion.renew_gain()

    assert learnt == pytest.approx(-GAIN_MAX_RATIO, abs=0.01)
    assert motion.gain_ratio == 0.0


def test_a_speed_that_no_brake_explains_changes_no_learnt_gain() -> None:
    model = TrainModel(MAY_BE_LATE, TractionBelief(), DT_S)
    model.meet(15.0)
    model.issue(-0.5)
    for _ in range(40):
        model.step(15.0, 0.0, 1)
        model.issue(-0.5)
    model.step(14.0, 0.0, 1)

    assert model.gain_ratio == 0.0
    assert model.speed_mps == pytest.approx(14.0)


def test_a_held_train_changes_no_learnt_gain() -> None:
    model, _ = braked(0.0, 1.0)
    before = model.gain_ratio
    for _ in range(100):
        model.issue(-0.4)
        model.step(0.0, 0.0, 1)
        model.meet(0.0) if model.speed_mps > 0.1 else None

    assert model.gain_ratio == pytest.approx(before, abs=0.1)
