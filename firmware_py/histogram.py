"""A histogram of whole numbers in bounded memory, for percentiles over hours."""

import math
from typing import Final

EXACT_BITS: Final = 7
"""Number of bits below which every value has its own bucket."""
HALF: Final = 1 << (EXACT_BITS - 1)
VALUE_BITS: Final = 40
"""Number of bits from which on values share the last bucket; the maximum stays exact."""
LAST_BUCKET: Final = HALF * (VALUE_BITS - EXACT_BITS + 2) - 1


class Histogram:
    """Counts non-negative whole numbers.

    Small values are kept exactly, larger ones in buckets of at most 1/64 of their value.
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
        """Return the value that at least `percent` of all values do not exceed, as the top of its
        bucket.

        It is never too small and at most 1/64 too large; 0 without values.
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
