"""Many seeds on several processes: each is a run by itself, so they may run in any order."""

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
"""So many seeds for each process wait for their turn: enough that none is idle."""
BEGINNING: Final = b'{"seed": '
"""Of each line of a journal."""


def cpu_ns() -> int:
    """Processor time of this process so far."""
    usage = resource.getrusage(resource.RUSAGE_SELF)
    return int((usage.ru_utime + usage.ru_stime) * NS_PER_S)


@dataclass(slots=True)
class Total:
    """Of all results so far."""

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
    """Results as they come. With one worker all happens here, in the order of the seeds.

    Whoever takes no more of them closes it: what runs then ends at once.
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
    """It ends with whoever started it, who hears Ctrl-C for all."""
    leave_to_parent()
    die_with_parent(parent)


def _seed(result: RunResult) -> int:
    return result.seed


class SeedJournal:
    """Results as lines of JSON in a file: what is in it need not be run again."""

    def __init__(self, path: Path) -> None:
        """Raises OSError, and ValueError naming file and line for one that is none of ours."""
        self._path = path
        path.open("a", encoding="utf-8").close()
        self.results = list(_read(path))

    def append(self, result: RunResult) -> None:
        with self._path.open("a", encoding="utf-8") as file:
            file.write(json.dumps(as_table(result)) + "\n")


def as_table(result: "RunResult | Total") -> dict[str, Any]:
    """For JSON."""
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
            # A killed program had not finished its last line.
            os.truncate(path, path.stat().st_size - len(line))
            break
        try:
            told: Any = json.loads(line)
        except ValueError:
            told = None
        if not isinstance(told, dict):
            raise ValueError(f"{path}:{number}: is no result of a seed: {line[:40]!a}")
        if set(told) != names:
            differing = sorted(set(told) ^ names)
            raise ValueError(f"{path}:{number}: has not the fields of a result: {differing}")
        for name in ("faults", "looked", "covered", "messages"):
            told[name] = Counter(told[name])
        yield RunResult(**told)


def repeat_with(result: RunResult, options: Sequence[str] = ()) -> str:
    """The one command that tells the story of a seed again."""
    return " ".join(["hil simulate", f"--seed {result.seed}", *options, "--trace"])
