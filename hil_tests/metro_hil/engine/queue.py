"""Decides which case is next, how often a case is tried, and when it is lost. Pure."""

from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Final

from metro_hil.model.case import BenchKind, Case, CaseResult, Host, Verdict

ATTEMPTS_MAX: Final = 3
GROUP_CASES_MAX: Final = 64
"""Maximum number of cases in a batch, so that several workers share a group and the loss of a
worker costs little."""
CHUNKS_PER_WORKER: Final = 2
RESERVE_PER_WORKER: Final = 2
"""A busy worker gets one more batch only while more than this many batches are left for each
worker. Near the end, a batch could otherwise wait behind a long one while another worker is
idle."""


@dataclass(frozen=True, slots=True)
class Batch:
    """Cases that one worker gets in one piece."""

    number: int
    cases: tuple[Case, ...]
    attempt: int = 1
    folder: str | None = None
    """Folder for the logs of the batch's only case."""

    @property
    def alone(self) -> bool:
        """Whether the batch runs in real time, while nothing else may run on the machine."""
        return any(case.bench is not BenchKind.LOCKSTEP for case in self.cases)


GroupKey = Callable[[Case], bytes | None]
"""Gives the same key for cases that are one run up to their branch; None for a case without
branch."""


def no_group(case: Case) -> bytes | None:
    return None


class WorkQueue:
    """Batches still to be run, in the campaign's order; real time comes last."""

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
        """Number of batches that wait."""
        return len(self._waiting)

    @property
    def plenty(self) -> bool:
        """Whether so many batches wait that a busy worker may get one more."""
        return len(self._waiting) > self._reserve

    def peek(self) -> Batch | None:
        return self._waiting[0] if self._waiting else None

    def take(self) -> Batch:
        return self._waiting.popleft()

    def put_back(self, batch: Batch, cases: Sequence[Case]) -> None:
        """Put cases of a batch that never began at the front of the queue."""
        if cases:
            self._waiting.appendleft(self._batch(tuple(cases), batch.attempt))

    def failed(
        self, batch: Batch, left: Sequence[Case], begun: int, reason: str
    ) -> list[CaseResult]:
        """Handle a batch that ended with its worker.

        Args:
            left: the batch's cases without a result, in order.
            begun: number of cases at the front of `left` that may be the cause.

        Returns a LOST result for each suspect that has been tried often enough. The other suspects
        wait at the end of the queue, each in its own batch; cases that never began are next.
        """
        suspects, others = left[:begun], left[begun:]
        self.put_back(batch, others)
        if batch.attempt >= self._attempts_max:
            return [lost(case, reason, batch.attempt) for case in suspects]
        for case in suspects:
            self._insert(self._batch((case,), batch.attempt + 1))
        return []

    def _insert(self, batch: Batch) -> None:
        """Insert at the end, but keep real time behind virtual time."""
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
    """Cases of one group together, in pieces that keep all workers busy; others one by one."""
    groups: dict[bytes | int, list[Case]] = {}
    for case in sorted(cases, key=lambda case: (case.bench is not BenchKind.LOCKSTEP, case.index)):
        common = key(case) if case.bench is BenchKind.LOCKSTEP else None
        groups.setdefault(case.index if common is None else common, []).append(case)
    for group in groups.values():
        size = min(GROUP_CASES_MAX, -(-len(group) // (CHUNKS_PER_WORKER * workers)))
        for first in range(0, len(group), size):
            yield tuple(group[first : first + size])
