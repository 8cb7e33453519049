"""The faults on the page of a run: the catalogue, acts of viewers, and what became of them."""

import dataclasses
import enum
import json
import tomllib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

from firmware_py.settings import SettingsError, parse
from firmware_py.trackdb.circuit import load_line, load_switched
from plant_emulator.cli.by_hand import FAULT_ACTS, FAULT_RECORD
from plant_emulator.faults.by_hand import ActError, plan_by_hand
from plant_emulator.faults.declared_loops import LOOP_FAULTS
from plant_emulator.faults.declared_train import PowerSectionOff
from plant_emulator.faults.described import PLACE_TITLES, Described, FaultParameter, all_described
from plant_emulator.faults.fitting import TRACK_FAULTS, FaultTargets, targets_on
from plant_emulator.faults.kinds import BENCH_PLACES, CATALOGUE, FaultPlace, Kind
from plant_emulator.train_config import TrainConfig, load_train

NOT_IN_REAL_TIME: Final = (
    "Not in real time, because it acts between the controller and the bus: "
    "use --lockstep, or `hil run --bench processes`."
)
NO_LOOPS: Final = "This train has no current loops."
NO_SWITCHES: Final = "This line has no switches; run the train over a route of a network."

NO_SECTIONS: Final = "This line has no power sections."


class FaultActs:
    """Checks what viewers want, passes it on to the plant, and reads what the plant recorded."""

    def __init__(self, folder: Path) -> None:
        """Open the file of the acts. Raises OSError or SettingsError."""
        options = parse(folder / "run.toml").get("options", {})
        self._targets = _targets(load_train(options["consist"]), options.get("line"))
        in_real_time = BENCH_PLACES if not options["lockstep"] else frozenset[FaultPlace]()
        self._places = frozenset(FaultPlace) - in_real_time
        self._record = folder / FAULT_RECORD
        self._stamp = 0
        self._tables: list[dict[str, Any]] = []
        self._file = (folder / FAULT_ACTS).open("a", buffering=1, encoding="utf-8")

    @property
    def catalogue(self) -> Sequence[Mapping[str, Any]]:
        """The faults by place, as the page lists them."""
        return [
            {
                "title": title,
                "kinds": [
                    _kind_head(each, self._targets, self._places)
                    for each in all_described()
                    if each.place is place
                ],
            }
            for place, title in PLACE_TITLES.items()
        ]

    def act(self, message: Mapping[str, Any]) -> str:
        """Pass an act on to the plant. Return why it is impossible; empty if it is possible."""
        try:
            line = self._checked(message)
        except ActError as error:
            return str(error)
        self._file.write(f"{json.dumps(line, ensure_ascii=True)}\n")
        return ""

    def _checked(self, message: Mapping[str, Any]) -> Mapping[str, Any]:
        """Raises ActError."""
        act, values = message.get("act"), message.get("values", {})
        if not isinstance(values, Mapping):
            raise ActError("values: no table")
        if act == "start":
            table = {"kind": message.get("fault"), **values}
            plan_by_hand(table, 0, self._targets, self._places)
            return {"start": table}
        index = message.get("index")
        if not isinstance(index, int) or not 0 <= index < len(self._tables):
            raise ActError(f"there is no fault {index!r}")
        if act == "stop":
            return {"stop": index}
        if act == "set":
            table = {"kind": self._tables[index]["kind"], **values}
            plan_by_hand(table, index, self._targets, self._places)
            return {"set": index, "values": values}
        raise ActError(f"{act!r}: an act is start, set or stop")

    def news(self) -> Sequence[Mapping[str, Any]] | None:
        """Return the recorded faults if the record has changed since the last call, else None."""
        try:
            stamp = self._record.stat().st_mtime_ns
            if stamp == self._stamp:
                return None
            text = self._record.read_text(encoding="utf-8")
            self._tables = tomllib.loads(text).get("fault", [])
        except (OSError, ValueError):
            return None
        self._stamp = stamp
        return self._tables

    def close(self) -> None:
        self._file.close()


def open_fault_acts(folder: Path) -> FaultActs:
    """Open the faults of a run folder. Raises SettingsError or OSError."""
    try:
        return FaultActs(folder)
    except KeyError as error:
        raise SettingsError(f"{folder / 'run.toml'}: options.{error.args[0]}: missing") from error


def _targets(train: TrainConfig, line: str | None) -> FaultTargets:
    if line is None:
        return FaultTargets(train)
    return targets_on(train, load_line(line), load_switched(line))


def _kind_head(
    described: Described, targets: FaultTargets, places: frozenset[FaultPlace]
) -> Mapping[str, Any]:
    kind = CATALOGUE[described.name]
    missing = ""
    if kind.place not in places:
        missing = NOT_IN_REAL_TIME
    elif issubclass(kind.parameters, LOOP_FAULTS) and not targets.train.loop.connected:
        missing = NO_LOOPS
    elif issubclass(kind.parameters, TRACK_FAULTS) and targets.network is None:
        missing = NO_SWITCHES
    elif kind.parameters is PowerSectionOff and not targets.sections:
        missing = NO_SECTIONS
    return {
        "name": described.name,
        "story": described.story,
        "missing": missing,
        "parameters": [_parameter_head(each, kind) for each in described.parameters],
    }


def _parameter_head(parameter: FaultParameter, kind: Kind) -> Mapping[str, Any]:
    (field,) = (each for each in dataclasses.fields(kind.parameters) if each.name == parameter.name)
    default = field.default.name.lower() if isinstance(field.default, enum.Enum) else field.default
    return {
        "name": parameter.name,
        "kind": parameter.kind,
        "unit": "" if parameter.unit == "1" else parameter.unit,
        "range": parameter.range,
        "story": parameter.story,
        "value": default,
    }
