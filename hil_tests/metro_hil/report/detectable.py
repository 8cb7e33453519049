"""What a paired comparison can find at all, told before anything is found.

Two limits hold. The exact signed-rank test of k differences gives no p below 2**(1-k), when all of
them go the same way; Holm's first step compares that with 5 % by the number of tests. And a shift
that is small beside the scatter of the differences is found in some comparisons only: the power is
that of the paired t-test, with 3/pi as many pairs, which is the asymptotic relative efficiency of
the signed-rank test where differences are normal (Hodges and Lehmann 1956).
"""

import functools
import math
from dataclasses import dataclass
from typing import Final

LEVEL_RATIO: Final = 0.05
"""Of p after correction, for one family of tests."""
POWER_RATIO: Final = 0.8
EFFICIENCY_RATIO: Final = 3.0 / math.pi
SHIFT_SD_MAX: Final = 100.0


@dataclass(frozen=True, slots=True)
class Detectable:
    """What one family of tests can find."""

    pairs: int
    tests: int
    """Series with a difference that matters, whichever way."""
    pairs_needed: int
    """So many pairs that all go the same way are significant; with fewer nothing is."""
    shift_sd_ratio: float | None
    """Mean difference, in standard deviations of the differences, that is found in POWER_RATIO of
    such comparisons; None where nothing can be found."""

    @property
    def hopeless(self) -> bool:
        return self.tests > 0 and self.pairs < self.pairs_needed


def detectable(pairs: int, tests: int) -> Detectable:
    needed = pairs_needed(tests)
    shift_sd = shift_sd_of(pairs, max(1, tests)) if pairs >= needed else None
    return Detectable(pairs, tests, needed, shift_sd)


def least_p_ratio(differences: int) -> float:
    """Of the exact signed-rank test, two-sided, when all differences go the same way."""
    return min(1.0, 2.0 ** (1 - differences))


def pairs_needed(tests: int) -> int:
    """The fewest with a least p that stays below 5 % when it is multiplied by `tests`."""
    pairs = 1
    while least_p_ratio(pairs) * max(1, tests) >= LEVEL_RATIO:
        pairs += 1
    return pairs


@functools.cache
def shift_sd_of(pairs: int, tests: int) -> float | None:
    """None where not even a huge shift would be found."""
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
    # The other tail is beneath notice wherever the power is four fifths.
    return float(nct.sf(limit, worth - 1.0, shift_sd * math.sqrt(worth)))
