"""Runs the common beginning of several cases once; each case continues from a copy of it.

A copy is a fork of the process, so it holds every bit of the state. A case therefore gives the same
result as if it had run alone from its start.
"""

import gc
import os
from collections.abc import Iterator, Sequence
from typing import Any, Final

import msgspec

from firmware_py.clock.clock import WallClock
from firmware_py.clock.realtime import die_with_parent
from firmware_py.settings import SettingsError
from metro_hil.model.case import Case, CaseResult, ControllerSpec, PlantSpec
from metro_hil.model.case_setup import NO_FILES, Files, parts_of
from metro_hil.run.case import CaseRun, hearing_of, run_alone
from plant_emulator.faults.plan import read_faults

READ_BYTES: Final = 1 << 16


def group_key(case: Case) -> bytes | None:
    """Key that is equal for cases with the same beginning; None for a case without a branch.

    An external controller or plant has no key: the fork cannot copy its process. Whether
    monitors observe the controller's own port depends on the later faults, so that is in the key,
    too.
    """
    if case.branch is None or case.controller.kind != ControllerSpec().kind:
        return None
    if case.plant.kind != PlantSpec().kind:
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
    """Yield the results in the order of the cases, which must have one key.

    A case whose copy of the process dies runs again alone, so that its error appears as without a
    group.
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
    # Freeze the present objects: a collection in a copy would touch, and so copy, all of their
    # pages.
    gc.collect()
    gc.freeze()
    try:
        for case in cases:
            result = _in_copy(run, case)
            yield run_alone(case, files=files) if result is None else result
    finally:
        gc.unfreeze()


def _in_copy(run: CaseRun, case: Case) -> CaseResult | None:
    """Fork, let the child run the case to its end, and return its result; None if it died."""
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
            # The child must not flush or clean up the parent's files.
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
