"""What the fixture `bench` gives a test: scenarios to run, or to drive piece by piece."""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from firmware_py.expression import compile_expression
from firmware_py.settings import SettingsError
from metro_hil.campaign import plan_cases
from metro_hil.campaign.builder import Scenario
from metro_hil.model.case import Case, CaseResult
from metro_hil.model.case_setup import Files, parts_of
from metro_hil.model.frame_names import check_bus_fault
from metro_hil.model.run_folder import RunFolder
from metro_hil.monitors import MonitorPlan, read_monitors
from metro_hil.pytest.live_verdict import (
    Expect,
    Expected,
    Finding,
    complaints,
    findings_of,
    findings_of_live,
    place_of_call,
    read_expected,
)
from metro_hil.run.case import CaseRun
from metro_hil.run.dispatch import run_case
from plant_emulator.faults.kinds import FaultPlace
from plant_emulator.faults.plan import read_faults
from plant_emulator.truth import SIGNALS, Truth
from plant_emulator.world import STEP_NS
from vobc.vocabulary import CycleOutput

NS_PER_S = 1_000_000_000


class BenchTimeoutError(AssertionError):
    """The train did not do in time what a test waits for."""


class LiveRun:
    """A run in virtual time that stands still until it is told to go on."""

    def __init__(self, case: Case, files: Files, folder: RunFolder) -> None:
        self.case = case
        self._run = CaseRun(case, parts_of(case, files), folder, frozenset(FaultPlace))
        self._bench = self._run.bench
        self._result: CaseResult | None = None
        self._planned_away: list[str] = []
        """Kinds of faults that had not begun when others were planned in their place."""
        self._death_shown = False

    @property
    def train(self) -> Truth:
        """What is true of the train now."""
        return self._run.truth

    @property
    def controller(self) -> CycleOutput:
        """What the controller decided in its last cycle."""
        return self._bench.vobc.output

    @property
    def now_s(self) -> float:
        return self._bench.clock.now_ns() / NS_PER_S

    @property
    def arrived(self) -> bool:
        """Whether the train has stood with open doors at its last station for a while."""
        return self._bench.arrived

    def run_for(self, duration_s: float) -> None:
        end_ns = self._bench.clock.now_ns() + round(duration_s * NS_PER_S)
        self._go_on(lambda now_ns: now_ns >= end_ns)

    def run_until(self, condition: str | Callable[[], bool], *, timeout_s: float) -> None:
        """Until an expression over the truth, or a function, says true.

        Raises BenchTimeoutError when that takes longer than `timeout_s` of the train's time.
        """
        holds = self._asker(condition)
        end_ns = self._bench.clock.now_ns() + round(timeout_s * NS_PER_S)
        # Asked at the steps of the plant, so that the instant does not depend on other tasks.
        self._go_on(lambda now_ns: now_ns >= end_ns or (now_ns % STEP_NS == 0 and holds()))
        if not holds():
            words = condition if isinstance(condition, str) else "the condition"
            raise BenchTimeoutError(f"{words}: not within {timeout_s:g} s, at {self.now_s:.2f} s")

    def _go_on(self, over: Callable[[int], bool]) -> None:
        """A controller that dies shows its exception to the test, and the run goes on without."""
        assert self._result is None, f"{self.case.id}: the run is over; it was closed and judged"
        try:
            self._bench.run_until(over)
        except Exception as error:
            self._run.bury(error)
            self._death_shown = True
            raise

    def _asker(self, condition: str | Callable[[], bool]) -> Callable[[], bool]:
        if not isinstance(condition, str):
            return condition
        expression = compile_expression(condition, SIGNALS)
        return lambda: bool(expression(self._run.truth))

    def plan_faults(self, *tables: dict[str, Any]) -> None:
        """From now on these faults act as their windows say, and none of those planned before.

        Raises SettingsError for a wrong table, and while a fault that was planned before acts.
        """
        schedule = self._bench.plant.schedule
        if schedule.active:
            acting = ", ".join(plan.kind.name for plan in schedule.active)
            raise SettingsError(f"{self.case.id}: fault {acting} acts still; let it end first")
        plans = read_faults(tables, self.case.id)
        for plan in plans:
            check_bus_fault(plan)
        self._planned_away += [plan.kind.name for plan in schedule.never_began]
        schedule.plan(plans)

    def close(self) -> CaseResult:
        """End the run and judge what was seen so far."""
        if self._result is None:
            self._run.close()
            self._result = self._run.result()
        return self._result

    def findings(self) -> list[Finding]:
        """End the run; what a test has to expect or to avoid."""
        result = self.close()
        never = [plan.kind.name for plan in self._bench.plant.schedule.never_began]
        return findings_of_live(
            result.monitors,
            _plans_of(self.case),
            () if self.case.idle_counts else [*self._planned_away, *never],
            "" if self._death_shown else self._run.died,
        )


class Bench:
    """Runs scenarios; what is run alone keeps its logs in the test's own folder.

    Whatever a run violates that its call does not `expect` fails the test when it ends.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._unjudged: list[tuple[Expected, Callable[[], list[tuple[str, Finding]]]]] = []
        self._made = 0

    def run(self, scenario: Scenario, *, expect: Expect = ()) -> CaseResult:
        """The one case of a scenario, to its end. Raises CampaignError for a wrong scenario.

        Args:
            expect: monitors or invariants that the run is to violate; SettingsError if none has
                such a name.
        """
        __tracebackhide__ = True
        case, files = self._only_case(scenario)
        expected = read_expected(expect, _plans_of(case), place_of_call())
        folder = RunFolder(self._new_folder("run"))
        result = run_case(case, files=files, folder=folder)
        name = f"{case.id} (logs: {folder.path})"
        self._unjudged.append((expected, lambda: [(name, each) for each in findings_of(result)]))
        return result

    def run_all(self, scenario: Scenario, *, expect: Expect = ()) -> Sequence[CaseResult]:
        """Every case of a scenario with a sweep or several seeds, without logs.

        Args:
            expect: as for `run`; each is to be violated in one case at least.
        """
        __tracebackhide__ = True
        campaign = scenario.campaign()
        files, cases = self._written(campaign.files), plan_cases(campaign)
        plans = [plan for case in cases for plan in _plans_of(case)]
        expected = read_expected(expect, plans, place_of_call())
        results = [run_case(case, files=files) for case in cases]
        self._unjudged.append(
            (expected, lambda: [(r.case_id, each) for r in results for each in findings_of(r)])
        )
        return results

    def start(self, scenario: Scenario, *, expect: Expect = ()) -> LiveRun:
        """A run that the test drives itself. It is closed and judged when the test ends.

        Args:
            expect: as for `run`.
        """
        __tracebackhide__ = True
        case, files = self._only_case(scenario)
        expected = read_expected(expect, _plans_of(case), place_of_call())
        folder = RunFolder(self._new_folder("run"))
        live = LiveRun(case, files, folder)
        name = f"{case.id} (logs: {folder.path})"
        self._unjudged.append((expected, lambda: [(name, each) for each in live.findings()]))
        return live

    def judge(self) -> list[str]:
        """End all runs that were not judged yet; what of them fails the test, as sentences."""
        said: list[str] = []
        while self._unjudged:
            expected, findings = self._unjudged.pop(0)
            said += complaints(expected, findings())
        return said

    def close(self) -> None:
        """End all runs, whatever they came to."""
        self.judge()

    def _only_case(self, scenario: Scenario) -> tuple[Case, Files]:
        campaign = scenario.campaign()
        cases = plan_cases(campaign)
        assert len(cases) == 1, f"the scenario has {len(cases)} cases; run_all runs them"
        return cases[0], self._written(campaign.files)

    def _written(self, contents: Mapping[str, str]) -> Files:
        """The files of the user that the cases name, where a run finds them."""
        if not contents:
            return {}
        folder = self._new_folder("files")
        places = {}
        for number, (name, content) in enumerate(contents.items()):
            places[name] = folder / f"{number}.toml"
            places[name].write_text(content, encoding="utf-8")
        return places

    def _new_folder(self, what: str) -> Path:
        self._made += 1
        path = self._folder / f"{what}{self._made}"
        path.mkdir()
        return path


def _plans_of(case: Case) -> Sequence[MonitorPlan]:
    return read_monitors(case.monitors, case.id, case.invariants)
