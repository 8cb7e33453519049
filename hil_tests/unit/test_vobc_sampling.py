"""The odometer's clock as the controller sees it, against a sensor whose delays are known."""

from hypothesis import assume, given
from hypothesis import strategies as st

from vobc.odometry.sampling import (
    DRIFT_RATIO,
    LATE_NS,
    PACED_FRAMES,
    STAMP_PLAY_MS,
    FrameClock,
    SampleClock,
)

MS = 1_000_000
PERIOD_NS = 20 * MS

delays_ns = st.lists(st.integers(0, LATE_NS - 2 * MS), min_size=2, max_size=300)


def in_order(sampled_ns: list[int], late_ns: list[int]) -> list[int]:
    """When each frame is heard: no frame overtakes the one before."""
    heard, latest_ns = [], 0
    for at_ns, delay_ns in zip(sampled_ns, late_ns, strict=True):
        latest_ns = max(latest_ns, at_ns + delay_ns)
        heard.append(latest_ns)
    return heard


@given(delays_ns, st.integers(0, 10**9), st.floats(-1e-4, 1e-4))
def test_the_instant_is_off_by_no_more_than_the_fastest_frame_and_the_drift(
    late_ns: list[int], start_ns: int, drift: float
) -> None:
    """The first frame is as fast as any, so later ones are placed by it, however late they come."""
    sampled_ns = [start_ns + PERIOD_NS * number for number in range(len(late_ns))]
    heard_ns = in_order(sampled_ns, [0, *late_ns[1:]])
    clock = SampleClock()

    for number, (at_ns, hear_ns) in enumerate(zip(sampled_ns, heard_ns, strict=True)):
        since_ns = at_ns - start_ns
        stamp_ms = int(since_ns * (1.0 + drift)) // MS % 256
        found_ns = clock.sampled_ns(hear_ns, number % 256, stamp_ms)

        assert found_ns is not None
        assert found_ns <= hear_ns
        # The stamp is cut to a millisecond; the clocks part by drift and what is allowed for it.
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


def test_exactly_as_late_as_allowed_is_still_taken() -> None:
    for extra_ns, taken in ((0, True), (1, False)):
        clock = SampleClock()
        clock.sampled_ns(0, 0, 0)
        # Its age is counted from where the fastest frame may have drifted to by then: 24 004 ns.
        allowed_ns = PERIOD_NS + LATE_NS + int(DRIFT_RATIO * (PERIOD_NS + LATE_NS + 24_004))

        found_ns = clock.sampled_ns(allowed_ns + extra_ns, 1, 20)

        assert (found_ns is not None) is taken
        assert clock.refused == (not taken)


@given(st.integers(0, 255))
def test_a_sensor_that_started_anew_is_followed_from_its_first_sample_on(new_ms: int) -> None:
    """Its counter begins anew, and its clock may show anything but what fits the old counter."""
    assume(min((new_ms + 100) % 256, -(new_ms + 100) % 256) > STAMP_PLAY_MS)
    clock = SampleClock()
    for number in range(5):
        clock.sampled_ns(number * PERIOD_NS, number, 20 * number)
    for number in range(5, 10):
        heard_ns = number * PERIOD_NS

        found_ns = clock.sampled_ns(heard_ns, number - 5, (new_ms + 20 * number) % 256)

        assert found_ns is not None
        assert heard_ns - PERIOD_NS <= found_ns <= heard_ns


def test_a_faster_frame_than_ever_sets_the_clocks_closer() -> None:
    """Frames were all 30 ms late until one is not: from then on lateness is seen."""
    clock = SampleClock()
    clock.sampled_ns(30 * MS, 0, 0)

    assert clock.sampled_ns(20 * MS + 30 * MS, 1, 20) == 50 * MS
    assert clock.sampled_ns(40 * MS, 2, 40) == 40 * MS
    late_ns = clock.sampled_ns(60 * MS + 30 * MS, 3, 60)
    assert late_ns is not None
    assert abs(late_ns - 60 * MS) <= MS


@given(st.integers(1, 200), st.integers(0, 255))
def test_what_waited_in_a_mailbox_is_as_old_as_its_counter_says(waited: int, first: int) -> None:
    """All frames of a silence of up to 4 s come out of a queue together, 0.2 ms apart."""
    clock = SampleClock()
    clock.sampled_ns(0, first, 0)
    free_ns = waited * PERIOD_NS

    for number in range(1, waited + 1):
        heard_ns = free_ns + number * MS // 5
        found_ns = clock.sampled_ns(heard_ns, (first + number) % 256, 20 * number % 256)

        sampled_ns = number * PERIOD_NS
        if found_ns is None:
            assert heard_ns - sampled_ns > 0.9 * LATE_NS
        else:
            assert abs(found_ns - sampled_ns) <= 2 * DRIFT_RATIO * free_ns + MS
    assert found_ns is not None


def test_a_frame_that_was_overtaken_keeps_its_place() -> None:
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
    """6 s later a counter of 256 frames of 20 ms cannot tell 0.9 s from 6 s."""
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


def test_radar_and_accelerometer_are_as_old_as_their_counters_say() -> None:
    clock = FrameClock(50)
    clock.sampled_ns(0, 255)

    assert clock.sampled_ns(50 * MS, 0) == 50 * MS
    assert clock.sampled_ns(2_000 * MS, 1) is None
    assert clock.refused == 1
    fresh_ns = clock.sampled_ns(2_001 * MS, 39)
    assert fresh_ns is not None
    assert abs(fresh_ns - 2_000 * MS) < MS
