"""Those who run cases, as the campaign sees them."""

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
    """A batch ended with its worker."""

    batch: Batch
    left: tuple[Case, ...]
    """Without a result, in order."""
    begun: int
    """So many at the front of `left` may be the cause; 0 when the batch was still waiting."""
    reason: str


@dataclass(frozen=True, slots=True)
class PoolMessage:
    """Something that people shall know of."""

    words: str


Outcome = CaseFinished | CaseRaised | WorkerLost | PoolMessage


class WorkerPool(Protocol):
    """Takes batches and gives outcomes. A batch that is not heard of any more is over."""

    @property
    def workers(self) -> int:
        """That work at the same time."""
        ...

    @property
    def busy(self) -> int:
        """Batches that are not over."""
        ...

    def room(self, plenty: bool) -> bool:
        """Whether another batch may be handed over; with `plenty`, also to wait at a worker."""
        ...

    def hand(self, batch: Batch) -> None: ...

    def wait(self, timeout_s: float) -> Sequence[Outcome]:
        """What happened; returns early when something did. Raises EngineError."""
        ...

    def stop(self) -> None:
        """Begin nothing that was not begun: it comes back as `WorkerLost` with none begun."""
        ...

    def close(self) -> None:
        """End all at once."""
        ...
