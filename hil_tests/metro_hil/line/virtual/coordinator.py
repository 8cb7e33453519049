"""Runs all trains of a line side by side and couples them once an interval, in any order.

The answer to a train's report on one interval is due before the interval after the next, so that no
train waits for another. There are as many processes as processors. More processes cost every train
more than they gain, because a processor's cache holds little of several processes. Seven trains in
seven processes took 1.6 times the processor time that they take in two.
"""

import gc
import itertools
import math
import multiprocessing
import os
import struct
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Final, NamedTuple

from firmware_py.interrupts import leave_to_parent, never
from metro_hil.line.virtual.member import LinePlan, VirtualTrain, VirtualTrainReport
from metro_hil.model.gc_tuning import collect_rarely
from metro_hil.model.run_folder import RunFolder
from plant_emulator.traffic.coupling import (
    INTERVAL_S,
    Coupling,
    CouplingAnswer,
    IntervalReport,
    PowerCoupling,
)

AHEAD: Final = 2
"""Number of intervals that a train runs before it needs an answer."""
RECORD_EVERY: Final = 5
"""Number of intervals between two rows of the record: one row each second."""
SAID_NUMBERS: Final = len(IntervalReport._fields)
ANSWER_NUMBERS: Final = len(CouplingAnswer._fields)
STOP: Final = b"\xff"
"""Byte of an answer that holds no numbers; the process then reports its results."""
GONE: Final = (EOFError, BrokenPipeError, ConnectionResetError)
"""Errors that show that the process at the other end has ended."""


Member = tuple[int, RunFolder | None]
"""Index of a train, and the folder for its logs."""


class LineInstant(NamedTuple):
    """One instant of the line in the record; trains in their order."""

    said: tuple[IntervalReport, ...]
    answers: tuple[CouplingAnswer, ...]
    substations_w: tuple[float, ...]


class TrainDiedError(Exception):
    """A train's process ended early; the text says which and why."""


@dataclass(slots=True)
class LineRecord:
    """Results of the run."""

    coupling: PowerCoupling
    interval_s: float = INTERVAL_S * RECORD_EVERY
    rows: list[LineInstant] = field(default_factory=list)
    reports: list[VirtualTrainReport] = field(default_factory=list)
    duration_s: float = 0.0
    """Simulated time; less than planned if the user ended the run."""
    least_gap_m: float = float("inf")
    """Least distance from a front to the rear ahead, by true positions."""


class _LocalTrains:
    """Some trains, one after the other in this process."""

    def __init__(self, plan: LinePlan, members: Sequence[Member]) -> None:
        self.trains = len(members)
        self._seats = [VirtualTrain(plan, index, folder) for index, folder in members]
        self._waiting: list[Sequence[CouplingAnswer]] = []
        self._intervals = 0

    def said(self) -> list[IntervalReport]:
        """Return the reports of the next interval, after the trains took the answers due."""
        if self._intervals >= AHEAD:
            self._take_answers()
        self._intervals += 1
        return [seat.advance() for seat in self._seats]

    def answer(self, answers: Sequence[CouplingAnswer]) -> None:
        self._waiting.append(answers)

    def stop(self, outstanding: int) -> None:
        """Do nothing: trains in this process do not run ahead."""

    def reports(self) -> list[VirtualTrainReport]:
        while self._waiting:
            self._take_answers()
        return [seat.close() for seat in self._seats]

    def _take_answers(self) -> None:
        for seat, answer in zip(self._seats, self._waiting.pop(0), strict=True):
            seat.on_message(answer)


class _RemoteTrains:
    """Some trains in a separate process, which runs ahead by itself."""

    def __init__(self, plan: LinePlan, members: Sequence[Member], intervals: int) -> None:
        self.trains = len(members)
        self._names = _names(plan, members)
        self._said, self._answer = _packing(len(members))
        context = multiprocessing.get_context("fork")
        self._pipe, theirs = context.Pipe()
        self.process = context.Process(
            target=_serve, args=(plan, members, intervals, theirs), daemon=True
        )
        self.process.start()
        theirs.close()

    def said(self) -> list[IntervalReport]:
        try:
            numbers = self._said.unpack(_read(self._pipe, self._said.size))
        except GONE as error:
            raise self._died() from error
        return [IntervalReport(*part) for part in _parts(numbers, SAID_NUMBERS)]

    def answer(self, answers: Sequence[CouplingAnswer]) -> None:
        try:
            _write(self._pipe, self._answer.pack(*itertools.chain(*answers)))
        except GONE as error:
            raise self._died() from error

    def reports(self) -> list[VirtualTrainReport]:
        try:
            reports: list[VirtualTrainReport] = self._pipe.recv()
        except GONE as error:
            raise self._died() from error
        self.process.join()
        return reports

    def stop(self, outstanding: int) -> None:
        """End the process early.

        Args:
            outstanding: number of intervals that it ran ahead.
        """
        try:
            _write(self._pipe, STOP * self._answer.size)
        except GONE as error:
            raise self._died() from error
        for _ in range(outstanding):
            self.said()

    def _died(self) -> TrainDiedError:
        self.process.join()
        return TrainDiedError(
            f"{self._names}: its process ended with {self.process.exitcode}, see above"
        )


def _names(plan: LinePlan, members: Sequence[Member]) -> str:
    numbers = ", ".join(str(plan.starts[index].train) for index, _ in members)
    return f"train{'' if len(members) == 1 else 's'} {numbers}"


def _packing(trains: int) -> tuple[struct.Struct, struct.Struct]:
    """Return the layouts of the reports and answers of all trains of one process."""
    return (
        struct.Struct(f"<{trains * SAID_NUMBERS}d"),
        struct.Struct(f"<{trains * ANSWER_NUMBERS}d"),
    )


def _parts(numbers: tuple[float, ...], size: int) -> list[tuple[float, ...]]:
    return [numbers[at : at + size] for at in range(0, len(numbers), size)]


def _read(pipe: Connection, size: int) -> bytes:
    """Read exactly `size` bytes.

    Raises EOFError if the other end is gone.

    Messages of `Connection` begin with their length, which takes one more system call.
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


def _serve(plan: LinePlan, members: Sequence[Member], intervals: int, pipe: Connection) -> None:
    """Run some trains from start to end in this separate process."""
    leave_to_parent()
    collect_rarely()
    gc.freeze()
    says, answered = _packing(len(members))
    trains = _LocalTrains(plan, members)

    def hear() -> bool:
        """Return False if the run ends early."""
        data = _read(pipe, answered.size)
        if data == STOP * answered.size:
            return False
        numbers = answered.unpack(data)
        trains.answer([CouplingAnswer(*part) for part in _parts(numbers, ANSWER_NUMBERS)])
        return True

    for interval in range(intervals + AHEAD):
        if interval >= AHEAD and not hear():
            break
        if interval < intervals:
            _write(pipe, says.pack(*itertools.chain(*trains.said())))
    pipe.send(trains.reports())


def groups(trains: int, processors: int) -> list[range]:
    """Return which trains share a process; the last and smallest group runs with the network."""
    size = math.ceil(trains / processors)
    return [range(at, min(at + size, trains)) for at in range(0, trains, size)]


def conduct(
    plan: LinePlan,
    duration_s: float,
    *,
    folders: Sequence[Path | None],
    processors: int | None = None,
    told: Callable[[float], None] = lambda now_s: None,
    interrupted: Callable[[], bool] = never,
) -> LineRecord:
    """Run all trains for the duration, or until the user interrupts.

    Raises TrainDiedError.

    Args:
        folders: log folder of each train; None: no logs.
        processors: number of processes; by default one for each processor, and 1 uses this one
            only.
        told: receives the simulated time at intervals, s.
    """
    intervals = max(1, round(duration_s / INTERVAL_S))
    paths = [None if path is None else RunFolder(path) for path in folders]
    *others, last = [
        [(index, paths[index]) for index in group]
        for group in groups(len(folders), processors or len(os.sched_getaffinity(0)))
    ]
    gc.freeze()
    there = [_RemoteTrains(plan, members, intervals) for members in others]
    try:
        return _coupled(plan, [*there, _LocalTrains(plan, last)], intervals, told, interrupted)
    finally:
        gc.unfreeze()
        for party in there:
            if party.process.is_alive():
                party.process.terminate()


def _coupled(
    plan: LinePlan,
    parties: Sequence[_LocalTrains | _RemoteTrains],
    intervals: int,
    told: Callable[[float], None],
    interrupted: Callable[[], bool],
) -> LineRecord:
    coupling = Coupling(plan.traffic, plan.supply, plan.line.power_sections)
    record = LineRecord(coupling)
    length_m = plan.scenarios[0].train.length_m
    for interval in range(intervals):
        if interrupted():
            for party in parties:
                party.stop(min(AHEAD, intervals - interval))
            break
        said = _all_said(parties)
        answers = coupling.answers(said)
        # Answer at once, because a process that is ahead of the others needs the answers first.
        _give(parties, answers)
        for ahead, behind in itertools.pairwise(said):
            gap_m = ahead.front_m - length_m - behind.front_m
            record.least_gap_m = min(record.least_gap_m, gap_m)
        if interval % RECORD_EVERY == 0:
            record.rows.append(LineInstant(tuple(said), tuple(answers), coupling.substations_w))
            told(interval * INTERVAL_S)
        record.duration_s = round((interval + 1) * INTERVAL_S, 6)
    record.reports = [report for party in parties for report in party.reports()]
    return record


def _all_said(parties: Sequence[_LocalTrains | _RemoteTrains]) -> list[IntervalReport]:
    """Return the reports in the order of the trains.

    The trains of this process run first, while those of the others run in parallel.
    """
    found = [party.said() for party in reversed(parties)]
    return [said for party in reversed(found) for said in party]


def _give(
    parties: Sequence[_LocalTrains | _RemoteTrains], answers: Sequence[CouplingAnswer]
) -> None:
    given = 0
    for party in parties:
        party.answer(answers[given : given + party.trains])
        given += party.trains
