"""Finds the evidence of a case: its kept logs, the frames around a time, the command to repeat
it."""

import shlex
from dataclasses import dataclass
from pathlib import Path
from typing import Final
from urllib.parse import quote

import numpy as np

import canlog
from metro_hil.engine.folder import CampaignFolder
from metro_hil.model.run_folder import RunFolder
from metro_hil.report.campaign.ledger import LedgerEntry

BEFORE_S: Final = 1.0
AFTER_S: Final = 0.5
NS_PER_S: Final = 1_000_000_000
EPOCH_FROM_NS: Final = 1_000_000 * NS_PER_S
"""Stamps from here on are calendar time; the first of them then marks the start of the run."""


@dataclass(frozen=True, slots=True)
class FrameSpan:
    """The frames around one time of one run."""

    from_s: float
    to_s: float
    path: str = ""
    """Path of the log relative to the campaign's folder; empty if it was not kept."""
    first: int = 0
    """Number of the first frame in the log, from 1; 0 if there is none."""
    last: int = 0

    @property
    def href(self) -> str:
        return quote(self.path)

    @property
    def text(self) -> str:
        span = f"{self.from_s:.2f}–{self.to_s:.2f}\u202fs"
        if not self.path:
            return span
        if not self.last:
            return f"{self.path}, {span}: no frame in it"
        return f"{self.path} frames {self.first}–{self.last}, {span}"


def rerun_command(entry: LedgerEntry) -> str:
    """Command that repeats this case in the campaign's folder, wherever that folder is."""
    return shlex.join(["hil", "rerun", ".", entry.case.id])


def kept_run(folder: Path, entry: LedgerEntry) -> RunFolder | None:
    """The logs of this case, if they were kept."""
    run = CampaignFolder(folder).kept(entry.case.id)
    return run if run.path.is_dir() else None


def frames_around(folder: Path, entry: LedgerEntry, at_s: float) -> FrameSpan:
    """The interval around `at_s`, with its frames if the bus log was kept."""
    from_s, to_s = max(0.0, at_s - BEFORE_S), at_s + AFTER_S
    run = kept_run(folder, entry)
    if run is None or not run.bus_log.is_file():
        return FrameSpan(from_s, to_s)
    first, last = numbers_between(run.bus_log, from_s, to_s)
    return FrameSpan(from_s, to_s, run.bus_log.relative_to(folder).as_posix(), first, last)


def numbers_between(log: Path, from_s: float, to_s: float) -> tuple[int, int]:
    """First and last frame, from 1, of a log within the interval; (0, 0) if there is none."""
    try:
        frames = canlog.read(log).frames
    except canlog.LogError:
        return 0, 0
    if not len(frames):
        return 0, 0
    since_ns = frames.at_ns - (frames.at_ns[0] if frames.at_ns[0] >= EPOCH_FROM_NS else 0)
    inside = (since_ns >= round(from_s * NS_PER_S)) & (since_ns <= round(to_s * NS_PER_S))
    rows = np.flatnonzero(inside)
    return (int(rows[0]) + 1, int(rows[-1]) + 1) if len(rows) else (0, 0)
