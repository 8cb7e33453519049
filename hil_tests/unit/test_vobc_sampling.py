"""The odometer's clock as the controller sees it, against a sensor whose delays are known."""

from hypothesis import given
from hypothesis import strategies as st

from vobc.odometry.sampling import DRIFT_RATIO, LATE_NS, SampleClock

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

    for at_ns, hear_ns in zip(sampled_ns, heard_ns, strict=True):
        since_ns = at_ns - start_ns
        stamp_ms = int(since_ns * (1.0 + drift)) // MS % 256
        found_ns = clock.sampled_ns(hear_ns, stamp_ms)

        assert found_ns is not None
        assert found_ns <= hear_ns
        # The stamp is cut to a millisecond; the clocks part by drift and what is allowed for it.
        allowed_ns = 1.1 * MS + (abs(drift) + DRIFT_RATIO) * (hear_ns - start_ns)
        assert abs(found_ns - at_ns) <= allowed_ns


@given(st.integers(0, 255), st.integers(1, 200))
def test_a_silence_of_any_length_is_bridged(first_ms: int, periods: int) -> None:
    clock = SampleClock()
    clock.sampled_ns(0, first_ms)
    silent_ns = periods * PERIOD_NS

    found_ns = clock.sampled_ns(silent_ns + 50 * MS, (first_ms + silent_ns // MS) % 256)

    assert found_ns is not None
    assert abs(found_ns - silent_ns) <= 2 * DRIFT_RATIO * silent_ns + MS


def test_exactly_as_late_as_allowed_is_still_taken() -> None:
    for extra_ns, taken in ((0, True), (1, False)):
        clock = SampleClock()
        clock.sampled_ns(0, 0)
        # Sampled at the same instant as the first, so nothing but lateness passes.
        # Its age is counted from where the fastest frame may have drifted to by then: 20 004 ns.
        allowed_ns = LATE_NS + int(DRIFT_RATIO * (LATE_NS + 20_004))

        found_ns = clock.sampled_ns(allowed_ns + extra_ns, 0)

        assert (found_ns is not None) is taken
        assert clock.refused == (not taken)


@given(st.integers(0, 255))
def test_a_sensor_that_started_anew_is_followed_from_its_first_sample_on(new_ms: int) -> None:
    """Its clock may show anything then. It never looks older than one period."""
    clock = SampleClock()
    for number in range(5):
        clock.sampled_ns(number * PERIOD_NS, 20 * number)
    for number in range(5, 10):
        heard_ns = number * PERIOD_NS

        found_ns = clock.sampled_ns(heard_ns, (new_ms + 20 * number) % 256)

        assert found_ns is not None
        assert heard_ns - PERIOD_NS <= found_ns <= heard_ns


def test_a_faster_frame_than_ever_sets_the_clocks_closer() -> None:
    """Frames were all 30 ms late until one is not: from then on lateness is seen."""
    clock = SampleClock()
    clock.sampled_ns(30 * MS, 0)

    assert clock.sampled_ns(20 * MS + 30 * MS, 20) == 50 * MS
    assert clock.sampled_ns(40 * MS, 40) == 40 * MS
    late_ns = clock.sampled_ns(60 * MS + 30 * MS, 60)
    assert late_ns is not None
    assert abs(late_ns - 60 * MS) <= MS
