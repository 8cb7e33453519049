"""Runs many seeds in several processes. Seeds are independent, so they may finish in any order."""

import json
import multiprocessing
import os
import resource
from collections import Counter
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any, Final

from firmware_py.clock.realtime import die_with_parent
from firmware_py.interrupts import held_back, leave_to_parent
from metro_hil.simulation.run import RunResult

NS_PER_S: Final = 1_000_000_000
AHEAD: Final = 2
"""Number of queued seeds for each worker process; two keep every worker busy."""
BEGINNING: Final = b'{"seed": '
"""First bytes of each line of a seed journal."""


def cpu_ns() -> int:
    """Return the processor time that this process has used, in nanoseconds."""
    usage = resource.getrusage(resource.RUSAGE_SELF)
    return int((usage.ru_utime + usage.ru_stime) * NS_PER_S)


@dataclass(slots=True)
class Total:
    """Sums over the results of many seeds."""

    runs: int = 0
    simulated_s: float = 0.0
    train_s: float = 0.0
    events: int = 0
    cpu_s: float = 0.0
    emergencies: int = 0
    recovery_s_max: float = 0.0
    broken: list[RunResult] = field(default_factory=list)
    faults: Counter[str] = field(default_factory=Counter)
    looked: Counter[str] = field(default_factory=Counter)
    covered: Counter[str] = field(default_factory=Counter)
    messages: Counter[str] = field(default_factory=Counter)

    def add(self, result: RunResult) -> None:
        self.runs += 1
        self.simulated_s += result.simulated_s
        self.train_s += result.train_s
        self.events += result.events
        self.cpu_s += result.cpu_s
        self.emergencies += result.emergencies
        self.recovery_s_max = max(self.recovery_s_max, result.recovery_s)
        if result.invariant:
            self.broken.append(result)
        for name in ("faults", "looked", "covered", "messages"):
            getattr(self, name).update(getattr(result, name))


def run_many(
    seeds: Iterable[int], run: Callable[[int], RunResult], *, workers: int
) -> Generator[RunResult]:
    """Yield results as they finish.

    A single worker runs in this process, in the order of the seeds.

    A caller that closes the generator early ends all running seeds at once.
    """
    if workers == 1:
        yield from map(run, seeds)
        return
    pending: set[Future[RunResult]] = set()
    context = multiprocessing.get_context("spawn")
    before = set(multiprocessing.active_children())
    with ProcessPoolExecutor(
        workers, mp_context=context, initializer=_begin_worker, initargs=(os.getpid(),)
    ) as pool:
        try:
            for seed in seeds:
                with held_back():
                    pending.add(pool.submit(run, seed))
                if len(pending) >= AHEAD * workers:
                    done, pending = wait(pending, return_when=FIRST_COMPLETED)
                    yield from sorted((each.result() for each in done), key=_seed)
            yield from sorted((each.result() for each in wait(pending).done), key=_seed)
        except BaseException:
            for worker in set(multiprocessing.active_children()) - before:
                worker.terminate()
            raise
        finally:
            pool.shutdown(cancel_futures=True)


def _begin_worker(parent: int) -> None:
    """Let the worker end with its parent process; only the parent handles Ctrl-C."""
    leave_to_parent()
    die_with_parent(parent)


def _seed(result: RunResult) -> int:
    return result.seed


class SeedJournal:
    """Results of seeds as lines of JSON in a file. Seeds in the file need not run again."""

    def __init__(self, path: Path) -> None:
        """Read the results that the file holds.

        Raises OSError, and ValueError naming file and line for a line that is not a result.
        """
        self._path = path
        path.open("a", encoding="utf-8").close()
        self.results = list(_read(path))

    def append(self, result: RunResult) -> None:
        with self._path.open("a", encoding="utf-8") as file:
            file.write(json.dumps(as_table(result)) + "\n")


def as_table(result: "RunResult | Total") -> dict[str, Any]:
    """Return the fields of a result as values that JSON can hold."""
    table: dict[str, Any] = {}
    for each in fields(result):
        value = getattr(result, each.name)
        if isinstance(value, Counter):
            value = dict(value)
        elif isinstance(value, list):
            value = [as_table(item) for item in value]
        table[each.name] = value
    return table


def _read(path: Path) -> Iterator[RunResult]:
    names = {each.name for each in fields(RunResult)}
    *whole, torn = path.read_bytes().split(b"\n")
    for number, line in enumerate([*whole, torn] if torn else whole, 1):
        if number > len(whole) and (line.startswith(BEGINNING) or BEGINNING.startswith(line)):
            # The program was killed while it wrote its last line.
            os.truncate(path, path.stat().st_size - len(line))
            break
        try:
            told: Any = json.loads(line)
        except ValueError:
            told = None
        if not isinstance(told, dict):
            raise ValueError(f"{path}:{number}: is not the result of a seed: {line[:40]!a}")
        if set(told) != names:
            differing = sorted(set(told) ^ names)
            raise ValueError(
                f"{path}:{number}: the fields differ from those of a result: {differing}"
            )
        for name in ("faults", "looked", "covered", "messages"):
            told[name] = Counter(told[name])
        yield RunResult(**told)


def repeat_with(result: RunResult, options: Sequence[str] = ()) -> str:
    """Return the command that repeats a seed and prints its event log."""
    return " ".join(["hil simulate", f"--seed {result.seed}", *options, "--trace"])
