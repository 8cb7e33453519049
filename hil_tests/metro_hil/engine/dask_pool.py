"""A worker pool on an existing Dask cluster: same cases and results, more processors."""

import contextlib
import queue
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import msgspec

from firmware_py.clock.clock import NS_PER_S, WallClock
from metro_hil.engine.dask_task import DaskAnswer, DaskOrder, contents, run_order
from metro_hil.engine.errors import EngineError
from metro_hil.engine.program import program_version
from metro_hil.engine.queue import Batch
from metro_hil.engine.worker import RUNNER
from metro_hil.engine.worker_pool import CaseFinished, CaseRaised, Outcome, PoolMessage, WorkerLost

CONNECT_S: Final = 15.0
TASK_S: Final = 1.0
"""Target run time of one task, s: long against the scheduler's overhead, and short enough for a
steady stream of results."""
BATCHES_MAX: Final = 64
"""Maximum number of batches in one task."""
TASKS_PER_THREAD: Final = 2
LOOK_S: Final = 2.0
"""Period at which the pool checks which Dask workers are present, s."""
SMOOTHING: Final = 0.1


class DaskPool:
    """A `WorkerPool` of all threads of a cluster; each thread has its own worker process.

    When a Dask worker is lost, the scheduler gives its tasks to others. A task that was lost with
    too many workers comes back here, and the engine tries its cases one by one.
    """

    def __init__(
        self,
        address: str,
        files: Mapping[str, Path],
        *,
        runner: str = RUNNER,
        case_timeout_s: float | None = None,
    ) -> None:
        """Raises EngineError without a scheduler, or if a worker runs another version of the
        program.

        Args:
            address: HOST:PORT of the scheduler.
        """
        try:
            import distributed
        except ImportError as error:
            raise EngineError(f"dask://{address}: {error}; install the extra `cluster`") from error
        connect: Any = distributed.Client
        try:
            self._client = connect(address, timeout=CONNECT_S, set_as_default=False, name="hil")
        except (OSError, ValueError) as error:
            raise EngineError(f"dask://{address}: no scheduler answers: {error}") from error
        self._address = address
        self._order = DaskOrder(program_version(), runner, contents(files), case_timeout_s, {})
        self._finished: queue.SimpleQueue[Any] = queue.SimpleQueue()
        self._waiting: list[Batch] = []
        self._tasks: dict[Any, dict[int, Batch]] = {}
        self._case_s = TASK_S
        self._stopping = False
        self._lost_workers = 0
        self._clock = WallClock()
        self._updated_ns = self._clock.now_ns()
        try:
            self._members = self._threads_by_worker()
            self._check_programs()
        except BaseException:
            self.close()
            raise

    def _threads_by_worker(self) -> dict[str, int]:
        """Number of threads of each Dask worker, by its address."""
        known = self._client.scheduler_info(n_workers=-1)["workers"]
        return {str(address): int(worker["nthreads"]) for address, worker in known.items()}

    def _check_programs(self) -> None:
        """Check all workers before any case runs; later workers are checked at their first task."""
        try:
            found: Mapping[str, str] = self._client.run(program_version)
        except Exception as error:
            raise EngineError(
                f"dask://{self._address}: its workers cannot import this project: {error}"
            ) from error
        for worker, program in sorted(found.items()):
            self._check_program(worker, program)

    def _check_program(self, worker: str, program: str) -> None:
        if program != program_version():
            raise EngineError(
                f"dask://{self._address}: worker {worker} has version {program} of this project, "
                f"here it is {program_version()}; results of the two may not be mixed"
            )

    @property
    def workers(self) -> int:
        return max(1, sum(self._members.values()))

    @property
    def busy(self) -> int:
        return len(self._waiting) + sum(len(batches) for batches in self._tasks.values())

    @property
    def _size(self) -> int:
        """Number of batches in a task that takes about `TASK_S`."""
        return max(1, min(BATCHES_MAX, round(TASK_S / max(self._case_s, 1e-4))))

    def room(self, plenty: bool) -> bool:
        """`plenty` has no effect: the scheduler moves waiting tasks to idle workers by itself."""
        return not self._stopping and self.busy < TASKS_PER_THREAD * self.workers * self._size

    def hand(self, batch: Batch) -> None:
        """Queue the batch; the next `wait` sends it."""
        self._waiting.append(batch)

    def _send(self) -> None:
        size = min(self._size, -(-len(self._waiting) // self.workers))
        while self._waiting:
            batches = {batch.number: batch for batch in self._waiting[:size]}
            del self._waiting[:size]
            cases = {str(number): batch.cases for number, batch in batches.items()}
            text = msgspec.json.encode(msgspec.structs.replace(self._order, batches=cases))
            task = self._client.submit(run_order, text, pure=False)
            self._tasks[task] = batches
            task.add_done_callback(self._finished.put)

    def wait(self, timeout_s: float) -> Sequence[Outcome]:
        self._send()
        outcomes: list[Outcome] = []
        with contextlib.suppress(queue.Empty):
            task = self._finished.get(timeout=timeout_s)
            while True:
                self._take(task, outcomes)
                task = self._finished.get_nowait()
        if self._clock.now_ns() - self._updated_ns > LOOK_S * NS_PER_S:
            self._update_members(outcomes)
        return outcomes

    def _update_members(self, outcomes: list[Outcome]) -> None:
        self._updated_ns = self._clock.now_ns()
        try:
            members = self._threads_by_worker()
        except Exception as error:
            raise EngineError(f"dask://{self._address}: the scheduler is gone: {error}") from error
        for gone in sorted(self._members.keys() - members.keys()):
            self._lost_workers += 1
            words = f"worker {gone} was lost ({self._lost_workers} so far), others take its cases"
            outcomes.append(PoolMessage(words))
        self._members = members

    def _take(self, task: Any, outcomes: list[Outcome]) -> None:
        batches = self._tasks.pop(task, None)
        if batches is None:
            return
        if task.status == "finished":
            self._on_answer(msgspec.json.decode(task.result(), type=DaskAnswer), batches, outcomes)
            return
        if task.status != "error":
            raise EngineError(
                f"dask://{self._address}: the scheduler dropped a task: {task.status}"
            )
        error = task.exception()
        if isinstance(error, EngineError):
            raise EngineError(f"dask://{self._address}: {error}")
        reason = f"lost by the cluster: {type(error).__name__}: {error}"
        for batch in batches.values():
            outcomes.append(WorkerLost(batch, batch.cases, len(batch.cases), reason))

    def _on_answer(
        self, answer: DaskAnswer, batches: dict[int, Batch], outcomes: list[Outcome]
    ) -> None:
        self._check_program("that came later", answer.program)
        for number, result in answer.results:
            outcomes.append(CaseFinished(batches[number], result))
            self._case_s += SMOOTHING * (result.host.wall_s - self._case_s)
        for number, case_id, traceback in answer.raised:
            outcomes.append(CaseRaised(batches[number], case_id, traceback))
        for loss in answer.losses:
            cases = batches[loss.number].cases
            left = cases[len(cases) - loss.left :]
            outcomes.append(WorkerLost(batches[loss.number], left, loss.begun, loss.reason))

    def stop(self) -> None:
        """The tasks that the scheduler already has run to their end and give results."""
        self._stopping = True
        self._waiting.clear()

    def close(self) -> None:
        with contextlib.suppress(Exception):
            self._client.cancel(list(self._tasks))
        self._tasks.clear()
        self._waiting.clear()
        with contextlib.suppress(Exception):
            self._client.close()
