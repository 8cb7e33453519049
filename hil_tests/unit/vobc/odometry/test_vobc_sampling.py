"""The sensor clocks as the controller estimates them, against sensors with known delays."""

from dataclasses import replace

import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from can_dbc.nodes import Direction
from can_dbc.odometer import Doppler, Imu, Tacho
from vobc.odometry.sampling import (
    DRIFT_RATIO,
    LATE_NS,
    PACED_FRAMES,
    STAMP_PLAY_MS,
    FrameClock,
    OdometerClocks,
    ReaderClock,
    SampleClock,
)

MS = 1_000_000
PERIOD_NS = 20 * MS

delays_ns = st.lists(st.integers(0, LATE_NS - 2 * MS), min_size=2, max_size=300)


def in_order(sampled_ns: list[int], late_ns: list[int]) -> list[int]:
    """Arrival time of each frame; no frame overtakes the one before."""
    heard, latest_ns = [], 0
    for at_ns, delay_ns in zip(sampled_ns, late_ns, strict=True):
        latest_ns = max(latest_ns, at_ns + delay_ns)
        heard.append(latest_ns)
    return heard


@given(delays_ns, st.integers(0, 10**9), st.floats(-1e-4, 1e-4))
def test_the_time_error_is_at_most_the_fastest_delay_plus_the_drift(
    late_ns: list[int], start_ns: int, drift: float
) -> None:
    """The first frame is as fast as any, so it places later ones however late they arrive."""
    sampled_ns = [start_ns + PERIOD_NS * number for number in range(len(late_ns))]
    received_at_ns = in_order(sampled_ns, [0, *late_ns[1:]])
    clock = SampleClock()

    for number, (at_ns, hear_ns) in enumerate(zip(sampled_ns, received_at_ns, strict=True)):
        since_ns = at_ns - start_ns
        stamp_ms = int(since_ns * (1.0 + drift)) // MS % 256
        found_ns = clock.sampled_ns(hear_ns, number % 256, stamp_ms)

        assert found_ns is not None
        assert found_ns <= hear_ns
        # The stamp has a resolution of a millisecond; the clocks part by the drift and its
        # allowance.
        allowed_ns = 1.1 * MS + (abs(drift) + DRIFT_RATIO) * (hear_ns - start_ns)
        assert abs(found_ns - at_ns) <= allowed_ns


@given(st.integers(0, 255), st.integers(1, 200))
def test_a_silence_of_any_length_is_bridged(first_ms: int, periods: int) -> None:
    clock = SampleClock()
    clock.sampled_ns(0, 7, first_ms)
    silent_ns = periods * PERIOD_NS

    stamp_ms = (first_ms + silent_ns // MS) % 256
    found_ns = clock.sampled_ns(silent_ns + 50 * MS, (7 + periods) % 256, stamp_ms)

    assert found_ns is not None
    assert abs(found_ns - silent_ns) <= 2 * DRIFT_RATIO * silent_ns + MS


def test_a_frame_exactly_at_the_lateness_limit_is_accepted() -> None:
    for extra_ns, taken in ((0, True), (1, False)):
        clock = SampleClock()
        clock.sampled_ns(0, 0, 0)
        # The age counts from where the fastest frame may have drifted to by then: 24 004 ns.
        allowed_ns = PERIOD_NS + LATE_NS + int(DRIFT_RATIO * (PERIOD_NS + LATE_NS + 24_004))

        found_ns = clock.sampled_ns(allowed_ns + extra_ns, 1, 20)

        assert (found_ns is not None) is taken
        assert clock.refused == (not taken)


@given(st.integers(0, 255))
def test_a_restarted_sensor_is_timed_from_its_first_sample(new_ms: int) -> None:
    """The counter of a restarted sensor restarts too, and its clock may show anything that does
    not fit the old counter."""
    assume(min((new_ms + 100) % 256, -(new_ms + 100) % 256) > STAMP_PLAY_MS)
    clock = SampleClock()
    for number in range(5):
        clock.sampled_ns(number * PERIOD_NS, number, 20 * number)
    for number in range(5, 10):
        received_at_ns = number * PERIOD_NS

        found_ns = clock.sampled_ns(received_at_ns, number - 5, (new_ms + 20 * number) % 256)

        assert found_ns is not None
        assert received_at_ns - PERIOD_NS <= found_ns <= received_at_ns


def test_a_faster_frame_corrects_the_clock_offset() -> None:
    """All frames are 30 ms late until one is prompt; from then on the clock detects lateness."""
    clock = SampleClock()
    clock.sampled_ns(30 * MS, 0, 0)

    assert clock.sampled_ns(20 * MS + 30 * MS, 1, 20) == 50 * MS
    assert clock.sampled_ns(80 * MS, 4, 80) == 80 * MS
    late_ns = clock.sampled_ns(100 * MS + 30 * MS, 5, 100)
    assert late_ns is not None
    assert abs(late_ns - 100 * MS) <= MS


@given(st.integers(1, 200), st.integers(0, 255))
def test_the_counter_gives_the_age_of_queued_frames(waited: int, first: int) -> None:
    """All frames of a silence of up to 4 s arrive from a queue together, 0.2 ms apart."""
    clock = SampleClock()
    clock.sampled_ns(0, first, 0)
    free_ns = waited * PERIOD_NS

    for number in range(1, waited + 1):
        received_at_ns = free_ns + number * MS // 5
        found_ns = clock.sampled_ns(received_at_ns, (first + number) % 256, 20 * number % 256)

        sampled_ns = number * PERIOD_NS
        if found_ns is None:
            assert received_at_ns - sampled_ns > 0.9 * LATE_NS
        else:
            assert abs(found_ns - sampled_ns) <= 2 * DRIFT_RATIO * free_ns + MS
    assert found_ns is not None


def test_an_overtaken_frame_keeps_its_order() -> None:
    clock = SampleClock()
    found_ns = [
        clock.sampled_ns(heard * MS, number, 20 * number)
        for heard, number in ((0, 0), (20, 1), (60, 3), (82, 2), (84, 4))
    ]

    assert found_ns[:3] == [0, 20 * MS, 60 * MS]
    for found, sampled_ms in zip(found_ns[3:], (40, 80), strict=True):
        assert found is not None
        assert abs(found - sampled_ms * MS) < MS


def test_a_silence_beyond_the_counter_is_over_once_frames_come_in_step_again() -> None:
    """After 6 s a counter of 256 frames of 20 ms cannot distinguish 0.9 s from 6 s."""
    clock = SampleClock()
    clock.sampled_ns(0, 0, 0)

    queued = [clock.sampled_ns(6_000 * MS + n * MS, n, 20 * n % 256) for n in range(1, 50)]
    late_ms = 6_100
    fresh = [
        clock.sampled_ns(ms * MS, ms // 20 % 256, ms % 256)
        for ms in range(late_ms, late_ms + 20 * (PACED_FRAMES + 3), 20)
    ]

    assert queued == [None] * 49
    assert fresh[0] is None
    assert fresh[-1] is not None


def test_the_counters_give_the_age_of_radar_and_accelerometer_frames() -> None:
    clock = FrameClock(50)
    clock.sampled_ns(0, 255)

    assert clock.sampled_ns(50 * MS, 0) == 50 * MS
    assert clock.sampled_ns(2_000 * MS, 1) is None
    assert clock.refused == 1
    fresh_ns = clock.sampled_ns(2_001 * MS, 39)
    assert fresh_ns is not None
    assert abs(fresh_ns - 2_000 * MS) < MS


# Each limit, to the nanosecond.


def test_the_fastest_frame_times_the_frames_without_a_stamp() -> None:
    """The frames are 50 ms apart. The second came 7 ms late, and the drift allows 200 ppm of 57
    ms."""
    clock = FrameClock(50)
    assert clock.sampled_ns(1_000 * MS, 250) == 1_000 * MS

    assert clock.sampled_ns(1_057 * MS, 251) == 1_050 * MS + 11_400
    assert clock.sampled_ns(1_100 * MS, 252) == 1_100 * MS
    assert clock.refused == 0


@pytest.mark.parametrize(("late_ns", "taken"), [(30 * MS, True), (30 * MS + 1, False)])
def test_the_lateness_limit_of_a_clock_can_be_set(late_ns: int, *, taken: bool) -> None:
    clock = FrameClock(50, late_ns=30 * MS)
    clock.sampled_ns(0, 0)
    drift_ns = int(DRIFT_RATIO * (80 * MS + 16_003))

    assert (clock.sampled_ns(50 * MS + late_ns + drift_ns, 1) is not None) is taken
    assert clock.refused == (not taken)


def test_a_silence_up_to_a_second_before_the_turn_of_the_counter_needs_no_pacing() -> None:
    """The counter covers 256 frames of 50 ms or 12.8 s, less one second by which the first may
    have been late."""
    for silent_ns, taken in ((11_800 * MS, True), (11_850 * MS, False)):
        clock = FrameClock(50)
        clock.sampled_ns(0, 0)
        found_ns = clock.sampled_ns(silent_ns, silent_ns // (50 * MS) % 256)

        assert (found_ns is not None) is taken


def test_after_a_long_silence_five_frames_in_step_are_needed() -> None:
    clock = FrameClock(50)
    clock.sampled_ns(0, 0)
    heard = [clock.sampled_ns((20_000 + 50 * n) * MS, (400 + n) % 256) for n in range(8)]

    assert [found_ns is not None for found_ns in heard] == [False] * 5 + [True] * 3
    assert clock.refused == 5
    assert heard[-1] == 20_350 * MS


@pytest.mark.parametrize(("early_ms", "paced"), [(10, True), (11, False)])
def test_a_frame_in_step_comes_no_more_than_ten_milliseconds_early(
    early_ms: int, *, paced: bool
) -> None:
    clock = FrameClock(50)
    clock.sampled_ns(0, 0)
    clock.sampled_ns(20_050 * MS, 401 % 256)
    early = clock.sampled_ns((20_100 - early_ms) * MS, 402 % 256)
    later = [clock.sampled_ns((20_150 + 50 * n) * MS, (403 + n) % 256) for n in range(6)]

    assert early is None
    first = [found_ns is not None for found_ns in later].index(True)
    assert first == (3 if paced else 4)


@pytest.mark.parametrize("play_ms", [-6, -5, -1, 0, 5, 6])
def test_a_stamp_that_deviates_from_its_counter_by_more_than_five_means_a_new_sensor(
    play_ms: int,
) -> None:
    clock = SampleClock()
    clock.sampled_ns(0, 255, 250)
    found_ns = clock.sampled_ns(30 * MS, 0, (270 + play_ms) % 256)
    restarts = abs(play_ms) > 5

    assert clock.restarts == restarts
    assert found_ns == (30 * MS if restarts else (20 + play_ms) * MS + 6_000)


def test_a_restarted_tacho_restarts_the_clocks_of_radar_and_accelerometer() -> None:
    clocks = OdometerClocks()
    tacho = Tacho(0, 0, Direction.FORWARD, True, True, 100.0)
    radar, imu = Doppler(0.0, 0.0, True), Imu(0.0, True)
    for frame in (tacho, radar, imu):
        assert clocks.sampled_ns(frame, 0, 0) == 0
    for frame in (radar, imu):
        assert clocks.sampled_ns(frame, 300 * MS, 1) is None
    assert clocks.refused == 2
    assert clocks.sampled_ns(tacho, 310 * MS, 70) == 310 * MS
    assert clocks.refused == 0
    for frame in (radar, imu):
        assert clocks.sampled_ns(frame, 320 * MS, 1) == 320 * MS
    assert clocks.sampled_ns(replace(tacho, stamp_ms=120.0), 480 * MS, 71) is None
    assert clocks.sampled_ns(radar, 600 * MS, 2) is None
    assert clocks.sampled_ns(imu, 600 * MS, 2) is None
    assert clocks.refused == 3


def test_radar_and_accelerometer_have_clocks_of_their_own() -> None:
    clocks = OdometerClocks()
    radar, imu = Doppler(0.0, 0.0, True), Imu(0.0, True)
    clocks.sampled_ns(radar, 0, 0)
    clocks.sampled_ns(imu, 30 * MS, 9)

    assert clocks.sampled_ns(radar, 50 * MS, 1) == 50 * MS
    assert clocks.sampled_ns(imu, 80 * MS, 10) == 80 * MS


# The tag reader's clock.

READER_PERIOD_MS = 1000.0 * 3600.0
READER_PLAY_NS = 5 * MS
READER_LATE_NS = 1000 * MS


def computed_late_ns(
    clock: ReaderClock, sent_ns: int, late_ns: int, *, starts_ms: float = 0.0
) -> int:
    """Lateness that the clock computes for a telegram sent at one instant and received later."""
    sent_ms = (starts_ms + sent_ns / MS) % READER_PERIOD_MS
    return clock.late_ns(sent_ns + late_ns, sent_ms)


@given(
    st.lists(
        st.tuples(st.integers(0, 2_000 * MS), st.integers(0, READER_LATE_NS - 2 * MS)),
        min_size=1,
        max_size=100,
    ),
    st.floats(0.0, READER_PERIOD_MS, exclude_max=True),
    st.floats(-1e-4, 1e-4),
)
def test_a_delayed_telegram_counts_from_its_sending(
    steps_ns: list[tuple[int, int]], starts_ms: float, drift: float
) -> None:
    """The first telegram is as fast as any; clocks wrap around and drift."""
    sent_ns, at_ns = [0], 0
    for step_ns, _ in steps_ns:
        at_ns += step_ns
        sent_ns.append(at_ns)
    received_at_ns = in_order(sent_ns, [0, *[late_ns for _, late_ns in steps_ns]])
    assume(
        all(h - s < READER_LATE_NS - 2 * MS for s, h in zip(sent_ns, received_at_ns, strict=True))
    )
    clock = ReaderClock(READER_PERIOD_MS)

    for send_ns, hear_ns in zip(sent_ns, received_at_ns, strict=True):
        sent_ms = (starts_ms + send_ns / MS * (1.0 + drift)) % READER_PERIOD_MS
        late_ns = clock.late_ns(hear_ns, sent_ms)

        assert late_ns >= 0
        allowed_ns = READER_PLAY_NS + MS + (abs(drift) + DRIFT_RATIO) * hear_ns
        assert abs(hear_ns - late_ns - send_ns) <= allowed_ns


def test_a_delayed_first_telegram_is_corrected_by_a_prompt_one() -> None:
    clock = ReaderClock(READER_PERIOD_MS)

    assert computed_late_ns(clock, 0, 80 * MS) == 0
    assert computed_late_ns(clock, 500 * MS, 80 * MS) == 0
    assert computed_late_ns(clock, 1000 * MS, 10 * MS) == 0
    assert computed_late_ns(clock, 1500 * MS, 80 * MS) == pytest.approx(70 * MS, abs=0.2 * MS)


@pytest.mark.parametrize(
    ("late_ns", "said_ns", "again_ns"),
    [
        (READER_PLAY_NS, 0, 0),
        (READER_PLAY_NS + 1, READER_PLAY_NS + 1, 0),
        (READER_LATE_NS, READER_LATE_NS, READER_LATE_NS),
        (READER_LATE_NS + 1, 0, 0),
    ],
)
def test_lateness_up_to_the_limit_counts_and_beyond_it_the_clock_restarts(
    late_ns: int, said_ns: int, again_ns: int
) -> None:
    """The reader's clock gives both telegrams the same stamp; the test allows for its drift."""
    clock = ReaderClock(READER_PERIOD_MS)
    clock.late_ns(0, 7.0)
    received_at_ns = late_ns
    while received_at_ns - int(DRIFT_RATIO * received_at_ns) < late_ns:
        received_at_ns += 1

    assert clock.late_ns(received_at_ns, 7.0) == said_ns
    # After a restart that telegram becomes the reference for the next one.
    assert clock.late_ns(received_at_ns + 300 * MS, 307.0) == pytest.approx(again_ns, abs=0.1 * MS)


@pytest.mark.parametrize("early_ms", [1.0, 999.0, 5000.0, READER_PERIOD_MS - 20.0])
def test_a_telegram_that_comes_too_early_becomes_the_reference(early_ms: float) -> None:
    """The first telegram was late, or the reader restarted."""
    clock = ReaderClock(READER_PERIOD_MS)
    clock.late_ns(2000 * MS, 7.0)

    assert clock.late_ns(2000 * MS, (7.0 + early_ms) % READER_PERIOD_MS) == 0
    late_ns = clock.late_ns(2020 * MS, (7.0 + early_ms) % READER_PERIOD_MS)
    assert late_ns == pytest.approx(20 * MS, abs=MS)


def test_the_clock_learns_again_after_the_boards_clock_was_set_back() -> None:
    clock = ReaderClock(READER_PERIOD_MS)
    clock.late_ns(900 * MS, 100.0)

    assert clock.late_ns(899 * MS, 600.0) == 0
    assert clock.late_ns(1429 * MS, 1100.0) == pytest.approx(30 * MS, abs=MS)


def test_the_readers_clock_wraps_around() -> None:
    clock = ReaderClock(READER_PERIOD_MS)
    starts_ms = READER_PERIOD_MS - 100.0

    assert computed_late_ns(clock, 0, 0, starts_ms=starts_ms) == 0
    assert computed_late_ns(clock, 500 * MS, 60 * MS, starts_ms=starts_ms) == pytest.approx(
        60 * MS, abs=MS
    )
