"""Tachos, radar, accelerometer, tag reader and supply: their readings against the truth."""

import itertools
import math
import struct
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from can_dbc.nodes import Direction
from firmware_py.tag_reader.telegram import HealthTelegram, Heard, TagTelegram, TelegramParser
from firmware_py.trackdb import TagKind, TagSite
from plant_emulator.noise import BLOCK, Gaussian, Generators, NoiseSource, Uniform
from plant_emulator.power import HighVoltageBox
from plant_emulator.sensors.inertial import Accelerometer, DopplerRadar
from plant_emulator.sensors.tacho import Tachos
from plant_emulator.sensors.tag_reader import TagReader
from plant_emulator.train_config import SensorConfig, Spread, load_train

STEP_S = 0.01
STEP_NS = 10_000_000
TRAIN = load_train("florence4")
IDEAL = load_train("florence4_ideal").sensors
PULSE_M = math.pi * 0.860 / 256.0


B_PERIOD = 1024
"""Counter B is shorter on the wire."""


def off_by(counted_b: int, wanted: float) -> float:
    """Difference between counter B and its expected value, across its wrap."""
    return abs((counted_b - wanted + B_PERIOD / 2) % B_PERIOD - B_PERIOD / 2)


def with_error(error_ratio: float) -> SensorConfig:
    return replace(IDEAL, odometer_error_ratio=Spread(error_ratio, error_ratio))


class AxleRun:
    """Axles that the test moves, with tachos and a tag reader."""

    def __init__(
        self,
        config: SensorConfig = IDEAL,
        tags: tuple[TagSite, ...] = (),
        seed: int = 1,
        start_ns: int = 0,
    ) -> None:
        generators = Generators(seed)
        self.front_m = 0.0
        self.now_ns = start_ns
        self.tachos = Tachos(config, generators, cars=4, front_m=0.0, step_s=STEP_S)
        self.reader = TagReader(config, generators, tags, front_m=0.0, start_ns=start_ns)

    def move(self, way_m: float, slip_mps: float = 0.0) -> None:
        self.front_m += way_m
        start_ns, self.now_ns = self.now_ns, self.now_ns + STEP_NS
        self.tachos.step([self.front_m] * 4, slip_mps, 0.0)
        self.reader.step(self.front_m, start_ns, self.now_ns, self.tachos)


@given(ways_m=st.lists(st.floats(-0.3, 0.4), max_size=60), error_ratio=st.floats(-0.01, 0.05))
def test_pulses_equal_the_distance_over_the_pulse_length(
    ways_m: list[float], error_ratio: float
) -> None:
    """The error is at most half a pulse, whatever the direction and the number of turns."""
    ride = AxleRun(with_error(error_ratio))
    for way_m in ways_m:
        ride.move(way_m)

    frame = ride.tachos.frame(ride.now_ns)

    wanted = ride.front_m * (1.0 + error_ratio) / PULSE_M
    counted = frame.pulses_a - 65536 if frame.pulses_a >= 32768 else frame.pulses_a
    assert abs(counted - wanted) <= 0.5 + 1e-6
    assert frame.pulses_a % B_PERIOD == frame.pulses_b % B_PERIOD


def test_the_counter_wraps_and_goes_on() -> None:
    ride = AxleRun()
    seen, total = [], 0
    before = ride.tachos.frame(0).pulses_a
    for _ in range(1000):
        ride.move(1.0)
        now = ride.tachos.frame(ride.now_ns).pulses_a
        total += (now - before) % 65536
        before = now
        seen.append(now)

    assert min(seen) >= 0
    assert max(seen) < 65536
    assert sum(later < earlier for earlier, later in itertools.pairwise(seen)) == 1
    assert total == pytest.approx(1000.0 / PULSE_M, abs=1.0)


def test_each_worn_wheel_counts_more_independently() -> None:
    tachos = tuple(
        replace(tacho, wheel_diameter_m=diameter_m)
        for tacho, diameter_m in zip(IDEAL.tachos, (0.80, 0.86), strict=True)
    )
    ride = AxleRun(replace(IDEAL, tachos=tachos))  # type: ignore[arg-type]
    ride.move(100.0)
    frame = ride.tachos.frame(ride.now_ns)
    assert frame.pulses_a == pytest.approx(100.0 * 256.0 / (math.pi * 0.80), abs=1.0)
    assert off_by(frame.pulses_b, 100.0 * 256.0 / (math.pi * 0.86)) <= 1.0


def test_only_the_slipping_axle_counts_slip() -> None:
    ride = AxleRun()
    for _ in range(100):
        ride.move(0.1, slip_mps=2.0)
    frame = ride.tachos.frame(ride.now_ns)
    assert frame.pulses_a == pytest.approx(12.0 / PULSE_M, abs=1.0)
    assert off_by(frame.pulses_b, 10.0 / PULSE_M) <= 1.0


@pytest.mark.parametrize("pulses_per_turn", [16, 100, 1024])
def test_the_resolution_of_the_tachos_is_that_of_the_consist(pulses_per_turn: int) -> None:
    run = AxleRun(replace(IDEAL, pulses_per_turn=pulses_per_turn))
    turn_m = math.pi * 0.860
    run.move(3.0 * turn_m)

    assert run.tachos.frame(STEP_NS).pulses_a == 3 * pulses_per_turn
    assert run.tachos.counted_m == pytest.approx(3.0 * turn_m)


@pytest.mark.parametrize("pulses_per_turn", [15, 1025])
def test_a_resolution_out_of_range_is_refused(pulses_per_turn: int) -> None:
    with pytest.raises(ValueError, match=f"pulses_per_turn {pulses_per_turn}"):
        replace(IDEAL, pulses_per_turn=pulses_per_turn)


def test_the_direction_follows_the_last_pulses_and_is_neutral_without_any() -> None:
    ride = AxleRun()
    ride.move(0.1)
    assert ride.tachos.frame(ride.now_ns).direction is Direction.FORWARD
    ride.move(-0.1)
    assert ride.tachos.frame(ride.now_ns).direction is Direction.REVERSE
    assert ride.tachos.frame(ride.now_ns + 199_000_000).direction is Direction.REVERSE
    assert ride.tachos.frame(ride.now_ns + 200_000_000).direction is Direction.NEUTRAL


def test_the_error_is_sampled_within_its_spread_for_each_seed() -> None:
    errors = [AxleRun(TRAIN.sensors, seed=seed).tachos.error for seed in range(300)]
    assert -0.01 <= min(errors) < -0.005
    assert 0.045 < max(errors) <= 0.05
    assert np.mean(errors) == pytest.approx(0.02, abs=0.003)


def test_the_radar_is_blind_at_low_speed_and_noisy_above() -> None:
    radar = DopplerRadar(TRAIN.sensors, Generators(1))
    slow = radar.frame(0.49)
    assert (slow.speed_mps, slow.quality_percent) == (0.0, 0.0)

    fast = [radar.frame(-15.0) for _ in range(2000)]

    speeds_mps = np.array([frame.speed_mps for frame in fast])
    assert float(np.mean(speeds_mps)) == pytest.approx(-15.0, abs=0.16)
    assert float(np.std(speeds_mps)) == pytest.approx(TRAIN.sensors.doppler_sigma_mps, rel=0.1)
    assert min(frame.quality_percent for frame in fast) > 50.0


def test_the_accelerometer_measures_a_gradient_as_acceleration() -> None:
    imu = Accelerometer(IDEAL, Generators(1), start_ns=0)
    assert imu.frame(50_000_000, 0.04, 0.0).accel_mps2 == pytest.approx(0.8)
    assert imu.frame(100_000_000, 0.04, 0.2943).accel_mps2 == pytest.approx(0.2943)
    assert imu.frame(150_000_000, 0.0, -0.2943).accel_mps2 == pytest.approx(-1.0943)


def test_the_accelerometer_has_its_bias_and_its_noise() -> None:
    config = replace(IDEAL, imu_bias_mps2=Spread(0.04, 0.04), imu_sigma_mps2=0.02)
    imu = Accelerometer(config, Generators(1), start_ns=0)
    felt = [imu.frame(50_000_000 * n, 0.0, 0.0).accel_mps2 for n in range(1, 2000)]
    assert float(np.mean(felt)) == pytest.approx(0.04, abs=0.002)
    assert float(np.std(felt)) == pytest.approx(0.02, rel=0.1)


TAG = TagSite(7, 48.0, TagKind.T1)


@given(
    tag_m=st.floats(1.0, 90.0),
    speed_mps=st.floats(0.05, 25.0),
    error_ratio=st.floats(-0.01, 0.05),
)
def test_time_and_pulses_are_those_at_the_antennas_centre(
    tag_m: float, speed_mps: float, error_ratio: float
) -> None:
    """At constant speed the truth needs no interpolation: t = (tag + 2 m) / v."""
    site = TagSite(9, tag_m, TagKind.T2)
    ride = AxleRun(with_error(error_ratio), (site,))
    steps = math.ceil((tag_m + 2.0) / (speed_mps * STEP_S)) + 1
    for _ in range(min(steps, 20_000)):
        ride.move(speed_mps * STEP_S)
    passed = ride.reader.last
    if steps > 20_000:
        return

    assert passed is not None
    assert passed.site is site
    true_s = (tag_m + 2.0) / speed_mps
    assert passed.true_ns / 1e9 == pytest.approx(true_s, abs=1e-6)
    assert passed.stamp_ns == passed.true_ns
    counted = (tag_m + 2.0) * (1.0 + error_ratio) / PULSE_M
    wrapped = (counted - passed.pulses + 32768.0) % 65536.0 - 32768.0
    assert abs(wrapped) <= 0.5 + 1e-6


def drive_over(ride: AxleRun, until_m: float, speed_mps: float = 10.0) -> list[tuple[int, Heard]]:
    """Telegrams as a parser on the line decodes them, with the instants at which they left."""
    parser = TelegramParser()
    heard: list[tuple[int, Heard]] = []
    while ride.front_m < until_m:
        ride.move(speed_mps * STEP_S)
        for telegram in ride.reader.telegrams(ride.now_ns):
            heard += [(ride.now_ns, each) for each in parser.feed(telegram)]
    return heard


def test_a_telegram_holds_tag_kind_pulses_and_its_own_age() -> None:
    ride = AxleRun(TRAIN.sensors, (TAG,), start_ns=5_000_000_000)
    heard = [
        (sent_ns, each) for sent_ns, each in drive_over(ride, 60.0) if isinstance(each, TagTelegram)
    ]
    passed = ride.reader.last
    assert passed is not None
    assert len(heard) == 1
    sent_ns, telegram = heard[0]

    assert (telegram.tag_id, telegram.kind, telegram.pulses) == (7, TagKind.T1, passed.pulses)
    assert telegram.sent_ms == pytest.approx((sent_ns - 5_000_000_000) / 1e6, abs=0.05)
    # Plus the stamp's error of up to 5 ms and the wait for the next step.
    assert 0.0 <= telegram.age_at_sending_s <= 0.05 + 0.005 + 0.01
    assert telegram.age_at_sending_s == pytest.approx(
        (sent_ns - passed.true_ns) / 1e9, abs=0.005 + 1e-4
    )
    assert passed.due_ns <= sent_ns < passed.due_ns + STEP_NS


def test_tags_are_detected_at_their_place_within_their_noise() -> None:
    tags = tuple(TagSite(n, 10.0 * n, TagKind.BALISE) for n in range(1, 401))
    ride = AxleRun(replace(IDEAL, tag_sigma_m=0.02, tag_clip_m=0.05), tags)
    errors_m = []
    while ride.front_m < 4050.0:
        before = ride.reader.tags_read
        ride.move(0.1)
        if ride.reader.tags_read > before:
            passed = ride.reader.last
            assert passed is not None
            true_m = 0.1 * passed.true_ns / STEP_NS - 2.0
            errors_m.append(true_m - passed.site.position_m)

    assert len(errors_m) == 400
    assert max(abs(error_m) for error_m in errors_m) <= 0.05 + 1e-6
    assert float(np.std(errors_m)) == pytest.approx(0.02, rel=0.12)
    assert float(np.mean(errors_m)) == pytest.approx(0.0, abs=0.004)


def test_a_tag_is_read_again_on_the_way_back() -> None:
    ride = AxleRun(IDEAL, (TAG,))
    for _ in range(600):
        ride.move(0.1)
    for _ in range(200):
        ride.move(-0.1)
    assert ride.reader.tags_read == 2
    passed = ride.reader.last
    assert passed is not None
    assert passed.pulses == pytest.approx(50.0 / PULSE_M, abs=1.0)


def test_a_train_that_stands_over_a_tag_reads_it_once() -> None:
    ride = AxleRun(IDEAL, (TAG,))
    for _ in range(501):
        ride.move(0.1)
    for _ in range(1000):
        ride.move(0.0)
    assert ride.reader.tags_read == 1


def test_two_tags_within_one_step_are_both_read_in_order() -> None:
    near = (TagSite(1, 1.00, TagKind.T3), TagSite(2, 1.02, TagKind.STOP))
    ride = AxleRun(IDEAL, near)
    ride.move(5.0)
    telegrams = b"".join(ride.reader.telegrams(ride.now_ns + 60_000_000))
    read = [each for each in TelegramParser().feed(telegrams) if isinstance(each, TagTelegram)]
    assert [each.tag_id for each in read] == [1, 2]
    assert read[0].stamp_ms <= read[1].stamp_ms


def test_telegrams_keep_their_order_whatever_their_latencies() -> None:
    tags = tuple(TagSite(n, 0.2 * n, TagKind.BALISE) for n in range(1, 201))
    ride = AxleRun(replace(TRAIN.sensors, tag_sigma_m=0.0), tags)
    heard = [each for _, each in drive_over(ride, 50.0, speed_mps=20.0)]
    ids = [each.tag_id for each in heard if isinstance(each, TagTelegram)]
    assert ids == list(range(1, 201))


def test_the_reader_sends_a_heartbeat_twice_a_second() -> None:
    ride = AxleRun(IDEAL)
    heard = drive_over(ride, 99.95)
    health = [each for _, each in heard if isinstance(each, HealthTelegram)]
    assert [each.sent_ms for each in health] == [10.0, *(500.0 * n for n in range(1, 21))]
    assert [each.sequence for each in health] == list(range(21))
    assert all(each.antenna_ok for each in health)


def test_the_health_frame_counts_the_telegrams_on_the_line() -> None:
    ride = AxleRun(IDEAL, (TAG,))
    drive_over(ride, 60.0)
    frame = ride.reader.frame(ride.now_ns)
    assert frame.telegrams_sent == 1
    assert 0.0 <= frame.self_test_age_ms <= 500.0


@given(low=st.floats(-5.0, 5.0), span=st.floats(0.0, 5.0))
def test_uniform_samples_stay_in_range_and_do_not_depend_on_blocks(low: float, span: float) -> None:
    draws = Uniform(Generators(3).of(NoiseSource.TAG_TIME), low=low, high=low + span)
    found = [draws.draw() for _ in range(2 * BLOCK + 3)]
    assert all(low <= value <= low + span for value in found)
    plain = Generators(3).of(NoiseSource.TAG_TIME).random(2 * BLOCK)
    assert found[: 2 * BLOCK] == pytest.approx(list(low + span * plain))


def test_normal_samples_are_clipped_and_not_dropped() -> None:
    draws = Gaussian(Generators(3).of(NoiseSource.TAG_PLACE), 0.02, clip=0.05)
    found = np.array([draws.draw() for _ in range(20_000)])
    assert float(np.abs(found).max()) == 0.05
    assert float(np.mean(np.abs(found) == 0.05)) == pytest.approx(0.0124, abs=0.003)


def test_a_source_does_not_depend_on_the_number_of_other_sources() -> None:
    """The oracle spawns many more children than there are sources and finds the same numbers."""
    generators = Generators(42)
    children = np.random.SeedSequence(42).spawn(100)
    for source in NoiseSource:
        expected = np.random.Generator(np.random.PCG64(children[source])).random(5)
        assert generators.of(source).random(5).tolist() == expected.tolist()


def test_no_two_sources_give_the_same_samples() -> None:
    generators = Generators(42)
    first = {struct.pack("d", generators.of(source).random()) for source in NoiseSource}
    assert len(first) == len(NoiseSource)


def box() -> HighVoltageBox:
    return HighVoltageBox(
        TRAIN.supply,
        step_s=STEP_S,
        traction_efficiency_ratio=0.88,
        electric_efficiency_ratio=0.85,
    )


@given(
    works_j=st.lists(
        st.tuples(st.floats(-20_000.0, 25_000.0), st.floats(0.0, 25_000.0)), max_size=50
    )
)
def test_the_energy_balance_closes(works_j: list[tuple[float, float]]) -> None:
    power = box()
    for drive_j, brake_j in works_j:
        power.step(drive_j, brake_j)

    net_j = power.drawn_j - power.returned_j
    assert net_j == pytest.approx(
        power.traction_j - power.braking_j + power.auxiliary_j, abs=1e-6 * (1.0 + abs(net_j))
    )
    assert power.auxiliary_j == pytest.approx(80_000.0 * STEP_S * len(works_j))
    assert power.drawn_j >= 0.0
    assert power.returned_j >= 0.0


@pytest.mark.parametrize("drive_w", [0.0, 500_000.0, 2_400_000.0])
def test_the_voltage_is_the_source_voltage_minus_the_drop_of_the_current(drive_w: float) -> None:
    power = box()
    power.step(drive_w * STEP_S, 0.0)
    drawn_w = drive_w / 0.88 + 80_000.0
    assert power.voltage_v * power.current_a == pytest.approx(drawn_w)
    assert power.voltage_v == pytest.approx(750.0 - 0.02 * power.current_a)


def test_a_train_that_feeds_back_raises_the_voltage() -> None:
    power = box()
    power.step(0.0, 1_000_000.0 * STEP_S)
    frame = power.supply()
    assert frame.line_voltage_v > 750.0
    assert frame.line_current_a < 0.0
    assert power.meter().regenerated_kwh == pytest.approx((850_000.0 - 80_000.0) * STEP_S / 3.6e6)


def test_a_train_that_rolls_against_its_effort_feeds_back() -> None:
    power = box()
    power.step(-5_000.0, 0.0)
    assert power.traction_j == 0.0
    assert power.braking_j == pytest.approx(0.85 * 5_000.0)


def test_a_resting_train_takes_the_power_of_its_auxiliaries() -> None:
    power = box()
    power.step(20_000.0, 0.0)
    before_j = power.drawn_j
    for _ in range(100):
        power.rest()
    assert power.drawn_j - before_j == pytest.approx(80_000.0)
    assert power.voltage_v * power.current_a == pytest.approx(80_000.0)


def test_effort_derates_with_the_voltage() -> None:
    power = HighVoltageBox(
        replace(TRAIN.supply, source_ohm=0.05),
        step_s=STEP_S,
        traction_efficiency_ratio=0.88,
        electric_efficiency_ratio=0.85,
    )
    power.step(2_000_000.0 * STEP_S, 0.0)
    assert 450.0 < power.voltage_v < 600.0
    assert power.effort_ratio == pytest.approx((power.voltage_v - 450.0) / 150.0)
    power.step(20_000_000.0 * STEP_S, 0.0)
    assert power.voltage_v == pytest.approx(375.0)
    assert power.effort_ratio == 0.0
