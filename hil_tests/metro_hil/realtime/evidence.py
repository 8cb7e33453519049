"""Collects from the logs of a run the evidence that the host disturbed it."""

import json
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Final

from metro_hil.model.log_columns import Columns, RunLogError, read_columns
from metro_hil.model.run_folder import RunFolder
from metro_hil.realtime.attribution import (
    GATEWAY_LATE_S,
    HANG_S,
    STEAL_S,
    WAITED_S,
    CycleRow,
    Disturbance,
    DisturbanceSource,
    HostEvidence,
    RunWindow,
    lateness_disturbances,
    plant_disturbances,
    second_disturbances,
)
from metro_hil.realtime.commands import again
from metro_hil.realtime.host import HostRecord

GATEWAY_LOG: Final = "gateway.csv"
STEP_S: Final = 0.01


def collect_evidence(
    folder: RunFolder,
    host: HostRecord,
    *,
    cycle_s: float,
    origin_s: float,
    starts_s: Sequence[float],
    excused: Sequence[RunWindow],
    own_controller: bool,
) -> HostEvidence:
    """Collect all disturbances of the run.

    Args:
        origin_s: start of the plant's time on the machine's clock.
        starts_s: first cycle of each start of the controller, in the plant's time.
        excused: stretches in which a fault of the scenario delayed the process.
        own_controller: whether the controller's log belongs to this run.
    """
    found: list[Disturbance] = []
    found += second_disturbances(host.stolen, DisturbanceSource.STEAL, STEAL_S)
    found += second_disturbances(host.waited, DisturbanceSource.WAITING, WAITED_S)
    found += second_disturbances(host.carriers_waited, DisturbanceSource.CARRIERS, WAITED_S)
    found += second_disturbances(host.stalled, DisturbanceSource.STALL, HANG_S)
    found += plant_disturbances(host.truth_late)
    found += second_disturbances(
        gateway_waits(folder, origin_s), DisturbanceSource.GATEWAY, GATEWAY_LATE_S
    )
    if own_controller:
        for number, begin_s in enumerate(starts_s):
            log = again(folder.path, number) / folder.cycle_log.name
            rows = cycle_rows(log, cycle_s=cycle_s, begin_s=begin_s)
            found += lateness_disturbances(rows, excused)
    found.sort(key=lambda each: (each.begin_s, each.source.value))
    return HostEvidence(disturbances=found, given_up_s=STEP_S * lost_steps(folder))


def cycle_rows(path: Path, *, cycle_s: float, begin_s: float) -> list[CycleRow]:
    """Return the rows of the controller's log; none if it keeps no such log."""
    log = _read(path)
    if log is None:
        return []
    try:
        columns = [log.numbers(name).tolist() for name in ("t_s", "work_us", "lateness_us")]
    except RunLogError:
        return []
    rows = [row for row in zip(*columns, strict=True) if not any(map(math.isnan, row))]
    if not rows:
        return []
    # The log's first row is the first cycle, and its frame is the controller's first one.
    shift_s = begin_s - rows[0][0]
    return [
        CycleRow(t_s + shift_s, work_us / 1e6, lateness_us / 1e6, cycle_s)
        for t_s, work_us, lateness_us in rows
    ]


def gateway_waits(folder: RunFolder, origin_s: float) -> list[tuple[float, float]]:
    """Return (end of each second, longest wait of a frame that no fault delayed)."""
    log = _read(folder.path / GATEWAY_LOG)
    if log is None:
        return []
    times_s, waits_us = log.numbers("t_s").tolist(), log.numbers("wait_max_us").tolist()
    return [(t_s - origin_s, wait_us / 1e6) for t_s, wait_us in zip(times_s, waits_us, strict=True)]


def lost_steps(folder: RunFolder) -> int:
    """Return the number of steps that the plant skipped after a long delay."""
    try:
        told = json.loads((folder.path / "plant.json").read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return 0
    return int(told.get("lost_steps", 0))


def touched_counts(folder: RunFolder) -> dict[int, int]:
    """Return how often plant and gateway report that a fault acted, by index of the fault."""
    found: dict[int, int] = {}
    for name in ("plant.json", "gateway.json"):
        try:
            told = json.loads((folder.path / name).read_text(encoding="utf-8"))
        except (OSError, ValueError):
            continue
        found |= {int(index): count for index, count in told.get("touched", {}).items()}
    return found


def _read(path: Path) -> Columns | None:
    try:
        return read_columns(path)
    except RunLogError:
        return None
