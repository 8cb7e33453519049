"""The benches in real time: the same case as in lockstep, with processes, wires and a clock."""

from collections.abc import Mapping
from pathlib import Path

from metro_hil.cases import Case, CaseResult
from metro_hil.realtime.wires import Presence, RealtimeWires
from metro_hil.run_folder import RunFolder

__all__ = ["Presence", "RealtimeWires", "run_realtime_case"]


def run_realtime_case(
    case: Case,
    *,
    files: Mapping[str, Path] | None = None,
    folder: RunFolder | None = None,
    wires: RealtimeWires | None = None,
) -> CaseResult:
    """See `metro_hil.realtime.realtime_case`, which is loaded only when a case is run."""
    from metro_hil.realtime import realtime_case

    return realtime_case.run_realtime_case(
        case, files=files or {}, folder=folder, wires=wires or RealtimeWires()
    )
