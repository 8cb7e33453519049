"""Interface between a campaign and the pools that run its cases."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

from metro_hil.engine.queue import Batch
from metro_hil.model.case import Case, CaseResult


@dataclass(frozen=True, slots=True)
class CaseFinished:
    """One case has its result."""

    batch: Batch
    result: CaseResult


@dataclass(frozen=True, slots=True)
class CaseRaised:
    """Running one case raised an exception: a mistake of this program, not of the controller."""

    batch: Batch
    case_id: str
    traceback: str


@dataclass(frozen=True, slots=True)
class WorkerLost:
    """A worker ended before its batch did."""

    batch: Batch
    left: tuple[Case, ...]
    """Cases without a result, in order."""
    begun: int
    """Number of cases at the front of `left` that may be the cause; 0 if the batch had not
    begun."""
    reason: str


@dataclass(frozen=True, slots=True)
class PoolMessage:
    """A message for the user."""

    words: str


Outcome = CaseFinished | CaseRaised | WorkerLost | PoolMessage


class WorkerPool(Protocol):
    """Takes batches and gives outcomes. A batch without further outcomes is over."""

    @property
    def workers(self) -> int:
        """Number of workers that run at the same time."""
        ...

    @property
    def busy(self) -> int:
        """Number of batches that are not over."""
        ...

    def room(self, plenty: bool) -> bool:
        """Whether `hand` may be called; with `plenty`, a batch may also wait at a busy worker."""
        ...

    def hand(self, batch: Batch) -> None: ...

    def wait(self, timeout_s: float) -> Sequence[Outcome]:
        """Outcomes since the last call, at the latest after the timeout. Raises EngineError."""
        ...

    def stop(self) -> None:
        """Start no further case: those not begun come back in a `WorkerLost` with `begun` 0."""
        ...

    def close(self) -> None:
        """End all workers at once."""
        ...
