"""The first frames may all be late, so odometry reports nothing until it has learnt the delay."""

from dataclasses import replace

import pytest

from hil_tests.unit.vobc.odometry.odometry_desk import CONFIG, Desk
from hil_tests.unit.vobc.odometry.odometry_rig import Errors, Rig
from vobc.vocabulary import TagReading


@pytest.mark.parametrize("learn_s", [0.0, 0.04, 0.4])
def test_odometry_reports_after_the_learning_time(learn_s: float) -> None:
    new = Desk(learn_s=learn_s)
    for number in range(20):
        told = new.hear(0)
        assert (told is not None) is (new.track.heard_s >= learn_s)
        assert new.track.heard_s == pytest.approx(0.04 * number)
    assert told is not None


def test_time_without_samples_teaches_nothing() -> None:
    new = Desk(learn_s=0.4)
    new.hear(0)
    assert all(new.hear() is None for _ in range(30))
    assert new.hear(0) is not None


@pytest.mark.parametrize("radar_mps", [None, 4.0])
@pytest.mark.parametrize("step", [0, 8])
def test_during_learning_the_speed_over_ground_is_unknown(
    step: int, radar_mps: float | None
) -> None:
    """Neither a still wheel nor radar nor a full window counts yet, but the position interval
    follows them."""
    new = Desk(learn_s=0.8)
    while new.hear(step, step, radar_mps=radar_mps) is None:
        assert not new.ground.begun
        assert new.where.ground_low_m <= new.where.low_m
        assert new.where.high_m <= new.where.ground_high_m
    new.hear(step, step, radar_mps=radar_mps)
    assert new.ground.begun


def test_pulses_and_tags_during_learning_count() -> None:
    new, at_once = Desk(61.1, learn_s=0.8), Desk(61.1, learn_s=0.0)
    for number in range(40):
        tags = (TagReading(7, 4 * (2 * number + 1), 0.0),) if number == 11 else ()
        told, other = new.hear(4, 4, tags=tags), at_once.cycle(4, 4, tags=tags)
        assert bool(other.accepted_tag_ids) is (number == 11)
    assert told is not None
    assert told.front_m.best == pytest.approx(other.front_m.best)
    assert told.front_m.high - told.front_m.low < 0.5
    assert told.pulses_m == pytest.approx(other.pulses_m)


def test_learning_does_not_delay_the_proof_of_standstill() -> None:
    new, at_once = Desk(learn_s=1.0), Desk(learn_s=0.0)
    for _ in range(60):
        told, other = new.hear(0, 0), at_once.cycle(0, 0)
        if told is not None:
            assert (told.standing, told.standstill) == (other.standing, other.standstill)
    assert other.standstill


def test_a_train_that_starts_while_all_first_frames_are_late_is_within_the_bounds() -> None:
    """Odometry takes the late first frames for prompt ones; they show a standing train that
    already runs."""
    errors = Errors(seed=443408, lost_share=0.375, late_share=0.5, late_s=0.25)
    history = Rig(errors).run(20.0, lambda time_s, speed_mps: 1.0)

    assert history[0].time_s < 1.5
    for moment in history:
        speed, front = moment.motion.speed_mps, moment.motion.front_m
        assert speed.low <= moment.speed_mps <= speed.high, moment
        assert front.low <= moment.front_m <= front.high, moment


def test_a_negative_learning_time_is_refused() -> None:
    with pytest.raises(ValueError, match=r"^learn_s -0\.1 is not in "):
        replace(CONFIG, learn_s=-0.1)
    assert replace(CONFIG, learn_s=0.0).learn_s == 0.0
