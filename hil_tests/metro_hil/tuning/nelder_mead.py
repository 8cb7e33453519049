"""The flexible simplex of Nelder & Mead (1965), which tuned the PIDs of [Allotta 2013]."""

from collections.abc import Generator, Sequence
from typing import Final

import numpy as np

from metro_hil.search.optimisers import BELOW_ONE, Shares

STEP: Final = 0.15
"""Length of the first simplex's edges, in widths of the space."""
REFLECT: Final = 1.0
EXPAND: Final = 2.0
CONTRACT: Final = 0.5
SHRINK: Final = 0.5
SMALL: Final = 0.01
"""Size at which a simplex has settled; the next one starts around the best point."""

Asking = Generator[list[Shares], Sequence[float], None]


class NelderMead:
    """Works in the unit cube from a first point; moves points beyond a face onto it.

    It asks for the whole first simplex at once, then for one point after another.
    """

    def __init__(self, start: Shares, seed: int) -> None:
        self._start = start
        self._signs = np.random.Generator(np.random.PCG64(seed))
        self._asking = self._search()
        self._next = next(self._asking)

    def ask(self) -> list[Shares]:
        return self._next

    def tell(self, values: Sequence[float]) -> None:
        self._next = self._asking.send(values)

    def _search(self) -> Asking:
        best = self._start
        while True:
            corners = [best, *self._edges(best)]
            values = yield corners
            simplex = sorted(zip(values, corners, strict=True))
            while _size(simplex) > SMALL:
                simplex = yield from self._step(simplex)
            best = simplex[0][1]

    def _edges(self, start: Shares) -> list[Shares]:
        """One corner along each axis, in a random direction that stays inside the cube."""
        corners = []
        for axis, share in enumerate(start):
            sign = 1.0 if self._signs.random() < 0.5 else -1.0
            if not 0.0 <= share + sign * STEP < 1.0:
                sign = -sign
            moved = list(start)
            moved[axis] = share + sign * STEP
            corners.append(_inside(moved))
        return corners

    def _step(
        self, simplex: list[tuple[float, Shares]]
    ) -> Generator[list[Shares], Sequence[float], list[tuple[float, Shares]]]:
        worst_value, worst = simplex[-1]
        centre = [
            sum(axis) / (len(simplex) - 1) for axis in zip(*_points(simplex[:-1]), strict=True)
        ]
        reflected = _along(centre, worst, -REFLECT)
        value = (yield [reflected])[0]
        if value < simplex[0][0]:
            expanded = _along(centre, worst, -EXPAND)
            further = (yield [expanded])[0]
            return _with(simplex, *min((further, expanded), (value, reflected)))
        if value < simplex[-2][0]:
            return _with(simplex, value, reflected)
        outside = value < worst_value
        contracted = _along(centre, worst, -CONTRACT if outside else CONTRACT)
        nearer = (yield [contracted])[0]
        if nearer < min(value, worst_value):
            return _with(simplex, nearer, contracted)
        best_value, best = simplex[0]
        shrunk = [_along(best, point, SHRINK) for point in _points(simplex[1:])]
        values = yield shrunk
        return sorted([(best_value, best), *zip(values, shrunk, strict=True)])


def _points(simplex: Sequence[tuple[float, Shares]]) -> list[Shares]:
    return [point for _, point in simplex]


def _with(
    simplex: list[tuple[float, Shares]], value: float, point: Shares
) -> list[tuple[float, Shares]]:
    """The simplex with this corner in place of the worst."""
    return sorted([*simplex[:-1], (value, point)])


def _along(centre: Sequence[float], point: Sequence[float], factor: float) -> Shares:
    return _inside([c + factor * (p - c) for c, p in zip(centre, point, strict=True)])


def _inside(shares: Sequence[float]) -> Shares:
    return tuple(min(BELOW_ONE, max(0.0, share)) for share in shares)


def _size(simplex: list[tuple[float, Shares]]) -> float:
    """Greatest distance of a corner from the best one along any axis."""
    best = simplex[0][1]
    return max(
        abs(share - near)
        for _, point in simplex[1:]
        for share, near in zip(point, best, strict=True)
    )
