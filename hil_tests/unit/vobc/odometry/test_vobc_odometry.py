"""Odometry against a train that the test moves step by step with deliberately wrong sensors."""

import math
import random
from collections.abc import Callable
from dataclasses import dataclass, field, replace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from can_dbc.nodes import Direction
from can_dbc.odometer import Doppler, Tacho
from firmware_py.trackdb import LineMap, SpeedSection, Station, TagSite
from hil_tests.unit.vobc.atp.heard_rig import SILENCE
from vobc.config import load_config
from vobc.odometry import Odometry, OdometryConfig
from vobc.odometry.pulses import PulseCounter, signed_difference
from vobc.odometry.tracking import SpeedTrack
from vobc.vocabulary import Motion, OdometryRecord, TachoSample, TagReading

CONFIG = load_config("florence4")
TRAIN = CONFIG.train
AT_ONCE = replace(CONFIG.odometry, learn_s=0.0)
"""Odometry settings with which the first sample already gives a motion."""
NOMINAL_M = math.pi * 0.86 / 256.0
ANTENNA_M = 2.0
TAGS = tuple(TagSite(100 + index, 150.0 + 200.0 * index) for index in range(6))
LINE = LineMap(
    "test", -100.0, 3000.0, (Station("A", 0.0, -80.0, 5.0),), (SpeedSection(-100.0, 3000.0, 20.0),),
    tags=TAGS,
)  # fmt: skip


STEP_S = 0.005
Drive = Callable[[float, float], float]
"""Function of time and speed that returns the acceleration."""


@dataclass
class Truth:
    time_s: float
    front_m: float
    speed_mps: float
    motion: Motion


@dataclass
class Sensors:
    """Errors of the sensors."""

    error_ratio: float = 0.0
    seed: int = 1
    start_off_m: float = 0.0
    first_pulses: int = 65_000
    tag_sigma_m: float = 0.02
    latch_s: float = 0.005
    latency_s: float = 0.05
    missed: frozenset[int] = frozenset()
    false_tags: dict[int, int] = field(default_factory=dict)
    """Passed tag to the tag that the reader reports instead."""
    slip: Callable[[float], float] = lambda time_s: 1.0
    """Wheel speed divided by the true speed, as a function of time."""
    stuck_a: tuple[float, float] = (math.inf, math.inf)
    lost: Callable[[int], bool] = lambda number: False
    """Whether a tacho frame is lost on the bus."""


class OdometryRun:
    """A true train, its sensors and an odometry that receives their frames."""

    def __init__(self, sensors: Sensors, config: OdometryConfig = CONFIG.odometry) -> None:
        self.sensors = sensors
        self.rng = random.Random(sensors.seed)
        self.front_m = sensors.start_off_m
        self.speed_mps = 0.0
        self.time_s = 0.0
        self.wheel_m = 0.0
        self.m_per_pulse = NOMINAL_M / (1.0 + sensors.error_ratio)
        self.part = self.rng.random()
        self.held_a = 0
        self.samples: list[tuple[float, Tacho]] = []
        self.tags: list[tuple[float, TagReading]] = []
        self.last: Tacho | None = None
        self.heard_s = -math.inf
        self.radar: tuple[float, float] = (-math.inf, 0.0)
        self.number = 0
        self.places = {
            tag.tag_id: tag.position_m
            + ANTENNA_M
            + max(-0.05, min(0.05, self.rng.gauss(0.0, sensors.tag_sigma_m)))
            for tag in TAGS
        }
        start = OdometryRecord(0.0, config.start_bound_m, NOMINAL_M)
        self.odometry = Odometry(config, TRAIN, LINE, start)

    def pulses(self) -> int:
        return self.sensors.first_pulses + math.floor(self.wheel_m / self.m_per_pulse + self.part)

    def run(self, drive: Drive, duration_s: float) -> list[Truth]:
        history = []
        steps = round(duration_s / STEP_S)
        for step in range(1, steps + 1):
            self.move(drive)
            if step % 4 == 0:
                self.sample_tacho()
            if step % 10 == 0:
                motion = self.cycle()
                if motion is not None:
                    history.append(Truth(self.time_s, self.front_m, self.speed_mps, motion))
        return history

    def move(self, drive: Drive) -> None:
        before_m, before_pulses = self.front_m, self.pulses()
        accel_mps2 = drive(self.time_s, self.speed_mps)
        after_mps = self.speed_mps + accel_mps2 * STEP_S
        if self.speed_mps * after_mps < 0.0:
            after_mps = 0.0
        moved_m = 0.5 * (self.speed_mps + after_mps) * STEP_S
        self.speed_mps = after_mps
        self.front_m += moved_m
        self.wheel_m += moved_m * self.sensors.slip(self.time_s)
        self.time_s += STEP_S
        if int(self.time_s / 0.05) != int((self.time_s - STEP_S) / 0.05):
            quality = self.speed_mps + self.rng.gauss(0.0, 0.03)
            self.radar = (self.time_s, quality)
        self.pass_tags(before_m, before_pulses)

    def pass_tags(self, before_m: float, before_pulses: int) -> None:
        for tag_id, place_m in self.places.items():
            if before_m < place_m <= self.front_m:
                late_s = self.rng.uniform(-self.sensors.latch_s, self.sensors.latch_s)
                if tag_id in self.sensors.missed:
                    continue
                share = (place_m - before_m) / (self.front_m - before_m)
                pulses = before_pulses + (self.pulses() - before_pulses) * share
                pulses += late_s * self.speed_mps / self.m_per_pulse
                heard_id = self.sensors.false_tags.get(tag_id, tag_id)
                reading = TagReading(heard_id, math.floor(pulses) % 65536, self.time_s)
                self.tags.append((self.time_s + self.sensors.latency_s, reading))

    def sample_tacho(self) -> None:
        count = self.pulses()
        stuck_from_s, stuck_to_s = self.sensors.stuck_a
        if not stuck_from_s <= self.time_s < stuck_to_s:
            self.held_a = count
        self.number += 1
        if not self.sensors.lost(self.number):
            direction = Direction.FORWARD if self.speed_mps >= 0.0 else Direction.REVERSE
            tacho = Tacho(self.held_a % 65536, (count + 77) % 1024, direction, True, True, 0)
            self.samples.append((self.time_s, tacho))

    def cycle(self) -> Motion | None:
        if self.samples:
            self.heard_s, self.last = self.samples[-1]
        tags = tuple(
            replace(tag, age_s=self.time_s - tag.age_s)
            for due_s, tag in self.tags
            if due_s <= self.time_s
        )
        self.tags = [entry for entry in self.tags if entry[0] > self.time_s]
        radar_s, radar_mps = self.radar
        fast = abs(self.speed_mps) > 0.5
        seen = replace(
            SILENCE,
            now_ns=round(self.time_s * 1e9),
            tacho=self.last,
            tacho_age_s=self.time_s - self.heard_s,
            tacho_samples=tuple(TachoSample(t, self.time_s - at_s) for at_s, t in self.samples),
            doppler=Doppler(radar_mps, 100.0 if fast else 0.0, True),
            doppler_age_s=self.time_s - radar_s,
            tags=tags,
        )
        self.samples = []
        return self.odometry.step(seen)


def up_and_down(time_s: float, speed_mps: float) -> float:
    """Accelerate for 20 s, cruise, brake to a stop."""
    if time_s < 20.0:
        return 0.8
    if time_s < 40.0:
        return 0.0
    return -0.9 if speed_mps > 0.0 else 0.0


def on_and_on(time_s: float, speed_mps: float) -> float:
    """Accelerate for 20 s and cruise."""
    return 0.8 if time_s < 20.0 else 0.0


def assert_holds(history: list[Truth]) -> None:
    for truth in history:
        front, speed = truth.motion.front_m, truth.motion.speed_mps
        assert front.low <= truth.front_m <= front.high, truth
        assert front.low <= front.best <= front.high
        assert speed.low <= truth.speed_mps <= speed.high, truth
        assert speed.low <= speed.best <= speed.high


@settings(max_examples=25, deadline=None)
@given(
    error_ratio=st.floats(-0.01, 0.05),
    seed=st.integers(0, 10_000),
    start_off_m=st.floats(-0.5, 0.5),
    phases=st.lists(st.tuples(st.floats(2.0, 12.0), st.floats(-1.3, 1.2)), min_size=3, max_size=7),
)
def test_the_intervals_hold_the_truth_for_every_declared_error(
    error_ratio: float,
    seed: int,
    start_off_m: float,
    phases: list[tuple[float, float]],
) -> None:
    """Hypothesis samples accelerations, scale errors in the declared range, noisy tags and lost
    frames."""
    ride = OdometryRun(
        Sensors(error_ratio, seed, start_off_m, lost=lambda number: number % 11 == seed % 11)
    )

    for duration_s, accel_mps2 in phases:

        def drive(_: float, speed_mps: float, accel_mps2: float = accel_mps2) -> float:
            within = 0.0 < speed_mps < 22.0 or (speed_mps <= 0.0) == (accel_mps2 > 0.0)
            return accel_mps2 if within else 0.0

        assert_holds(ride.run(drive, duration_s))
    assert ride.odometry.rejected_tags == 0


@pytest.mark.parametrize("error_ratio", [-0.01, 0.0, 0.02, 0.05])
def test_two_tags_give_the_position_to_centimetres_and_the_wheel_to_a_tenth_of_a_percent(
    error_ratio: float,
) -> None:
    ride = OdometryRun(Sensors(error_ratio, seed=3))

    last = ride.run(up_and_down, 62.0)[-1]

    assert abs(last.motion.front_m.best - last.front_m) < 0.15
    found = ride.odometry.record().m_per_pulse
    assert found == pytest.approx(ride.m_per_pulse, rel=1e-3)


def test_uncertainty_falls_only_at_an_accepted_tag() -> None:
    """The test compares over two cycles because every second cycle has the same number of tacho
    samples."""
    history = OdometryRun(Sensors(0.03)).run(up_and_down, 40.0)

    tags = 0
    for before, between, after in zip(history, history[1:], history[2:], strict=False):
        width_before = before.motion.front_m.high - before.motion.front_m.low
        width_after = after.motion.front_m.high - after.motion.front_m.low
        tags += bool(after.motion.accepted_tag_ids)
        if not (after.motion.accepted_tag_ids or between.motion.accepted_tag_ids):
            assert width_after > width_before - 0.02
    assert tags == 2


@pytest.mark.parametrize("claimed", [100 + 1, 100 + 3, 999_999])
def test_a_tag_with_the_id_of_another_place_changes_nothing(claimed: int) -> None:
    honest = OdometryRun(Sensors(0.03, missed=frozenset({100})))
    deceived = OdometryRun(Sensors(0.03, false_tags={100: claimed}))

    expected = honest.run(up_and_down, 25.0)
    history = deceived.run(up_and_down, 25.0)

    assert deceived.odometry.rejected_tags == 1
    assert_holds(history)
    refused = [truth.motion.refused_tags for truth in history if truth.motion.refused_tags]
    assert [[tag.tag_id for tag in tags] for tags in refused] == [[claimed]]
    assert [replace(truth.motion, refused_tags=()) for truth in history] == [
        truth.motion for truth in expected
    ]


def test_a_false_tag_twenty_metres_off_is_refused() -> None:
    near = replace(TAGS[0], tag_id=77, position_m=TAGS[0].position_m + 20.0)
    line = replace(LINE, tags=(TAGS[0], near, *TAGS[1:]))
    odometry = Odometry(AT_ONCE, TRAIN, line, OdometryRecord(151.9, 0.5, NOMINAL_M))
    tacho = Tacho(0, 0, Direction.NEUTRAL, True, True, 0)
    seen = replace(SILENCE, tacho=tacho, tacho_age_s=0.0, tacho_samples=(TachoSample(tacho, 0.0),))

    refused = odometry.step(replace(seen, tags=(TagReading(77, 0, 0.01),)))
    accepted = odometry.step(replace(seen, now_ns=1, tags=(TagReading(100, 0, 0.01),)))

    assert refused is not None
    assert refused.accepted_tag_ids == ()
    assert accepted is not None
    assert accepted.accepted_tag_ids == (100,)
    assert accepted.front_m.best == pytest.approx(152.0, abs=0.06)


def test_link_latency_does_not_shift_the_position() -> None:
    quick = OdometryRun(Sensors(0.02, latch_s=0.0, latency_s=0.0)).run(up_and_down, 39.0)[-1]
    slow = OdometryRun(Sensors(0.02, latch_s=0.0, latency_s=0.4)).run(up_and_down, 39.0)[-1]

    assert slow.motion.front_m.best == pytest.approx(quick.motion.front_m.best, abs=0.02)


def test_one_missed_tag_is_tolerated_and_two_in_a_row_are_not() -> None:
    one = OdometryRun(Sensors(missed=frozenset({100}))).run(up_and_down, 35.0)
    two = OdometryRun(Sensors(missed=frozenset({100, 101}))).run(up_and_down, 35.0)

    assert all(truth.motion.localised for truth in one)
    lost = [truth for truth in two if not truth.motion.localised]
    assert lost[0].front_m > TAGS[1].position_m + ANTENNA_M
    assert_holds(two)


def test_a_train_recovers_a_lost_position_at_the_second_tag() -> None:
    history = OdometryRun(Sensors(missed=frozenset({100, 101}))).run(on_and_on, 75.0)

    lost_s = [truth.time_s for truth in history if not truth.motion.localised]
    first_m, second_m = (TAGS[index].position_m + ANTENNA_M for index in (2, 3))
    found = next(truth for truth in history if truth.time_s > lost_s[-1])
    assert lost_s[0] < next(truth.time_s for truth in history if truth.front_m > first_m)
    assert second_m < found.front_m < second_m + 3.0
    assert found.motion.accepted_tag_ids == (TAGS[3].tag_id,)
    assert all(
        truth.motion.accepted_tag_ids == () for truth in history if truth.time_s < lost_s[-1]
    )
    assert_holds(history)


def slip_between(start_s: float, end_s: float, share: float) -> Callable[[float], float]:
    """The wheels lose and regain their grip within half a second."""

    def turning(time_s: float) -> float:
        depth = min(1.0, max(0.0, time_s - start_s) / 0.5, max(0.0, end_s - time_s) / 0.5)
        return 1.0 + (share - 1.0) * depth

    return turning


@pytest.mark.parametrize(
    ("start_s", "end_s", "share"), [(22.0, 25.0, 1.2), (42.0, 46.0, 0.7), (22.0, 30.0, 1.5)]
)
def test_the_position_interval_holds_the_truth_through_slip_and_slide(
    start_s: float, end_s: float, share: float
) -> None:
    history = OdometryRun(Sensors(0.01, slip=slip_between(start_s, end_s, share))).run(
        up_and_down, 58.0
    )

    for truth in history:
        front = truth.motion.front_m
        assert front.low <= truth.front_m <= front.high, truth
    during = [t for t in history if start_s + 0.7 < t.time_s < end_s]
    assert all(truth.motion.slip for truth in during)
    assert not history[-1].motion.slip
    for truth in during:
        assert truth.motion.speed_mps.low <= truth.speed_mps <= truth.motion.speed_mps.high


def test_wheels_without_error_never_slip() -> None:
    history = OdometryRun(Sensors(0.05)).run(up_and_down, 58.0)

    assert not any(truth.motion.slip for truth in history)


def test_a_stuck_axle_is_replaced_by_the_other_one() -> None:
    history = OdometryRun(Sensors(0.01, stuck_a=(25.0, math.inf))).run(up_and_down, 40.0)

    late = [truth for truth in history if truth.time_s > 26.0]
    assert all(abs(t.motion.speed_mps.best - t.speed_mps) < 0.3 for t in late)
    assert all(truth.motion.front_m.low <= truth.front_m + 0.3 for truth in late)


def test_a_bunch_of_delayed_samples_counts_as_one_sample() -> None:
    """At 16 m/s all samples of 100 ms arrive within a millisecond."""
    ride = OdometryRun(Sensors(0.0))
    ride.run(up_and_down, 30.0)
    motions = []
    for number in range(10):
        held_up = number in (4, 5)
        for step in range(1, 11):
            ride.move(up_and_down)
            if (number * 10 + step) % 4 == 0:
                ride.sample_tacho()
        if number == 4:
            continue
        if held_up:
            count = len(ride.samples)
            ride.samples = [
                (ride.time_s - 0.0002 * (count - index), sample)
                for index, (_, sample) in enumerate(ride.samples, 1)
            ]
        motion = ride.cycle()
        assert motion is not None
        assert ride.odometry.usable
        motions.append((motion, ride.speed_mps, ride.front_m))

    for motion, speed_mps, front_m in motions:
        assert motion.speed_mps.best == pytest.approx(speed_mps, abs=0.5)
        assert motion.front_m.low <= front_m <= motion.front_m.high


def test_speed_is_quiet_and_does_not_lag() -> None:
    history = OdometryRun(Sensors(0.0, latch_s=0.0, tag_sigma_m=0.0)).run(up_and_down, 55.0)

    steady = [t for t in history if 8.0 < t.time_s < 19.5 or 30.0 < t.time_s < 39.5]
    errors = [truth.motion.speed_mps.best - truth.speed_mps for truth in steady]
    mean = sum(errors) / len(errors)
    spread = math.sqrt(sum((error - mean) ** 2 for error in errors) / len(errors))
    assert spread < 0.02
    assert abs(mean) < 0.1, "what is left is the scale before the first tag"
    braking = [t for t in history if 42.0 < t.time_s < 54.0]
    assert max(abs(t.motion.speed_mps.best - t.speed_mps) for t in braking) < 0.08
    assert max(abs(t.motion.accel_mps2 + 0.9) for t in braking) < 0.2


def stop_softly(time_s: float, speed_mps: float) -> float:
    return 0.5 if time_s < 4.0 else (-0.3 if speed_mps > 0.0 else 0.0)


def test_standing_comes_after_half_a_second_and_standstill_after_two() -> None:
    history = OdometryRun(Sensors()).run(stop_softly, 16.0)

    stopped_s = next(t.time_s for t in history if t.time_s > 5.0 and t.speed_mps == 0.0)
    standing_s = next(t.time_s for t in history if t.time_s > 5.0 and t.motion.standing)
    proven_s = next(t.time_s for t in history if t.time_s > 5.0 and t.motion.standstill)
    assert 0.2 <= standing_s - stopped_s <= 0.7
    assert 1.2 <= proven_s - stopped_s <= 2.3
    for truth in history:
        if truth.motion.standstill:
            assert truth.speed_mps < 1.0 / 3.6
        if truth.motion.standing:
            assert truth.motion.speed_mps.best == 0.0
            assert truth.motion.accel_mps2 == 0.0


def test_a_crawl_of_one_kilometre_an_hour_is_never_a_standstill() -> None:
    def crawl(_: float, speed_mps: float) -> float:
        return 0.3 if speed_mps < 1.0 / 3.6 else 0.0

    history = OdometryRun(Sensors(error_ratio=0.05)).run(crawl, 20.0)

    assert not any(truth.motion.standstill for truth in history if truth.time_s > 3.0)


def test_standstill_is_not_proven_by_silence() -> None:
    ride = OdometryRun(Sensors())
    ride.run(lambda time_s, speed_mps: 0.0, 5.0)
    ride.sensors.lost = lambda number: True

    history = ride.run(lambda time_s, speed_mps: 0.0, 3.0)

    assert [truth.motion.standstill for truth in history[:4]] == [True, True, True, False]
    assert not any(truth.motion.standstill for truth in history[3:])


def test_rolling_back_is_seen_with_its_sign() -> None:
    history = OdometryRun(Sensors(0.02)).run(lambda time_s, speed_mps: -0.3, 5.0)

    assert_holds(history)
    assert history[-1].motion.speed_mps.best == pytest.approx(-1.5, abs=0.1)
    assert history[-1].motion.travel_m == pytest.approx(-3.75, abs=0.2)
    assert history[-1].motion.pulses_m == history[-1].motion.travel_m


def test_travel_never_jumps_at_a_tag() -> None:
    history = OdometryRun(Sensors(0.05)).run(up_and_down, 40.0)

    for before, after in zip(history, history[2:], strict=False):
        step_m = after.motion.travel_m - before.motion.travel_m
        assert step_m == pytest.approx(0.05 * (before.speed_mps + after.speed_mps), abs=0.12)


def test_before_the_first_sample_there_is_no_motion() -> None:
    odometry = Odometry(CONFIG.odometry, TRAIN, LINE, OdometryRecord(0.0, 0.5, NOMINAL_M))

    assert odometry.step(SILENCE) is None
    assert not odometry.usable


def test_two_unhealthy_axles_are_no_odometer_from_the_first_sample_on() -> None:
    odometry = Odometry(AT_ONCE, TRAIN, LINE, OdometryRecord(0.0, 0.5, NOMINAL_M))
    sick = Tacho(5, 5, Direction.NEUTRAL, False, False, 0)
    well = Tacho(5, 5, Direction.NEUTRAL, True, True, 0)

    motions: list[Motion | None] = []
    for number, tacho in enumerate((sick, well, sick)):
        seen = replace(
            SILENCE,
            now_ns=number * 50_000_000,
            tacho=tacho,
            tacho_age_s=0.0,
            tacho_samples=(TachoSample(tacho, 0.0),),
        )
        motions.append(odometry.step(seen))

        assert odometry.usable is tacho.healthy_a
    first, _, last = motions
    assert first is None
    assert last is not None
    assert last.front_m.high - last.front_m.low > 2.0, "it may have been anywhere since"


# The counter of pulses.


@given(st.integers(0, 65535), st.integers(-32768, 32767))
def test_counters_wrap_both_ways(earlier: int, step: int) -> None:
    assert signed_difference((earlier + step) % 65536, earlier) == step


def tacho(a: int, b: int, *, healthy_a: bool = True, healthy_b: bool = True) -> Tacho:
    return Tacho(a % 65536, b % 1024, Direction.FORWARD, healthy_a, healthy_b, 0)


def test_a_counter_that_jumps_is_overruled_by_the_other() -> None:
    pulses = PulseCounter(4000.0)
    heard = [tacho(0, 0), tacho(20, 21), tacho(5000, 41), tacho(5020, 61)]

    steps = [(pulses.step(sample, 0.02), pulses.on_b, pulses.since_latched(10)) for sample in heard]

    assert steps == [(0, False, -10), (20, False, 10), (20, True, None), (20, False, 5010)]
    assert pulses.jumps == 1
    assert pulses.count == 60


def test_two_counters_that_jump_together_add_no_distance() -> None:
    pulses = PulseCounter(4000.0)
    pulses.step(tacho(0, 0), 0.0)

    assert pulses.step(tacho(30000, 30000), 0.02) is None
    assert pulses.count == 0


def test_an_unhealthy_axle_does_not_count() -> None:
    pulses = PulseCounter(4000.0)
    pulses.step(tacho(0, 0), 0.0)

    assert pulses.step(tacho(10, 12, healthy_a=False), 0.02) == 12
    assert pulses.step(tacho(20, 24, healthy_b=False), 0.02) == 10
    assert pulses.step(tacho(30, 36, healthy_a=False, healthy_b=False), 0.02) is None


def test_a_time_without_pulses_bounds_the_speed() -> None:
    track = SpeedTrack(bandwidth_rad_s=8.0, window_s=0.2)
    for number in range(50):
        track.add(number * 0.02, number)
    for number in range(50, 60):
        track.add(number * 0.02, 49)

    assert track.limited_rate_pulses_per_s(59 * 0.02) <= 1.0 / 0.2 + 1e-9


@given(st.floats(0.0, 1500.0), st.floats(0.0, 1.0))
def test_the_mean_rate_bounds_hold_for_any_constant_rate(rate: float, part: float) -> None:
    track = SpeedTrack(bandwidth_rad_s=8.0, window_s=0.2)
    for number in range(30):
        track.add(number * 0.02, math.floor(rate * number * 0.02 + part))

    low, high, length_s = track.mean_rate(0.001)

    assert low <= rate <= high
    assert 0.2 - 1e-9 <= length_s <= 0.22 + 1e-9


@pytest.mark.parametrize("samples", [1, 3])
def test_the_first_motion_of_a_controller_is_finite(samples: int) -> None:
    """The controller may join the bus just as a sample passes, or read several at the same
    instant."""
    ride = OdometryRun(Sensors(), AT_ONCE)
    for _ in range(samples):
        ride.sample_tacho()

    motion = ride.cycle()

    assert motion is not None
    assert math.isfinite(motion.speed_mps.low)
    assert math.isfinite(motion.speed_mps.high)
    assert motion.speed_mps.low <= -CONFIG.odometry.max_speed_mps, "nothing is known of the speed"
    assert motion.speed_mps.high >= CONFIG.odometry.max_speed_mps
    assert not motion.standstill
