"""All inputs of a controller before its first cycle, also as a table for JSON."""

import dataclasses
import enum
import typing
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from firmware_py.ports import CanPort, RadioPort, SerialPort
from firmware_py.settings import SettingsError, build
from firmware_py.storage.nvram import Nvram, NvramRecord
from firmware_py.trackdb import LineMap
from vobc.config import VobcConfig
from vobc.process.cycle_log import CycleLog
from vobc.process.device import VobcDevice
from vobc.process.event_log import EventLog
from vobc.vocabulary import Mission, OdometryRecord

if TYPE_CHECKING:
    from vobc.process.line_command import LineCommand


@dataclass(frozen=True, slots=True)
class Commission:
    """Everything that determines a controller. Equal inputs at equal instants give equal
    outputs.
    """

    config: VobcConfig
    line: LineMap
    mission: Mission
    nvram: NvramRecord
    """Memory as the controller finds it."""
    start_ns: int
    """Start on the controller's clock."""
    start: OdometryRecord | None = None
    """Place of the train. None: the start of its mission."""
    grid_ns: int | None = None
    """Start of the grid of task releases. None: `start_ns`."""
    forgotten: bool = False
    """The memory of the board is unreadable, and `nvram` is the replacement."""

    def device(
        self,
        *,
        can: CanPort,
        tags: SerialPort,
        radio: RadioPort,
        nvram: Nvram | None = None,
        cycle_log: CycleLog | None = None,
        event_log: EventLog | None = None,
        command: "LineCommand | None" = None,
    ) -> VobcDevice:
        """Create the device. Without `nvram` its memory is lost at the end."""
        device = VobcDevice(
            self.config,
            self.line,
            self.mission,
            can=can,
            tags=tags,
            radio=radio,
            nvram=nvram or Nvram(None, self.nvram),
            cycle_log=cycle_log,
            start_ns=self.start_ns,
            start=self.start,
            event_log=event_log,
            forgotten=self.forgotten,
            command=command,
        )
        if self.grid_ns is not None:
            device.executive.start_at(self.grid_ns)
        return device

    def table(self) -> dict[str, Any]:
        """Table for JSON. `read_commission` restores the same commission from it."""
        return {
            "start_ns": self.start_ns,
            "grid_ns": self.start_ns if self.grid_ns is None else self.grid_ns,
            "line": plain(self.line),
            "params": plain(self.config),
            "mission": {
                "start": self.mission.start.name,
                "stops": [station.name for station in self.mission.stops],
            },
            "memory": plain(self.nvram),
            "standing": None if self.start is None else plain(self.start),
            "forgotten": self.forgotten,
        }


def read_commission(
    table: Mapping[str, Any], source: str, left_out: list[str] | None = None
) -> Commission:
    """Read a table. Raises SettingsError that names source, key and value.

    Args:
        left_out: receives the keys that this version does not know. Without it they are an error.
    """
    parts: dict[str, Any] = {}
    kinds = {"line": LineMap, "params": VobcConfig, "memory": NvramRecord}
    for key, kind in kinds.items():
        parts[key] = build(
            kind, _known(kind, _table(table, key, source), key, left_out), source, key
        )
    line: LineMap = parts["line"]
    standing = table.get("standing")
    return Commission(
        config=parts["params"],
        line=line,
        mission=_mission(_table(table, "mission", source), line, source),
        nvram=parts["memory"],
        start_ns=_instant_ns(table, "start_ns", source),
        grid_ns=_instant_ns(table, "grid_ns", source),
        start=None if standing is None else build(OdometryRecord, standing, source, "standing"),
        forgotten=table.get("forgotten") is True,
    )


def _instant_ns(table: Mapping[str, Any], key: str, source: str) -> int:
    value = table.get(key)
    if not isinstance(value, int):
        raise SettingsError(f"{source}: {key}: {value!r} is no instant")
    return value


def _mission(table: Mapping[str, Any], line: LineMap, source: str) -> Mission:
    names = [table.get("start"), *table.get("stops", ())]
    try:
        first, *stops = (line.station(str(name)) for name in names)
    except KeyError as error:
        raise SettingsError(f"{source}: mission: {error.args[0]}") from None
    return Mission(first, tuple(stops))


def _table(table: Mapping[str, Any], key: str, source: str) -> Mapping[str, Any]:
    value = table.get(key)
    if not isinstance(value, Mapping):
        raise SettingsError(f"{source}: {key}: missing table")
    return value


def plain(value: Any) -> Any:
    """Convert dataclasses and enums for `settings.build`. None is left out."""
    if dataclasses.is_dataclass(value):
        fields = ((field.name, field.init) for field in dataclasses.fields(value))
        told = {name: getattr(value, name) for name, init in fields if init}
        return {name: plain(item) for name, item in told.items() if item is not None}
    if isinstance(value, enum.Enum):
        return value.name.lower()
    if isinstance(value, tuple | list):
        return [plain(item) for item in value]
    return value


def _known(kind: Any, table: Any, key: str, left_out: list[str] | None) -> Any:
    """The part of a table that this version's dataclasses have fields for."""
    if isinstance(table, list):
        entries = enumerate(table)
        return [_known(kind, item, f"{key}[{index}]", left_out) for index, item in entries]
    if left_out is None or not isinstance(table, Mapping) or not dataclasses.is_dataclass(kind):
        return table
    hints = typing.get_type_hints(kind)
    known = {}
    for name, item in table.items():
        if name not in hints:
            left_out.append(f"{key}.{name}")
            continue
        inner = [hints[name], *typing.get_args(hints[name])]
        nested = next((hint for hint in inner if dataclasses.is_dataclass(hint)), None)
        known[name] = _known(nested, item, f"{key}.{name}", left_out)
    return known
