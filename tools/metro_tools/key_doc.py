"""Writes docs/reference/files/: every key of a line, train, parameter and campaign file.

Type, unit and default come from the classes that read the files. A range is found by trying: it
holds while all other keys have the values of the shipped file that the page names.
"""

import argparse
import dataclasses
import enum
import math
import sys
import tomllib
import types
import typing
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple

from firmware_py.storage.whole_file import write_whole
from firmware_py.trackdb import load_line
from firmware_py.trackdb.areas import load_areas
from firmware_py.trackdb.circuit import load_network
from metro_hil.campaign import schema
from metro_hil.model.service import Service, Trip
from metro_tools.generated_doc import EXIT_OK, EXIT_OUTDATED, markdown_table
from metro_tools.law_doc import docstrings, unit_of
from plant_emulator.train_config import load_train
from vobc.config import load_config

FOLDER: Final = "docs/reference/files"
MEANINGS: Final = Path(__file__).with_name("key_meanings.toml")
"""What a key means where its class has no docstring for it."""
HEADS: Final = ("key", "type", "unit", "range", "default", "meaning")
LARGE: Final = 1e12
PROBES: Final = (-LARGE, -1e3, -1.0, -1e-9, 0.0, 1e-9, 1.0, 1e3, LARGE)
"""Values that are tried first; a limit between two of them is found by bisection."""
BISECTIONS: Final = 60
DIGITS: Final = 6
"""To which a limit is rounded. All limits that stand in the code have fewer."""
CHAINAGES: Final = frozenset(
    {
        *("start_m", "end_m", "stop_m", "platform_start_m", "platform_end_m", "position_m"),
        *("stop_up_m", "stop_down_m"),
    }
)
"""Keys of a line that are limited by their neighbours alone."""


class KeyFile(NamedTuple):
    """One kind of file and what its page says."""

    page: str
    title: str
    opening: str
    example: str
    """Shipped name, for the ranges."""
    value: Any
    """What the example was read into."""


class FileKey(NamedTuple):
    """One key of a file, or of a table inside it."""

    name: str
    hint: Any
    default: str
    meaning: str
    owner: Any
    """Object that holds the value, or the class where no example has one."""


def files() -> Iterator[KeyFile]:
    """The files that a user may write, each with an example that ships."""
    yield KeyFile(
        "line",
        "Keys of a line file",
        "A line is one TOML file: stations, speed limits, gradients, curves and tags by chainage.\n"
        "`--line FILE` takes it; `[train] line` of a campaign does, too.",
        "florence",
        load_line("florence"),
    )
    yield KeyFile(
        "network",
        "Keys of a network file",
        "A network is one TOML file: tracks with their own chainage, joins, switches and routes.\n"
        "`--line FILE:ROUTE` takes it; `[train] line` of a campaign does, too.",
        "florence",
        load_network("florence"),
    )
    yield KeyFile(
        "service",
        "Keys of a service file",
        "A service is one TOML file: the trips that one train makes one after the other.\n"
        "`vobc run --service FILE` takes it; `[train] service` of a campaign does, too.",
        "florence",
        Service("florence", (Trip("up"), Trip("down"))),
    )
    yield KeyFile(
        "areas",
        "Keys of an areas file",
        "`mine.areas.toml` beside `mine.toml` divides a line into areas for trains that command\n"
        "themselves.",
        "loop",
        load_areas("loop"),
    )
    yield KeyFile(
        "consist",
        "Keys of a consist file",
        "A consist is the real train of the plant: cars, motors, brakes, sensors, doors.\n"
        "`--consist FILE` takes it; `[train] consist` and `real` of a campaign do, too.",
        "florence4",
        load_train("florence4"),
    )
    yield KeyFile(
        "parameters",
        "Keys of a parameter file",
        "Parameters are what the controller believes of its train, and the settings of odometry,\n"
        "ATP and ATO. `--params FILE` takes them; `[train] params` and `believed` of a campaign\n"
        "do, too.",
        "florence4",
        load_config("florence4"),
    )


CAMPAIGN: Final = (
    ("", schema.HeadKeys),
    ("train", schema.TrainKeys),
    ("timetable", schema.TimetableKeys),
    ("controller", schema.ControllerKeys),
    ("plant", schema.PlantKeys),
    ("branch", schema.BranchKeys),
    ("sweep", schema.SweepKeys),
)
"""Tables of a campaign file that a class reads."""


def pages() -> dict[str, str]:
    """The text of each page by its file name."""
    meanings = tomllib.loads(MEANINGS.read_text(encoding="utf-8"))
    made = {f"{each.page}.md": _page(each, meanings.get(each.page, {})) for each in files()}
    return {**made, "campaign.md": _campaign_page(meanings["campaign"], meanings["forms"])}


def without_meaning() -> list[str]:
    """Keys that neither a docstring nor the table of meanings explains, as `page: table.key`."""
    meanings = tomllib.loads(MEANINGS.read_text(encoding="utf-8"))
    found = []
    for each in files():
        for table, keys in _tables(each.value, meanings.get(each.page, {})):
            found += [f"{each.page}: {table}.{key.name}" for key in keys if not key.meaning]
    for table, kind in CAMPAIGN:
        keys = _keys_of(kind, kind, meanings["campaign"], table)
        found += [f"campaign: {table}.{key.name}" for key in keys if not key.meaning]
    return found


def _page(file: KeyFile, meanings: Mapping[str, str]) -> str:
    parts = [
        f"# {file.title}\n",
        "Generated from the classes that read the file by `python -m metro_tools.key_doc`\n"
        "(`make docs`).\n",
        f"{file.opening}\n",
        f"The ranges hold while all other keys are those of the shipped `{file.example}`.\n"
        "A key without a default must be there. `[]` marks a table that may stand several times,\n"
        "as `[[stations]]`.\n",
    ]
    for table, keys in _tables(file.value, meanings):
        if rows := [_row(key) for key in keys]:
            parts += [f"## {f'`{table}`' if table else 'Top level'}\n", markdown_table(HEADS, rows)]
    return "\n".join(parts)


def _campaign_page(meanings: Mapping[str, str], forms: Mapping[str, Sequence[str]]) -> str:
    parts = [
        "# Keys of a campaign file\n",
        "Generated from the classes that read the file by `python -m metro_tools.key_doc`\n"
        "(`make docs`). [Campaign files](../../guide/campaigns.md) explains how they work\n"
        "together, with examples; `hil faults` and `hil monitors` list what `[[fault]]` and\n"
        "`[[monitor]]` may hold.\n",
    ]
    for table, kind in CAMPAIGN:
        head = f"`[{table}]`" if table else "Above all tables"
        if table == "":
            head += ", and in `[[scenario]]`"
        rows = [_row(key) for key in _keys_of(kind, kind, meanings, table)]
        parts += [f"## {head}\n", markdown_table(HEADS, rows)]
    rows = [(f"`{key}`", *cells) for key, cells in forms.items()]
    table = markdown_table(("key", "form", "default", "meaning"), rows)
    return "\n".join([*parts, "## Keys that have several forms\n", table])


def _tables(value: Any, meanings: Mapping[str, str]) -> Iterator[tuple[str, list[FileKey]]]:
    """Each table of a file with its keys, outer before inner."""
    waiting = [("", value)]
    while waiting:
        table, owner = waiting.pop(0)
        keys = _keys_of(type(owner), owner, meanings, table)
        yield table, [key for key in keys if not _inner(key, owner)]
        for key in keys:
            inner = _inner(key, owner)
            many = isinstance(getattr(owner, key.name), tuple)
            if inner is not None:
                name = f"{table}.{key.name}" if table else key.name
                waiting.append((f"{name}[]" if many else name, inner))


def _inner(key: FileKey, owner: Any) -> Any:
    """The table, or the first of several, that a key holds; None where it holds a value."""
    value = getattr(owner, key.name)
    first = value[0] if isinstance(value, tuple) and value else value
    return first if dataclasses.is_dataclass(first) and not _is_range(type(first)) else None


def _is_range(kind: Any) -> bool:
    return dataclasses.is_dataclass(kind) and [
        field.name for field in dataclasses.fields(kind)
    ] == ["low", "high"]


def _keys_of(kind: Any, owner: Any, meanings: Mapping[str, str], table: str) -> list[FileKey]:
    hints = typing.get_type_hints(kind)
    _, of_fields = docstrings(kind)
    keys = []
    for field in dataclasses.fields(kind):
        if not field.init:
            continue
        where = f"{table}.{field.name}" if table else field.name
        given = meanings.get(where) or of_fields.get(field.name)
        meaning = given or meanings.get(field.name, "")
        keys.append(FileKey(field.name, hints[field.name], _default(field), meaning, owner))
    return keys


def _row(key: FileKey) -> tuple[str, ...]:
    cells = (
        f"`{key.name}`",
        _type_text(key.hint),
        unit_of(key.name).replace("–", ""),
        _range_text(key),
        "" if "Default: " in key.meaning else key.default,
        key.meaning,
    )
    return tuple(" ".join(cell.split()).replace("|", "\\|") for cell in cells)


def _type_text(hint: Any) -> str:
    origin, arguments = typing.get_origin(hint), typing.get_args(hint)
    if origin in (types.UnionType, typing.Union):
        return " or ".join(_type_text(each) for each in arguments if each is not types.NoneType)
    if origin is tuple:
        inner = [each for each in arguments if each is not Ellipsis]
        return f"list of {_type_text(inner[0])}"
    if origin in (dict, Mapping) or getattr(origin, "__name__", "") == "Mapping":
        return f"table of {_type_text(arguments[1])}"
    if isinstance(hint, type) and issubclass(hint, enum.Enum):
        return "text"
    if _is_range(hint):
        return "{ low, high }"
    names: dict[Any, str] = {float: "number", int: "integer", str: "text", bool: "true or false"}
    return names.get(hint, "table")


def _default(field: "dataclasses.Field[Any]") -> str:
    if field.default is dataclasses.MISSING and field.default_factory is dataclasses.MISSING:
        return ""
    value = field.default
    if field.default_factory is not dataclasses.MISSING:
        value = field.default_factory()
    if dataclasses.is_dataclass(value):
        return "see below"
    if isinstance(value, enum.Enum):
        return f"`{_enum_text(value)}`"
    texts: dict[Any, str] = {None: "none", (): "none", "": "none", True: "true", False: "false"}
    if isinstance(value, bool | str | None | tuple) and value in texts:
        return texts[value]
    return f"{value:g}" if isinstance(value, float) else str(value).replace("'", "")


def _enum_text(value: enum.Enum) -> str:
    return value.value if isinstance(value.value, str) else value.name.lower()


def _range_text(key: FileKey) -> str:
    kind = _plain(key.hint)
    if isinstance(kind, type) and issubclass(kind, enum.Enum):
        return ", ".join(f"`{_enum_text(each)}`" for each in kind)
    if kind not in (int, float) or isinstance(key.owner, type):
        return _class_range(key) if kind in (int, float) else ""
    value = getattr(key.owner, key.name)
    if value is None or key.name in CHAINAGES:
        return ""
    return _limits(float(value), _taker(key.owner, key.name, kind), whole=kind is int)


def _plain(hint: Any) -> Any:
    """Without `None`."""
    arguments = [each for each in typing.get_args(hint) if each is not types.NoneType]
    return arguments[0] if arguments and types.NoneType in typing.get_args(hint) else hint


def _taker(owner: Any, name: str, kind: type) -> Callable[[float], bool]:
    """Whether the table that holds a key takes a value of it."""

    def takes(value: float) -> bool:
        try:
            dataclasses.replace(owner, **{name: kind(value)})
        except (ValueError, AssertionError, ZeroDivisionError, OverflowError):
            return False
        return True

    return takes


def _class_range(key: FileKey) -> str:
    """Of a class whose keys all have defaults, so that one alone can be tried."""
    kind = _plain(key.hint)

    def takes(value: float) -> bool:
        others: dict[str, Any] = {}
        if key.owner is schema.TrainKeys:
            others = {"service": "shuttle.toml", "masters": True}
        if key.owner is schema.BranchKeys:
            others = {"when": "speed_mps > 1"}
        if key.owner is schema.SweepKeys:
            designs = {"strength": "COVERING", "count": "LHS"}
            design = designs.get(key.name, "DRAWN" if "faults" in key.name else "FACTORIAL")
            others = {"design": schema.DesignKind[design]}
        try:
            key.owner(**{**others, key.name: kind(value)})
        except ValueError:
            return False
        return True

    start = next(value for value in (1.0, 0.1, 50.0) if takes(value))
    return _limits(start, takes, whole=kind is int)


def _limits(inside: float, takes: Callable[[float], bool], *, whole: bool) -> str:
    """The interval around a value that is taken, as text.

    Args:
        inside: a value that is taken.
        whole: only whole numbers are tried.
    """
    low = _edge(inside, [probe for probe in reversed(PROBES) if probe < inside], takes, whole)
    high = _edge(inside, [probe for probe in PROBES if probe > inside], takes, whole)
    if low is not None and high is not None and low[1] and high[1]:
        return f"{_number(low[0])} … {_number(high[0])}"
    below = "" if low is None else f"{'≥' if low[1] else '>'} {_number(low[0])}"
    above = "" if high is None else f"{'≤' if high[1] else '<'} {_number(high[0])}"
    return ", ".join(text for text in (below, above) if text)


def _edge(
    inside: float, probes: Sequence[float], takes: Callable[[float], bool], whole: bool
) -> tuple[float, bool] | None:
    """Return the limit on one side and whether the limit itself is valid; None without a limit."""
    good = inside
    for probe in probes:
        if whole and probe != int(probe):
            continue
        if takes(probe):
            good = probe
            continue
        bad = probe
        for _ in range(BISECTIONS):
            middle = (good + bad) / 2.0
            if whole:
                middle = float(int(middle))
                if middle in (good, bad):
                    return good, True
            if takes(middle):
                good = middle
            else:
                bad = middle
        limit = good if whole else float(f"{good:.{DIGITS}g}")
        if math.isclose(limit, 0.0, abs_tol=1e-6):
            limit = 0.0
        return limit, takes(limit)
    return None


def _number(value: float) -> str:
    return f"{value:.{DIGITS}g}"


def main(argv: Sequence[str] | None = None) -> int:
    """Write the pages, or with --check only report which are outdated."""
    parser = argparse.ArgumentParser(prog="python -m metro_tools.key_doc", description=__doc__)
    parser.add_argument("root", nargs="?", default=".", help="the project's folder; default: here")
    parser.add_argument("--check", action="store_true", help="write nothing; exit 1 if outdated")
    options = parser.parse_args(argv)
    folder = Path(options.root) / FOLDER
    code = EXIT_OK
    for name, text in pages().items():
        path = folder / name
        if not options.check:
            folder.mkdir(parents=True, exist_ok=True)
            write_whole(path, text)
        elif not path.is_file() or path.read_text(encoding="utf-8") != text:
            print(f"{path}: outdated; run python -m metro_tools.key_doc", file=sys.stderr)
            code = EXIT_OUTDATED
    return code


if __name__ == "__main__":
    sys.exit(main())
