"""Cases run by processes on this machine, for whoever has no better place."""

import signal
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path

from metro_hil.model.case import Case, CaseResult
from metro_hil.search.find import Evaluate

Files = Mapping[str, Path]
_files: dict[str, Path] = {}
"""Of a worker's process, set as it starts."""


def _begin(files: Files) -> None:
    _files.update(files)
    # Ctrl-C is for the one who asks; what runs here is called off by it.
    signal.signal(signal.SIGINT, signal.SIG_IGN)


def _run(case: Case) -> CaseResult:
    from metro_hil.run.dispatch import run_case

    return run_case(case, files=_files)


@contextmanager
def local_crew(workers: int, files: Files) -> Iterator[Evaluate]:
    """An evaluator over so many processes; their number changes nothing but the time."""
    from concurrent.futures import ProcessPoolExecutor
    from multiprocessing import get_context

    # Spawned: a fork would carry over whatever threads hold at that moment.
    with ProcessPoolExecutor(
        workers, mp_context=get_context("spawn"), initializer=_begin, initargs=(dict(files),)
    ) as pool:

        def evaluate(cases: Sequence[Case]) -> Sequence[CaseResult]:
            return list(pool.map(_run, cases))

        try:
            yield evaluate
        except BaseException:
            pool.shutdown(cancel_futures=True)
            raise
