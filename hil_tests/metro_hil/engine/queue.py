"""Which case is handed out next, how often one is tried, and when it is lost. Pure."""

from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Final

from metro_hil.model.case import BenchKind, Case, CaseResult, Host, Verdict

ATTEMPTS_MAX: Final = 3
GROUP_CASES_MAX: Final = 64
"""So that a group is shared by several workers and little is lost with one of them."""
CHUNKS_PER_WORKER: Final = 2
RESERVE_PER_WORKER: Final = 2
"""While so many batches are left for each worker, one may wait at a worker that is busy. Nearer to
the end a waiting batch would wait for the wrong one."""


@dataclass(frozen=True, slots=True)
class Batch:
    """Handed to one worker in one piece."""

    number: int
    cases: tuple[Case, ...]
    attempt: int = 1
    folder: str | None = None
    """Keeps the logs of its only case."""

    @property
    def alone(self) -> bool:
        """Real time: nothing else may run on the machine meanwhile."""
        return any(case.bench is not BenchKind.LOCKSTEP for case in self.cases)


GroupKey = Callable[[Case], bytes | None]
"""The same for cases that are one run up to their branch; None for a case without one."""


def no_group(case: Case) -> bytes | None:
    return None


class WorkQueue:
    """What is still to be run, in the order of the campaign; real time comes last."""

    def __init__(
        self,
        cases: Iterable[Case],
        workers: int,
        *,
        key: GroupKey = no_group,
        attempts_max: int = ATTEMPTS_MAX,
    ) -> None:
        self._numbers = 0
        self._attempts_max = attempts_max
        self._waiting: deque[Batch] = deque()
        for chunk in chunks(cases, workers, key):
            self._waiting.append(self._batch(chunk, 1))
        self._reserve = RESERVE_PER_WORKER * workers

    def _batch(self, cases: tuple[Case, ...], attempt: int) -> Batch:
        self._numbers += 1
        return Batch(self._numbers, cases, attempt)

    def __len__(self) -> int:
        """Batches that wait."""
        return len(self._waiting)

    @property
    def plenty(self) -> bool:
        """So much waits that a busy worker may be given one more batch."""
        return len(self._waiting) > self._reserve

    def peek(self) -> Batch | None:
        return self._waiting[0] if self._waiting else None

    def take(self) -> Batch:
        return self._waiting.popleft()

    def put_back(self, batch: Batch, cases: Sequence[Case]) -> None:
        """Cases of a batch that were never begun; they are next."""
        if cases:
            self._waiting.appendleft(self._batch(tuple(cases), batch.attempt))

    def failed(
        self, batch: Batch, left: Sequence[Case], begun: int, reason: str
    ) -> list[CaseResult]:
        """A batch ended with its worker.

        Args:
            left: its cases without a result, in order.
            begun: so many at the front of `left` may be the cause.

        Returns results for those that have been tried often enough: LOST. The others wait again, at
        the end, the suspicious ones each in a batch of its own.
        """
        suspects, others = left[:begun], left[begun:]
        self.put_back(batch, others)
        if batch.attempt >= self._attempts_max:
            return [lost(case, reason, batch.attempt) for case in suspects]
        for case in suspects:
            self._insert(self._batch((case,), batch.attempt + 1))
        return []

    def _insert(self, batch: Batch) -> None:
        """At the end, but real time stays behind virtual time."""
        place = len(self._waiting)
        if not batch.alone:
            place = sum(not waiting.alone for waiting in self._waiting)
        self._waiting.insert(place, batch)


def lost(case: Case, reason: str, attempts: int) -> CaseResult:
    return CaseResult(
        case_id=case.id,
        index=case.index,
        verdict=Verdict.LOST,
        reason=reason,
        host=Host(attempts=attempts),
    )


def chunks(
    cases: Iterable[Case], workers: int, key: GroupKey = no_group
) -> Iterator[tuple[Case, ...]]:
    """One case each; those of a group together, in pieces that keep all workers busy."""
    groups: dict[bytes | int, list[Case]] = {}
    for case in sorted(cases, key=lambda case: (case.bench is not BenchKind.LOCKSTEP, case.index)):
        common = key(case) if case.bench is BenchKind.LOCKSTEP else None
        groups.setdefault(case.index if common is None else common, []).append(case)
    for group in groups.values():
        size = min(GROUP_CASES_MAX, -(-len(group) // (CHUNKS_PER_WORKER * workers)))
        for first in range(0, len(group), size):
            yield tuple(group[first : first + size])
