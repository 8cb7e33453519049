"""Cases run by processes on this machine, for whoever has no better place."""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path

from firmware_py.interrupts import held_back, leave_to_parent
from metro_hil.model.case import Case, CaseResult
from metro_hil.search.find import Evaluate

Files = Mapping[str, Path]
_files: dict[str, Path] = {}
"""Of a worker's process, set as it starts."""


def _begin(files: Files) -> None:
    _files.update(files)
    leave_to_parent()


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
            with held_back():
                results = pool.map(_run, cases)
            return list(results)

        try:
            yield evaluate
        except BaseException:
            pool.shutdown(cancel_futures=True)
            raise
