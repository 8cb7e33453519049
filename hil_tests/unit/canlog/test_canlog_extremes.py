"""Down-sampled pictures keep everything that is visible in all samples."""

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given
from hypothesis import strategies as st

from canlog.views import extremes
from canlog.views.extremes import Pyramid, kept
from canlog.views.traces import SignalTrace

samples = st.lists(
    st.tuples(st.integers(0, 40), st.floats(-1e6, 1e6) | st.just(float("nan"))),
    min_size=1,
    max_size=300,
)


def columns_of(
    drawn: list[tuple[int, float]],
) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.float64]]:
    steps, values = zip(*drawn, strict=True)
    return np.cumsum(np.array(steps, np.int64)), np.array(values, np.float64)


@given(samples, st.integers(1, 12), st.integers(0, 3000), st.integers(0, 3000))
def test_each_column_keeps_first_least_greatest_and_last(
    drawn: list[tuple[int, float]], columns: int, one_ns: int, other_ns: int
) -> None:
    at_ns, values = columns_of(drawn)
    start_ns, end_ns = sorted((one_ns, other_ns))

    rows = set(kept(at_ns, values, start_ns=start_ns, end_ns=end_ns, columns=columns).tolist())

    edges = [start_ns + (end_ns - start_ns) * each // columns for each in range(columns)]
    inside = [row for row, at in enumerate(at_ns) if start_ns <= at <= end_ns]
    for number, low_ns in enumerate(edges):
        high_ns = edges[number + 1] if number + 1 < columns else end_ns + 1
        mine = [row for row in inside if low_ns <= at_ns[row] < high_ns]
        if not mine:
            continue
        assert {mine[0], mine[-1]} <= rows
        finite = [values[row] for row in mine if not np.isnan(values[row])]
        shown = [values[row] for row in mine if row in rows and not np.isnan(values[row])]
        if finite:
            assert (min(shown), max(shown)) == (min(finite), max(finite))


@given(samples, st.integers(1, 12))
def test_the_neighbours_outside_of_a_span_are_kept(
    drawn: list[tuple[int, float]], columns: int
) -> None:
    at_ns, values = columns_of(drawn)
    middle = len(at_ns) // 2
    span_ns = int(at_ns[middle]), int(at_ns[-1]) // 2 + int(at_ns[middle]) // 2 + 1

    rows = kept(at_ns, values, start_ns=span_ns[0], end_ns=span_ns[1], columns=columns)

    before = [row for row, at in enumerate(at_ns) if at < span_ns[0]]
    after = [row for row, at in enumerate(at_ns) if at > span_ns[1]]
    assert not before or before[-1] in rows
    assert not after or after[0] in rows


@pytest.mark.parametrize("at_once", [0, 1 << 20], ids=["by_blocks", "at_once"])
def test_a_window_has_the_extremes_of_every_column(
    at_once: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Blocks of four samples give a short trace several levels."""
    monkeypatch.setattr(extremes, "BLOCK", 4)
    monkeypatch.setattr(extremes, "AT_ONCE", at_once)
    noise = np.random.default_rng(5)
    for _ in range(40):
        count = int(noise.integers(50, 900))
        at_ns = np.cumsum(noise.integers(0, 9, count)) + 1_000
        values = noise.normal(0, 10, count)
        start_ns, end_ns = sorted(noise.uniform(900, at_ns[-1] + 100, 2).tolist())
        columns = int(noise.integers(1, 15))

        window = Pyramid(SignalTrace("x", "", at_ns, values), zero_ns=0).window(
            start_ns, end_ns, columns
        )

        width_ns = (end_ns - start_ns) / columns
        shown = list(zip(window.at_ns.tolist(), window.values.tolist(), strict=True))
        for number in range(columns):
            low_ns, high_ns = start_ns + number * width_ns, start_ns + (number + 1) * width_ns
            mine = values[(at_ns >= low_ns + 1e-6) & (at_ns < high_ns - 1e-6)]
            seen = [value for at, value in shown if low_ns - 1e-6 <= at <= high_ns + 1e-6]
            if len(mine):
                assert min(seen) <= mine.min()
                assert max(seen) >= mine.max()
        assert {value for _, value in shown} <= set(values.tolist())
        assert all(np.diff(window.at_ns) >= 0)


def test_silence_breaks_the_picture_wherever_one_looks_from() -> None:
    """Ten thousand samples are a millisecond apart, with one second missing in the middle."""
    at_ns = np.arange(10_000, dtype=np.int64) * 1_000_000
    at_ns[5_000:] += 1_000_000_000
    pyramid = Pyramid(SignalTrace("x", "", at_ns, np.ones(10_000), gap_ns=50_000_000), zero_ns=0)

    for columns in (10, 100, 1_000, 5_000):
        far = pyramid.window(0, 1.2e10, columns)
        breaks = np.flatnonzero(np.isnan(far.values))
        assert len(breaks) == 1
        assert 4_999_000_000 <= far.at_ns[breaks[0]] <= 5_999_000_000
    assert not np.isnan(pyramid.window(6.5e9, 7e9, 100).values).any()
