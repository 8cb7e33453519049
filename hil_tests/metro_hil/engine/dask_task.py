"""Runs batches of cases on a Dask worker, in a separate process whose death harms no other."""

import hashlib
import os
import tempfile
import threading
from collections.abc import Mapping
from pathlib import Path

import msgspec

from metro_hil.engine.local_pool import LocalPool
from metro_hil.engine.program import program_version
from metro_hil.engine.queue import Batch
from metro_hil.engine.worker_pool import CaseFinished, CaseRaised, PoolMessage
from metro_hil.model.case import Case, CaseResult

WAIT_S = 1.0


class DaskOrder(msgspec.Struct, frozen=True):
    """Message from master to Dask worker: cases to run, and everything that they need."""

    program: str
    """Program version that the master runs; a worker of another version computes nothing."""
    runner: str
    files: dict[str, str]
    """File contents, by the name by which cases refer to the file."""
    case_timeout_s: float | None
    batches: dict[str, tuple[Case, ...]]
    """Cases of each batch, by the number of the batch as text."""


class Loss(msgspec.Struct, frozen=True):
    """Cases of a batch that never got a result, as in `WorkerLost`."""

    number: int
    left: int
    """Number of cases without a result, at the end of the batch."""
    begun: int
    reason: str


class DaskAnswer(msgspec.Struct, frozen=True):
    """Message from Dask worker to master: results and losses of the cases of one order."""

    program: str
    results: tuple[tuple[int, CaseResult], ...] = ()
    """Results, each with the number of its batch."""
    raised: tuple[tuple[int, str, str], ...] = ()
    """Cases whose run raised an exception: number of the batch, id of the case, traceback."""
    losses: tuple[Loss, ...] = ()


_mine = threading.local()
"""Worker process of each thread of a Dask worker. It lives until the thread gets another campaign,
and dies with the Dask worker."""


def run_order(text: bytes) -> bytes:
    """Run one order, given as JSON, and return its answer as JSON."""
    order = msgspec.json.decode(text, type=DaskOrder)
    if order.program != program_version():
        return msgspec.json.encode(DaskAnswer(program_version()))
    return msgspec.json.encode(_work(order, _pool_for(order)))


def _pool_for(order: DaskOrder) -> LocalPool:
    wanted = (order.runner, order.files, order.case_timeout_s)
    if getattr(_mine, "wanted", None) != wanted:
        if hasattr(_mine, "crew"):
            _mine.crew.close()
        paths = {name: _on_disk(content) for name, content in order.files.items()}
        _mine.crew = LocalPool(1, paths, runner=order.runner, case_timeout_s=order.case_timeout_s)
        _mine.wanted = wanted
    crew: LocalPool = _mine.crew
    return crew


def _on_disk(content: str) -> Path:
    """Store `content` in a file of this user whose name is a hash of the content."""
    folder = Path(tempfile.gettempdir()) / f"metro_hil_files_{os.getuid()}"
    folder.mkdir(mode=0o700, exist_ok=True)
    path = folder / f"{hashlib.sha256(content.encode()).hexdigest()}.toml"
    # Another thread may write the same file now; the atomic replacement always leaves a whole file.
    part = folder / f"{path.name}.{os.getpid()}.{threading.get_ident()}"
    part.write_text(content, encoding="utf-8")
    part.replace(path)
    return path


def _work(order: DaskOrder, crew: LocalPool) -> DaskAnswer:
    results: list[tuple[int, CaseResult]] = []
    raised: list[tuple[int, str, str]] = []
    losses: list[Loss] = []
    for name, cases in order.batches.items():
        crew.hand(Batch(int(name), cases))
    while crew.busy:
        for outcome in crew.wait(WAIT_S):
            if isinstance(outcome, PoolMessage):
                continue
            number = outcome.batch.number
            if isinstance(outcome, CaseFinished):
                results.append((number, outcome.result))
            elif isinstance(outcome, CaseRaised):
                raised.append((number, outcome.case_id, outcome.traceback))
            else:
                losses.append(Loss(number, len(outcome.left), outcome.begun, outcome.reason))
    return DaskAnswer(program_version(), tuple(results), tuple(raised), tuple(losses))


def contents(files: Mapping[str, Path]) -> dict[str, str]:
    return {name: path.read_text(encoding="utf-8") for name, path in sorted(files.items())}
