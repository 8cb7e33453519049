"""Logs of the cases that people will want to look at: run once more, compared, kept."""

from collections.abc import Callable, Collection, Sequence
from typing import Final

import msgspec

from metro_hil.engine.folder import CampaignFolder, empty_run_folder
from metro_hil.engine.journal import once_each, same_result
from metro_hil.engine.local_pool import TOO_LATE
from metro_hil.engine.progress import Watcher
from metro_hil.engine.queue import Batch
from metro_hil.engine.stopping import StopWish
from metro_hil.engine.worker_pool import CaseFinished, CaseRaised, Outcome, PoolMessage, WorkerPool
from metro_hil.model.case import BenchKind, Case, CaseResult, Verdict, as_expected

WAIT_S: Final = 0.1
TRACEBACK: Final = "traceback.txt"


def worth_keeping(
    folder: CampaignFolder,
    cases: Sequence[Case],
    results: Sequence[CaseResult],
    keep: int,
    keep_worst: int,
    always: Collection[str] = (),
) -> list[Case]:
    """The first `keep` cases that are not as expected, then the `keep_worst` least margins, and
    those whose ids are in `always`.

    A function of the results, not of their order. What has its logs already is left out; so is real
    time, which cannot be repeated, and what would only hang again.
    """
    by_id = {case.id: case for case in cases if case.bench is BenchKind.LOCKSTEP}
    known = sorted(
        (
            result
            for result in results
            if result.case_id in by_id and not result.reason.startswith(TOO_LATE)
        ),
        key=lambda result: result.index,
    )
    failed = [result for result in known if not as_expected(by_id[result.case_id], result)][:keep]
    chosen = {result.case_id for result in failed}
    near = sorted(
        (
            (least.margin, result.index, result.case_id)
            for result in known
            if result.case_id not in chosen
            and result.verdict is not Verdict.LOST
            and (least := result.least_margin()) is not None
            and least.margin is not None
        ),
    )[:keep_worst]
    ids = [*(result.case_id for result in failed), *(name for _, _, name in near)]
    ids += [result.case_id for result in known if result.case_id in set(always) - set(ids)]
    return [by_id[name] for name in ids if not folder.kept(name).results.exists()]


def keep_logs(
    folder: CampaignFolder,
    chosen: Sequence[Case],
    make_keeper: Callable[[], WorkerPool],
    watcher: Watcher,
    stop: StopWish,
) -> None:
    """Run them once more with logs. A worker that dies again leaves what was written till then."""
    cases = "1 case" if len(chosen) == 1 else f"{len(chosen)} cases"
    watcher.say(f"keeping the logs of {cases}")
    crew = make_keeper()
    try:
        waiting = list(enumerate(chosen, start=1))
        while (waiting or crew.busy) and not stop.count:
            while waiting and crew.room(plenty=False):
                number, case = waiting.pop(0)
                path = empty_run_folder(folder.kept(case.id)).path
                crew.hand(Batch(number, (case,), folder=str(path)))
            for outcome in crew.wait(WAIT_S):
                _take(folder, outcome, watcher)
    finally:
        crew.close()


def _take(folder: CampaignFolder, outcome: Outcome, watcher: Watcher) -> None:
    if isinstance(outcome, PoolMessage):
        watcher.say(outcome.words)
        return
    case = outcome.batch.cases[0]
    if isinstance(outcome, CaseFinished):
        text = msgspec.json.format(msgspec.json.encode(outcome.result), indent=2)
        kept = folder.kept(case.id)
        kept.results.write_bytes(text + b"\n")
        watcher.say(f"logs: {kept.path}")
    elif isinstance(outcome, CaseRaised):
        note_traceback(folder, case, outcome.traceback)
    else:
        watcher.say(f"no logs of {case.id}: {outcome.reason}")


def note_traceback(folder: CampaignFolder, case: Case, traceback: str) -> None:
    path = folder.kept(case.id).path
    path.mkdir(parents=True, exist_ok=True)
    (path / TRACEBACK).write_text(traceback, encoding="utf-8")


def doubts(
    folder: CampaignFolder, cases: Sequence[Case], results: Sequence[CaseResult]
) -> list[str]:
    """Cases that gave something else when they were repeated. There must never be one."""
    found = []
    by_id = once_each(results)
    for case in cases:
        path = folder.kept(case.id).results
        first = by_id.get(case.id)
        if case.bench is not BenchKind.LOCKSTEP or first is None or not path.is_file():
            continue
        again = msgspec.json.decode(path.read_bytes(), type=CaseResult)
        if not same_result(first, again):
            what = (
                f"chain {first.chain[:12]} and then {again.chain[:12]}"
                if first.chain != again.chain
                else f"{first.verdict.value} and then {again.verdict.value}, with the same frames"
            )
            found.append(f"NOT DETERMINISTIC: {case.id} gave {what} when it was repeated")
    return found
