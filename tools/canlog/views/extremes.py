"""Down-sampling that keeps extremes: the first, minimum, maximum and last sample of each column."""

from dataclasses import dataclass
from typing import Final

import numpy as np

from canlog.frames import Ints
from canlog.views.traces import Floats, SignalTrace

BLOCK: Final = 256
"""Samples per entry of the next level."""
RAW_PER_COLUMN: Final = 3
"""Maximum samples per column that are returned unchanged."""
AT_ONCE: Final = 1 << 20
"""Maximum samples that are scanned one by one; for more, block extremes are used."""


def kept(at_ns: Ints, values: Floats, *, start_ns: int, end_ns: int, columns: int) -> Ints:
    """Return the rising indices of samples that draw the same picture as all samples.

    The time from `start_ns` to `end_ns` is cut into `columns` equal pieces. Each keeps its first,
    minimum, maximum and last sample (M4 of Jugel et al., VLDB 2014). The last sample before the
    span and the first one after it are kept, too, so that lines continue beyond the picture. NaN
    counts as neither minimum nor maximum.

    Args:
        at_ns: (n,) rising or equal.
        columns: at least 1.
    """
    assert columns >= 1
    assert end_ns >= start_ns
    low = int(np.searchsorted(at_ns, start_ns, "left"))
    high = int(np.searchsorted(at_ns, end_ns, "right"))
    around = np.arange(max(0, low - 1), min(len(at_ns), high + 1))
    if high - low <= 4 * columns:
        return around
    cuts = np.linspace(0, end_ns - start_ns, columns + 1)[:-1].astype(np.int64) + start_ns
    begins = np.unique(np.searchsorted(at_ns[low:high], cuts, "left"))
    begins = begins[begins < high - low]
    inside = values[low:high]
    sizes = np.diff(np.append(begins, high - low))
    column = np.repeat(np.arange(len(begins)), sizes)
    firsts = [begins, begins + sizes - 1]
    for reduce in (np.fmin, np.fmax):
        hits = np.flatnonzero(inside == reduce.reduceat(inside, begins)[column])
        _, first_hit = np.unique(column[hits], return_index=True)
        firsts.append(hits[first_hit])
    return np.unique(np.concatenate([*[each + low for each in firsts], around[[0, -1]]]))


@dataclass(frozen=True, slots=True, eq=False)
class ViewWindow:
    """Samples that draw a span, with the neighbours outside of it.

    They are either all samples, or the first, minimum, maximum and last one of each column of
    pixels. A NaN value breaks the line: no frame came for longer than the signal holds.
    """

    is_raw: bool
    at_ns: Floats
    """(k,) float64: exact up to 104 days from the zero of the trace."""
    values: Floats


class Pyramid:
    """Minimum and maximum of blocks of samples, of blocks of these, and so on."""

    def __init__(self, trace: SignalTrace, zero_ns: int) -> None:
        """Build the levels. Instants in `window` count from `zero_ns`."""
        self.at_ns = trace.at_ns - zero_ns
        self.values = trace.values
        self.gap_ns = trace.gap_ns
        self._levels: list[tuple[Floats, Floats]] = []
        low = high = trace.values
        while len(low) > BLOCK:
            begins = np.arange(0, len(low), BLOCK)
            low, high = np.fmin.reduceat(low, begins), np.fmax.reduceat(high, begins)
            self._levels.append((low, high))

    def window(self, start_ns: float, end_ns: float, columns: int) -> ViewWindow:
        """Return the span in `columns` equal columns."""
        begin = int(np.searchsorted(self.at_ns, start_ns, "left"))
        end = int(np.searchsorted(self.at_ns, end_ns, "right"))
        first, stop = max(0, begin - 1), min(len(self.at_ns), end + 1)
        if stop - first <= RAW_PER_COLUMN * columns:
            return self._raw(first, stop)
        inside = self.at_ns[begin:end]
        column = ((inside - start_ns) * (columns / (end_ns - start_ns))).astype(np.int64)
        begins = begin + np.flatnonzero(np.append(True, column[1:] != column[:-1]))
        ends = np.append(begins[1:], end)
        low, high = self._extremes(begins, ends)
        # Each column has a break after a silence, then its first, minimum, maximum and last sample.
        at_ns = np.empty((len(begins), 5))
        values = np.empty((len(begins), 5))
        at_ns[:, 1:3] = self.at_ns[begins, None]
        at_ns[:, 3:] = self.at_ns[ends - 1, None]
        before = np.maximum(begins - 1, 0)
        at_ns[:, 0] = self.at_ns[before]
        values[:, 0] = np.nan
        values[:, 1], values[:, 2] = self.values[begins], low
        values[:, 3], values[:, 4] = high, self.values[ends - 1]
        keep = np.ones(at_ns.shape, np.bool_)
        silent = self.at_ns[begins] - self.at_ns[before] > self.gap_ns
        keep[:, 0] = silent if self.gap_ns else False
        edges = [self._raw(first, begin), self._raw(end, stop)]
        return ViewWindow(
            False,
            np.concatenate([edges[0].at_ns, at_ns[keep], edges[1].at_ns]),
            np.concatenate([edges[0].values, values[keep], edges[1].values]),
        )

    def _raw(self, first: int, stop: int) -> ViewWindow:
        at_ns, values = self.at_ns[first:stop].astype(np.float64), self.values[first:stop]
        if self.gap_ns:
            where = np.flatnonzero(np.diff(at_ns) > self.gap_ns) + 1
            at_ns = np.insert(at_ns, where, at_ns[where - 1] + self.gap_ns)
            values = np.insert(values, where, np.nan)
        return ViewWindow(True, at_ns, values)

    def _extremes(self, begins: Ints, ends: Ints) -> tuple[Floats, Floats]:
        """Return minimum and maximum of each piece; the pieces follow each other without a gap."""
        first, stop = int(begins[0]), int(ends[-1])
        if stop - first <= AT_ONCE or not self._levels:
            inside = self.values[first:stop]
            return np.fmin.reduceat(inside, begins - first), np.fmax.reduceat(
                inside, begins - first
            )
        pairs = [self._span(int(begin), int(end)) for begin, end in zip(begins, ends, strict=True)]
        low, high = np.array(pairs).T
        return low, high

    def _span(self, begin: int, end: int) -> tuple[float, float]:
        low = high = float("nan")
        lows = highs = self.values
        for level in range(len(self._levels) + 1):
            inner_begin, inner_end = -(-begin // BLOCK), end // BLOCK
            last = level == len(self._levels) or inner_begin >= inner_end
            pieces = (
                [(begin, end)] if last else [(begin, inner_begin * BLOCK), (inner_end * BLOCK, end)]
            )
            for first, stop in pieces:
                if stop > first:
                    low = float(np.fmin(low, np.fmin.reduce(lows[first:stop])))
                    high = float(np.fmax(high, np.fmax.reduce(highs[first:stop])))
            if last:
                break
            begin, end = inner_begin, inner_end
            lows, highs = self._levels[level]
        return low, high
