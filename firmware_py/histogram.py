"""A histogram of whole numbers in bounded memory, for percentiles over hours."""

import math
from typing import Final

EXACT_BITS: Final = 7
"""Below 2**7 every value has a bucket of its own."""
HALF: Final = 1 << (EXACT_BITS - 1)
VALUE_BITS: Final = 40
"""Larger values share the last bucket; the maximum stays exact."""
LAST_BUCKET: Final = HALF * (VALUE_BITS - EXACT_BITS + 2) - 1


class Histogram:
    """Counts whole numbers of zero or more.

    Small values are kept exactly, larger ones in buckets at most 1/64 of their value wide.
    """

    __slots__ = ("_buckets", "count", "max")

    def __init__(self) -> None:
        self._buckets: dict[int, int] = {}
        self.count = 0
        self.max = 0

    def add(self, value: int) -> None:
        assert value >= 0
        bucket = _bucket(value)
        self._buckets[bucket] = self._buckets.get(bucket, 0) + 1
        self.count += 1
        if value > self.max:
            self.max = value

    def percentile(self, percent: float) -> int:
        """The value that at least `percent` of all values do not exceed, as the top of its bucket.

        Never understated and at most 1/64 overstated; 0 without values.
        """
        assert 0.0 < percent <= 100.0
        wanted = math.ceil(self.count * percent / 100.0)
        seen = 0
        for bucket in sorted(self._buckets):
            seen += self._buckets[bucket]
            if seen >= wanted:
                return self.max if bucket == LAST_BUCKET else min(_top(bucket), self.max)
        return 0


def _bucket(value: int) -> int:
    shift = value.bit_length() - EXACT_BITS
    if shift <= 0:
        return value
    return min(shift * HALF + (value >> shift), LAST_BUCKET)


def _top(bucket: int) -> int:
    """The largest value of a bucket."""
    shift = bucket // HALF - 1
    if shift <= 0:
        return bucket
    return ((bucket - shift * HALF + 1) << shift) - 1
