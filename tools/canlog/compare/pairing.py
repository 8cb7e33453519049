"""Pairs the frames of two logs by the nearest instant, each frame at most once."""

from dataclasses import dataclass
from typing import Final

import numpy as np

from canlog.database import MessageSpec
from canlog.frames import Ints

NS_PER_MS: Final = 1_000_000
REACH_RATIO: Final = 0.5
"""Share of a period by which the frames of a pair may be apart."""
REACH_NS: Final = 500 * NS_PER_MS
"""Maximum distance of the frames of a pair if the period is unknown."""


@dataclass(frozen=True, slots=True, eq=False)
class Pairs:
    """Rows of two tables that belong together, and the rows without a partner."""

    a: Ints
    """(k,) rows of A that have a partner, rising."""
    b: Ints
    """(k,) rows of their partners in B, rising."""
    only_a: Ints
    only_b: Ints


def reach_ns(spec: MessageSpec | None, a_ns: Ints, b_ns: Ints) -> int:
    """Return the maximum distance in time of the two frames of a pair: half a period.

    The period is that of the DBC file, or else the median gap of the log with more frames.
    """
    if spec is not None and spec.period_ms:
        return round(REACH_RATIO * spec.period_ms * NS_PER_MS)
    longer = a_ns if len(a_ns) >= len(b_ns) else b_ns
    if spec is None and len(longer) > 2:
        return max(1, round(REACH_RATIO * float(np.median(np.diff(longer)))))
    return REACH_NS


def pair(a_ns: Ints, b_ns: Ints, reach: int) -> Pairs:
    """Pair frames that are nearest to each other and at most `reach` apart.

    Args:
        a_ns, b_ns: instants, rising or equal, with a common zero.
    """
    if not len(a_ns) or not len(b_ns):
        none = np.empty(0, np.int64)
        return Pairs(none, none, np.arange(len(a_ns)), np.arange(len(b_ns)))
    if len(a_ns) == len(b_ns) and bool((np.abs(a_ns - b_ns) <= reach).all()):
        # Pair frame by frame, even if several frames share a stamp.
        every = np.arange(len(a_ns))
        return Pairs(every, every, every[:0], every[:0])
    of_a, of_b = _nearest(a_ns, b_ns), _nearest(b_ns, a_ns)
    rows = np.flatnonzero(of_b[of_a] == np.arange(len(a_ns)))
    rows = rows[np.abs(a_ns[rows] - b_ns[of_a[rows]]) <= reach]
    partners = of_a[rows]
    return Pairs(
        rows,
        partners,
        np.setdiff1d(np.arange(len(a_ns)), rows, assume_unique=True),
        np.setdiff1d(np.arange(len(b_ns)), partners, assume_unique=True),
    )


def _nearest(from_ns: Ints, to_ns: Ints) -> Ints:
    """(n,): for each instant the index of the nearest one in `to_ns`, the earlier of two."""
    after = np.clip(np.searchsorted(to_ns, from_ns), 0, len(to_ns) - 1)
    before = np.maximum(after - 1, 0)
    nearer = np.abs(from_ns - to_ns[before]) <= np.abs(to_ns[after] - from_ns)
    found: Ints = np.where(nearer, before, after)
    # The first of several frames with one stamp stands for all; otherwise none would be a nearest
    # one.
    return np.searchsorted(to_ns, to_ns[found], "left").astype(np.int64)
