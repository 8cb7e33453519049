"""Single steps of the odometer by hand calculation: its position, speed and standstill."""

import math
from dataclasses import replace

import pytest

from can_dbc.nodes import Direction
from can_dbc.odometer import Doppler, Imu, Tacho
from firmware_py.trackdb import LineMap, SpeedSection, Station, TagSite
from hil_tests.unit.vobc.atp.heard_rig import SILENCE
from vobc.config import load_config
from vobc.odometry import Odometry
from vobc.vocabulary import (
    NEVER_S,
    Interval,
    Motion,
    OdometryRecord,
    PlaceProof,
    RefusedTag,
    TachoSample,
    TagReading,
    TagRefusal,
)

BASE = load_config("florence4")
CONFIG = replace(
    BASE.odometry,
    scale_error_low_ratio=-0.01,
    scale_error_high_ratio=0.05,
    start_bound_m=0.5,
    tag_bound_m=0.06,
    tag_stamp_s=0.006,
    window_s=0.2,
    stamp_jitter_s=0.001,
    learn_s=0.0,
    max_accel_mps2=1.7,
    max_speed_mps=40.0,
    standing_s=0.5,
    silence_s=0.15,
    zero_speed_mps=1.0 / 3.6,
    zero_speed_s=2.0,
    ground_slack_m=0.03,
)
TRAIN = replace(
    BASE.train, wheel_diameter_m=2.56 / math.pi, pulses_per_turn=256, antenna_offset_m=2.0
)
LEAST_M, MOST_M = 0.01 / 1.05, 0.01 / 0.99
TAGS = (TagSite(7, 60.0), TagSite(8, 90.0))
LINE = LineMap(
    "flat", -100.0, 900.0, (Station("A", 0.0, -80.0, 5.0),), (SpeedSection(-100.0, 900.0, 20.0),),
    tags=TAGS,
)  # fmt: skip
CYCLE_NS = 40_000_000


class OdometerRig:
    """An odometer with a cycle every 40 ms and two tacho samples in each, the later one 4 ms
    old."""

    def __init__(self, front_m: float = 10.0, proof: PlaceProof = PlaceProof.SET_UP) -> None:
        record = OdometryRecord(front_m, 0.5, 0.01, proof)
        self.odometry = Odometry(CONFIG, TRAIN, LINE, record)
        self.cycles = 0
        self.pulses = 0

    def cycle(
        self,
        step: int = 0,
        *,
        tags: tuple[TagReading, ...] = (),
        radar_mps: float | None = None,
        felt_mps2: float | None = None,
        way: Direction = Direction.FORWARD,
        age_s: float = 0.004,
        silent: bool = False,
    ) -> Motion:
        """Args: step: pulses in each sample."""
        samples = []
        for ago_s in () if silent else (age_s + 0.02, age_s):
            self.pulses += step
            tacho = Tacho(self.pulses % 65536, self.pulses % 1024, way, True, True, 0.0)
            samples.append(TachoSample(tacho, ago_s))
        self.cycles += 1
        radar = None if radar_mps is None else Doppler(radar_mps, 99.0, True)
        imu = None if felt_mps2 is None else Imu(felt_mps2, True)
        motion = self.odometry.step(
            replace(
                SILENCE,
                now_ns=self.cycles * CYCLE_NS,
                tacho=samples[-1].frame if samples else None,
                tacho_age_s=NEVER_S if silent else age_s,
                tacho_samples=tuple(samples),
                doppler=radar,
                doppler_age_s=NEVER_S if radar is None else 0.0,
                imu=imu,
                imu_age_s=NEVER_S if imu is None else 0.0,
                tags=tags,
            )
        )
        assert motion is not None
        return motion

    def cruise(self, cycles: int, step: int = 20, **heard: float) -> Motion:
        motion = self.cycle(step, **heard)  # type: ignore[arg-type]
        for _ in range(cycles - 1):
            motion = self.cycle(step, **heard)  # type: ignore[arg-type]
        return motion


def ends(interval: Interval) -> tuple[float, float]:
    return interval.low, interval.high


def near(low: float, high: float) -> tuple[object, object]:
    return pytest.approx(low, abs=1e-9), pytest.approx(high, abs=1e-9)


@pytest.mark.parametrize("sign", [1, -1])
def test_a_full_window_of_pulses_bounds_the_speed(sign: int) -> None:
    """There are 20 pulses in each 20 ms over 0.2 s. The bound allows for one pulse, 1 ms and 1.7
    m/s² over half the window.

    The last sample is 4 ms old.
    """
    bench = OdometerRig()
    way = Direction.FORWARD if sign > 0 else Direction.REVERSE
    for _ in range(6):
        motion = bench.cycle(sign * 20, way=way)
    change_mps = 1.7 * (0.1 + 0.001 + 0.004)

    slow, fast = 199 / 0.201 * LEAST_M - change_mps, 201 / 0.199 * MOST_M + change_mps
    assert ends(motion.speed_mps) == near(*sorted((sign * slow, sign * fast)))
    assert not motion.slip
    assert bench.odometry.usable


def test_the_position_is_the_start_plus_the_distance_of_the_pulses() -> None:
    """The position is known within 0.5 m and a pulse. The last sample, 220 pulses after the
    first, is 4 ms old."""
    bench = OdometerRig()
    motion = bench.cruise(6)
    speed = motion.speed_mps
    low_m = 10.0 - 0.5 - MOST_M + 220 * LEAST_M + speed.low * 0.003
    high_m = 10.0 + 0.5 + MOST_M + 220 * MOST_M + speed.high * 0.005

    assert ends(motion.front_m) == near(low_m - 0.03, high_m + 0.03)
    assert motion.travel_m == pytest.approx(2.2)
    assert motion.wheel_diameter_m == pytest.approx(2.56 / math.pi)
    assert (motion.missed_tags, motion.lost_cause, motion.localised) == (0, "", True)


def test_a_backward_movement_is_measured_too() -> None:
    bench = OdometerRig()
    for _ in range(6):
        motion = bench.cycle(-20, way=Direction.REVERSE)
    speed = motion.speed_mps
    low_m = 10.0 - 0.5 - MOST_M - 220 * MOST_M + speed.low * 0.005
    high_m = 10.0 + 0.5 + MOST_M - 220 * LEAST_M + speed.high * 0.003

    assert ends(motion.front_m) == near(low_m - 0.03, high_m + 0.03)


def test_a_silent_tacho_widens_position_and_speed_by_the_possible_motion() -> None:
    """The last sample is 0.204 s old; beyond 0.1 s it is unknown how long the train ran on."""
    bench = OdometerRig()
    bench.cruise(30)
    for _ in range(5):
        motion = bench.cycle(silent=True)
    age_s = 0.204
    speed = motion.speed_mps

    assert speed.low <= 199 / 0.201 * LEAST_M - 1.7 * (0.101 + age_s) + 1e-9
    assert speed.high >= 201 / 0.199 * MOST_M + 1.7 * (0.101 + age_s) - 1e-9
    assert motion.front_m.low <= 10.0 - 0.5 - MOST_M + 1180 * LEAST_M
    assert motion.front_m.high >= 10.5 + MOST_M + 1180 * MOST_M + speed.high * (age_s + 0.001)
    assert not motion.standstill


def test_a_bunch_of_samples_counts_once_by_its_last() -> None:
    """Two delayed samples arrive 7 ms apart; their 10 pulses are no jump although they seem to
    come in 7 ms."""
    bench = OdometerRig()
    bench.cruise(10)
    tachos = [Tacho(p % 65536, p % 1024, Direction.FORWARD, True, True, 0.0) for p in (500, 520)]
    for apart_s, jumps in ((0.0079, 0), (0.008, 0)):
        odometry = OdometerRig().odometry
        seen = replace(
            SILENCE, now_ns=0, tacho=tachos[1], tacho_age_s=0.0,
            tacho_samples=(TachoSample(tachos[0], apart_s), TachoSample(tachos[1], 0.0)),
        )  # fmt: skip
        motion = odometry.step(seen)
        assert motion is not None
        assert motion.travel_m == pytest.approx(0.2 if apart_s >= 0.008 else 0.0)
        assert odometry.rejected_tags == jumps


# Tags.


def at_tag(bench: OdometerRig, tag: int, *, since: int, age_s: float) -> TagReading:
    """A reading `since` pulses before the last sample of the next cycle, which has 40 pulses."""
    return TagReading(tag, (bench.pulses + 40 - since) % 65536, age_s)


def test_an_accepted_tag_narrows_the_position_to_its_bound_and_the_pulses_since() -> None:
    """The front is at 62 m; at 10 m/s, tag and instant are known within 0.06 m + 6 ms and a
    pulse."""
    bench = OdometerRig(front_m=2.0)
    bench.cruise(149, radar_mps=10.0)
    motion = bench.cycle(20, radar_mps=10.0, tags=(at_tag(bench, 7, since=30, age_s=0.034),))
    ground = motion.speed_mps

    assert motion.accepted_tag_ids == (7,)
    assert motion.refused_tags == ()
    assert motion.front_m.best == pytest.approx(62.34, abs=0.05)
    rate_mps = 10.0
    bound_m = 0.06 + 0.006 * rate_mps + MOST_M
    low_m = 62.0 + 30 * LEAST_M - bound_m + ground.low * 0.003
    high_m = 62.0 + 30 * MOST_M + bound_m + ground.high * 0.005
    assert motion.front_m.low <= low_m + 2e-3
    assert motion.front_m.high >= high_m - 2e-3
    assert motion.front_m.high - motion.front_m.low < 2 * bound_m + 0.15
    assert bench.odometry.rejected_tags == 0


@pytest.mark.parametrize(
    ("tag_id", "reason"), [(99, TagRefusal.UNKNOWN), (8, TagRefusal.OUTSIDE_WINDOW)]
)
def test_a_refused_tag_changes_only_the_report_about_it(tag_id: int, reason: TagRefusal) -> None:
    told, silent = OdometerRig(front_m=52.0), OdometerRig(front_m=52.0)
    for bench in (told, silent):
        bench.cruise(24, radar_mps=10.0)
    for cycle in range(20):
        tags = (at_tag(told, tag_id, since=30, age_s=0.034),) if cycle % 5 == 0 else ()
        with_tag, without = told.cycle(20, tags=tags), silent.cycle(20)

        assert replace(with_tag, refused_tags=()) == without
        assert [refused.reason for refused in with_tag.refused_tags] == [reason] * len(tags)
    assert told.odometry.rejected_tags == 4
    assert told.odometry.record() == silent.odometry.record()


def test_a_tag_that_is_read_again_narrows_nothing() -> None:
    told, silent = OdometerRig(front_m=52.0), OdometerRig(front_m=52.0)
    for bench in (told, silent):
        bench.cruise(24, radar_mps=10.0)
        bench.cycle(20, radar_mps=10.0, tags=(at_tag(bench, 7, since=30, age_s=0.034),))
    for cycle in range(20):
        tags = (at_tag(told, 7, since=10, age_s=0.014),) if cycle == 3 else ()
        with_tag, without = told.cycle(20, tags=tags), silent.cycle(20)

        assert replace(with_tag, refused_tags=()) == without
        assert [refused.reason for refused in with_tag.refused_tags] == [
            TagRefusal.REPEATED for _ in tags
        ]


def test_an_unknown_tag_is_reported_as_unknown() -> None:
    motion = OdometerRig().cycle(20, tags=(TagReading(99, 0, 0.03),))

    assert motion.refused_tags == (RefusedTag(99, TagRefusal.UNKNOWN, 0.0),)


# Standstill.


def test_a_train_stands_after_half_a_second_and_is_proven_to_after_two() -> None:
    bench = OdometerRig()
    told = [bench.cycle(0) for _ in range(60)]

    standing = [motion.standing for motion in told].index(True)
    proven = [motion.standstill for motion in told].index(True)
    assert all(motion.standing for motion in told[standing:])
    assert all(motion.standstill for motion in told[proven:])
    # Counted in sample time from the first sample at 16 ms, the train stands from 516 ms on.
    assert (standing + 1) * 40 - 4 - 16 == 500
    assert (proven + 1) * 40 >= 2_000
    assert told[-1].speed_mps.best == 0.0
    assert told[-1].accel_mps2 == 0.0


@pytest.mark.parametrize(("age_s", "proven"), [(0.15, True), (0.151, False)])
def test_a_tacho_that_is_silent_for_too_long_proves_no_standstill(
    age_s: float, *, proven: bool
) -> None:
    bench = OdometerRig()
    for _ in range(70):
        motion = bench.cycle(0)
    assert motion.standstill
    seen = replace(SILENCE, now_ns=71 * CYCLE_NS, tacho_age_s=age_s)
    after = bench.odometry.step(seen)

    assert after is not None
    assert after.standstill is proven


def test_the_stored_position_covers_both_ends_of_both_intervals() -> None:
    bench = OdometerRig(front_m=10.0)
    record = bench.odometry.record()
    assert record.front_m == 10.0
    assert record.bound_m == pytest.approx(0.5 + MOST_M + 0.03)
    assert record.m_per_pulse == 0.01
    assert record.proof is PlaceProof.REMEMBERED
    assert OdometerRig(proof=PlaceProof.UNKNOWN).odometry.record().proof is PlaceProof.UNKNOWN


# Contradictions.


def test_pulses_against_their_direction_count_in_both_directions() -> None:
    """From the third pulse on, the train may have run as far in the other direction."""
    bench = OdometerRig()
    for _ in range(6):
        motion = bench.cycle(20, way=Direction.REVERSE)

    assert not bench.odometry.usable
    assert motion.speed_mps.low <= -motion.speed_mps.high + 1e-9
    assert motion.front_m.low <= 9.5 - MOST_M + 220 * LEAST_M - 440 * MOST_M
    assert motion.front_m.low >= 9.5 - 2 * 440 * MOST_M
    assert motion.front_m.high >= 10.5 + 220 * MOST_M
    assert motion.front_m.high <= 12.9


def test_two_unhealthy_tachos_widen_the_position_by_the_greatest_possible_distance() -> None:
    bench = OdometerRig()
    before = bench.cruise(30)
    tacho = Tacho(0, 0, Direction.FORWARD, False, False, 0.0)
    after = bench.odometry.step(
        replace(
            SILENCE, now_ns=31 * CYCLE_NS, tacho=tacho, tacho_age_s=0.004,
            tacho_samples=(TachoSample(tacho, 0.004),),
        )
    )  # fmt: skip

    assert after is not None
    assert not bench.odometry.usable
    width_m = before.front_m.high - before.front_m.low
    assert after.front_m.high - after.front_m.low == pytest.approx(width_m + 2 * 1.6, abs=0.3)
