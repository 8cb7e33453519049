"""Tables of campaign files: their shape, inheritance, and values set by dotted key."""

from collections.abc import Mapping
from typing import Any, Final

from firmware_py.settings import nearest, unknown_key
from metro_hil.campaign.problems import Findings
from metro_hil.campaign.schema import (
    ARRAYS,
    CAMPAIGN_ONLY,
    HEAD,
    OVERRIDES,
    SWEPT,
    TABLES,
    unfit,
)

ConfigTable = dict[str, Any]
APPENDED: Final = ("fault", "monitor")
REPLACED: Final = ("sweep", "stops", "expected", "vacuous")
WHOLE: Final = ("train", "timetable")
"""Tables of which one level may set several keys."""


class KeyMissingError(KeyError):
    """A dotted key that leads to no value; the first argument says why."""


def shaped(table: Mapping[str, Any], findings: Findings, *, inside_scenario: bool) -> ConfigTable:
    """The entries of a file's table with known keys and right kinds; others are reported."""
    known = [
        name
        for name in (*HEAD, *TABLES, *ARRAYS)
        if not (inside_scenario and name in CAMPAIGN_ONLY)
    ]
    kept: ConfigTable = {}
    for name, value in table.items():
        if name not in known:
            findings.add(name, unknown_key(name, known, {} if inside_scenario else table))
        elif name in TABLES and not isinstance(value, dict):
            findings.add(name, f"{value!r} is not a table")
        elif name in ARRAYS and not _is_array(value):
            findings.add(name, f"{value!r} is not an array of tables; write [[{name}]]")
        elif name != "scenario" and (wrong := list(unfit(value, name))):
            for key, why in wrong:
                findings.add(key, why)
        else:
            kept[name] = value
    if "train" in kept:
        kept["train"] = flat_overrides(kept["train"], findings)
    return kept


def flat_overrides(train: Mapping[str, Any], findings: Findings) -> ConfigTable:
    """Overrides by dotted key, whether the file quotes the keys or nests tables."""
    made = dict(train)
    for name in OVERRIDES:
        if name not in made:
            continue
        if not isinstance(made[name], dict):
            findings.add(f"train.{name}", f"{made[name]!r} is not a table")
            del made[name]
            continue
        made[name] = flat(made[name])
    return made


def flat(table: Mapping[str, Any]) -> ConfigTable:
    """Nested tables as one table with dotted keys."""
    made: ConfigTable = {}
    for name, value in table.items():
        if isinstance(value, dict):
            for key, inner in flat(value).items():
                put(made, f"{name}.{key}", inner)
        else:
            put(made, name, value)
    return made


def put(overrides: ConfigTable, key: str, value: Any) -> None:
    """Set one dotted key, and remove all keys below it."""
    for other in [name for name in overrides if name.startswith(f"{key}.")]:
        del overrides[other]
    overrides[key] = value


def merged(above: Mapping[str, Any], own: Mapping[str, Any]) -> ConfigTable:
    """A scenario with what it inherits: tables merge by key; faults and monitors are appended."""
    made: ConfigTable = copied(above)
    for name, value in own.items():
        if name in APPENDED:
            made[name] = [*made.get(name, []), *copied(value)]
        elif isinstance(value, dict) and isinstance(made.get(name), dict) and name not in REPLACED:
            if name in OVERRIDES:
                for key, inner in value.items():
                    put(made[name], key, inner)
            else:
                made[name] = merged(made[name], value)
        else:
            made[name] = copied(value)
    return made


def copied(value: Any) -> Any:
    """A deep copy of tables and arrays."""
    if isinstance(value, dict):
        return {name: copied(inner) for name, inner in value.items()}
    if isinstance(value, list | tuple):
        return [copied(inner) for inner in value]
    return value


def with_value(table: Mapping[str, Any], key: str, value: Any) -> ConfigTable:
    """The scenario with one value set by key, such as `fault.0.start_s`.

    It copies only the tables on the way to the key. Raises KeyMissingError.
    """
    head, _, rest = key.partition(".")
    if head not in SWEPT:
        raise KeyMissingError(f"cannot be swept; {nearest(head, list(SWEPT), 'beginning')}")
    if key == "fault" and _is_array(value):
        return {**table, head: [*table.get(head, []), *value]}
    if head in WHOLE and not rest and isinstance(value, dict):
        return {**table, head: merged(table.get(head, {}), value)}
    if not rest:
        raise KeyMissingError(f"is a whole table; sweep one of its keys, such as {head}.…")
    if head in APPENDED:
        return {**table, head: _with_entry(table.get(head, []), head, rest, value)}
    return {**table, head: _with_key(table.get(head, {}), head, rest, value)}


def _with_entry(array: list[ConfigTable], head: str, rest: str, value: Any) -> list[ConfigTable]:
    digits, _, rest = rest.partition(".")
    if not digits.isdecimal() or int(digits) >= len(array):
        entries = ", ".join(f"{head}.{index}" for index in range(len(array)))
        raise KeyMissingError(f"no such {head}; {f'there is {entries}' if entries else 'none'}")
    index = int(digits)
    entry = value if not rest else _with_key(array[index], f"{head}.{digits}", rest, value)
    return [entry if place == index else other for place, other in enumerate(array)]


def _with_key(table: ConfigTable, where: str, rest: str, value: Any) -> ConfigTable:
    name, _, below = rest.partition(".")
    if not below:
        made = dict(table)
        made[name] = flat(value) if name in OVERRIDES and isinstance(value, dict) else value
        return made
    inner = table.get(name, {})
    if not isinstance(inner, dict):
        raise KeyMissingError(f"{where}.{name} is no table")
    if where == "train" and name in OVERRIDES:
        made = dict(inner)
        for key, item in flat({below: value}).items():
            put(made, key, item)
        return {**table, name: made}
    return {**table, name: {**inner, below: value}}


def _is_array(value: object) -> bool:
    return isinstance(value, list) and all(isinstance(item, dict) for item in value)
