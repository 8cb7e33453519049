"""Statistics of the gaps between frames of one message, gathered in bounded memory."""

from typing import Any, Final

import numpy as np

from canlog.frames import Ints

EXACT_BITS: Final = 12
"""Resolution of the histogram.

Distances from the period below 4096 us have a bucket each; longer ones share buckets at most 1/2048
of their value wide.
"""
HALF: Final = 1 << EXACT_BITS - 1
VALUE_BITS: Final = 40
BUCKETS: Final = HALF * (VALUE_BITS - EXACT_BITS + 2)
NS_PER_US: Final = 1000
LATE_FACTOR: Final = 1.5
"""Number of periods above which a gap has missing frames."""
EARLY_FACTOR: Final = 0.5
"""Share of a period below which a frame is one too many."""
MIDDLE_PERCENT: Final = (16, 84)
"""Percentiles whose half distance is the standard deviation of a normal distribution."""


class Gaps:
    """Cycle times of one message on one channel."""

    def __init__(self, period_ns: int, timeout_ns: int) -> None:
        """Start without frames; a period or timeout of 0 means that the DBC file gives none."""
        self.period_ns, self.timeout_ns = period_ns, timeout_ns
        self.count = 0
        """Number of gaps: one less than frames."""
        self.least_ns, self.most_ns, self.most_at_ns = 0, 0, 0
        self.missing = self.extra = self.late = self.backwards = self.stale = 0
        self.stale_ns = 0
        self.first_ns: int | None = None
        self.last_ns = 0
        self.newest_ns = 0
        """Greatest stamp so far."""
        self._sum_ns = 0
        self._below: Any = np.zeros(BUCKETS, np.int64)
        """Histogram of gaps shorter than the period, by the difference; empty without a period."""
        self._above: Any = np.zeros(BUCKETS, np.int64)

    def feed(self, at_ns: Ints) -> None:
        """Add the stamps of the next frames."""
        if not len(at_ns):
            return
        newest_ns = int(at_ns.max())
        self.newest_ns = newest_ns if self.first_ns is None else max(self.newest_ns, newest_ns)
        if self.first_ns is None:
            self.first_ns, gaps = int(at_ns[0]), np.diff(at_ns)
            at_ns = at_ns[1:]
        else:
            gaps = np.diff(at_ns, prepend=self.last_ns)
        if not len(gaps):
            self.last_ns = self.first_ns
            return
        self.last_ns = int(at_ns[-1])
        if int(gaps.min()) < 0:
            forward = gaps >= 0
            self.backwards += int(len(gaps) - forward.sum())
            gaps, at_ns = gaps[forward], at_ns[forward]
            if not len(gaps):
                return
        self._count(gaps, at_ns)

    def finish(self, end_ns: int) -> None:
        """End the log: a message that is stale at `end_ns` has been missing since its last frame.

        This gap has no second frame, so neither the mean nor a percentile counts it.
        """
        silent_ns = end_ns - self.newest_ns
        if self.first_ns is None or not self.timeout_ns or silent_ns <= self.timeout_ns:
            return
        self.stale += 1
        self.stale_ns += silent_ns - self.timeout_ns
        if silent_ns > self.most_ns:
            self.most_ns, self.most_at_ns = silent_ns, end_ns
        if self.period_ns:
            self.late += 1
            self.missing += silent_ns // self.period_ns

    def _count(self, gaps: Ints, at_ns: Ints) -> None:
        least, longest = int(gaps.min()), int(gaps.argmax())
        self.least_ns = least if not self.count else min(self.least_ns, least)
        if int(gaps[longest]) > self.most_ns:
            self.most_ns, self.most_at_ns = int(gaps[longest]), int(at_ns[longest])
        self.count += len(gaps)
        self._sum_ns += int(gaps.sum())
        off_ns = gaps - self.period_ns
        below = off_ns < 0
        for buckets, some_ns in ((self._below, -off_ns[below]), (self._above, off_ns[~below])):
            counts = np.bincount(_bucket(some_ns // NS_PER_US))
            buckets[: len(counts)] += counts
        if self.period_ns:
            late = gaps[gaps > LATE_FACTOR * self.period_ns]
            self.late += len(late)
            self.missing += int((np.rint(late / self.period_ns) - 1).sum())
            self.extra += int((gaps < EARLY_FACTOR * self.period_ns).sum())
        if self.timeout_ns and self.most_ns > self.timeout_ns:
            stale = gaps[gaps > self.timeout_ns]
            self.stale += len(stale)
            self.stale_ns += int((stale - self.timeout_ns).sum())

    @property
    def mean_ns(self) -> float:
        return self._sum_ns / self.count if self.count else 0.0

    @property
    def jitter_ns(self) -> int:
        """Half the width of the middle 68 % of the gaps.

        For normally distributed gaps this is the standard deviation. A start, a stop or a few
        missing frames do not affect it; they count as extremes, missing and extra.
        """
        low_us, high_us = (self.percentile_us(percent) for percent in MIDDLE_PERCENT)
        return (high_us - low_us) * NS_PER_US // 2

    def percentile_us(self, percent: float) -> int:
        """Upper bound for the given percentage of the gaps.

        It is too high by at most 1 us and 1/2048 of its distance from the period.
        """
        wanted = int(np.ceil(self.count * percent / 100.0))
        if not wanted:
            return 0
        period_us = self.period_ns // NS_PER_US
        shorter = np.cumsum(self._below[::-1])
        if wanted <= int(shorter[-1]):
            bucket = BUCKETS - 1 - int(np.searchsorted(shorter, wanted))
            return period_us - (_top(bucket - 1) + 1 if bucket else 0)
        bucket = int(np.searchsorted(np.cumsum(self._above), wanted - int(shorter[-1])))
        return min(period_us + _top(bucket), self.most_ns // NS_PER_US)


def _bucket(value: Ints) -> Any:
    """Bucket of a value, as in `firmware_py.histogram`: its leading bits and their position."""
    exponent = np.frexp(value.astype(np.float64))[1]
    shift = np.maximum(exponent - EXACT_BITS, 0)
    return np.minimum(shift * HALF + (value >> shift), BUCKETS - 1)


def _top(bucket: int) -> int:
    shift = max(bucket // HALF - 1, 0)
    return (bucket - shift * HALF + 1 << shift) - 1
