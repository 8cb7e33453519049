"""Cases that are the same up to a branch: that part is run once, and each case goes on from a copy.

A copy is a fork of the process, so it holds every bit of the state, and a case gives the same
result as if it had been run alone from its start.
"""

import gc
import os
from collections.abc import Iterator, Sequence
from typing import Any, Final

import msgspec

from firmware_py.clock.clock import WallClock
from firmware_py.clock.realtime import die_with_parent
from firmware_py.settings import SettingsError
from metro_hil.model.case import Case, CaseResult, ControllerSpec
from metro_hil.model.case_setup import NO_FILES, Files, parts_of
from metro_hil.run.case import CaseRun, hearing_of, run_alone
from plant_emulator.faults.plan import read_faults

READ_BYTES: Final = 1 << 16


def group_key(case: Case) -> bytes | None:
    """Cases with the same key share what comes before their branch; None for a case without one.

    A controller of a process of its own cannot be copied with the process of the bench. What the
    monitors are told before the branch depends on the faults that come after it.
    """
    if case.branch is None or case.controller.kind != ControllerSpec().kind:
        return None
    try:
        plans = read_faults(case.faults, case.id)
    except SettingsError:
        return None
    shared = msgspec.structs.replace(
        case,
        id="",
        index=0,
        scenario="",
        seed=0,
        faults=(),
        factors={},
        requirements=(),
    )
    hearing = hearing_of(plans)
    return msgspec.json.encode((shared, hearing), order="deterministic")


def run_group(cases: Sequence[Case], *, files: Files = NO_FILES) -> Iterator[CaseResult]:
    """The results in the order of the cases, which must have one key.

    A case whose copy of the process dies is run again alone, so that what is wrong with it shows
    where it would without a group.
    """
    assert cases
    assert len({group_key(case) for case in cases}) == 1
    if len(cases) == 1 or group_key(cases[0]) is None or not hasattr(os, "fork"):
        for case in cases:
            yield run_alone(case, files=files)
        return
    try:
        plans = [plan for case in cases for plan in read_faults(case.faults, case.id)]
        places = frozenset(plan.kind.place for plan in plans)
        run = CaseRun(cases[0], parts_of(cases[0], files), None, places)
    except SettingsError:
        for case in cases:
            yield run_alone(case, files=files)
        return
    run.to_branch()
    run.warm_up()
    # What is there now stays: a collection in a copy would only touch, and so copy, all of it.
    gc.collect()
    gc.freeze()
    try:
        for case in cases:
            result = _in_copy(run, case)
            yield run_alone(case, files=files) if result is None else result
    finally:
        gc.unfreeze()


def _in_copy(run: CaseRun, case: Case) -> CaseResult | None:
    """Fork, let the child run the case to its end, and take its result; None if it died."""
    parent = os.getpid()
    reader, writer = os.pipe()
    child = os.fork()
    if child == 0:
        status = 1
        try:
            os.close(reader)
            gc.disable()
            die_with_parent(parent)
            _write_all(writer, msgspec.json.encode(_finish(run, case)))
            status = 0
        finally:
            # Nothing of the parent's may be flushed or cleaned up twice.
            os._exit(status)
    os.close(writer)
    with os.fdopen(reader, "rb") as pipe:
        content = pipe.read()
    _, status = os.waitpid(child, 0)
    if status != 0:
        return None
    return msgspec.json.decode(content, type=CaseResult)


def _finish(run: CaseRun, case: Case) -> CaseResult:
    began_ns = WallClock().now_ns()
    run.become(case, read_faults(case.faults, case.id))
    run.to_end()
    run.close()
    return run.result(began_ns)


def _write_all(descriptor: int, content: bytes) -> None:
    view: Any = memoryview(content)
    while view:
        view = view[os.write(descriptor, view[:READ_BYTES]) :]
