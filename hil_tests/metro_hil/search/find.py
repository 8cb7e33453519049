"""The search loop: gets points from the optimiser, runs them, and returns their values to it."""

from collections.abc import Callable, Sequence
from typing import Any, Final

import msgspec

from metro_hil.model.case import Case, CaseResult
from metro_hil.search.objective import NOTHING_SEEN, Objective, margins_of
from metro_hil.search.optimisers import OPTIMISERS, Shares
from metro_hil.search.space import Sample, SearchError, SearchSpace

Evaluate = Callable[[Sequence[Case]], Sequence[CaseResult]]
"""Runs cases, in any order and place, and gives their results in the order of the cases."""

IN_VAIN_MAX: Final = 200
"""Number of batches in a row without a new point after which the space counts as exhausted."""


class Sought(msgspec.Struct, frozen=True, kw_only=True):
    """One point that was run; one line of the history."""

    number: int
    values: dict[str, Any]
    """Values by swept key."""
    value: float
    """The minimised value: a margin, or its ratio to the usual size; NOTHING_SEEN without
    margin."""
    seed: int
    """Seed of the worst run."""
    case_id: str
    verdict: str
    margins: dict[str, float]
    """Margins of the worst run, by monitor."""


class WorstCaseSearch:
    """One search, which depends on space, objective, budget and seed, but not on the workers."""

    def __init__(
        self,
        space: SearchSpace,
        evaluate: Evaluate,
        *,
        monitor: str | None = None,
        budget: int = 200,
        seed: int = 1,
        method: str = "cma",
    ) -> None:
        """
        Args:
            monitor: monitor whose margin is minimised. None means the least of all margins, each
                over its usual size.
            budget: number of runs, counting each seed of a point; at least one point is run.
            method: a key of OPTIMISERS.
        """
        self._space = space
        self._evaluate = evaluate
        self.objective = Objective(monitor)
        self._points_max = max(1, budget // len(space.plan.seeds))
        self._optimiser = OPTIMISERS[method](len(space.factors), self._points_max, seed)
        self._values: dict[bytes, float] = {}
        self.history: list[Sought] = []

    def run(self, heard: Callable[[Sequence[Sought]], None] = lambda new: None) -> list[Sought]:
        """Search until the budget is used or no new point is found; `heard` gets each batch.

        Raises SearchError if no point can be run, or if no run has the monitor.
        """
        in_vain = 0
        while len(self.history) < self._points_max and in_vain < IN_VAIN_MAX:
            asked = self._optimiser.ask()
            choices = [self._space.values(shares) for shares in asked]
            new = self._run_new(choices)
            in_vain = 0 if new else in_vain + 1
            self._tell_optimiser(asked, choices)
            if new:
                heard(new)
        if not self.history:
            raise SearchError("the sweep allows none of the points that were tried")
        return self.history

    def worst(self, count: int) -> list[Sought]:
        """The worst points with a margin, the worst first."""
        seen = [sought for sought in self.history if sought.value < NOTHING_SEEN]
        return sorted(seen, key=lambda sought: (sought.value, sought.number))[:count]

    def _tell_optimiser(self, asked: Sequence[Shares], choices: Sequence[dict[str, Any]]) -> None:
        values = [self._values.get(_key(choice), NOTHING_SEEN) for choice in choices]
        assert len(asked) == len(values)
        self._optimiser.tell(values)

    def _run_new(self, choices: Sequence[dict[str, Any]]) -> list[Sought]:
        """Run the new points, within the budget."""
        samples: list[Sample] = []
        keys: list[bytes] = []
        for choice in choices:
            key = _key(choice)
            if key in self._values or key in keys:
                continue
            if len(self.history) + len(samples) == self._points_max:
                break
            sample = self._space.sample(len(self.history) + len(samples), choice)
            if sample is None:
                self._values[key] = NOTHING_SEEN
                continue
            samples.append(sample)
            keys.append(key)
        if not samples:
            return []
        results = self._evaluate([case for sample in samples for case in sample.cases])
        if not self.history:
            self.objective.calibrate(results)
        new: list[Sought] = []
        place = 0
        for sample, key in zip(samples, keys, strict=True):
            own = results[place : place + len(sample.cases)]
            place += len(sample.cases)
            sought = self._judged(sample, own)
            self._values[key] = sought.value
            new.append(sought)
        self.history += new
        return new

    def _judged(self, sample: Sample, results: Sequence[CaseResult]) -> Sought:
        worst = self.objective.worst_of(results)
        case = sample.cases[list(results).index(worst)]
        return Sought(
            number=sample.number,
            values=sample.values,
            value=self.objective.of(results),
            seed=case.seed,
            case_id=case.id,
            verdict=worst.verdict.value,
            margins=dict(margins_of(worst)),
        )


def _key(choice: dict[str, Any]) -> bytes:
    return msgspec.json.encode([repr(value) for value in choice.values()])
