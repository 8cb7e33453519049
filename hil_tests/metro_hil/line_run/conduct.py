"""Runs all trains of a line side by side, tied together once an interval, the same in any order.

What a train says about an interval is answered before the one after next, so that no train waits
for another: with a process for each, two processors are as busy as seven trains can keep them.
"""

import gc
import itertools
import multiprocessing
import os
import struct
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Final, NamedTuple

from metro_hil.line_run.seat import LinePlan, Seat, TrainReport
from metro_hil.run_folder import RunFolder
from plant_emulator.traffic.coupling import INTERVAL_S, Answer, Books, Coupling, Said

AHEAD: Final = 2
"""Intervals that a train runs before it needs an answer."""
RECORD_EVERY: Final = 5
"""Intervals: a row of the record each second."""
COLLECT_AFTER: Final = 50_000
SAID: Final = struct.Struct("<6d")
ANSWER: Final = struct.Struct("<5d")
GONE: Final = (EOFError, BrokenPipeError, ConnectionResetError)
"""What tells that the process at the other end has ended."""


class Row(NamedTuple):
    """Of the record: one instant of the line, trains in their order."""

    said: tuple[Said, ...]
    answers: tuple[Answer, ...]
    substations_w: tuple[float, ...]


class TrainDiedError(Exception):
    """A train's process ended before its time; the text says which and why."""


@dataclass(slots=True)
class LineRecord:
    """What came of it all."""

    interval_s: float = INTERVAL_S * RECORD_EVERY
    rows: list[Row] = field(default_factory=list)
    reports: list[TrainReport] = field(default_factory=list)
    books: Books = field(default_factory=Books)
    unconverged: int = 0
    solved: int = 0
    least_gap_m: float = float("inf")
    """From a front to the rear ahead, by the truth."""


class _Here:
    """A train in this process."""

    def __init__(self, seat: Seat) -> None:
        self._seat = seat

    def said(self) -> Said:
        return self._seat.advance()

    def answer(self, answer: Answer) -> None:
        self._seat.hears(answer)

    def report(self) -> TrainReport:
        return self._seat.close()


class _There:
    """A train in a process of its own, which runs ahead by itself."""

    def __init__(
        self, plan: LinePlan, index: int, folder: RunFolder | None, intervals: int
    ) -> None:
        self._train = plan.starts[index].train
        context = multiprocessing.get_context("fork")
        self._pipe, theirs = context.Pipe()
        self.process = context.Process(
            target=_serve, args=(plan, index, folder, intervals, theirs), daemon=True
        )
        self.process.start()
        theirs.close()

    def said(self) -> Said:
        try:
            return Said(*SAID.unpack(_read(self._pipe, SAID.size)))
        except GONE as error:
            raise self._died() from error

    def answer(self, answer: Answer) -> None:
        try:
            _write(self._pipe, ANSWER.pack(*answer))
        except GONE as error:
            raise self._died() from error

    def report(self) -> TrainReport:
        try:
            report: TrainReport = self._pipe.recv()
        except GONE as error:
            raise self._died() from error
        self.process.join()
        return report

    def _died(self) -> TrainDiedError:
        self.process.join()
        return TrainDiedError(
            f"train {self._train}: its process ended with {self.process.exitcode}, see above"
        )


def _read(pipe: Connection, size: int) -> bytes:
    """Exactly so much, a message of a known size; raises EOFError when the other end is gone.

    A connection's own messages begin with their length, which is one call of the system more.
    """
    found = b""
    while len(found) < size:
        more = os.read(pipe.fileno(), size - len(found))
        if not more:
            raise EOFError
        found += more
    return found


def _write(pipe: Connection, data: bytes) -> None:
    while data:
        data = data[os.write(pipe.fileno(), data) :]


def _serve(
    plan: LinePlan, index: int, folder: RunFolder | None, intervals: int, pipe: Connection
) -> None:
    """One train from beginning to end, in a process of its own."""
    gc.set_threshold(COLLECT_AFTER)
    gc.freeze()
    seat = Seat(plan, index, folder)
    for interval in range(intervals):
        if interval >= AHEAD:
            seat.hears(Answer(*ANSWER.unpack(_read(pipe, ANSWER.size))))
        _write(pipe, SAID.pack(*seat.advance()))
    for _ in range(min(AHEAD, intervals)):
        seat.hears(Answer(*ANSWER.unpack(_read(pipe, ANSWER.size))))
    pipe.send(seat.close())


def conduct(
    plan: LinePlan,
    duration_s: float,
    *,
    folders: Sequence[Path | None],
    processes: bool | None = None,
    told: Callable[[float], None] = lambda now_s: None,
) -> LineRecord:
    """All trains for so long; raises TrainDiedError.

    Args:
        folders: of each train's logs; None logs nothing of it.
        processes: one for each train; by default where there is more than one processor.
        told: now and then hears how far it is.
    """
    intervals = max(1, round(duration_s / INTERVAL_S))
    apart = (os.cpu_count() or 1) > 1 if processes is None else processes
    trains: list[_Here | _There] = []
    for index, path in enumerate(folders):
        folder = None if path is None else RunFolder(path)
        if apart:
            trains.append(_There(plan, index, folder, intervals))
        else:
            trains.append(_Here(Seat(plan, index, folder)))
    try:
        return _tied(plan, trains, intervals, told)
    finally:
        for train in trains:
            if isinstance(train, _There) and train.process.is_alive():
                train.process.terminate()


def _tied(
    plan: LinePlan,
    trains: Sequence[_Here | _There],
    intervals: int,
    told: Callable[[float], None],
) -> LineRecord:
    coupling = Coupling(plan.traffic, plan.supply, len(trains))
    record = LineRecord(books=coupling.books)
    length_m = plan.scenarios[0].train.length_m
    waiting: list[list[Answer]] = []
    for interval in range(intervals):
        if len(waiting) == AHEAD:
            _give(trains, waiting.pop(0))
        said = [train.said() for train in trains]
        answers = coupling.answers(said)
        waiting.append(answers)
        for ahead, behind in itertools.pairwise(said):
            gap_m = ahead.front_m - length_m - behind.front_m
            record.least_gap_m = min(record.least_gap_m, gap_m)
        if interval % RECORD_EVERY == 0:
            record.rows.append(Row(tuple(said), tuple(answers), coupling.substations_w))
            told(interval * INTERVAL_S)
    for left in waiting:
        _give(trains, left)
    record.reports = [train.report() for train in trains]
    record.unconverged = coupling.network.unconverged
    record.solved = coupling.network.solved
    return record


def _give(trains: Sequence[_Here | _There], answers: Sequence[Answer]) -> None:
    for train, answer in zip(trains, answers, strict=True):
        train.answer(answer)
