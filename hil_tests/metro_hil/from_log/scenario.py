"""Writes the scenario of a recorded ride: a campaign file, with the desk as it was recorded."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import tomli_w

from can_dbc.cab import Desk
from firmware_py.settings import SettingsError, is_path
from firmware_py.storage.whole_file import write_whole
from firmware_py.trackdb.circuit import split_route, with_route
from metro_hil.from_log.ride import RecordedRide, RideStations
from plant_emulator.desk.hands import unattended
from plant_emulator.desk.recording import HEADER, change_line
from plant_emulator.train_config import TrainConfig

SCENARIO: Final = "scenario.toml"
RECORDING: Final = "recorded.desk"
AFTER_S: Final = 60.0
"""How much longer than the record the simulated ride may take, s."""
HEAD: Final = """\
# Made by `hil from-log` from {name}. `hil run {scenario}` runs it; docs/guide/from_log.md tells how
# each value was found.

"""


@dataclass(frozen=True, slots=True)
class ChosenFiles:
    """Line, consist and parameters, as the user names them: shipped names, or paths."""

    line: str
    consist: str
    params: str


def load_ratio_of(ride: RecordedRide, train: TrainConfig) -> float | None:
    """Share of the full load that the ride reported; None if it reported none.

    Raises SettingsError for more than the train can carry.
    """
    full_kg = sum(car.passengers_kg for car in train.cars) * train.load_report_ratio
    if ride.load_kg is None or full_kg == 0.0:
        return None
    ratio = round(ride.load_kg / full_kg, 3)
    if ratio > 1.0:
        raise SettingsError(
            f"{ride.path}: load_kg: {ride.load_kg:g} is more than the {full_kg:g} that "
            f"{train.name} can carry; name the --consist of the ride"
        )
    return ratio


def write_scenario(
    folder: Path,
    ride: RecordedRide,
    stations: RideStations,
    files: ChosenFiles,
    *,
    load_ratio: float | None,
    odometer_error_ratio: float,
    real: Mapping[str, float],
    seed: int,
) -> Path:
    """Write the scenario with the files that it needs. Raises OSError."""
    last_s = ride.duration_ns / 1e9
    train: dict[str, Any] = {
        "line": copied(folder, "line", files.line),
        "consist": copied(folder, "consist", files.consist),
        "params": copied(folder, "params", files.params),
        "start": stations.start.name,
        "end": stations.stops[-1].name,
        "odometer_error": odometer_error_ratio,
        "duration_s": float(math.ceil(last_s) + AFTER_S),
        **_desk(folder, ride),
    }
    if load_ratio is not None:
        train["load_ratio"] = load_ratio
    document: dict[str, Any] = {
        "title": f"Recorded ride from {stations.start.name} to {stations.stops[-1].name}",
        "seeds": [seed],
        "stop_at_violation": False,
        "train": {**train, "real": dict(real)},
        "timetable": {"stops": [station.name for station in stations.stops]},
    }
    if stations.arrived:
        document["monitor"] = [{"name": "arrives", "measure": "arrived_count", "min": 1.0}]
    path = folder / SCENARIO
    head = HEAD.format(name=ride.path.name, scenario=SCENARIO)
    write_whole(path, head + tomli_w.dumps(document))
    return path


def copied(folder: Path, what: str, name: str) -> str:
    """The name of a shipped file, or that of a copy in the folder."""
    base, route = split_route(name) if what == "line" else (name, None)
    if not is_path(base):
        return name
    write_whole(folder / f"{what}.toml", Path(base).read_text(encoding="utf-8"))
    return with_route(f"{what}.toml", route)


def _desk(folder: Path, ride: RecordedRide) -> dict[str, str]:
    """Keys of the desk; a desk that no person operates needs no recording."""
    before, lines = None, list[str]()
    for at_ns, desk in ride.desk:
        assert isinstance(desk, Desk)
        if line := change_line(at_ns / 1e9 if before else 0.0, before, desk):
            lines.append(line)
        before = desk
    if before is None:
        return {}
    if len(lines) == 1 and before == unattended(before.mode):
        return {"desk_mode": before.mode.name.lower()}
    write_whole(folder / RECORDING, HEADER + "".join(lines))
    return {"desk_recording": RECORDING}
