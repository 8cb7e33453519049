"""Where to look: logs of a kept run, frames around an instant, the command that repeats it."""

import shlex
from dataclasses import dataclass
from pathlib import Path
from typing import Final
from urllib.parse import quote

from metro_hil.engine.folder import CampaignFolder
from metro_hil.report.campaign.ledger import Entry
from metro_hil.run_folder import RunFolder

BEFORE_S: Final = 1.0
AFTER_S: Final = 0.5
EPOCH_FROM_S: Final = 1e6
"""Stamps from here on are of the calendar, so that the first of them is the start of the run."""


@dataclass(frozen=True, slots=True)
class Frames:
    """The frames around one instant of one run."""

    from_s: float
    to_s: float
    path: str = ""
    """Relative to the campaign's folder; empty when the log of this run was not kept."""
    first_line: int = 0
    last_line: int = 0

    @property
    def href(self) -> str:
        return quote(self.path)

    @property
    def text(self) -> str:
        span = f"{self.from_s:.2f}–{self.to_s:.2f}\u202fs"
        if not self.path:
            return span
        if not self.last_line:
            return f"{self.path}, {span}: no frame in it"
        return f"{self.path} lines {self.first_line}–{self.last_line}, {span}"


def rerun_command(entry: Entry) -> str:
    """What repeats this case when typed in the campaign's folder, wherever that lies."""
    return shlex.join(["hil", "rerun", ".", entry.case.id])


def kept_run(folder: Path, entry: Entry) -> RunFolder | None:
    """The logs of this case, if they were kept."""
    run = CampaignFolder(folder).kept(entry.case.id)
    return run if run.path.is_dir() else None


def frames_around(folder: Path, entry: Entry, at_s: float) -> Frames:
    """The interval around `at_s`, with the lines of the bus log if there is one."""
    from_s, to_s = max(0.0, at_s - BEFORE_S), at_s + AFTER_S
    run = kept_run(folder, entry)
    if run is None or not run.bus_log.is_file():
        return Frames(from_s, to_s)
    first, last = lines_between(run.bus_log, from_s, to_s)
    return Frames(from_s, to_s, run.bus_log.relative_to(folder).as_posix(), first, last)


def lines_between(log: Path, from_s: float, to_s: float) -> tuple[int, int]:
    """First and last line, from 1, of a can-utils log within the interval; (0, 0) if none is."""
    first = last = 0
    origin_s: float | None = None
    with log.open(encoding="utf-8", errors="replace") as lines:
        for number, line in enumerate(lines, start=1):
            stamp, closed, _ = line.removeprefix("(").partition(")")
            try:
                at_s = float(stamp) if closed else None
            except ValueError:
                at_s = None
            if at_s is None:
                continue
            if origin_s is None:
                origin_s = at_s if at_s >= EPOCH_FROM_S else 0.0
            since_s = at_s - origin_s
            if since_s > to_s:
                break
            if since_s >= from_s:
                first, last = first or number, number
    return first, last
