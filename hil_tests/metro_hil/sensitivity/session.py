"""Tries mutants one after the other, each in its own worker, until a case notices it."""

import enum
import os
from collections import deque
from collections.abc import Callable, Generator, Mapping, Sequence
from dataclasses import dataclass
from difflib import unified_diff
from pathlib import Path
from typing import Final

from msgspec.structs import replace

from metro_hil.engine.errors import EngineError
from metro_hil.engine.local_pool import LocalPool
from metro_hil.engine.queue import Batch
from metro_hil.engine.worker_pool import CaseFinished, CaseRaised, WorkerLost
from metro_hil.model.case import BenchKind, Case, CaseResult, ControllerSpec, Verdict, as_expected
from metro_hil.model.verdict import DEAD
from metro_hil.sensitivity.findings import MutantFinding, MutantOutcome, violated
from metro_hil.sensitivity.mutants import ControllerMutant, mutated_source
from metro_hil.sensitivity.overlay import Overlays

RUNNER: Final = "metro_hil.sensitivity.worker_runner:run_case"
POLL_S: Final = 0.02
UNFIT_ERRORS: Final = (
    *("NameError", "UnboundLocalError", "AttributeError", "TypeError", "ImportError"),
    *("ModuleNotFoundError", "KeyError", "SyntaxError"),
)
"""Exceptions that show a badly written mutant; it breaks no rule of the controller."""


@dataclass(frozen=True, slots=True)
class CaseRequest:
    """A trial's request for the result of a case, with the mutant or the true controller."""

    case: Case
    mutated: bool = True


class Depth(enum.Enum):
    """Which cases a mutant is tried with, until one notices it."""

    QUICK = "the cases that its list names"
    USUAL = "all cases, or those that its list names if it has an argument"
    THOROUGH = "all cases"


class UnfitError(Exception):
    """The mutant does not run."""


Trial = Generator[CaseRequest, CaseResult, MutantFinding]


def usable_cases(cases: Sequence[Case]) -> tuple[Case, ...]:
    """Cases with the shipped controller in virtual time; only these can run a mutant."""
    own = ControllerSpec().kind
    return tuple(
        case for case in cases if case.bench is BenchKind.LOCKSTEP and case.controller.kind == own
    )


def in_order(mutant: ControllerMutant, cases: Sequence[Case]) -> tuple[Case, ...]:
    """Cases that the mutant's list names; then one of each scenario, then a second one, and so
    on."""
    named = [
        case for wanted in mutant.tries for case in cases if wanted in (case.id, case.scenario)
    ]
    met: dict[str, int] = {}
    rounds = []
    for case in cases:
        number = met[case.scenario] = met.get(case.scenario, 0) + 1
        rounds.append((number, case.index, case))
    ordered = [*named, *(case for _, _, case in sorted(rounds, key=lambda each: each[:2]))]
    return tuple({case.id: case for case in ordered}.values())


def trial(mutant: ControllerMutant, cases: Sequence[Case], *, likely: int, depth: Depth) -> Trial:
    """Request results until a case notices the mutant.

    Args:
        cases: in the order in which they run.
        likely: number of cases at the front that the mutant's list names.
    """
    began = not_tried(mutant)
    if depth is Depth.QUICK or (mutant.argued and depth is Depth.USUAL):
        # At least one case runs, which shows that the mutant runs at all.
        cases = cases[: max(1, likely)]
    tried = 0
    try:
        for case in cases:
            result = yield CaseRequest(case)
            tried += 1
            _refuse_unfit(result)
            if as_expected(case, result):
                continue
            true = yield CaseRequest(case, mutated=False)
            if not as_expected(case, true):
                continue
            outcome = MutantOutcome.REFUTED if mutant.argued else MutantOutcome.NOTICED
            return replace(
                violated(began, result, true),
                outcome=outcome,
                case=case.id,
                scenario=case.scenario,
                tried=tried,
            )
    except UnfitError as error:
        return replace(began, outcome=MutantOutcome.INVALID, why=str(error), tried=tried)
    if mutant.argued:
        return replace(began, outcome=MutantOutcome.ARGUED, why=mutant.argued.strip(), tried=tried)
    why = f"none of {tried} cases notices it"
    return replace(began, outcome=MutantOutcome.UNNOTICED, why=why, tried=tried)


def _refuse_unfit(result: CaseResult) -> None:
    """Raises UnfitError if the controller died because the mutant is badly written."""
    if result.verdict is Verdict.FAIL and result.reason.startswith(DEAD):
        kind, _, _ = result.reason.removeprefix(f"{DEAD}: ").partition(":")
        if kind.rpartition(".")[2] in UNFIT_ERRORS:
            raise UnfitError(f"{result.case_id}: {result.reason}")


class _CasePool:
    """A local pool that works on one case at a time for its caller."""

    def __init__(self, crew: LocalPool) -> None:
        self._crew = crew
        self._numbers = 0

    def hand(self, case: Case) -> None:
        self._numbers += 1
        self._crew.hand(Batch(self._numbers, (case,)))

    def results(self) -> list[CaseResult]:
        """Results since the last call. Raises UnfitError if a case gave none."""
        found = []
        try:
            outcomes = self._crew.wait(POLL_S)
        except EngineError as error:
            raise UnfitError(str(error)) from error
        for outcome in outcomes:
            if isinstance(outcome, CaseFinished):
                found.append(outcome.result)
            elif isinstance(outcome, CaseRaised):
                last = outcome.traceback.strip().splitlines()[-1]
                raise UnfitError(f"{outcome.case_id}: {last}")
            elif isinstance(outcome, WorkerLost):
                raise UnfitError(outcome.reason)
        return found

    def close(self) -> None:
        self._crew.close()


@dataclass(slots=True)
class _Running:
    """A trial with its worker and its pending request."""

    mutant: ControllerMutant
    trial: Trial
    crew: _CasePool
    ask: CaseRequest


class SensitivitySession:
    """Tries mutants against cases. `findings` is valid after an interruption as well."""

    def __init__(
        self,
        cases: Sequence[Case],
        files: Mapping[str, Path],
        folder: Path,
        *,
        workers: int,
        depth: Depth = Depth.USUAL,
        told: Callable[[MutantFinding], None] = lambda _: None,
    ) -> None:
        """Args:
        cases: cases of the campaign; at least one must be usable.
        files: paths, by the name by which cases refer to a file.
        folder: folder for the copies of the packages.
        told: receives each finding as it comes.
        """
        self._cases = cases
        self._files, self._workers = files, workers
        self._depth, self._told = depth, told
        self._overlays = Overlays(folder)
        self._true_results: dict[str, CaseResult] = {}
        self._true_asked: set[str] = set()
        self.root = self._overlays.true
        """Folder of the unchanged packages."""
        self.findings: dict[str, MutantFinding] = {}

    def check(self, mutants: Sequence[ControllerMutant]) -> None:
        """Raises SettingsError for the first mutant that does not fit the source."""
        for mutant in mutants:
            mutated_source(mutant, self.root)

    def run(
        self, mutants: Sequence[ControllerMutant], stopped: Callable[[], bool] = lambda: False
    ) -> None:
        """Try mutants that fit the source. Raises EngineError if no worker can start.

        Args:
            stopped: returns true when the remaining mutants are not to be tried.
        """
        waiting = deque(mutants)
        running: list[_Running] = []
        true = self._crew(self._overlays.true_environment(os.environ), self._workers)
        try:
            while (waiting or running) and not stopped():
                while waiting and len(running) < self._workers:
                    self._begin(waiting.popleft(), running)
                for result in true.results():
                    self._true_results[result.case_id] = result
                for each in list(running):
                    self._attend(each, running, true)
        except UnfitError as error:
            raise EngineError(f"the true controller gave no result: {error}") from error
        finally:
            true.close()
            for each in running:
                each.crew.close()

    def _crew(self, environment: Mapping[str, str], workers: int) -> _CasePool:
        return _CasePool(LocalPool(workers, self._files, runner=RUNNER, environment=environment))

    def _begin(self, mutant: ControllerMutant, running: list[_Running]) -> None:
        cases = in_order(mutant, self._cases)
        likely = sum(case.id in mutant.tries or case.scenario in mutant.tries for case in cases)
        begun = trial(mutant, cases, likely=likely, depth=self._depth)
        crew = self._crew(self._overlays.environment(mutant, os.environ), 1)
        ask = next(begun)
        crew.hand(ask.case)
        running.append(_Running(mutant, begun, crew, ask))

    def _attend(self, each: _Running, running: list[_Running], true: _CasePool) -> None:
        """Give a trial its requested result, if it has come."""
        try:
            result = self._result_for(each)
            if result is None:
                return
            try:
                each.ask = each.trial.send(result)
            except StopIteration as end:
                self._end(each, end.value, running)
                return
        except UnfitError as error:
            try:
                each.trial.throw(error)
            except StopIteration as end:
                self._end(each, end.value, running)
            return
        case = each.ask.case
        if each.ask.mutated:
            each.crew.hand(case)
        elif case.id not in self._true_asked:
            self._true_asked.add(case.id)
            true.hand(case)

    def _result_for(self, each: _Running) -> CaseResult | None:
        if not each.ask.mutated:
            return self._true_results.get(each.ask.case.id)
        results = each.crew.results()
        return results[0] if results else None

    def _end(self, each: _Running, finding: MutantFinding, running: list[_Running]) -> None:
        running.remove(each)
        each.crew.close()
        self._overlays.discard(each.mutant)
        self.findings[each.mutant.name] = finding
        self._told(finding)


def with_difference(finding: MutantFinding, mutant: ControllerMutant, root: Path) -> MutantFinding:
    """The finding with the change of the source, as a unified diff.

    Args:
        root: folder that holds the packages.

    Raises SettingsError like `mutated_source`.
    """
    changed = mutated_source(mutant, root)
    true = (root / mutant.file).read_text(encoding="utf-8")
    lines = unified_diff(
        true.splitlines(), changed.splitlines(), mutant.file, mutant.name, n=1, lineterm=""
    )
    return replace(finding, difference="\n".join(lines))


def not_tried(mutant: ControllerMutant) -> MutantFinding:
    return MutantFinding(
        mutant=mutant.name,
        rule=mutant.rule,
        file=mutant.file,
        source=mutant.source,
        outcome=MutantOutcome.NOT_TRIED,
        why="interrupted before it was tried",
    )
