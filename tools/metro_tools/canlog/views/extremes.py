"""Down-sampling that keeps extremes: of each column first, least, greatest and last sample."""

from dataclasses import dataclass
from typing import Final

import numpy as np

from metro_tools.canlog.frames import Ints
from metro_tools.canlog.views.traces import Floats

BLOCK: Final = 256
"""Samples that one entry of the next level stands for."""


def kept(at_ns: Ints, values: Floats, *, start_ns: int, end_ns: int, columns: int) -> Ints:
    """Indices, rising, of the samples that make the same picture as all of them.

    Time from `start_ns` to `end_ns` is cut into `columns` equal pieces; of each the first, the
    least, the greatest and the last sample are kept (M4 of Jugel et al., VLDB 2014), and the last
    sample before and the first one after the span, so that lines leave the picture where they
    should. NaN counts as neither least nor greatest.

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
class Columns:
    """What a picture of `m` columns needs; columns without samples are left out."""

    column: Ints
    """(k,) which of the columns, rising."""
    first: Floats
    low: Floats
    high: Floats
    last: Floats


class Pyramid:
    """Least and greatest of blocks of samples, and of blocks of these."""

    def __init__(self, at_ns: Ints, values: Floats) -> None:
        self.at_ns = at_ns
        self.values = values
        self._levels: list[tuple[Floats, Floats]] = []
        low = high = values
        while len(low) > BLOCK:
            begins = np.arange(0, len(low), BLOCK)
            low, high = np.fmin.reduceat(low, begins), np.fmax.reduceat(high, begins)
            self._levels.append((low, high))

    def columns(self, start_ns: int, end_ns: int, count: int) -> Columns:
        """The span from `start_ns` up to, not including, `end_ns` in `count` columns, exactly."""
        width = (end_ns - start_ns) / count
        cuts = start_ns + np.rint(np.arange(count + 1) * width).astype(np.int64)
        cuts[-1] = end_ns
        edges = np.searchsorted(self.at_ns, cuts, "left")
        begins, ends = edges[:-1], edges[1:]
        there = np.flatnonzero(ends > begins)
        begins, ends = begins[there], ends[there]
        low = np.empty(len(there))
        high = np.empty(len(there))
        for at in range(len(there)):
            low[at], high[at] = self._span(int(begins[at]), int(ends[at]))
        return Columns(there, self.values[begins], low, high, self.values[ends - 1])

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
