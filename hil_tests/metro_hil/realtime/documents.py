"""The files that the processes of a case read: line, real train, believed train and faults."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import tomli_w

from metro_hil.case_setup import CaseParts, Files, file_name
from metro_hil.cases import Case
from metro_hil.realtime.wires import Blocked
from metro_hil.run_folder import plain


@dataclass(frozen=True, slots=True)
class Documents:
    """Names of shipped files, the user's own files, or ones written for this case alone."""

    line: str
    consist: str
    params: str
    faults: Path


def write_documents(case: Case, parts: CaseParts, files: Files, folder: Path) -> Documents:
    """Files are written only for what the case changes, so that an older controller reads its own.

    Raises Blocked for what no file can say.
    """
    setup = case.setup
    _refuse_skipped(parts)
    line = file_name(setup.line, files)
    if setup.dwell_s:
        line = _written(folder / "line.toml", plain(parts.journey.line))
    consist = file_name(setup.consist, files)
    if setup.real:
        consist = _written(folder / "consist.toml", plain(parts.scenario.train))
    params = file_name(setup.params, files)
    if setup.believed:
        params = _written(folder / "params.toml", plain(parts.config))
    faults = Path(_written(folder / "faults.toml", {"fault": [dict(each) for each in case.faults]}))
    return Documents(line, consist, params, faults)


def _refuse_skipped(parts: CaseParts) -> None:
    """The controller's command line knows no timetable: it stops at every station on its way."""
    journey = parts.journey
    way = journey.line.stations_between(journey.start.stop_m, journey.end.stop_m)
    stops = {station.name for station in journey.stops}
    skipped = [station.name for station in way if station.name not in stops]
    if skipped:
        raise Blocked(
            f"stops: the controller's program cannot be told to pass {', '.join(skipped)}; "
            "leave `stops` out, or run it in lockstep"
        )


def _written(path: Path, table: Mapping[str, Any]) -> str:
    path.write_text(tomli_w.dumps(table), encoding="utf-8")
    return str(path)
