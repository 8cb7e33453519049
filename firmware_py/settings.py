"""Converts TOML files to frozen dataclasses. Every error names file, key and value."""

import dataclasses
import difflib
import enum
import functools
import os
import sys
import tomllib
import types
import typing
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from importlib import resources
from pathlib import Path
from typing import Any, Final, TypeVar, Union, get_args, get_origin

from firmware_py.toml_lines import key_lines, line_of

T = TypeVar("T")

KEPT_MAX: Final = 64
"""Number of files whose parsed settings are cached while their text is unchanged."""

MARKS: Final[Mapping[str, str]] = {
    "trips": "a service",
    "tracks": "a network",
    "stations": "a line",
    "scenario": "a campaign",
    "substations": "a supply network",
    "dwell_s": "the traffic of a line",
    "cars": "a consist",
    "odometry": "the parameters of a controller",
}
"""Keys that only files of one kind have at their top level."""


class SettingsError(Exception):
    """An unusable configuration file; the text names file, key and value."""


def shipped_names(package: str) -> list[str]:
    """Names of the TOML files that ship with a package, without suffix, sorted."""
    return list(_shipped(package))


@functools.cache
def _shipped(package: str) -> tuple[str, ...]:
    """Look the names up once; shipped files do not change while a process runs."""
    entries = [entry.name for entry in resources.files(package).iterdir()]
    return tuple(sorted(name.removesuffix(".toml") for name in entries if name.endswith(".toml")))


def is_path(name: str) -> bool:
    """Return whether `name` is the path of a file and not the name of a shipped one."""
    return name.endswith(".toml") or "/" in name or os.sep in name


def find(name: str, package: str) -> Path:
    """Return the file called `name`: a path if it looks like one, otherwise a file shipped with
    `package`.
    """
    if is_path(name):
        return Path(name)
    shipped = shipped_names(package)
    if name not in shipped:
        is_there = os.path.exists(name)  # noqa: PTH110 - no error for a name that no file can have
        there = "is there, but is no .toml file; " if is_there else ""
        raise SettingsError(f"{name}: {there}{nearest(name, shipped, 'shipped name')}")
    return Path(str(resources.files(package) / f"{name}.toml"))


def load(kind: type[T], name: str, package: str) -> T:
    """Read the file called `name` (see `find`) into `kind`."""
    path = find(name, package)
    hashable: Any = kind
    loaded: T = _loaded(hashable, text_of(path), str(path))
    return loaded


@functools.lru_cache(maxsize=KEPT_MAX)
def _loaded(kind: type[Any], text: str, source: str) -> Any:
    """Cache the result; it is frozen, so all callers may share it."""
    with located(source, text):
        return build(kind, tables_of(text, source), source)


def parse(path: Path) -> dict[str, Any]:
    """Read the tables of one TOML file."""
    return tables_of(text_of(path), str(path))


def text_of(path: Path) -> str:
    """Read a file. Raises SettingsError if it cannot be read."""
    try:
        return path.read_text(encoding="utf-8")
    except FileNotFoundError as error:
        raise SettingsError(f"{path}: no such file") from error
    except OSError as error:
        raise SettingsError(f"{path}: cannot be read: {error.strerror}") from error
    except ValueError as error:
        raise SettingsError(f"{path}: not TOML: {error}") from error


@contextmanager
def located(source: str, text: str) -> Iterator[None]:
    """Adds the line of the file to the messages of a SettingsError: `SOURCE:LINE: KEY: …`.

    Args:
        source: what messages call the file.
        text: of the file.
    """
    try:
        yield
    except SettingsError as error:
        # The parser itself names the line of text that is not TOML.
        lines = key_lines(text) if _is_toml(text) else {}
        error.args = tuple(_with_line(str(each), source, lines) for each in error.args)
        raise


def _is_toml(text: str) -> bool:
    try:
        tables_of(text, "")
    except SettingsError:
        return False
    return True


def _with_line(message: str, source: str, lines: Mapping[str, int]) -> str:
    """Each line of the message is changed by itself; one without a key of the file stays."""
    changed = []
    for each in message.split("\n"):
        rest = each.removeprefix(f"{source}: ")
        number = None if rest == each else line_of(lines, rest)
        changed.append(each if number is None else f"{source}:{number}: {rest}")
    return "\n".join(changed)


def tables_of(text: str, source: str) -> dict[str, Any]:
    """Parse the text of a TOML file. Raises SettingsError."""
    try:
        return tomllib.loads(text)
    # Besides its own errors, the parser lets errors of too large numbers and dates and of too
    # deeply nested brackets pass through.
    except (ValueError, RecursionError) as error:
        raise SettingsError(f"{source}: not TOML: {error}") from error


def build(kind: type[T], table: Mapping[str, Any], source: str, key: str = "") -> T:
    """Build the dataclass `kind` from a table.

    Raises:
        SettingsError: for an unknown or missing key, a value of the wrong type, or a value that the
            dataclass itself rejects with ValueError in `__post_init__`.
    """
    assert dataclasses.is_dataclass(kind)
    hints = _hints(kind)
    fields = {field.name: field for field in dataclasses.fields(kind) if field.init}
    for name in table:
        if name not in fields:
            found = unknown_key(name, list(fields), {} if key else table)
            raise SettingsError(f"{source}: {_join(key, name)}: {found}")
    values: dict[str, Any] = {}
    for name, field in fields.items():
        if name in table:
            values[name] = _convert(hints[name], table[name], source, _join(key, name))
        elif field.default is dataclasses.MISSING and field.default_factory is dataclasses.MISSING:
            raise SettingsError(f"{source}: {_join(key, name)}: missing key")
    try:
        return kind(**values)
    except ValueError as error:
        where = f"{source}: {key}" if key else source
        raise SettingsError(f"{where}: {error}") from error


@functools.cache
def _hints(kind: type[Any]) -> Mapping[str, Any]:
    return typing.get_type_hints(kind)


def override(value: T, changes: Mapping[str, Any], source: str) -> T:
    """Return the frozen dataclass `value` with some of its contents replaced, checked as a whole.

    Args:
        changes: by dotted key relative to `value`, such as `brake.service.gain_ratio`; entries of a
            list by index, `cars.0.tare_kg`. A value is written as in a file, but a table changes
            only the keys it names. A dataclass with only the fields low and high may be given as
            one number for both.

    Raises:
        SettingsError: with source, key and value, as in `build`.
    """
    assert dataclasses.is_dataclass(value)
    changed: T = _changed(type(value), value, _tree(changes, source), source, "")
    return changed


def _tree(changes: Mapping[str, Any], source: str, above: str = "") -> dict[str, Any]:
    """Convert dotted keys to nested tables."""
    tree: dict[str, Any] = {}
    for dotted, new in changes.items():
        where = _join(above, dotted)
        *path, last = dotted.split(".")
        branch = tree
        for name in path:
            branch = branch.setdefault(name, {})
            if not isinstance(branch, dict):
                raise SettingsError(f"{source}: {where}: changed twice, here and as a whole")
        leaf = _tree(new, source, where) if isinstance(new, Mapping) else new
        present = branch.get(last)
        if isinstance(leaf, dict) and isinstance(present, dict) and not leaf.keys() & present:
            branch[last] = {**present, **leaf}
        elif last in branch:
            raise SettingsError(f"{source}: {where}: changed twice")
        else:
            branch[last] = leaf
    return tree


def _changed(hint: Any, value: Any, change: Any, source: str, key: str) -> Any:
    if not isinstance(change, dict):
        if _is_range(value) and isinstance(change, int | float) and not isinstance(change, bool):
            change = {"low": change, "high": change}
        return _convert(hint, change, source, key)
    if dataclasses.is_dataclass(value):
        return _changed_fields(value, change, source, key)
    if isinstance(value, tuple):
        return _changed_entries(hint, value, change, source, key)
    if isinstance(value, Mapping):
        return {**value, **_convert(hint, change, source, key)}
    return _convert(hint, change, source, key)


def _changed_fields(value: Any, change: dict[str, Any], source: str, key: str) -> Any:
    kind: Any = type(value)
    hints = _hints(kind)
    names = [field.name for field in dataclasses.fields(kind) if field.init]
    new: dict[str, Any] = {}
    for name, part in change.items():
        where = _join(key, name)
        if name not in names:
            raise SettingsError(f"{source}: {where}: {unknown_key(name, names)}")
        new[name] = _changed(hints[name], getattr(value, name), part, source, where)
    try:
        return dataclasses.replace(value, **new)
    except ValueError as error:
        where = f"{source}: {key}" if key else source
        raise SettingsError(f"{where}: {error}") from error


def _changed_entries(
    hint: Any, value: tuple[Any, ...], change: dict[str, Any], source: str, key: str
) -> tuple[Any, ...]:
    inner, entries = get_args(hint), list(value)
    for name, part in change.items():
        where = _join(key, name)
        if not (name.isascii() and name.isdecimal() and int(name) < len(entries)):
            raise SettingsError(
                f"{source}: {where}: no such entry; they are numbered 0 to {len(entries) - 1}"
            )
        index = int(name)
        kind = inner[0] if inner[-1] is Ellipsis else inner[index]
        entries[index] = _changed(kind, entries[index], part, source, where)
    return tuple(entries)


def _is_range(value: object) -> bool:
    return dataclasses.is_dataclass(value) and [
        field.name for field in dataclasses.fields(value)
    ] == ["low", "high"]


def _convert(hint: Any, value: Any, source: str, key: str) -> Any:
    origin = get_origin(hint)
    if origin in (Union, types.UnionType):
        options = [option for option in get_args(hint) if option is not type(None)]
        if len(options) == 1:
            return _convert(options[0], value, source, key)
    elif origin is tuple:
        return _convert_tuple(hint, value, source, key)
    elif origin in (dict, Mapping):
        if not isinstance(value, dict):
            raise SettingsError(f"{source}: {key}: {value!r} is not a table")
        inner = get_args(hint)[1]
        return {n: _convert(inner, item, source, _join(key, n)) for n, item in value.items()}
    elif isinstance(hint, type):
        return _convert_plain(hint, value, source, key)
    raise TypeError(f"{key}: a field of type {hint} cannot be read from TOML")


def _convert_tuple(hint: Any, value: Any, source: str, key: str) -> tuple[Any, ...]:
    inner = get_args(hint)
    if not isinstance(value, list):
        raise SettingsError(f"{source}: {key}: {value!r} is not a list")
    if len(inner) == 2 and inner[1] is Ellipsis:
        inner = (inner[0],) * len(value)
    elif len(inner) != len(value):
        raise SettingsError(f"{source}: {key}: {len(value)} entries where {len(inner)} are needed")
    return tuple(
        _convert(kind, item, source, f"{key}[{index}]")
        for index, (kind, item) in enumerate(zip(inner, value, strict=True))
    )


def _convert_plain(kind: type[Any], value: Any, source: str, key: str) -> Any:
    if dataclasses.is_dataclass(kind) and isinstance(value, dict):
        return build(kind, value, source, key)
    if issubclass(kind, enum.Enum) and isinstance(value, str):
        names = {member.name.lower(): member for member in kind}
        if value.lower() in names:
            return names[value.lower()]
        raise SettingsError(f"{source}: {key}: {value!r}: {nearest(value, list(names), 'value')}")
    if kind is float and isinstance(value, int | float) and not isinstance(value, bool):
        # TOML integers are unbounded in Python, but integers above 1e308 have no float.
        if not -sys.float_info.max <= value <= sys.float_info.max:
            raise SettingsError(f"{source}: {key}: {value} is not a finite number")
        return float(value)
    if isinstance(value, kind) and (kind is bool or not isinstance(value, bool)):
        return value
    raise SettingsError(f"{source}: {key}: {value!r} is not {_type_text(kind)}")


def _type_text(hint: Any) -> str:
    plain = {float: "a number", int: "a whole number", str: "a string", bool: "true or false"}
    if hint in plain:
        return plain[hint]
    if isinstance(hint, type) and dataclasses.is_dataclass(hint):
        return "a table"
    if isinstance(hint, type) and issubclass(hint, enum.Enum):
        return f"one of {', '.join(member.name.lower() for member in hint)}"
    return f"of type {getattr(hint, '__name__', hint)}"


def check_ranges(owner: object, ranges: Mapping[str, tuple[float, float]]) -> None:
    """Raise ValueError for the first field that is outside of its range; NaN always is."""
    for name, (least, most) in ranges.items():
        value = getattr(owner, name)
        if not least <= value <= most:
            raise ValueError(f"{name} {value} is not in {least:g}..{most:g}")


def unknown_key(name: str, known: list[str], file: Mapping[str, Any] | None = None) -> str:
    """Say that a key is unknown: what else the file seems to be, or which keys are valid.

    Args:
        file: the file's top-level table, if the key belongs to it.
    """
    for mark, kind in MARKS.items():
        if mark in (file or {}) and mark not in known:
            return f"unknown key; the file describes {kind}, because it has {mark!r}"
    return f"unknown key; {nearest(name, known, 'key')}"


def nearest(name: str, known: list[str], what: str = "value") -> str:
    """Return a hint that leads from an unknown name to a known one."""
    close = difflib.get_close_matches(name, known, n=1)
    if close:
        return f"nearest valid {what}: {close[0]}"
    return f"valid {what}s: {', '.join(known)}"


def _join(key: str, name: str) -> str:
    return f"{key}.{name}" if key else name
