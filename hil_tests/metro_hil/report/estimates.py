"""Figures with their 95 % confidence intervals: shares by Clopper–Pearson, means by bootstrap."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from metro_hil.model.log_columns import Numbers

CONFIDENCE_RATIO: Final = 0.95
RESAMPLES: Final = 2000
BATCH_NUMBERS: Final = 2_000_000
SEED: Final = 20130628
"""Fixed seed, so that equal results give equal intervals."""
DIGITS: Final = 6
"""Number of published significant digits, fewer than those in which processors may differ."""


@dataclass(frozen=True, slots=True)
class ConfidenceInterval:
    """A figure and its confidence interval, in the figure's unit."""

    best: float
    low: float
    high: float

    def __post_init__(self) -> None:
        assert self.low <= self.best <= self.high or np.isnan(self.low), self


def pass_share(passed: int, judged: int) -> ConfidenceInterval | None:
    """Share of passes with its exact (Clopper–Pearson) interval; None without cases."""
    assert 0 <= passed <= judged
    if judged == 0:
        return None
    # `scipy.stats` has the same interval, but loads for half a second.
    from scipy.special import betaincinv

    failed, tail_ratio = judged - passed, 0.5 * (1.0 - CONFIDENCE_RATIO)
    low = betaincinv(passed, failed + 1, tail_ratio) if passed else 0.0
    high = betaincinv(passed + 1, failed, 1.0 - tail_ratio) if failed else 1.0
    return ConfidenceInterval(passed / judged, float(low), float(high))


def mean_with_interval(values: Sequence[float]) -> ConfidenceInterval | None:
    """Mean with its percentile bootstrap interval, independent of the order of the values.

    None without values. For a single value, or equal ones, the interval is that value and says
    nothing about the scatter.
    """
    return _with_interval(values, lambda table: table.mean(axis=-1))


def cluster_mean_with_interval(clusters: Sequence[Sequence[float]]) -> ConfidenceInterval | None:
    """Mean of all values with an interval by resampling whole clusters.

    Values of one cluster may depend on each other; clusters are independent. None without clusters.
    """
    if not len(clusters):
        return None
    sums = np.array([[len(own), np.sum(np.sort(np.asarray(own)))] for own in clusters])
    ordered = sums[np.lexsort((sums[:, 0], sums[:, 1]))]
    best = float(np.sum(ordered[:, 1]) / np.sum(ordered[:, 0]))
    drawn = _resampled(ordered, lambda table: table[..., 1].sum(-1) / table[..., 0].sum(-1))
    tail_percent = 50.0 * (1.0 - CONFIDENCE_RATIO)
    low, high = np.percentile(drawn, [tail_percent, 100.0 - tail_percent])
    return ConfidenceInterval(best, min(float(low), best), max(float(high), best))


def median_with_interval(values: Sequence[float]) -> ConfidenceInterval | None:
    """Median with its interval, like `mean_with_interval`."""
    return _with_interval(values, lambda table: np.median(table, axis=-1))


def _with_interval(
    values: Sequence[float], statistic: Callable[[Numbers], Numbers]
) -> ConfidenceInterval | None:
    if not len(values):
        return None
    ordered = np.sort(np.asarray(values, dtype=np.float64))
    if ordered[0] == ordered[-1]:
        return ConfidenceInterval(float(ordered[0]), float(ordered[0]), float(ordered[0]))
    best = float(statistic(ordered))
    drawn = _resampled(ordered, statistic)
    tail_percent = 50.0 * (1.0 - CONFIDENCE_RATIO)
    low, high = np.percentile(drawn, [tail_percent, 100.0 - tail_percent])
    return ConfidenceInterval(best, min(float(low), best), max(float(high), best))


def _resampled(values: Numbers, statistic: Callable[[Numbers], Numbers]) -> Numbers:
    generator = np.random.default_rng(SEED)
    step = max(1, BATCH_NUMBERS // len(values))
    found = []
    for first in range(0, RESAMPLES, step):
        rows = min(step, RESAMPLES - first)
        drawn = generator.integers(0, len(values), size=(rows, len(values)))
        found.append(statistic(values[drawn]))
    return np.concatenate(found)


def rounded(value: float | None) -> float | None:
    """Round to the published digits; NaN and infinity become None."""
    if value is None or not np.isfinite(value):
        return None
    return float(f"{value:.{DIGITS}g}")
