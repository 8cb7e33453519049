"""The fixture `bench`: lets a test run scenarios, or drive one piece by piece."""

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
    """The condition that a test waits for did not come true in time."""


class LiveRun:
    """A run in virtual time that advances only when the test says so."""

    def __init__(self, case: Case, files: Files, folder: RunFolder) -> None:
        self.case = case
        self._run = CaseRun(case, parts_of(case, files), folder, frozenset(FaultPlace))
        self._bench = self._run.bench
        self._result: CaseResult | None = None
        self._planned_away: list[str] = []
        """Kinds of faults that had not begun when others replaced them."""
        self._death_shown = False

    @property
    def train(self) -> Truth:
        """The true state of the train."""
        return self._run.truth

    @property
    def controller(self) -> CycleOutput:
        """The controller's output of its last cycle."""
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
        """Run until an expression over the true state, or a function, is true.

        Raises BenchTimeoutError if that takes longer than `timeout_s` of virtual time.
        """
        holds = self._asker(condition)
        end_ns = self._bench.clock.now_ns() + round(timeout_s * NS_PER_S)
        # The condition is checked at steps of the plant, so the instant does not depend on other
        # tasks.
        self._go_on(lambda now_ns: now_ns >= end_ns or (now_ns % STEP_NS == 0 and holds()))
        if not holds():
            words = condition if isinstance(condition, str) else "the condition"
            raise BenchTimeoutError(f"{words}: not within {timeout_s:g} s, at {self.now_s:.2f} s")

    def _go_on(self, over: Callable[[int], bool]) -> None:
        """Continue; if the controller dies, raise its exception and continue without it later."""
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
        """Replace all planned faults by these, which act as their windows say.

        Raises SettingsError for a wrong table, and while an earlier fault acts.
        """
        schedule = self._bench.plant.schedule
        if schedule.active:
            acting = ", ".join(plan.kind.name for plan in schedule.active)
            raise SettingsError(f"{self.case.id}: fault {acting} still acts; let it end first")
        plans = read_faults(tables, self.case.id)
        for plan in plans:
            check_bus_fault(plan)
        self._planned_away += [plan.kind.name for plan in schedule.never_began]
        schedule.plan(plans)

    def close(self) -> CaseResult:
        """End the run and judge it up to here."""
        if self._result is None:
            self._run.close()
            self._result = self._run.result()
        return self._result

    def findings(self) -> list[Finding]:
        """End the run; return everything that the test must expect or avoid."""
        result = self.close()
        never = [plan.kind.name for plan in self._bench.plant.schedule.never_began]
        return findings_of_live(
            result.monitors,
            _plans_of(self.case),
            () if self.case.idle_counts else [*self._planned_away, *never],
            "" if self._death_shown else self._run.died,
        )


class Bench:
    """Runs scenarios; a single run keeps its logs in the test's own folder.

    Any violation that a call does not `expect` fails the test at its end.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._unjudged: list[tuple[Expected, Callable[[], list[tuple[str, Finding]]]]] = []
        self._made = 0

    def run(self, scenario: Scenario, *, expect: Expect = ()) -> CaseResult:
        """Run the only case of a scenario to its end. Raises CampaignError for a wrong scenario.

        Args:
            expect: monitors or invariants that the run must violate; SettingsError for unknown
                names.
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
        """Run every case of a scenario with a sweep or several seeds, without logs.

        Args:
            expect: as for `run`; at least one case must violate each.
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
        """Start a run that the test drives. It is closed and judged when the test ends.

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
        """End and judge all runs that are not judged yet; return the failures as sentences."""
        said: list[str] = []
        while self._unjudged:
            expected, findings = self._unjudged.pop(0)
            said += complaints(expected, findings())
        return said

    def close(self) -> None:
        """End all runs and ignore their failures."""
        self.judge()

    def _only_case(self, scenario: Scenario) -> tuple[Case, Files]:
        campaign = scenario.campaign()
        cases = plan_cases(campaign)
        assert len(cases) == 1, f"the scenario has {len(cases)} cases; run_all runs them"
        return cases[0], self._written(campaign.files)

    def _written(self, contents: Mapping[str, str]) -> Files:
        """Write the user's files that the cases name; return their paths."""
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
