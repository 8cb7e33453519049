"""Computes what a paired comparison can detect at all, before its results are shown.

Two limits hold. First, the exact signed-rank test of k differences gives no p below 2**(1-k), even
if all go the same way. Holm's first step compares it with 5 % divided by the number of tests.

Second, only some comparisons find a shift that is small against the scatter of the differences. The
power is that of the paired t-test with 3/pi as many pairs. That is the asymptotic relative
efficiency of the signed-rank test for normal differences (Hodges and Lehmann 1956).
"""

import functools
import math
from dataclasses import dataclass
from typing import Final

LEVEL_RATIO: Final = 0.05
"""Significance level after correction, for one family of tests."""
POWER_RATIO: Final = 0.8
EFFICIENCY_RATIO: Final = 3.0 / math.pi
SHIFT_SD_MAX: Final = 100.0


@dataclass(frozen=True, slots=True)
class Detectable:
    """What one family of tests can detect."""

    pairs: int
    tests: int
    """Number of series with a difference that matters, in either direction."""
    pairs_needed: int
    """Number of pairs, all in the same direction, that is significant; fewer never are."""
    shift_sd_ratio: float | None
    """Mean difference, in standard deviations of the differences, that a share POWER_RATIO of such
    comparisons detects; None if nothing is detectable."""

    @property
    def hopeless(self) -> bool:
        return self.tests > 0 and self.pairs < self.pairs_needed


def detectable(pairs: int, tests: int) -> Detectable:
    needed = pairs_needed(tests)
    shift_sd = shift_sd_of(pairs, max(1, tests)) if pairs >= needed else None
    return Detectable(pairs, tests, needed, shift_sd)


def least_p_ratio(differences: int) -> float:
    """p of the exact signed-rank test, two-sided, if all differences go the same way."""
    return min(1.0, 2.0 ** (1 - differences))


def pairs_needed(tests: int) -> int:
    """Least number of pairs whose least p, multiplied by `tests`, is below 5 %."""
    pairs = 1
    while least_p_ratio(pairs) * max(1, tests) >= LEVEL_RATIO:
        pairs += 1
    return pairs


@functools.cache
def shift_sd_of(pairs: int, tests: int) -> float | None:
    """Detectable shift in standard deviations; None if not even a huge one would be found."""
    from scipy.optimize import brentq

    if pairs < 2 or _power_ratio(SHIFT_SD_MAX, pairs, tests) < POWER_RATIO:
        return None
    found = brentq(lambda shift_sd: _power_ratio(shift_sd, pairs, tests) - POWER_RATIO, 0.0,
                   SHIFT_SD_MAX, xtol=1e-6)  # fmt: skip
    return float(found)


def _power_ratio(shift_sd: float, pairs: int, tests: int) -> float:
    """Share of comparisons in which such a shift is significant at Holm's first step."""
    from scipy.stats import nct, t

    worth = max(2.0, pairs * EFFICIENCY_RATIO)
    limit = float(t.isf(LEVEL_RATIO / tests / 2.0, worth - 1.0))
    # The other tail is negligible where the power is four fifths.
    return float(nct.sf(limit, worth - 1.0, shift_sd * math.sqrt(worth)))
