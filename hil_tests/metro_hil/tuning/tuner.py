"""The tuning loop: gets settings, runs them, keeps the best, judges it on other seeds."""

from collections.abc import Callable, Mapping, Sequence
from typing import Final

import msgspec

from metro_hil.model.case import CaseResult
from metro_hil.search.find import Evaluate
from metro_hil.search.optimisers import OPTIMISERS, Optimiser, Shares
from metro_hil.tuning.nelder_mead import NelderMead
from metro_hil.tuning.objective import CM_PER_M, REFUSED_CM, RunFigures, cost_cm, figures_of
from metro_hil.tuning.parameters import TunedParameter
from metro_hil.tuning.training import TRAINING, VALIDATION, Ground

__all__ = ["RunFigures", "Tuned", "Tuner"]

METHODS: Final = ("nelder-mead", "cma-es")
IN_VAIN_MAX: Final = 200
"""Number of batches in a row without a new point after which the search ends."""

Values = Mapping[str, float]


class Tuned(msgspec.Struct, frozen=True, kw_only=True):
    """Result of a tuning. Costs are of the training runs, figures of runs with other seeds."""

    before: dict[str, float]
    after: dict[str, float]
    cost_before_m: float
    cost_after_m: float
    points: int
    """Number of sets of settings that were run."""
    runs: int
    """Number of training runs."""
    figures_before: RunFigures | None = None
    """Figures with other seeds; None if the tuning ended before the judgement."""
    figures_after: RunFigures | None = None


class Tuner:
    """Tunes a law; the result depends on all arguments except the evaluator."""

    def __init__(
        self,
        ground: Ground,
        parameters: Sequence[TunedParameter],
        before: Values,
        evaluate: Evaluate,
        *,
        budget: int,
        seed: int,
        method: str = METHODS[0],
    ) -> None:
        """
        Args:
            before: present value of each parameter; the first point that is run.
            budget: number of training runs; at least one set of settings besides the present ones
                is tried.
        """
        self._ground = ground
        self._parameters = tuple(parameters)
        self._evaluate = evaluate
        self._seed = seed
        self._before = dict(before)
        self.points_max = max(2, budget // TRAINING)
        self._optimiser = self._make_optimiser(method)
        self._costs: dict[tuple[float, ...], float] = {}
        self._usual_s: float | None = None
        self._points = 0
        self._best: tuple[float, dict[str, float]] | None = None
        self._cost_before_cm = REFUSED_CM
        self._judged: dict[str, RunFigures] = {}

    def _make_optimiser(self, method: str) -> Optimiser:
        if method == "nelder-mead":
            start = tuple(
                parameter.share_ratio(self._before[parameter.key]) for parameter in self._parameters
            )
            return NelderMead(start, self._seed)
        return OPTIMISERS["cma"](len(self._parameters), self.points_max, self._seed)

    def train(self, heard: Callable[[int, float], None] = lambda points, cost: None) -> None:
        """Run until the budget is used; `heard` gets the number of points and the least cost."""
        self._cost_before_cm = self._run([self._before], heard)[0]
        in_vain = 0
        while self._points < self.points_max and in_vain < IN_VAIN_MAX:
            points_before = self._points
            asked = self._optimiser.ask()
            costs = self._run([self._values(shares) for shares in asked], heard)
            in_vain = 0 if self._points > points_before else in_vain + 1
            self._optimiser.tell(costs)

    def judge(self, heard: Callable[[str], None] = lambda which: None) -> None:
        """Run the initial and the best settings on seeds that were not used for tuning."""
        for which, values in (("before", self._before), ("after", self._best_values())):
            if which == "after" and values == self._before:
                self._judged[which] = self._judged["before"]
            else:
                results = self._evaluate(self._ground.validation(values, self._seed))
                self._judged[which] = figures_of(results, notches=self._ground.by_notches)
            heard(which)

    @property
    def begun(self) -> bool:
        """Whether any result exists that is worth keeping."""
        return self._best is not None

    @property
    def tuned(self) -> Tuned:
        cost_after_cm = self._cost_before_cm if self._best is None else self._best[0]
        return Tuned(
            before=self._before,
            after=self._best_values(),
            cost_before_m=self._cost_before_cm / CM_PER_M,
            cost_after_m=cost_after_cm / CM_PER_M,
            points=self._points,
            runs=self._points * TRAINING,
            figures_before=self._judged.get("before"),
            figures_after=self._judged.get("after"),
        )

    def _best_values(self) -> dict[str, float]:
        return self._before if self._best is None else self._best[1]

    def _values(self, shares: Shares) -> dict[str, float]:
        return {
            parameter.key: parameter.value(share)
            for parameter, share in zip(self._parameters, shares, strict=True)
        }

    def _run(
        self, choices: Sequence[dict[str, float]], heard: Callable[[int, float], None]
    ) -> list[float]:
        """Costs of these settings; earlier results are reused."""
        new: list[dict[str, float]] = []
        for values in choices:
            key = tuple(values.values())
            if key in self._costs:
                continue
            if not self._ground.allows(values):
                self._costs[key] = REFUSED_CM
            elif self._points + len(new) < self.points_max:
                self._costs[key] = REFUSED_CM
                new.append(values)
        cases = [case for values in new for case in self._ground.training(values, self._seed)]
        results = self._evaluate(cases) if cases else []
        for place, values in enumerate(new):
            self._note(values, results[place * TRAINING : (place + 1) * TRAINING])
        if new and self._best is not None:
            heard(self._points, self._best[0])
        return [self._costs.get(tuple(values.values()), REFUSED_CM) for values in choices]

    def _note(self, values: dict[str, float], results: Sequence[CaseResult]) -> None:
        if self._points == 0:
            self._usual_s = figures_of(results, notches=self._ground.by_notches).run_time_mean_s
        self._points += 1
        cost = cost_cm(results, self._usual_s, notches=self._ground.by_notches)
        self._costs[tuple(values.values())] = cost
        if self._best is None or cost < self._best[0]:
            self._best = (cost, values)


def runs_in_all(points_max: int) -> int:
    """Number of training and validation runs together, for a progress bar."""
    return points_max * TRAINING + 2 * VALIDATION
