"""The files that the processes of a case read: line, real train, believed train and faults."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import tomli_w

from firmware_py.storage.whole_file import write_whole
from metro_hil.model.case import Case
from metro_hil.model.case_setup import CaseParts, Files, file_name
from metro_hil.model.run_folder import plain


@dataclass(frozen=True, slots=True)
class Documents:
    """Names of shipped files, the user's own files, or files written for this case."""

    line: str
    consist: str
    params: str
    faults: Path
    recording: str | None = None


def write_documents(case: Case, parts: CaseParts, files: Files, folder: Path) -> Documents:
    """Write only files that the case changes; an older controller then reads its own files."""
    setup = case.setup
    line = file_name(setup.line, files)
    if setup.dwell_s or setup.run_s:
        line = _written(folder / "line.toml", plain(parts.journey.line))
    consist = file_name(setup.consist, files)
    if setup.real:
        consist = _written(folder / "consist.toml", plain(parts.scenario.train))
    params = file_name(setup.params, files)
    if setup.believed:
        params = _written(folder / "params.toml", plain(parts.config))
    faults = Path(_written(folder / "faults.toml", {"fault": [dict(each) for each in case.faults]}))
    played = setup.desk_recording
    recording = None if played is None else file_name(played, files)
    return Documents(line, consist, params, faults, recording)


def _written(path: Path, table: Mapping[str, Any]) -> str:
    write_whole(path, tomli_w.dumps(table))
    return str(path)
