"""Tries mutants against tests: tests are collected once, each mutant meets them in a fork."""

import json
import os
import resource
import signal
import sys
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import CodeType, FrameType
from typing import Any, Final, TextIO

import pytest
from hypothesis import HealthCheck, Phase, settings

from metro_tools.mutate.module_finder import NotSwappableError, forget, install, swap
from metro_tools.mutate.mutations import Mutant, mutants_of, mutated

KILLED: Final = "killed"
TIMED_OUT: Final = "timed out"
SURVIVED: Final = "survived"
UNREACHED: Final = "unreached"
EXIT_KILLED: Final = 1
PYTEST_ARGS: Final = ("-q", "-p", "no:cacheprovider", "-p", "no:xdist", "--capture=sys")
CPU_FACTOR: Final = 5.0
CPU_FLOOR_S: Final = 4
"""A mutant may take this much longer than the tests without it, and then counts as noticed."""
WALL_FACTOR: Final = 5
MEMORY_BYTES: Final = 4 << 30
TESTS_FD: Final = "METRO_MUTATE_FD"
PROFILE: Final = "mutate"


@dataclass(frozen=True, slots=True)
class Task:
    """What one process is to try."""

    root: str
    modules: tuple[str, ...]
    tests: tuple[str, ...]
    keys: tuple[str, ...]
    """Only these mutants; all without any."""
    jobs: int


@dataclass(frozen=True, slots=True)
class Baseline:
    """What the tests do without any mistake."""

    duration_s: Mapping[str, float]
    """Of each test."""
    reached: Mapping[str, frozenset[str]]
    """Of each test: the functions it runs, as path:qualified name."""


class Trials:
    """A pytest plugin: instead of running the tests once it runs them for every mutant."""

    def __init__(self, task: Task, report: TextIO) -> None:
        self._task, self._report = task, report
        self._on_import: set[str] = set()
        """Functions that run while tests are collected: what they made cannot be mended later."""
        self.failed: str | None = None

    @pytest.hookimpl(wrapper=True, tryfirst=True)
    def pytest_collection(self, session: pytest.Session) -> Iterator[None]:
        _same_examples_always()
        paths = {str(Path(self._task.root) / module) for module in self._task.modules}
        with _watching(paths, self._on_import):
            result = yield
        return result

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        if report.failed and self.failed is None:
            self.failed = report.nodeid

    def pytest_runtestloop(self, session: pytest.Session) -> bool:
        if session.testsfailed:
            self._tell(error="the tests cannot be collected, even without a mutant")
            return True
        baseline, words = self._baseline(session.items)
        if baseline is None:
            self._tell(error=f"fails even without a mutant: {words}")
            return True
        with tempfile.TemporaryDirectory() as folder:
            self._try_all(session.items, baseline, folder)
        return True

    def _baseline(self, items: Sequence[pytest.Item]) -> tuple[Baseline | None, str]:
        """Run all tests once, in a fork that nobody inherits from."""
        pid, pipe = _fork(lambda told: self._run_watched(items, told))
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
        paths = {str(Path(self._task.root) / module) for module in self._task.modules}
        entries: dict[str, tuple[float, list[str]]] = {}
        used_s = _cpu_s()
        for item, after in _pairs(items):
            reached: set[str] = set()
            # What an earlier test has left in a cache would hide that this one needs it.
            forget(paths)
            with _watching(paths, reached):
                item.config.hook.pytest_runtest_protocol(item=item, nextitem=after)
            if self.failed is not None:
                told.write(self.failed)
                return EXIT_KILLED
            now_s = _cpu_s()
            entries[item.nodeid] = (now_s - used_s, sorted(reached))
            used_s = now_s
        json.dump(entries, told)
        return 0

    def _try_all(self, items: Sequence[pytest.Item], baseline: Baseline, folder: str) -> None:
        running: dict[int, tuple[str, Mutant, TextIO]] = {}
        for module in self._task.modules:
            source = (Path(self._task.root) / module).read_text(encoding="utf-8")
            for mutant in mutants_of(source):
                if self._task.keys and mutant.key not in self._task.keys:
                    continue
                picked = self._picked(items, module, mutant, baseline)
                if not picked:
                    self._result(module, mutant, UNREACHED, "")
                    continue
                if len(running) >= self._task.jobs:
                    self._reap(running)
                trial = _Trial(self, self._task, module, source, mutant, picked, folder)
                limit_s = sum(baseline.duration_s[item.nodeid] for item in picked)
                swappable = not mutant.on_import and f"{module}:{mutant.function}" not in (
                    self._relative(name) for name in self._on_import
                )
                pid, pipe = _fork(trial.run if swappable else trial.run_anew, limit_s)
                running[pid] = module, mutant, pipe
        while running:
            self._reap(running)

    def _picked(
        self, items: Sequence[pytest.Item], module: str, mutant: Mutant, baseline: Baseline
    ) -> list[pytest.Item]:
        """The tests that can notice it, quick ones first."""
        wanted = f"{Path(self._task.root) / module}:{mutant.function}"
        everywhere = mutant.on_import or wanted in self._on_import
        picked = [item for item in items if everywhere or wanted in baseline.reached[item.nodeid]]
        return sorted(picked, key=lambda item: baseline.duration_s[item.nodeid])

    def _reap(self, running: dict[int, tuple[str, Mutant, TextIO]]) -> None:
        pid, status = os.wait()
        module, mutant, pipe = running.pop(pid)
        code, by = os.waitstatus_to_exitcode(status), pipe.read()
        pipe.close()
        if code in (-signal.SIGPROF, -signal.SIGALRM):
            self._result(module, mutant, TIMED_OUT, by)
        else:
            self._result(module, mutant, KILLED if code else SURVIVED, by)

    def _relative(self, name: str) -> str:
        return name.removeprefix(f"{self._task.root}/")

    def _result(self, module: str, mutant: Mutant, result: str, by: str) -> None:
        self._tell(module=module, number=mutant.number, result=result, by=by)

    def _tell(self, **entry: object) -> None:
        self._report.write(json.dumps(entry) + "\n")
        self._report.flush()


@dataclass(frozen=True, slots=True)
class _Trial:
    """One mutant in its fork. What `run` returns is the status that the fork ends with."""

    trials: Trials
    task: Task
    module: str
    source: str
    mutant: Mutant
    picked: Sequence[pytest.Item]
    folder: str

    def run(self, told: TextIO) -> int:
        """Change the functions that are there already; that costs no import."""
        try:
            swap(Path(self.task.root) / self.module, mutated(self.source, self.mutant.number))
        except NotSwappableError:
            return self.run_anew(told)
        self._own_folder()
        for item, after in _pairs(self.picked):
            item.config.hook.pytest_runtest_protocol(item=item, nextitem=after)
            if self.trials.failed is not None:
                told.write(self.trials.failed)
                return EXIT_KILLED
        return 0

    def run_anew(self, told: TextIO) -> int:
        """Import everything once more, with the mistake in it."""
        own = self._own_folder()
        order = own / "order.json"
        order.write_text(json.dumps([item.nodeid for item in self.picked]), encoding="utf-8")
        os.set_inheritable(told.fileno(), True)
        os.environ[TESTS_FD] = str(told.fileno())
        place = [self.task.root, self.module, str(self.mutant.number), str(order)]
        argv = [sys.executable, "-m", "metro_tools.mutate.trial_anew", *place, *self.task.tests]
        os.execv(sys.executable, argv)  # noqa: S606

    def _own_folder(self) -> Path:
        own = Path(self.folder) / f"{Path(self.module).stem}-{self.mutant.number}"
        own.mkdir()
        os.environ["PYTEST_DEBUG_TEMPROOT"] = str(own)
        return own


class Anew:
    """A pytest plugin for tests in a process of their own: their order, and who failed first."""

    def __init__(self, order: Sequence[str], told: TextIO) -> None:
        self._place = {name: at for at, name in enumerate(order)}
        self._told = told

    @pytest.hookimpl(tryfirst=True)
    def pytest_collection(self) -> None:
        _same_examples_always()

    def pytest_collection_modifyitems(self, items: list[pytest.Item]) -> None:
        items[:] = [item for item in items if item.nodeid in self._place]
        items.sort(key=lambda item: self._place[item.nodeid])

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        if report.failed:
            self._told.write(report.nodeid)
            self._told.flush()


def try_anew(root: str, module: str, number: int, order: str, tests: Sequence[str]) -> int:
    """Import the module with the mistake and run the tests; 0 when nobody noticed."""
    path = Path(root) / module
    tree = mutated(path.read_text(encoding="utf-8"), number)
    install(module.removesuffix(".py").replace("/", "."), path, tree)
    with os.fdopen(int(os.environ[TESTS_FD]), "w", encoding="utf-8") as told:
        plugin = Anew(json.loads(Path(order).read_text(encoding="utf-8")), told)
        return int(pytest.main(["-x", *PYTEST_ARGS, *tests], plugins=[plugin]))


def try_group(task: Task, report: TextIO) -> int:
    """Try all mutants of a group; results go to `report`, one JSON object a line."""
    return int(pytest.main([*PYTEST_ARGS, *task.tests], plugins=[Trials(task, report)]))


def _fork(run: Callable[[TextIO], int], limit_s: float = 0.0) -> tuple[int, TextIO]:
    """A child that runs and ends, and what it tells; `limit_s` is what the tests take alone."""
    read_fd, write_fd = os.pipe()
    sys.stdout.flush()
    pid = os.fork()
    if pid:
        os.close(write_fd)
        return pid, os.fdopen(read_fd, encoding="utf-8")
    status = EXIT_KILLED
    try:
        os.close(read_fd)
        if limit_s:
            _limit(limit_s)
        with os.fdopen(write_fd, "w", encoding="utf-8") as told:
            status = run(told)
    except SystemExit:
        status = EXIT_KILLED
    finally:
        os._exit(status)


def _limit(tests_s: float) -> None:
    """The kernel ends what runs too long; by processor time, so that a busy machine does not."""
    cpu_s = int(CPU_FLOOR_S + CPU_FACTOR * tests_s)
    signal.signal(signal.SIGPROF, signal.SIG_DFL)
    signal.signal(signal.SIGALRM, signal.SIG_DFL)
    signal.setitimer(signal.ITIMER_PROF, cpu_s)
    signal.setitimer(signal.ITIMER_REAL, WALL_FACTOR * cpu_s)
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY_BYTES, MEMORY_BYTES))


def _same_examples_always() -> None:
    """The same examples for every mutant, and no search for the smallest one that fails."""
    settings.register_profile(
        PROFILE,
        deadline=None,
        derandomize=True,
        database=None,
        suppress_health_check=list(HealthCheck),
        phases=(Phase.explicit, Phase.generate),
    )
    settings.load_profile(PROFILE)


@contextmanager
def _watching(paths: set[str], reached: set[str]) -> Iterator[None]:
    """Note all functions of these files that are called."""
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
    """Each test and the one after it."""
    yield from zip(items, [*items[1:], None], strict=True)


def _cpu_s() -> float:
    used = resource.getrusage(resource.RUSAGE_SELF)
    return used.ru_utime + used.ru_stime
