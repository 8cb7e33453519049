"""Runs one case in real time: sets it up, judges it as in lockstep, and attributes failures."""

import tempfile
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path

import msgspec

from firmware_py.buses import BusError
from firmware_py.clock.clock import Clock, WallClock
from firmware_py.settings import SettingsError
from firmware_py.storage.errors import RecorderError
from metro_hil.model.case import (
    Case,
    CaseEvent,
    CaseResult,
    FaultResult,
    Host,
    MonitorResult,
    Verdict,
)
from metro_hil.model.case_setup import NO_FILES, CaseParts, Files, parts_of
from metro_hil.model.run_folder import RunFolder
from metro_hil.model.verdict import Judgement, RunEvidence, judge
from metro_hil.monitors import MonitorSet, plans_of
from metro_hil.realtime.attribution import HANG_S, NO_EXCUSE_S, Failure, HostEvidence, rule
from metro_hil.realtime.case_loop import Conduct
from metro_hil.realtime.ends import VIOLATION
from metro_hil.realtime.evidence import collect_evidence, touched_counts
from metro_hil.realtime.host import HostRecord, at_priority
from metro_hil.realtime.measures import lateness_us_p99, realtime_measures
from metro_hil.realtime.setup import PreparedCase, set_stage
from metro_hil.realtime.tolerances import context_of
from metro_hil.realtime.wires import Blocked, RealtimeWires
from metro_hil.realtime.without_truth import needs_truth, with_unjudged

NS_PER_S = 1_000_000_000
CASE_WIRES = RealtimeWires()


def run_realtime_case(
    case: Case,
    *,
    files: Files = NO_FILES,
    folder: RunFolder | None = None,
    wires: RealtimeWires = CASE_WIRES,
) -> CaseResult:
    """Run a case to its end and judge it.

    If the bench lacks something, the verdict is BLOCKED with the reason. All started processes are
    ended.

    Args:
        files: paths of the files that the case names by a user's name.
        folder: keeps all logs of the run; without one the logs are discarded.
    """
    clock = WallClock()
    began_ns = clock.now_ns()
    with ExitStack() as stack:
        if folder is None:
            path = stack.enter_context(tempfile.TemporaryDirectory(prefix="hil-"))
            folder = RunFolder(Path(path))
        try:
            run = _Run(case, parts_of(case, files), files, folder, wires, clock)
            result = run.result()
        except (SettingsError, Blocked, BusError, RecorderError, OSError) as error:
            result = _blocked(case, str(error))
        wall_s = (clock.now_ns() - began_ns) / NS_PER_S
        return msgspec.structs.replace(
            result, host=msgspec.structs.replace(result.host, wall_s=wall_s)
        )


def _blocked(case: Case, reason: str) -> CaseResult:
    return CaseResult(case_id=case.id, index=case.index, verdict=Verdict.BLOCKED, reason=reason)


class _Run:
    """A case that has run, with all its evidence."""

    def __init__(
        self,
        case: Case,
        made: CaseParts,
        files: Files,
        folder: RunFolder,
        wires: RealtimeWires,
        clock: Clock,
    ) -> None:
        if case.branch is not None:
            raise Blocked("branch: a run in real time cannot be continued from a copy")
        self._case, self._made, self._folder = case, made, folder
        self._plans = plans_of(case)
        with ExitStack() as stack:
            self._host = HostRecord(folder.host_log)
            stack.callback(self._host.close)
            self._stage: PreparedCase = set_stage(
                case, made, files=files, folder=folder, wires=wires, clock=clock, stack=stack
            )
            truth_known = self._stage.parts.plant
            judged = [plan for plan in self._plans if truth_known or not needs_truth(plan)]
            split = self._stage.segments.split
            self._monitors = MonitorSet(judged, context_of(case, made), own_port=split)
            self._conduct = Conduct(case, made, self._stage, self._monitors, self._host, clock)
            with at_priority(wires.bench_priority):
                self._conduct.run()
            self._monitors.finish(cut_short=self._conduct.reason == VIOLATION)

    def result(self) -> CaseResult:
        case, conduct = self._case, self._conduct
        truth_known = self._stage.parts.plant
        measures = realtime_measures(self._folder, self._made, conduct, truth_known=truth_known)
        monitors = with_unjudged(self._plans, self._monitors.results(measures))
        faults = conduct.faults.results({**touched_counts(self._folder), **conduct.touched})
        judgement = self._judged(monitors, faults)
        verdict, reason = judgement.verdict, judgement.reason
        evidence = self._evidence()
        ruling = rule(verdict, self._failures(monitors), evidence)
        if ruling.verdict is not verdict:
            reason = f"{ruling.reason}; without that: {reason}" if reason else ruling.reason
        return CaseResult(
            case_id=case.id,
            index=case.index,
            verdict=ruling.verdict,
            reason=reason,
            lacking=judgement.lacking,
            died=conduct.pulse.died,
            exit_reason=conduct.reason,
            sim_s=conduct.motion.t_s,
            frames=conduct.hearing.chain.frames,
            chain=conduct.hearing.chain.value,
            monitors=tuple(monitors),
            faults=faults,
            measures=measures,
            events=self._all_events(),
            host=Host(steal_s=self._host.steal_s, lateness_us_p99=lateness_us_p99(self._folder)),
        )

    def _all_events(self) -> tuple[CaseEvent, ...]:
        """All recorded events, in order of time."""
        reports = self._conduct.hearing.brake_reports.found
        told = [CaseEvent(round(at_s, 3), text) for at_s, text in reports]
        return tuple(sorted([*self._conduct.events, *told], key=lambda event: event.at_s))

    def _judged(
        self, monitors: tuple[MonitorResult, ...], faults: tuple[FaultResult, ...]
    ) -> Judgement:
        conduct = self._conduct
        return judge(
            self._case,
            RunEvidence(
                monitors=monitors,
                faults=faults,
                died=conduct.pulse.died,
                moved_m=conduct.motion.moved_m,
                violated=conduct.reason == VIOLATION,
            ),
        )

    def _failures(self, monitors: tuple[MonitorResult, ...]) -> list[Failure]:
        found = [Failure(each.at_s) for each in monitors if each.verdict is Verdict.FAIL]
        conduct = self._conduct
        if conduct.pulse.died:
            least_s = NO_EXCUSE_S if conduct.crashed else HANG_S
            found.append(Failure(conduct.died_s, least_s))
        return found

    def _evidence(self) -> HostEvidence:
        conduct, hearing = self._conduct, self._conduct.hearing
        origin_ns = hearing.origin_ns or 0
        found = collect_evidence(
            self._folder,
            self._host,
            cycle_s=self._case.setup.cycle_ms / 1000.0,
            origin_s=origin_ns / NS_PER_S,
            starts_s=[(start_ns - origin_ns) / NS_PER_S for start_ns in hearing.starts_ns],
            excused=conduct.excused,
            own_controller=self._stage.parts.controller,
        )
        return replace(found, dropped_frames=hearing.dropped_frames, blind=conduct.blind)
