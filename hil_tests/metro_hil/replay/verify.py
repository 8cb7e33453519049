"""Runs a sample of a finished campaign again under other conditions and requires the same bytes.

The cases run in separate processes, in another order, each with another PYTHONHASHSEED, from plain
sources without compiled modules. Meanwhile other processes load the processors at several levels of
niceness. A run in virtual time must not depend on any of this.
"""

import os
import random
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from itertools import zip_longest
from pathlib import Path
from typing import BinaryIO, Final, Self, cast

import msgspec

from metro_hil.engine.errors import EngineError, UsageError
from metro_hil.engine.folder import CampaignFolder
from metro_hil.engine.journal import (
    once_each,
    read_journal,
    refuse_damage,
    same_result,
    without_host,
)
from metro_hil.engine.messages import (
    LENGTH_BYTES,
    CaseBatch,
    Done,
    Raised,
    ToMaster,
    WorkerHello,
    pack,
    read_length,
    take_for_master,
)
from metro_hil.engine.program import program_version
from metro_hil.engine.worker import RUNNER
from metro_hil.model.case import BenchKind, Case, CaseResult, Verdict

SAMPLE: Final = 20
NICENESS: Final = (0, 5, 10, 19)
HASH_SEED_MAX: Final = 4_294_967_295
NOT_RERUN: Final = frozenset({Verdict.LOST, Verdict.INVALID})
SHOWN_MAX: Final = 60
BUSY: Final = """\
from firmware_py.clock.realtime import die_with_parent
die_with_parent({parent})
while True:
    pass
"""


class FirstFrame(msgspec.Struct, frozen=True):
    """First difference between the bus logs of two runs of one case."""

    number: int
    """Number of the line in both logs, from 1."""
    one: str
    """The line; empty where this log has ended."""
    other: str


class Mismatch(msgspec.Struct, frozen=True, kw_only=True):
    """A case with another result than before."""

    case_id: str
    differences: tuple[str, ...]
    """Differences as text; the run before comes first."""
    compared: str = ""
    """Text that names the two runs whose frames are compared."""
    first_frame: FirstFrame | None = None


class VerifyResult(msgspec.Struct, frozen=True, kw_only=True):
    campaign: str
    sampled: int
    of: int
    """Number of cases in virtual time with a result."""
    frames: int
    """Number of equal frames, over all matching cases."""
    mismatches: tuple[Mismatch, ...]
    notes: tuple[str, ...] = ()
    interrupted: bool = False
    """Whether the user ended it before the whole sample was run."""

    @property
    def identical(self) -> bool:
        return self.sampled > 0 and not self.mismatches


def verify(
    folder: CampaignFolder,
    *,
    sample: int | None = SAMPLE,
    seed: int = 1,
    workers: int = 2,
    load: int = 2,
    told: Callable[[Case], None] | None = None,
) -> VerifyResult:
    """Run a random sample again and compare the results with those in the journal.

    Args:
        sample: number of cases; None for all.
        seed: seed of the sample, its order, and the values of PYTHONHASHSEED.
        workers: number of processes that run cases at the same time.
        load: number of busy processes that load the machine meanwhile.
        told: receives each case that was run again.

    Raises:
        UsageError: if no case of the campaign can run again.
        EngineError: if the folder is damaged or a worker cannot start.
    """
    manifest, cases = folder.manifest(), {case.id: case for case in folder.cases()}
    found = read_journal(folder.journal_path)
    refuse_damage(folder.journal_path, found)
    before = {
        case_id: result
        for case_id, result in once_each(found.results).items()
        if cases[case_id].bench is BenchKind.LOCKSTEP and result.verdict not in NOT_RERUN
    }
    if not before:
        raise UsageError(f"{folder.path}: no case in virtual time has a result yet")
    draw = random.Random(seed)
    chosen = list(before)
    draw.shuffle(chosen)
    chosen = chosen if sample is None else chosen[:sample]
    places = Workplace(folder.files(), manifest.options.get("runner") or RUNNER, draw)
    mismatches, frames, done, interrupted = [], 0, 0, False
    with _busy(load):
        try:
            for case_id, answer in places.run([cases[name] for name in chosen], workers):
                if told is not None:
                    told(cases[case_id])
                done += 1
                if isinstance(answer, CaseResult) and same_result(before[case_id], answer):
                    frames += answer.frames
                else:
                    mismatches.append((case_id, answer))
        except KeyboardInterrupt:
            interrupted = True
        worse = [
            _mismatch(folder, cases[case_id], before[case_id], answer, places)
            for case_id, answer in mismatches
        ]
    notes: tuple[str, ...] = ()
    if manifest.program != program_version():
        notes = (f"the campaign was run by {manifest.program}, this is {program_version()}",)
    return VerifyResult(
        campaign=str(folder.path),
        sampled=done,
        interrupted=interrupted,
        of=len(before),
        frames=frames,
        mismatches=tuple(sorted(worse, key=lambda each: cases[each.case_id].index)),
        notes=notes,
    )


class Workplace:
    """Starts worker processes under different conditions and runs cases in them."""

    def __init__(self, files: Mapping[str, Path], runner: str, draw: random.Random) -> None:
        self._hello = WorkerHello(runner, {name: str(path) for name, path in files.items()})
        self._draw = draw

    def run(self, cases: Sequence[Case], workers: int) -> Iterator[tuple[str, CaseResult | str]]:
        """Id and result of each case, or an error text instead, in the order of the cases."""
        count = max(1, min(workers, len(cases)))
        shares = [cases[first::count] for first in range(count)]
        circumstances = [self._circumstances() for _ in shares]
        with ThreadPoolExecutor(count) as pool:
            for answers in pool.map(self._share, shares, circumstances):
                yield from answers

    def run_one(self, case: Case, folder: Path) -> CaseResult | str:
        """Run one case in its own process and keep its logs."""
        with _WorkerProcess(self._hello, *self._circumstances()) as worker:
            return worker.run(case, folder)

    def _circumstances(self) -> tuple[int, int]:
        return self._draw.randint(1, HASH_SEED_MAX), self._draw.choice(NICENESS)

    def _share(
        self, cases: Sequence[Case], circumstances: tuple[int, int]
    ) -> list[tuple[str, CaseResult | str]]:
        with _WorkerProcess(self._hello, *circumstances) as worker:
            return [(case.id, worker.run(case, None)) for case in cases]


class _WorkerProcess:
    """One process of the engine's worker, which runs one case at a time."""

    def __init__(self, hello: WorkerHello, hash_seed: int, nice: int) -> None:
        words = (sys.executable, "-m", "metro_hil.engine.worker")
        environment = {**os.environ, "PYTHONHASHSEED": str(hash_seed)}
        try:
            self._process = subprocess.Popen(
                (*words, "--parent", str(os.getpid()), "--nice", str(nice)),
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                env=environment,
                start_new_session=True,
            )
        except OSError as error:
            raise EngineError(f"no worker process can be started: {error.strerror}") from error
        self._input = cast(BinaryIO, self._process.stdin)
        self._output = cast(BinaryIO, self._process.stdout)
        self._number = 0
        self._send(pack(hello))
        if self._receive() is None:
            raise EngineError(f"a worker ended at its start with status {self._process.wait()}")

    def run(self, case: Case, folder: Path | None) -> CaseResult | str:
        self._number += 1
        keep = None if folder is None else str(folder)
        self._send(pack(CaseBatch(self._number, (case,), keep)))
        answer = self._receive()
        if isinstance(answer, Done):
            self._receive()
            return answer.result
        if isinstance(answer, Raised):
            self._receive()
            return f"raised {answer.traceback.strip().splitlines()[-1]}"
        return f"the worker ended with status {self._process.wait()}"

    def _send(self, data: bytes) -> None:
        try:
            self._input.write(data)
            self._input.flush()
        except BrokenPipeError:
            """The reader notices that the worker has ended."""

    def _receive(self) -> ToMaster | None:
        head = self._output.read(LENGTH_BYTES)
        if len(head) < LENGTH_BYTES:
            return None
        body = self._output.read(read_length(head))
        return next(iter(take_for_master(bytearray(head + body))), None)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._process.kill()
        self._process.wait()
        self._input.close()
        self._output.close()


def _mismatch(
    folder: CampaignFolder,
    case: Case,
    before: CaseResult,
    answer: CaseResult | str,
    places: Workplace,
) -> Mismatch:
    """Run the case with logs until two runs with different frames are found."""
    if isinstance(answer, str):
        return Mismatch(case_id=case.id, differences=(answer,))
    differences = tuple(_differences(before, answer))
    with tempfile.TemporaryDirectory(prefix="verify-") as place:
        logs = []
        for name in ("one", "other"):
            (Path(place) / name).mkdir()
            if isinstance(places.run_one(case, Path(place) / name), CaseResult):
                logs.append(Path(place) / name / "bus.log")
        kept = folder.kept(case.id).bus_log
        pairs = [("the logs that the campaign kept and a run now", [kept, *logs[:1]])]
        pairs.append(("two runs now", logs))
        for words, pair in pairs:
            if len(pair) == 2 and all(path.is_file() for path in pair):
                first = first_difference(*pair)
                if first is not None:
                    return Mismatch(
                        case_id=case.id, differences=differences, compared=words, first_frame=first
                    )
    return Mismatch(
        case_id=case.id,
        differences=differences,
        compared="two runs now have the same frames; the campaign's run kept no other log",
    )


def first_difference(one: Path, other: Path) -> FirstFrame | None:
    """The first line in which two bus logs differ."""
    with one.open(encoding="ascii") as mine, other.open(encoding="ascii") as theirs:
        for number, (line, its) in enumerate(zip_longest(mine, theirs, fillvalue=""), start=1):
            if line != its:
                return FirstFrame(number, line.strip(), its.strip())
    return None


def _differences(before: CaseResult, after: CaseResult) -> Iterator[str]:
    mine, theirs = without_host(before), without_host(after)
    for name, value in mine.items():
        if value != theirs[name]:
            yield f"{name}: {_short(value)}, now {_short(theirs[name])}"


def _short(value: object) -> str:
    text = str(value)
    return text if len(text) <= SHOWN_MAX else f"{text[: SHOWN_MAX - 3]}..."


@contextmanager
def _busy(count: int) -> Iterator[None]:
    """Processes that load the processors, at different levels of niceness."""
    words = (sys.executable, "-c", BUSY.format(parent=os.getpid()))
    busy = []
    try:
        for index in range(count):
            nice = NICENESS[index % len(NICENESS)]
            busy.append(subprocess.Popen(("nice", "-n", str(nice), *words), start_new_session=True))
        yield
    finally:
        for process in busy:
            process.kill()
            process.wait()
