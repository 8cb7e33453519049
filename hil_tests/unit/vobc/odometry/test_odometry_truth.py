"""The intervals of position and speed hold the truth whatever one sensor does wrong."""

import math
from collections.abc import Callable
from itertools import pairwise

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hil_tests.unit.vobc.odometry import odometry_rig as rig
from hil_tests.unit.vobc.odometry.odometry_rig import TAGS, Errors, Rig

Slip = tuple[float, float, float, int]


def along(phases: list[tuple[float, float]]) -> Callable[[float, float], float]:
    """A sequence of accelerations within 0 to 20 m/s, followed by a stop."""

    def accel(time_s: float, speed_mps: float) -> float:
        for duration_s, wanted in phases:
            if time_s < duration_s:
                return 0.0 if (speed_mps > 20.0 and wanted > 0.0) else wanted
            time_s -= duration_s
        return -0.7

    def forwards(time_s: float, speed_mps: float) -> float:
        wanted = accel(time_s, speed_mps)
        return 0.0 if speed_mps <= 0.0 and wanted < 0.0 else wanted

    return forwards


def assert_true(history: list[rig.Moment]) -> None:
    for moment in history:
        front, speed = moment.motion.front_m, moment.motion.speed_mps
        assert front.low <= moment.front_m <= front.high, moment
        assert front.low <= front.best <= front.high
        assert speed.low <= moment.speed_mps <= speed.high, moment
        assert speed.low <= speed.best <= speed.high


def assert_narrows_at_tags_only(history: list[rig.Moment]) -> None:
    for before, after in pairwise(history):
        if not before.motion.speed_mps.high < 39.0:
            continue
        width_before = before.motion.front_m.high - before.motion.front_m.low
        width_after = after.motion.front_m.high - after.motion.front_m.low
        if not after.motion.accepted_tag_ids:
            assert width_after >= width_before - 1e-9, after


phases = st.lists(st.tuples(st.floats(3.0, 12.0), st.floats(-1.1, 1.1)), min_size=2, max_size=5)
honest = st.builds(
    Errors,
    seed=st.integers(0, 1 << 20),
    scale_ratio=st.floats(-0.0099, 0.0499),
    start_off_m=st.floats(-0.5, 0.5),
    radar_ratio=st.floats(-0.01, 0.01),
    imu_bias_mps2=st.floats(-0.05, 0.05),
)
slips = st.lists(
    st.tuples(
        st.floats(2.0, 35.0), st.floats(0.3, 9.0), st.floats(-1.0, 1.0), st.sampled_from([1, 2, 3])
    ).map(lambda drawn: (drawn[0], drawn[0] + drawn[1], drawn[2], drawn[3])),
    min_size=1,
    max_size=2,
)  # fmt: skip
setting_off = [(12.0, 1.0)]


@settings(max_examples=40, deadline=None)
@given(honest, phases, st.frozensets(st.sampled_from([tag.tag_id for tag in TAGS]), max_size=8))
def test_honest_sensors_and_missed_tags(
    errors: rig.Errors, way: list[tuple[float, float]], missed: frozenset[int]
) -> None:
    errors.missed = missed
    history = Rig(errors).run(50.0, along(setting_off + way))

    assert_true(history)
    assert_narrows_at_tags_only(history)
    assert not any(moment.motion.refused_tags for moment in history)
    assert not any(moment.motion.slip for moment in history)


@settings(max_examples=60, deadline=None)
@given(honest, phases, slips)
def test_slip_and_slide_of_any_axle_up_to_a_locked_wheel(
    errors: rig.Errors, way: list[tuple[float, float]], schedule: list[Slip]
) -> None:
    errors.slips = tuple(schedule)
    history = Rig(errors).run(50.0, along(setting_off + way))

    assert_true(history)
    assert_narrows_at_tags_only(history)


@settings(max_examples=30, deadline=None)
@given(
    honest, phases, st.floats(0, 0.4), st.floats(0, 0.5), st.floats(0.02, 0.3), st.floats(0, 0.3)
)  # fmt: skip
def test_lost_late_overtaken_and_doubled_frames(
    errors: rig.Errors,
    way: list[tuple[float, float]],
    lost: float,
    late: float,
    late_s: float,
    twice: float,
) -> None:
    errors.lost_share, errors.late_share = lost, late
    errors.late_s, errors.twice_share = late_s, twice

    assert_true(Rig(errors).run(40.0, along(setting_off + way)))


@settings(max_examples=20, deadline=None)
@given(honest, phases, st.floats(2.0, 30.0), st.floats(0.1, 4.0))
def test_frames_that_arrive_from_a_queue_at_once(
    errors: rig.Errors, way: list[tuple[float, float]], from_s: float, for_s: float
) -> None:
    errors.silent = (from_s, from_s + for_s)

    assert_true(Rig(errors).run(40.0, along(setting_off + way)))


@settings(max_examples=20, deadline=None)
@given(honest, phases, st.floats(2.0, 30.0), st.floats(-0.3, 0.3))
def test_a_radar_that_shows_too_much_or_too_little(
    errors: rig.Errors, way: list[tuple[float, float]], from_s: float, wrong: float
) -> None:
    errors.radar = lambda time_s, mps: mps * (1.0 + wrong) if time_s > from_s else mps

    assert_true(Rig(errors).run(45.0, along(setting_off + way)))


@settings(max_examples=20, deadline=None)
@given(honest, phases, st.floats(2.0, 30.0))
def test_a_radar_that_falls_silent(
    errors: rig.Errors, way: list[tuple[float, float]], from_s: float
) -> None:
    errors.radar = lambda time_s, mps: None if time_s > from_s else mps

    assert_true(Rig(errors).run(45.0, along(setting_off + way)))


@settings(max_examples=20, deadline=None)
@given(honest, st.floats(3.0, 40.0), st.sampled_from([tag.tag_id for tag in TAGS] + [9_999]))
def test_a_false_tag_outside_its_window_changes_only_the_report_about_it(
    errors: rig.Errors, at_s: float, tag_id: int
) -> None:
    errors.false_tags = {at_s: tag_id}
    history = Rig(errors).run(45.0, along([(12.0, 1.0), (40.0, 0.0)]))

    told = [refused for moment in history for refused in moment.motion.refused_tags]
    believed = [tag for moment in history for tag in moment.motion.accepted_tag_ids]
    # A false tag inside its window is believed, and the true one that follows is a repetition.
    accepted_s = [
        m.time_s for m in history if m.time_s >= at_s and tag_id in m.motion.accepted_tag_ids
    ]
    refused_s = [m.time_s for m in history if m.motion.refused_tags]
    if refused_s and refused_s[0] < min(accepted_s, default=math.inf):
        assert_true(history)
        assert [refused.tag_id for refused in told][:1] == [tag_id]
    assert_narrows_at_tags_only(history)
    assert len(believed) == len(set(believed))


def test_each_tag_counts_once_however_often_it_is_read() -> None:
    history = Rig(Errors(repeat_tags=True)).run(40.0, along([(12.0, 1.0), (40.0, 0.0)]))

    believed = [tag for moment in history for tag in moment.motion.accepted_tag_ids]
    reasons = {r.reason.name for moment in history for r in moment.motion.refused_tags}
    assert believed == sorted(set(believed))
    assert reasons == {"REPEATED"}
    assert_true(history)


@settings(max_examples=40, deadline=None)
@given(
    honest, phases,
    st.dictionaries(st.sampled_from([tag.tag_id for tag in TAGS]), st.floats(0.0, 0.5)),
    st.frozensets(st.sampled_from([tag.tag_id for tag in TAGS])),
)  # fmt: skip
def test_second_readings_of_tags_whose_first_telegram_may_be_lost(
    errors: rig.Errors, way: list[tuple[float, float]], again_m: dict[int, float],
    untold: frozenset[int],
) -> None:  # fmt: skip
    errors.again_m, errors.untold = again_m, untold
    history = Rig(errors).run(45.0, along(setting_off + way))

    assert_true(history)
    assert_narrows_at_tags_only(history)


@pytest.mark.parametrize("seed", [2, 9, 15, 17])
def test_a_second_reading_that_arrives_after_the_train_has_left_the_tag(seed: int) -> None:
    """Each first telegram is lost. The loss is noticed between the readings, and the second
    telegram arrives more than 1.1 m later."""
    errors = Errors(seed=seed)
    errors.again_m = {tag.tag_id: 0.49 for tag in TAGS}
    errors.untold = frozenset(errors.again_m)

    assert_true(Rig(errors).run(30.0, along([(12.0 + 0.05 * seed, 1.0), (40.0, 0.0)])))


@pytest.mark.parametrize("mps", [0.4, 2.0, 9.0, 19.0])
@pytest.mark.parametrize("scale_ratio", [-0.0099, 0.0499])
def test_the_bounds_hold_when_every_tag_is_reported_at_the_end_of_its_reach(
    mps: float, scale_ratio: float
) -> None:
    """The first telegrams are lost and the second ones come 0.5 m later; the nearest tag is 62 m
    ahead."""
    every = {tag.tag_id: 0.5 for tag in TAGS}
    errors = Errors(scale_ratio=scale_ratio, again_m=every, untold=frozenset(every))
    start_m = 62.0 - 1.5 * mps - 0.6 * mps * mps
    made = Rig(errors, front_m=start_m, believed_m=start_m)
    history = made.run(
        40.0, lambda time_s, speed_mps: 1.0 if speed_mps < mps else 0.0,
    )  # fmt: skip

    accepted = [moment for moment in history if moment.motion.accepted_tag_ids]
    assert accepted, "they still correct the place"
    for moment in accepted:
        assert moment.motion.front_m.high - moment.front_m < 1.7
    assert_true(history)


@pytest.mark.parametrize("share", [-1.0, -0.5, -0.3, 0.2, 0.5, 1.0])
@pytest.mark.parametrize("axles", [1, 2, 3])
@pytest.mark.parametrize("from_s", [3.0, 8.0, 20.0])
def test_a_step_of_slip_at_any_speed(share: float, axles: int, from_s: float) -> None:
    errors = Errors(seed=7, scale_ratio=0.01, slips=((from_s, from_s + 3.0, share, axles),))
    history = Rig(errors).run(30.0, along([(12.0, 1.0), (12.0, 0.0)]))

    assert_true(history)
    during = [m for m in history if from_s + 0.5 < m.time_s < from_s + 2.9]
    replaced = axles == 1 and share == -1.0  # Axle A stands, so B counts instead.
    if axles != 2 and from_s > 5.0 and not replaced:
        assert all(moment.motion.slip for moment in during)
        assert max(abs(m.motion.speed_mps.best - m.speed_mps) for m in during) < 0.4
    assert not math.isinf(history[-1].motion.front_m.high)
