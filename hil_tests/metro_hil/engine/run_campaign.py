"""Runs one campaign from its folder to its totals: hands out, journals, retries, keeps logs."""

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace
from typing import Final

import msgspec

from firmware_py.clock.clock import WallClock
from metro_hil.engine.folder import CampaignFolder, empty_run_folder
from metro_hil.engine.journal import Journal, LostAttempt, Session, once_each
from metro_hil.engine.program import program_version
from metro_hil.engine.progress import Watcher
from metro_hil.engine.queue import Batch, GroupKey, WorkQueue, lost, no_group
from metro_hil.engine.retention import doubts, keep_logs, note_traceback, worth_keeping
from metro_hil.engine.stopping import StopWish
from metro_hil.engine.totals import Totals, total
from metro_hil.engine.worker_pool import (
    CaseFinished,
    CaseRaised,
    Outcome,
    PoolMessage,
    WorkerLost,
    WorkerPool,
)
from metro_hil.model.case import Case, CaseResult, as_expected
from metro_hil.model.run_folder import utc_text

WAIT_S: Final = 0.1
"""Longest time between two checks for a stop request or a journal that needs a flush, s."""


@dataclass(frozen=True, slots=True)
class CampaignOptions:
    """Options of `hil run` and `hil resume`."""

    keep: int = 10
    """Number of failed cases whose logs are kept."""
    keep_worst: int = 3
    """Number of further cases, those with the least margins, whose logs are kept."""
    always: Collection[str] = ()
    """Ids of cases whose logs are always kept."""
    fail_fast: bool = False


@dataclass(frozen=True, slots=True)
class CampaignEnd:
    """Outcome of a session."""

    totals: Totals
    cases: Sequence[Case]
    results: Sequence[CaseResult]
    """One result for each case that has one, in order."""
    interrupted: bool


def run_campaign(
    folder: CampaignFolder,
    make_crew: Callable[[], WorkerPool],
    make_keeper: Callable[[], WorkerPool],
    watcher: Watcher,
    stop: StopWish,
    wishes: CampaignOptions = CampaignOptions(),
) -> CampaignEnd:
    """Run the cases without a result, then keep the logs of the cases worth it.

    Args:
        folder: folder of a new campaign, or of one that was begun before.
        make_crew: makes the pool that runs the cases; not called if all have results.
        make_keeper: makes the pool that repeats cases and keeps their logs on this machine.
        stop: checked all the time; at the first request running cases end, at the second not.

    Raises:
        EngineError: if disk, journal or workers fail; results until then are in the journal.
    """
    cases = folder.cases()
    journal = Journal(folder.journal_path, folder.head())
    try:
        if journal.left_out:
            lines = f"{journal.left_out} damaged lines left out"
            watcher.say(f"{folder.journal_path}: {lines}; their cases are run again")
        shift = _CampaignSession(folder, cases, journal, watcher, stop, wishes)
        if shift.left:
            shift.work(make_crew)
    finally:
        journal.close()
    interrupted = stop.count > 0
    results = tuple(once_each(shift.results).values())
    if not interrupted:
        chosen = worth_keeping(
            folder, cases, results, wishes.keep, wishes.keep_worst, wishes.always
        )
        if chosen:
            keep_logs(folder, chosen, make_keeper, watcher, stop)
    return CampaignEnd(totals_of(folder, cases, shift.results, shift.sessions), cases, results,
                       interrupted or stop.count > 0)  # fmt: skip


def totals_of(
    folder: CampaignFolder,
    cases: Sequence[Case],
    results: Sequence[CaseResult],
    sessions: Sequence[Session],
) -> Totals:
    """Totals of a campaign, complete or not."""
    problems = doubts(folder, cases, results)
    programs = list(dict.fromkeys(session.program for session in sessions))
    if len(programs) > 1:
        problems.append(f"run by more than one version of the program: {', '.join(programs)}")
    return total(folder.manifest().cases, cases, results, problems)


class _CampaignSession:
    """One session: the time during which one process works on a campaign."""

    def __init__(
        self,
        folder: CampaignFolder,
        cases: Sequence[Case],
        journal: Journal,
        watcher: Watcher,
        stop: StopWish,
        wishes: CampaignOptions,
    ) -> None:
        self._folder, self._cases, self._journal = folder, cases, journal
        self._watcher, self._stop, self._wishes = watcher, stop, wishes
        self.results = list(journal.found.results)
        self.sessions = list(journal.found.sessions)
        done = {result.case_id for result in self.results}
        self.left = [case for case in cases if case.id not in done]
        self._by_id = {case.id: case for case in cases}
        self._stopping = False
        self._alone = False

    def work(self, make_crew: Callable[[], WorkerPool]) -> None:
        known = list(once_each(self.results).values())
        self._watcher.begin(len(self._cases), known, self._folder.manifest().name)
        try:
            crew = make_crew()
            try:
                self._record_session(crew)
                queue = WorkQueue(self.left, crew.workers, key=group_key_of(self.left))
                self._run_queue(crew, queue)
            finally:
                crew.close()
        finally:
            self._watcher.end()

    def _record_session(self, crew: WorkerPool) -> None:
        at = f"{utc_text(WallClock().epoch_ns())}Z"
        session = Session(at, program_version(), f"{type(crew).__name__} of {crew.workers}")
        self.sessions.append(session)
        self._journal.append(session)

    def _run_queue(self, crew: WorkerPool, queue: WorkQueue) -> None:
        while True:
            self._check_stop(crew)
            if not self._stopping:
                self._hand_out(crew, queue)
            if self._stop.count > 1 or (crew.busy == 0 and (self._stopping or not len(queue))):
                return
            for outcome in crew.wait(WAIT_S):
                self._take(outcome, queue)
            self._journal.sync()

    def _check_stop(self, crew: WorkerPool) -> None:
        if self._stop.count and not self._stopping:
            self._watcher.say(
                f"finishing at most {crew.workers} running cases; Ctrl-C again drops them"
            )
            self._stopping = True
        if self._stopping:
            crew.stop()

    def _hand_out(self, crew: WorkerPool, queue: WorkQueue) -> None:
        while (batch := queue.peek()) is not None:
            if crew.busy and (batch.alone or self._alone):
                return
            if not crew.room(queue.plenty):
                return
            queue.take()
            self._alone = batch.alone
            crew.hand(self._with_logs(batch) if batch.alone else batch)

    def _with_logs(self, batch: Batch) -> Batch:
        """Real time cannot be repeated to get its logs, so the first run keeps them."""
        kept = empty_run_folder(self._folder.kept(batch.cases[0].id))
        return replace(batch, folder=str(kept.path))

    def _take(self, outcome: Outcome, queue: WorkQueue) -> None:
        if isinstance(outcome, PoolMessage):
            self._watcher.say(outcome.words)
        elif isinstance(outcome, CaseFinished):
            self._record(outcome.batch, outcome.result)
        elif isinstance(outcome, CaseRaised):
            case = self._by_id[outcome.case_id]
            note_traceback(self._folder, case, outcome.traceback)
            last = outcome.traceback.strip().splitlines()[-1]
            self._record(outcome.batch, lost(case, f"the bench raised {last}", 1))
        elif outcome.begun:
            self._try_again(outcome, queue)
        else:
            queue.put_back(outcome.batch, outcome.left)

    def _try_again(self, gone: WorkerLost, queue: WorkQueue) -> None:
        for case in gone.left[: gone.begun]:
            attempt = LostAttempt(case.id, gone.batch.attempt, gone.reason)
            self._journal.append(attempt)
            self._watcher.lost_attempt(case.id, attempt.attempt, attempt.reason)
        for result in queue.failed(gone.batch, gone.left, gone.begun, gone.reason):
            self._record(gone.batch, result)

    def _record(self, batch: Batch, result: CaseResult) -> None:
        if result.host.attempts != batch.attempt:
            host = msgspec.structs.replace(result.host, attempts=batch.attempt)
            result = msgspec.structs.replace(result, host=host)
        self._journal.append(result)
        self.results.append(result)
        case = self._by_id[result.case_id]
        self._watcher.result(case, result)
        if self._wishes.fail_fast and not as_expected(case, result):
            self._stopping = True


def group_key_of(cases: Sequence[Case]) -> GroupKey:
    """Key of the groups of cases; the bench is imported only if a case has a branch."""
    if all(case.branch is None for case in cases):
        return no_group
    from metro_hil.run.branch import group_key

    return group_key
