"""Runs a case on the bench that it names; called by workers, tests and tools."""

import importlib
from collections.abc import Callable, Iterator, Sequence
from typing import Final

from firmware_py.settings import SettingsError
from metro_hil.model.case import BenchKind, Case, CaseResult
from metro_hil.model.case_setup import NO_FILES, Files
from metro_hil.model.run_folder import RunFolder
from metro_hil.model.service import trains_of
from metro_hil.run import branch
from metro_hil.run.case import blocked, run_alone
from metro_hil.run.service_case import run_service, runs_service

SEVERAL: Final = "metro_hil.line.turning.case:run_several"


def run_case(case: Case, *, files: Files = NO_FILES, folder: RunFolder | None = None) -> CaseResult:
    """Run a case; on the lockstep bench the result is the same everywhere, bit for bit.

    Args:
        files: paths of the user's files, by the name by which cases refer to them.
        folder: folder for all logs. Without it, a case in virtual time writes nothing to disk.
    """
    if case.bench is BenchKind.LOCKSTEP and runs_service(case):
        try:
            setup = case.setup
            several = setup.masters or setup.supply is not None or trains_of(setup, files) > 1
        except SettingsError as error:
            return blocked(case, error)
        run = _several() if several else run_service
        return run(case, files=files, folder=folder)
    if case.bench is BenchKind.LOCKSTEP:
        return run_alone(case, files=files, folder=folder)
    from metro_hil.realtime import run_realtime_case
    from metro_hil.realtime.wires import Presence, RealtimeWires

    said = case.wires
    wires = RealtimeWires(
        bus_a=said.bus_a,
        bus_b=said.bus_b,
        tags=said.tags,
        radio=said.radio,
        plant=Presence(said.plant),
        controller=Presence(said.controller),
    )
    return run_realtime_case(case, files=files, folder=folder, wires=wires)


def _several() -> Callable[..., CaseResult]:
    """The function that runs several trains. It lies above this package, like the engine."""
    module, _, function = SEVERAL.partition(":")
    found: Callable[..., CaseResult] = getattr(importlib.import_module(module), function)
    return found


def run_group(cases: Sequence[Case], *, files: Files = NO_FILES) -> Iterator[CaseResult]:
    """Run cases that share their beginning; see `metro_hil.run.branch`."""
    return branch.run_group(cases, files=files)
