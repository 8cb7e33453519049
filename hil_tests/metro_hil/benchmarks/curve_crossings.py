"""Measures how soon the emergency brake is commanded once the speed may have reached its curve."""

import csv
import math
import tempfile
from bisect import bisect_right
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from can_dbc.binding import binding_of
from can_dbc.brake import BrakeCommand
from canlog import ACCEPTED, judge, read
from metro_hil.campaign.plan import plan_cases
from metro_hil.campaign.scenarios import read_named
from metro_hil.model.case_setup import Files
from metro_hil.model.run_folder import RunFolder
from metro_hil.run.dispatch import run_case

SCENARIOS: Final = (
    "overspeed-runaway",
    "overspeed-runaway-downhill",
    "reckless-driver",
    "late-driver",
    "end-of-authority-downhill",
    "end-of-authority-no-service-brake",
)
"""Scenarios in which a driver or a failure brings the train onto the curve."""
NS_PER_S: Final = 1_000_000_000


@dataclass(frozen=True, slots=True)
class Crossing:
    """One run in which the upper bound of the speed reached the emergency limit."""

    case_id: str
    bound_s: float
    """Start of the cycle that detected it."""
    commanded_s: float
    """Instant of the command with its twin on the bus; infinite if it never came."""
    truth_s: float
    """Instant at which the true speed reached the limit of that time; infinite if it never did."""


def crossings(names: Sequence[str] = SCENARIOS) -> Iterator[Crossing]:
    """Run every case of these scenarios in virtual time; a case without a crossing gives none."""
    for name in names:
        campaign = read_named(name)
        for case in plan_cases(campaign):
            with tempfile.TemporaryDirectory() as scratch:
                folder = RunFolder(Path(scratch) / "run")
                folder.path.mkdir()
                run_case(case, files=_written(campaign.files, Path(scratch)), folder=folder)
                yield from crossing_of(case.id, folder)


def _written(files: Mapping[str, str], folder: Path) -> Files:
    """Write lines and trains of the campaign to where the case expects them."""
    places = {name: folder / str(number) / Path(name).name for number, name in enumerate(files)}
    for name, place in places.items():
        place.parent.mkdir()
        place.write_text(files[name], encoding="utf-8")
    return places


def crossing_of(case_id: str, folder: RunFolder) -> Iterator[Crossing]:
    """Find the crossing in the logs of a run in virtual time."""
    for row in _rows(folder.cycle_log):
        if not (row["speed_high_mps"] and row["emergency_mps"]):
            continue
        limit_mps = float(row["emergency_mps"])
        if 0.0 < limit_mps <= float(row["speed_high_mps"]):
            bound_s = float(row["t_s"])
            yield Crossing(case_id, bound_s, _commanded_s(folder, bound_s), _truth_s(folder))
            return


def _rows(path: Path) -> Iterator[dict[str, str]]:
    with path.open(newline="", encoding="utf-8") as lines:
        yield from csv.DictReader(lines)


def _commanded_s(folder: RunFolder, bound_s: float) -> float:
    """Return the instant of the first command from that cycle on that applies the emergency brake.

    It counts once its twin has confirmed it, judged over all frames from the first one on.
    """
    log = read(folder.bus_log)
    bound = binding_of(BrakeCommand)
    assert bound.twin is not None
    accepted = judge(log.frames).code == ACCEPTED
    said, twins = (log.table(each.name) for each in (bound.message, bound.twin))
    braked = accepted[said.rows] & (np.array(said.labels("emergency_released")) == "FALSE")
    confirmed = twins.at_ns[accepted[twins.rows]]
    # An accepted twin follows its command: the first one after a command belongs to it.
    own = np.searchsorted(confirmed, said.at_ns[braked], "right")
    at_ns = confirmed[own[own < len(confirmed)]]
    late_ns = at_ns[at_ns >= round(bound_s * NS_PER_S)]
    return int(late_ns[0]) / NS_PER_S if len(late_ns) else math.inf


def _truth_s(folder: RunFolder) -> float:
    limits = [
        (float(row["t_s"]), float(row["emergency_mps"]))
        for row in _rows(folder.cycle_log)
        if row["emergency_mps"] and float(row["emergency_mps"]) > 0.0
    ]
    starts_s = [start_s for start_s, _ in limits]
    for row in _rows(folder.path / "truth.csv"):
        at_s = float(row["t_s"])
        cycle = bisect_right(starts_s, at_s) - 1
        if cycle >= 0 and float(row["speed_mps"]) >= limits[cycle][1]:
            return at_s
    return math.inf
