"""Optimisers in the unit cube, which depend only on the seed and on the values of past points."""

from collections.abc import Callable, Sequence
from typing import Any, Final, Protocol

import numpy as np

Shares = tuple[float, ...]
"""One number in [0, 1) for each factor."""

BATCH: Final = 8
"""Number of points in a batch, independent of the number of workers, so that it changes nothing.
With 200 evaluations of four factors, 8 found lower values than 10 or 16."""
FIRST_SHARE: Final = 0.2
"""Share of the budget for the first sample of the whole space."""
STEP: Final = 0.2
"""First step size of CMA-ES, in widths of the space."""
DIMENSIONS_MIN: Final = 2
"""Least number of dimensions for CMA-ES; an unused second one does no harm."""
BELOW_ONE: Final = 1.0 - 1e-9
"""Greatest share, because shares are less than 1."""


class Optimiser(Protocol):
    def ask(self) -> list[Shares]: ...

    def tell(self, values: Sequence[float]) -> None:
        """Give the values of the points of the last `ask`; the optimiser minimises them."""
        ...


class Everywhere:
    """Samples points evenly: the baseline for every search."""

    def __init__(self, dimensions: int, budget: int, seed: int) -> None:
        del budget
        self._dimensions = dimensions
        self._generator = np.random.Generator(np.random.PCG64(seed))

    def ask(self) -> list[Shares]:
        drawn: list[list[float]] = self._generator.random((BATCH, self._dimensions)).tolist()
        return [tuple(point) for point in drawn]

    def tell(self, values: Sequence[float]) -> None:
        pass


class Descent:
    """Starts with a Latin hypercube, then runs CMA-ES from its best points in turn.

    CMA-ES (Hansen & Ostermeier 2001, package `cma`) uses only ranks, so margins may have any unit
    and kinks. Levels appear to it as steps.
    """

    def __init__(self, dimensions: int, budget: int, seed: int) -> None:
        from scipy.stats import qmc

        self._dimensions = dimensions
        self._generator = np.random.Generator(np.random.PCG64(seed))
        width = max(DIMENSIONS_MIN, dimensions)
        look = max(BATCH, round(FIRST_SHARE * budget / BATCH) * BATCH)
        engine = qmc.LatinHypercube(width, seed=np.random.default_rng(seed))
        drawn: list[list[float]] = engine.random(look).tolist()
        self._first: list[Shares] = [tuple(point) for point in drawn]
        self._asked: list[Shares] = []
        self._vectors: Any = None
        self._strategy: Any = None
        self._seen: list[tuple[float, Shares]] = []
        self._starts: list[Shares] = []

    def ask(self) -> list[Shares]:
        if self._first:
            self._asked, self._first = self._first[:BATCH], self._first[BATCH:]
            self._vectors = None
            return self._shares()
        if self._strategy is None or self._strategy.stop():
            self._strategy = self._descend_from(self._next_start())
        self._vectors = self._strategy.ask()
        self._asked = [
            tuple(min(max(float(share), 0.0), BELOW_ONE) for share in vector)
            for vector in self._vectors
        ]
        return self._shares()

    def tell(self, values: Sequence[float]) -> None:
        assert len(values) == len(self._asked)
        if self._vectors is None:
            self._seen += zip(values, self._asked, strict=True)
        else:
            self._strategy.tell(self._vectors, list(values))

    def _shares(self) -> list[Shares]:
        return [point[: self._dimensions] for point in self._asked]

    def _next_start(self) -> Shares:
        if not self._starts:
            self._starts = [point for _, point in sorted(self._seen)]
        return self._starts.pop(0)

    def _descend_from(self, start: Shares) -> Any:
        import cma

        draw = self._generator.standard_normal
        # CMA-ES gets its own random stream, which nothing else in this process can disturb.
        options = {
            "bounds": [0.0, 1.0],
            "popsize": BATCH,
            "seed": float("nan"),
            "randn": lambda *shape: draw(shape),
            "verbose": -9,
        }
        return cma.CMAEvolutionStrategy(list(start), STEP, options)


OPTIMISERS: Final[dict[str, Callable[[int, int, int], Optimiser]]] = {
    "cma": Descent,
    "random": Everywhere,
}
"""Optimisers by name, made from dimensions, number of points and seed."""
