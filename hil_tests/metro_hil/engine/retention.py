"""Keeps the logs of interesting cases: runs each once more, compares the result, keeps the logs."""

import hashlib
from collections.abc import Callable, Collection, Sequence
from pathlib import Path
from typing import Final

import msgspec

from firmware_py.storage.whole_file import write_whole
from metro_hil.engine.errors import EngineError
from metro_hil.engine.folder import CampaignFolder, empty_run_folder
from metro_hil.engine.journal import once_each, same_result
from metro_hil.engine.local_pool import TOO_LATE
from metro_hil.engine.progress import Watcher
from metro_hil.engine.queue import Batch
from metro_hil.engine.stopping import StopWish
from metro_hil.engine.worker_pool import CaseFinished, CaseRaised, Outcome, PoolMessage, WorkerPool
from metro_hil.model.case import BenchKind, Case, CaseResult, Verdict, as_expected
from metro_hil.model.run_folder import RunFolder

WAIT_S: Final = 0.1
TRACEBACK: Final = "traceback.txt"
REFUSED: Final = ("firmware_py.storage.errors.RecorderError:", "OSError:")
"""Beginnings of exceptions that a worker raises when the disk refuses its logs."""
SEAL: Final = "files.json"
"""File with the SHA-256 of each kept log by name. It is written after the logs and before the
result."""


def worth_keeping(
    folder: CampaignFolder,
    cases: Sequence[Case],
    results: Sequence[CaseResult],
    keep: int,
    keep_worst: int,
    always: Collection[str] = (),
) -> list[Case]:
    """The first `keep` unexpected cases, the `keep_worst` least margins, and all of `always`.

    The choice depends on the results, not on their order. It leaves out cases that have all their
    logs, real time, which cannot be repeated, and cases that would only hang again.
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
    return [by_id[name] for name in ids if kept_result(folder.kept(name)) is None]


def keep_logs(
    folder: CampaignFolder,
    chosen: Sequence[Case],
    make_keeper: Callable[[], WorkerPool],
    watcher: Watcher,
    stop: StopWish,
) -> None:
    """Run the cases once more with logs. A worker that dies again leaves a partial log."""
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
        write_whole(kept.path / SEAL, msgspec.json.encode(_digests(kept.path)))
        write_whole(kept.results, text + b"\n")
        watcher.say(f"logs: {kept.path}")
    elif isinstance(outcome, CaseRaised):
        last = outcome.traceback.strip().splitlines()[-1]
        if last.startswith(REFUSED):
            raise EngineError(f"no logs of {case.id}: {last.partition(': ')[2]}")
        note_traceback(folder, case, outcome.traceback)
    else:
        watcher.say(f"no logs of {case.id}: {outcome.reason}")


def kept_result(kept: RunFolder) -> CaseResult | None:
    """The result beside kept logs; None unless all logs are as they were written.

    A power cut may leave a file empty or half written, and a full disk may have refused it.
    """
    try:
        seal = msgspec.json.decode((kept.path / SEAL).read_bytes(), type=dict[str, str])
        found = _digests(kept.path)
    except (OSError, msgspec.DecodeError):
        return None
    whole = all(found.get(name) == digest for name, digest in seal.items())
    return _repeated(kept) if whole else None


def _repeated(kept: RunFolder) -> CaseResult | None:
    try:
        return msgspec.json.decode(kept.results.read_bytes(), type=CaseResult)
    except (OSError, msgspec.DecodeError):
        return None


def _digests(path: Path) -> dict[str, str]:
    """SHA-256 of every file in a folder and below it, by its path there."""
    digests = {}
    for each in sorted(each for each in path.rglob("*") if each.is_file()):
        with each.open("rb") as file:
            digests[str(each.relative_to(path))] = hashlib.file_digest(file, "sha256").hexdigest()
    return digests


def note_traceback(folder: CampaignFolder, case: Case, traceback: str) -> None:
    path = folder.kept(case.id).path
    path.mkdir(parents=True, exist_ok=True)
    write_whole(path / TRACEBACK, traceback)


def doubts(
    folder: CampaignFolder, cases: Sequence[Case], results: Sequence[CaseResult]
) -> list[str]:
    """Messages about cases whose repetition gave another result; there must never be one."""
    found = []
    by_id = once_each(results)
    for case in cases:
        first = by_id.get(case.id)
        if case.bench is not BenchKind.LOCKSTEP or first is None:
            continue
        again = _repeated(folder.kept(case.id))
        if again is not None and not same_result(first, again):
            what = (
                f"chain {first.chain[:12]} and then {again.chain[:12]}"
                if first.chain != again.chain
                else f"{first.verdict.value} and then {again.verdict.value}, with the same frames"
            )
            found.append(f"NOT DETERMINISTIC: {case.id} gave {what} when it was repeated")
    return found
