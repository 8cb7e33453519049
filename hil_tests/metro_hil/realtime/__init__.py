"""Benches in real time: the same case as in lockstep, with processes, wires and a clock."""

from collections.abc import Mapping
from pathlib import Path

from metro_hil.model.case import Case, CaseResult
from metro_hil.model.run_folder import RunFolder
from metro_hil.realtime.wires import Presence, RealtimeWires

__all__ = ["Presence", "RealtimeWires", "run_realtime_case"]


def run_realtime_case(
    case: Case,
    *,
    files: Mapping[str, Path] | None = None,
    folder: RunFolder | None = None,
    wires: RealtimeWires | None = None,
) -> CaseResult:
    """Run one case; `metro_hil.realtime.case_run` is imported only here, when a case runs."""
    from metro_hil.realtime import case_run

    return case_run.run_realtime_case(
        case, files=files or {}, folder=folder, wires=wires or RealtimeWires()
    )
