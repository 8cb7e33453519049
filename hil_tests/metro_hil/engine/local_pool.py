"""Worker processes on this machine: feeds and watches them, replaces those that die or hang.

A fork server imports everything once and forks them.
"""

import os
import selectors
import signal
import tempfile
from collections import deque
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Final

import msgspec

from firmware_py.clock.clock import NS_PER_S, WallClock
from metro_hil.engine.errors import EngineError
from metro_hil.engine.fork_server import ForkServer
from metro_hil.engine.messages import (
    CaseBatch,
    Done,
    Over,
    Raised,
    ToMaster,
    ToWorker,
    WorkerHello,
    WorkerReady,
    pack,
    take_for_master,
)
from metro_hil.engine.queue import Batch
from metro_hil.engine.worker import RUNNER
from metro_hil.engine.worker_pool import CaseFinished, CaseRaised, Outcome, WorkerLost
from metro_hil.model.case import BenchKind, Case
from metro_hil.model.native_copy import prepare, worker_environment

LEASE_S: Final = 120.0
"""Maximum wall time of a case in virtual time, and of the start of a worker, s."""
TOO_LATE: Final = "no result within"
"""Beginning of the reason of a case that took too long."""
START_FAILURES_MAX: Final = 3
READ_BYTES: Final = 1 << 18
LAST_LINES: Final = 6
ONE_THREAD: Final = dict.fromkeys(
    ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1"
)
"""Environment that limits numerical libraries to one thread, because a worker has one processor."""


def lease_s(case: Case, asked_s: float | None) -> float:
    """Wall time after which the pool treats a case as hanging, s."""
    if asked_s is not None:
        return asked_s
    return LEASE_S + (2.0 * case.setup.duration_s if case.bench is not BenchKind.LOCKSTEP else 0.0)


class _Entry:
    """One batch that a worker holds."""

    def __init__(self, batch: Batch) -> None:
        self.batch = batch
        self.left = deque(batch.cases)

    def gone(self, begun: bool, reason: str) -> WorkerLost:
        """The loss of this batch. Its first case without a result is the suspect.

        If the batch gave no result at all, every case of it is a suspect.
        """
        first = len(self.left) == len(self.batch.cases)
        suspects = (len(self.left) if first else min(1, len(self.left))) if begun else 0
        return WorkerLost(self.batch, tuple(self.left), suspects, reason)


class Worker:
    """One worker process, with its pipes and its batches."""

    def __init__(self, hello: WorkerHello, server: ForkServer, now_ns: int) -> None:
        self.stderr = tempfile.TemporaryFile()  # noqa: SIM115
        theirs, mine = os.pipe()
        self.input = os.fdopen(mine, "wb", buffering=0)
        mine, output = os.pipe()
        self.output = os.fdopen(mine, "rb", buffering=0)
        self.process = server.fork((theirs, output, self.stderr.fileno()))
        os.close(theirs)
        os.close(output)
        os.set_blocking(self.input.fileno(), False)
        os.set_blocking(self.output.fileno(), False)
        self.received, self.unsent = bytearray(), bytearray()
        self.entries: deque[_Entry] = deque()
        self.ready = False
        self.since_ns = now_ns
        """When the worker began its present case, or its own start."""
        self.send(hello)

    def send(self, message: ToWorker) -> None:
        self.unsent += pack(message)
        self.flush()

    def flush(self) -> None:
        """Write as much as the pipe takes. A dead worker is noticed when reading."""
        while self.unsent:
            try:
                sent = os.write(self.input.fileno(), self.unsent)
            except BlockingIOError:
                return
            except OSError:
                self.unsent.clear()
                return
            del self.unsent[:sent]

    def last_words(self) -> str:
        """The last lines of the worker's standard error, joined into one line."""
        self.stderr.seek(0)
        text = self.stderr.read().decode("utf-8", "replace")
        return " | ".join(line.strip() for line in text.strip().splitlines()[-LAST_LINES:])

    def end_words(self) -> str:
        code = self.process.end()
        words = f"signal {signal.Signals(-code).name}" if code < 0 else f"exit code {code}"
        said = self.last_words()
        return f"the worker ended with {words}" + (f": {said}" if said else "")

    def kill(self) -> None:
        self.process.kill()
        self.process.wait()
        self.release()

    def release(self) -> None:
        for file in (self.input, self.output, self.stderr):
            file.close()


class PoolServer:
    """The fork server of one or more pools. It starts with their first worker."""

    def __init__(
        self, runner: str = RUNNER, nice: int = 0, environment: Mapping[str, str] | None = None
    ) -> None:
        """Args:
        runner: `module:function`.
        nice: added to the workers' niceness.
        environment: environment of the workers; None for that of this process, with the
            compiled copy if there is one.
        """
        self.runner, self._nice, self._environment = runner, nice, environment
        self.started: ForkServer | None = None

    def running(self) -> ForkServer:
        """The fork server; another one if it has ended, and its workers with it."""
        if self.started is not None and not self.started.runs:
            self.close()
        if self.started is None:
            environment = self._environment or worker_environment(
                {**ONE_THREAD, **os.environ}, prepare("hil")
            )
            self.started = ForkServer(self.runner, environment, self._nice)
        return self.started

    def close(self) -> None:
        """End the server; workers that go on working are killed."""
        if self.started is not None:
            self.started.close()
            self.started = None


class LocalPool:
    """A `WorkerPool` of processes, which die with this process, however it ends."""

    def __init__(
        self,
        workers: int,
        files: Mapping[str, Path],
        *,
        runner: str = RUNNER,
        case_timeout_s: float | None = None,
        nice: int = 0,
        environment: Mapping[str, str] | None = None,
        server: PoolServer | None = None,
    ) -> None:
        """The processes start with the first batches.

        Args:
            workers: maximum number of processes; at least 1.
            files: paths, by the name by which cases refer to a file.
            runner, nice, environment: as for `PoolServer`, for a server of this pool alone.
            case_timeout_s: wall time for each case; None for `lease_s`.
            server: forks the workers, and outlives the pool.
        """
        assert workers >= 1
        self._workers_max = workers
        self._servers = server or PoolServer(runner, nice, environment)
        self._ends_server = server is None
        self._hello = WorkerHello(
            self._servers.runner, {name: str(path) for name, path in files.items()}
        )
        self._case_timeout_s = case_timeout_s
        self._clock = WallClock()
        self._crew: list[Worker] = []
        self._selector = selectors.DefaultSelector()
        self._start_failures = 0
        self._stopping = False

    @property
    def workers(self) -> int:
        return self._workers_max

    @property
    def busy(self) -> int:
        return sum(len(worker.entries) for worker in self._crew)

    @property
    def pids(self) -> list[int]:
        return [worker.process.known_pid() for worker in self._crew]

    @property
    def server_pid(self) -> int | None:
        """Process id of the fork server; None before the first batch."""
        started = self._servers.started
        return None if started is None else started.process.pid

    @property
    def ready(self) -> int:
        """Number of workers that have imported everything."""
        return sum(worker.ready for worker in self._crew)

    def room(self, plenty: bool) -> bool:
        if self._stopping:
            return False
        if self.busy < self._workers_max:
            return True
        return plenty and any(len(worker.entries) < 2 for worker in self._crew)

    def hand(self, batch: Batch) -> None:
        worker = min(self._crew, key=lambda other: len(other.entries), default=None)
        if worker is None or (worker.entries and len(self._crew) < self._workers_max):
            worker = self._start()
        if not worker.entries and worker.ready:
            worker.since_ns = self._clock.now_ns()
        worker.entries.append(_Entry(batch))
        worker.send(CaseBatch(batch.number, batch.cases, batch.folder))
        self._watch(worker)

    def _start(self) -> Worker:
        try:
            worker = Worker(self._hello, self._servers.running(), self._clock.now_ns())
        except OSError as error:
            raise EngineError(f"no worker process can be started: {error.strerror}") from error
        self._crew.append(worker)
        self._selector.register(worker.output, selectors.EVENT_READ, worker)
        self._watch(worker)
        return worker

    def _watch(self, worker: Worker) -> None:
        """Wait for room in a worker's pipe only while data is unsent."""
        watched = worker.input in self._selector.get_map()
        if worker.unsent and not watched:
            self._selector.register(worker.input, selectors.EVENT_WRITE, worker)
        elif not worker.unsent and watched:
            self._selector.unregister(worker.input)

    def wait(self, timeout_s: float) -> Sequence[Outcome]:
        outcomes: list[Outcome] = []
        for key, _ in self._selector.select(timeout_s):
            worker: Worker = key.data
            if worker not in self._crew:
                continue
            if key.fileobj is worker.input:
                worker.flush()
                self._watch(worker)
            else:
                self._read(worker, outcomes)
        self._end_hanging(outcomes)
        return outcomes

    def _read(self, worker: Worker, outcomes: list[Outcome]) -> None:
        try:
            data = os.read(worker.output.fileno(), READ_BYTES)
        except BlockingIOError:
            return
        worker.received += data
        before = len(worker.entries)
        try:
            for message in take_for_master(worker.received):
                self._on_message(worker, message, outcomes)
        except msgspec.DecodeError as error:
            worker.process.kill()
            self._replace(worker, f"the worker sent an unreadable message: {error}", outcomes)
            return
        if not data:
            self._replace(worker, worker.end_words(), outcomes)
        elif self._stopping and len(worker.entries) < before:
            self._give_back(worker, outcomes)

    def _on_message(self, worker: Worker, message: ToMaster, outcomes: list[Outcome]) -> None:
        worker.since_ns = self._clock.now_ns()
        if isinstance(message, WorkerReady):
            worker.ready = True
            self._start_failures = 0
            return
        entry = worker.entries[0]
        assert message.number == entry.batch.number, "a worker takes its batches in order"
        if isinstance(message, Over):
            assert not entry.left, "a batch is over when all its cases are"
            worker.entries.popleft()
            return
        case = entry.left.popleft()
        if isinstance(message, Done):
            assert message.result.case_id == case.id
            outcomes.append(CaseFinished(entry.batch, message.result))
        elif isinstance(message, Raised):
            assert message.case_id == case.id
            outcomes.append(CaseRaised(entry.batch, case.id, message.traceback))

    def _end_hanging(self, outcomes: list[Outcome]) -> None:
        now_ns = self._clock.now_ns()
        for worker in list(self._crew):
            limit_s = LEASE_S
            if worker.ready:
                if not worker.entries:
                    continue
                case = next(iter(worker.entries[0].left), None)
                limit_s = LEASE_S if case is None else lease_s(case, self._case_timeout_s)
            if now_ns - worker.since_ns > limit_s * NS_PER_S:
                worker.process.kill()
                said = worker.last_words()
                words = f"{TOO_LATE} {limit_s:g} s (--case-timeout)"
                self._replace(worker, words + (f": {said}" if said else ""), outcomes)

    def _replace(self, worker: Worker, reason: str, outcomes: list[Outcome]) -> None:
        """Remove a dead worker; the next batch starts another one."""
        if not worker.ready:
            self._start_failures += 1
            if self._start_failures >= START_FAILURES_MAX:
                raise EngineError(f"workers cannot be started: {reason}")
        for place, entry in enumerate(worker.entries):
            begun = place == 0 and worker.ready
            outcomes.append(entry.gone(begun, reason))
        self._remove(worker)

    def _give_back(self, worker: Worker, outcomes: list[Outcome]) -> None:
        """Give back the batches that wait at a worker, and end it before it begins them."""
        outcomes += [entry.gone(begun=False, reason="stopped") for entry in worker.entries]
        self._remove(worker)

    def _remove(self, worker: Worker) -> None:
        self._crew.remove(worker)
        for file in (worker.input, worker.output):
            if file in self._selector.get_map():
                self._selector.unregister(file)
        worker.kill()

    def stop(self) -> None:
        self._stopping = True
        for worker in list(self._crew):
            if not worker.entries:
                self._remove(worker)

    def close(self) -> None:
        """Idle workers end by themselves once their pipe is closed; busy ones are killed."""
        for worker in self._crew:
            self._selector.unregister(worker.output)
            if worker.entries:
                worker.process.kill()
            elif worker.input in self._selector.get_map():
                self._selector.unregister(worker.input)
            worker.input.close()
        if self._ends_server:
            self._servers.close()
        for worker in self._crew:
            worker.release()
        self._crew.clear()
        self._selector.close()
