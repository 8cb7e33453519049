"""Runs cases in processes on this machine."""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path

from firmware_py.interrupts import held_back, leave_to_parent
from metro_hil.model.case import Case, CaseResult
from metro_hil.search.find import Evaluate

Files = Mapping[str, Path]
_files: dict[str, Path] = {}
"""Files of a worker process, set at its start."""


def _begin(files: Files) -> None:
    _files.update(files)
    leave_to_parent()


def _run(case: Case) -> CaseResult:
    from metro_hil.run.dispatch import run_case

    return run_case(case, files=_files)


@contextmanager
def local_crew(workers: int, files: Files) -> Iterator[Evaluate]:
    """Evaluator with the given number of processes, which affects nothing but the time."""
    from concurrent.futures import ProcessPoolExecutor
    from multiprocessing import get_context

    # Spawn instead of fork, which would copy locks that other threads hold at that moment.
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
