"""Recordings of a desk: text with one line for each change.

    # comment
    0.0   mode=manual lever_percent=40
    12.5  lever_percent=-60 reset_requested=true

Each line has the seconds since the start and the fields of the frame DESK that change. The other
fields keep their values. The seconds never decrease. Before the first line the desk is unattended.
"""

import enum
import math
import typing
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any, Final

from can_dbc.cab import CabMode, Desk
from firmware_py.settings import SettingsError, nearest, unknown_key

COMMENT: Final = "#"
LEVER_MAX_PERCENT: Final = 100.0
T_MAX_S: Final = 1.0e6
_TYPES: Final = typing.get_type_hints(Desk)
FIELDS: Final[tuple[str, ...]] = tuple(field.name for field in fields(Desk))
_BOOLEANS: Final = {"true": True, "false": False}
HEADER: Final = "# Desk: seconds since the start, then what changes. See docs/guide/desk.md.\n"


@dataclass(frozen=True, slots=True)
class DeskChange:
    t_s: float
    values: tuple[tuple[str, Any], ...]
    """Changed fields of the frame with their new values."""


@dataclass(frozen=True, slots=True)
class DeskRecording:
    """Changes of the desk in order of time."""

    changes: tuple[DeskChange, ...]

    def at(self, t_s: float, before: Desk) -> Desk:
        """Return the desk at an instant; `before` is the desk before the first change."""
        values: dict[str, Any] = {}
        for change in self.changes:
            if change.t_s > t_s:
                break
            values.update(change.values)
        return replace(before, **values)

    @property
    def end_s(self) -> float:
        return self.changes[-1].t_s if self.changes else 0.0


def load_recording(name: str) -> DeskRecording:
    """Load a recording. Raises SettingsError with file, line and key."""
    try:
        text = Path(name).read_text(encoding="utf-8")
    except FileNotFoundError as error:
        raise SettingsError(f"{name}: no such file") from error
    except (OSError, ValueError) as error:
        raise SettingsError(f"{name}: cannot be read: {error}") from error
    return parse_recording(text, name)


def parse_recording(text: str, source: str) -> DeskRecording:
    """Parse a recording. Raises SettingsError with source, line and key."""
    changes: list[DeskChange] = []
    for number, line in enumerate(text.splitlines(), start=1):
        words = line.split(COMMENT)[0].split()
        if not words:
            continue
        where = f"{source}:{number}"
        t_s = _seconds(words[0], where)
        if changes and t_s < changes[-1].t_s:
            raise SettingsError(f"{where}: t_s: {t_s:g} is before {changes[-1].t_s:g}")
        if len(words) == 1:
            raise SettingsError(f"{where}: nothing changes at {t_s:g} s; write key=value after it")
        changes.append(DeskChange(t_s, tuple(_values(words[1:], where))))
    return DeskRecording(tuple(changes))


def _seconds(word: str, where: str) -> float:
    t_s = _number(word)
    if not 0.0 <= t_s <= T_MAX_S:
        raise SettingsError(f"{where}: t_s: {word!r} is not a number of seconds in 0..{T_MAX_S:g}")
    return t_s


def _values(words: list[str], where: str) -> Iterator[tuple[str, Any]]:
    for word in words:
        key, equals, value = word.partition("=")
        if key not in FIELDS:
            raise SettingsError(f"{where}: {key}: {unknown_key(key, list(FIELDS))}")
        if not equals:
            raise SettingsError(f"{where}: {key}: no value; write {key}=...")
        yield key, _value(key, value, where)


def _value(key: str, text: str, where: str) -> Any:
    kind = _TYPES[key]
    if kind is bool:
        if text not in _BOOLEANS:
            raise SettingsError(f"{where}: {key}: {text!r} is neither true nor false")
        return _BOOLEANS[text]
    if kind is CabMode:
        modes = {mode.name.lower(): mode for mode in CabMode}
        if text not in modes:
            raise SettingsError(f"{where}: {key}: {text!r}: {nearest(text, list(modes))}")
        return modes[text]
    percent = _number(text)
    if not abs(percent) <= LEVER_MAX_PERCENT:
        raise SettingsError(f"{where}: {key}: {text!r} is not a number in -100..100")
    return percent


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        return math.nan


def change_line(t_s: float, before: Desk | None, now: Desk) -> str:
    """Return the recording's line for the changed fields; without `before`, for all fields.

    Returns an empty text if no field changed.
    """
    values = {
        name: _text(getattr(now, name))
        for name in FIELDS
        if before is None or getattr(before, name) != getattr(now, name)
    }
    return _line(t_s, values) if values else ""


def _line(t_s: float, values: Mapping[str, str]) -> str:
    return " ".join([f"{t_s:.3f}", *(f"{name}={value}" for name, value in values.items())]) + "\n"


def _text(value: Any) -> str:
    if isinstance(value, enum.Enum):
        return value.name.lower()
    if isinstance(value, bool):
        return str(value).lower()
    return f"{value:g}"
