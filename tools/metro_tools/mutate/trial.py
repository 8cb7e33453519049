"""Tries mutants against tests: the tests are collected once, and each mutant runs them in a
fork.
"""

import dataclasses
import gc
import json
import os
import sys
import tempfile
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import CodeType, FrameType, ModuleType
from typing import Any, TextIO

import pytest

from metro_tools.mutate.examples import few, same_always
from metro_tools.mutate.forks import (
    EXIT_ANEW,
    EXIT_KILLED,
    Pool,
    cpu_s,
    fork,
    limit,
    result_of,
    write_line,
)
from metro_tools.mutate.fresh_import import last_told, tell_test, try_fresh
from metro_tools.mutate.module_finder import Living, NotSwappableError
from metro_tools.mutate.mutations import Mutant, mutants_of, mutated
from metro_tools.mutate.result import KILLED, SURVIVED, UNREACHED
from metro_tools.mutate.task import PYTEST_ARGS, FreshImportTask, MutantOrder, MutantTask


@dataclass(frozen=True, slots=True)
class Baseline:
    """Properties of the tests without any mutation."""

    duration_s: Mapping[str, float]
    """Duration of each test."""
    reached: Mapping[str, frozenset[str]]
    """Functions that each test runs, as path:qualified name."""


class Trials:
    """A pytest plugin that runs the tests once for every mutant."""

    def __init__(self, task: MutantTask, report: TextIO) -> None:
        self._task, self._report = task, report
        self._paths = {str(Path(task.root) / module) for module in task.modules}
        self._on_import: set[str] = set()
        """Functions that run during collection; a mutation in them needs a fresh process."""
        self._collecting_s = 0.0
        self._places: dict[tuple[str, int], str] = {}
        self._orders: dict[tuple[str, int], MutantOrder] = {}
        self._killers: Counter[tuple[str, str]] = Counter()
        """Number of mutations in one function that a test has detected so far."""
        self._fresh_imports: list[MutantOrder] = []
        self.failed: str | None = None

    @pytest.hookimpl(wrapper=True, tryfirst=True)
    def pytest_collection(self, session: pytest.Session) -> Iterator[None]:
        same_always()
        with _watching(self._paths, self._on_import):
            result = yield
        few(session.items)
        self._collecting_s = cpu_s()
        return result

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        if report.failed and self.failed is None:
            self.failed = report.nodeid

    def pytest_runtestloop(self, session: pytest.Session) -> bool:
        if session.testsfailed:
            self._send(error="the tests cannot be collected, even without a mutant")
            return True
        baseline, words = self._baseline(session.items)
        if baseline is None:
            self._send(error=f"fails even without a mutant: {words}")
            return True
        with tempfile.TemporaryDirectory() as folder:
            self._try_all(session.items, baseline, folder)
        return True

    @property
    def left(self) -> FreshImportTask:
        """The mutants that need processes of their own."""
        foreign = [name for name, module in sys.modules.items() if self._is_foreign(name, module)]
        return FreshImportTask(tuple(self._fresh_imports), tuple(foreign))

    def _is_foreign(self, name: str, module: ModuleType) -> bool:
        file = getattr(module, "__file__", None)
        if file is None or name.startswith(("_pytest", "_hypothesis_pytest", "__")):
            return False
        return "site-packages" in file or not file.startswith(f"{self._task.root}/")

    def _baseline(self, items: Sequence[pytest.Item]) -> tuple[Baseline | None, str]:
        """Run all tests once, in a fork that no other process is forked from."""
        pid, pipe = fork(lambda told: self._run_watched(items, told))
        with pipe:
            text = pipe.read()
        _, status = os.waitpid(pid, 0)
        if os.waitstatus_to_exitcode(status) != 0 or not text:
            return None, text or "a test ended the process"
        told = json.loads(text)
        return Baseline(
            {name: entry[0] for name, entry in told.items()},
            {name: frozenset(entry[1]) for name, entry in told.items()},
        ), ""

    def _run_watched(self, items: Sequence[pytest.Item], told: TextIO) -> int:
        entries: dict[str, tuple[float, list[str]]] = {}
        living = Living(self._paths)
        used_s = cpu_s()
        for item, after in _pairs(items):
            reached: set[str] = set()
            # Clear the caches: a value cached by an earlier test would hide that this test needs
            # the function.
            living.forget()
            with _watching(self._paths, reached):
                item.config.hook.pytest_runtest_protocol(item=item, nextitem=after)
            if self.failed is not None:
                told.write(self.failed)
                return EXIT_KILLED
            now_s = cpu_s()
            entries[item.nodeid] = (now_s - used_s, sorted(reached))
            used_s = now_s
        json.dump(entries, told)
        return 0

    def _try_all(self, items: Sequence[pytest.Item], baseline: Baseline, folder: str) -> None:
        living = Living(self._paths)
        gc.freeze()
        pool = Pool(self._task.jobs, self._ended)
        for module, numbers in self._task.numbers.items():
            source = (Path(self._task.root) / module).read_text(encoding="utf-8")
            for mutant in mutants_of(source):
                if mutant.number not in numbers:
                    continue
                name, place = (module, mutant.number), f"{module}:{mutant.function}"
                wanted = str(Path(self._task.root) / place)
                everywhere = mutant.on_import or wanted in self._on_import
                picked = [
                    item for item in items if everywhere or wanted in baseline.reached[item.nodeid]
                ]
                if not picked:
                    self._send(module=module, number=mutant.number, result=UNREACHED, by="")
                    continue
                picked.sort(key=lambda item: self._cost(item, place, baseline))
                limit_s = sum(baseline.duration_s[item.nodeid] for item in picked)
                ids = tuple(item.nodeid for item in picked)
                self._places[name] = place
                self._orders[name] = MutantOrder(*name, ids, limit_s + self._collecting_s)
                if everywhere:
                    self._fresh_imports.append(self._orders[name])
                else:
                    mine_s = [baseline.duration_s[item.nodeid] for item in picked]
                    trial = _Trial(
                        self, self._task, living, module, source, mutant, picked, mine_s, folder
                    )
                    pool.start(name, trial.run, limit_s)
        pool.drain()

    def _cost(self, item: pytest.Item, place: str, baseline: Baseline) -> float:
        """Order quick tests first, and those that detected mutations nearby."""
        return baseline.duration_s[item.nodeid] / (1 + self._killers[place, item.nodeid])

    def _ended(self, name: tuple[str, int], code: int, text: str) -> None:
        if code == EXIT_ANEW:
            self._fresh_imports.append(self._orders[name])
            return
        result, by = result_of(code), last_told(text)
        if result == KILLED:
            self._killers[self._places[name], by] += 1
        by = "" if result == SURVIVED else by
        self._send(module=name[0], number=name[1], result=result, by=by)

    def _send(self, **entry: object) -> None:
        write_line(self._report, **entry)


@dataclass(frozen=True, slots=True)
class _Trial:
    """One mutant in its fork; `run` returns the fork's exit status."""

    trials: Trials
    task: MutantTask
    living: Living
    module: str
    source: str
    mutant: Mutant
    picked: Sequence[pytest.Item]
    durations_s: Sequence[float]
    """Durations of the picked tests without the mutation."""
    folder: str

    def run(self, told: TextIO) -> int:
        """Change the loaded functions, which avoids an import."""
        try:
            tree = mutated(self.source, self.mutant.number)
            self.living.swap(Path(self.task.root) / self.module, tree)
        except NotSwappableError:
            return EXIT_ANEW
        own = Path(self.folder) / f"{Path(self.module).stem}-{self.mutant.number}"
        own.mkdir()
        os.environ["PYTEST_DEBUG_TEMPROOT"] = str(own)
        for (item, after), duration_s in zip(_pairs(self.picked), self.durations_s, strict=True):
            tell_test(told, item.nodeid)
            # The limit per test finds an endless loop at the first quick test that runs into it.
            limit(duration_s)
            item.config.hook.pytest_runtest_protocol(item=item, nextitem=after)
            if self.trials.failed is not None:
                return EXIT_KILLED
        return 0


def try_group(task: MutantTask, report: TextIO) -> int:
    """Try all mutants of a group; results go to `report`, one JSON object a line."""
    read_fd, write_fd = os.pipe()
    pid = os.fork()
    if pid == 0:
        os.close(write_fd)
        with os.fdopen(read_fd, encoding="utf-8") as orders:
            told = orders.read()
        status = try_fresh(task, _orders(told), report) if told else 0
        report.flush()
        os._exit(status)
    os.close(read_fd)
    trials = Trials(task, report)
    status = int(pytest.main([*PYTEST_ARGS, *task.tests], plugins=[trials]))
    with os.fdopen(write_fd, "w", encoding="utf-8") as orders:
        if trials.left.orders:
            json.dump(dataclasses.asdict(trials.left), orders)
    os.waitpid(pid, 0)
    return status


def _orders(told: str) -> FreshImportTask:
    entries = json.loads(told)
    return FreshImportTask(
        tuple(
            MutantOrder(entry["module"], entry["number"], tuple(entry["tests"]), entry["limit_s"])
            for entry in entries["orders"]
        ),
        tuple(entries["foreign"]),
    )


@contextmanager
def _watching(paths: set[str], reached: set[str]) -> Iterator[None]:
    """Record all called functions of these files."""
    known: dict[CodeType, str | None] = {}

    def note(frame: FrameType, event: str, _argument: Any) -> None:
        if event != "call":
            return
        code = frame.f_code
        if code not in known:
            name = f"{code.co_filename}:{code.co_qualname}"
            known[code] = name if code.co_filename in paths else None
        name_or_none = known[code]
        if name_or_none is not None:
            reached.add(name_or_none)

    sys.setprofile(note)
    try:
        yield
    finally:
        sys.setprofile(None)


def _pairs(items: Sequence[pytest.Item]) -> Iterator[tuple[pytest.Item, pytest.Item | None]]:
    """Yield each test with its successor."""
    yield from zip(items, [*items[1:], None], strict=True)
