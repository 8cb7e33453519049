"""Writes the packing functions of all frame classes as one typed module for mypyc.

It contains the functions that `can_dbc.packing` generates at program start, which would stay
interpreted, with the same field names and numbers. Frames without a compiled class are left to
`can_dbc.packing`.
"""

import enum
import importlib
from collections.abc import Iterable, Sequence
from typing import Final

from can_dbc.agreement import FieldLayout
from can_dbc.binding import Frame, binding_of, kinds
from can_dbc.packing import bool_raws

HEAD: Final = '''\
"""Written by `make compiled`; see metro_tools.written_packing."""

from typing import Any, Final

from can_dbc.binding import binding_of
from can_dbc.packing import refusal, value_table
'''
TABLE: Final = """
def _table(kind: Any, name: str) -> Any:
    fields = binding_of(kind).fields
    return next(value_table(field) for field in fields if field.name == name)
"""


def written(modules: Iterable[str]) -> str:
    """Return the module's text for the frame classes that these modules define by name."""
    places = {name: importlib.import_module(name) for name in modules}
    chosen = [
        kind
        for kind in kinds()
        if getattr(places.get(kind.__module__), kind.__name__, None) is kind
    ]
    imports = [f"from {kind.__module__} import {kind.__name__}" for kind in chosen]
    enums = {
        f"from {field.kind.__module__} import {field.kind.__name__}"
        for kind in chosen
        for field in binding_of(kind).fields
        if issubclass(field.kind, enum.Enum)
    }
    parts = [HEAD, "\n".join(sorted({*imports, *enums})), TABLE]
    for kind in chosen:
        parts += ["\n".join(lines) for lines in (_packer(kind), _unpacker(kind))]
    functions = [
        f'    ("{what}", {kind.__name__}): {what}_{kind.__name__},'
        for kind in chosen
        for what in ("pack", "unpack")
    ]
    parts.append("\n".join(["FUNCTIONS: Final[dict[Any, Any]] = {", *functions, "}"]))
    return "\n\n".join(parts) + "\n"


def _packer(kind: type[Frame]) -> Sequence[str]:
    name = kind.__name__
    lines = [f"def pack_{name}(frame: {name}) -> int:", "    try:", "        bits = 0"]
    for index, field in enumerate(binding_of(kind).fields):
        lines += ["        " + line for line in _pack_lines(field, f"value{index}")]
    lines += ["        return bits", "    except (ValueError, TypeError, AttributeError):"]
    return [*lines, f"        raise refusal({name}, frame) from None"]


def _pack_lines(field: FieldLayout, value: str) -> list[str]:
    lines = [f"{value} = frame.{field.name}"]
    if field.kind is bool:
        true, false = (hex(raw << field.start) for raw in bool_raws(field))
        return [*lines, f"bits += {true} if {value} else {false}"]
    if issubclass(field.kind, enum.Enum):
        return [
            *lines,
            f"if {value}.__class__ is not {field.kind.__name__}: raise ValueError",
            f"bits += {value}._value_ << {field.start}",
        ]
    mask = (1 << field.length) - 1
    least, most = ((raw & mask) << field.start for raw in (field.raw_minimum, field.raw_maximum))
    number = int if field.kind is int else float
    unscaled = f"({value} - {number(field.offset)!r})" if field.offset else value
    raw = f"round({unscaled} / {float(field.scale)!r})" if field.scale != 1 else unscaled
    if field.kind is float and field.scale == 1:
        raw = f"round({unscaled})"
    return [
        *lines,
        f"if {value} <= {number(field.minimum)!r}: bits += {least:#x}",
        f"elif {value} >= {number(field.maximum)!r}: bits += {most:#x}",
        f"else: bits += ({raw} & {mask:#x}) << {field.start}",
    ]


def _unpacker(kind: type[Frame]) -> Sequence[str]:
    name, fields = kind.__name__, binding_of(kind).fields
    tables = [
        f'TABLE_{name}_{index}: Final[Any] = _table({name}, "{field.name}")'
        for index, field in enumerate(fields)
        if issubclass(field.kind, enum.Enum)
    ]
    lines = [*tables, "", f"def unpack_{name}(bits: int) -> {name} | None:"]
    for index, field in enumerate(fields):
        table = f"TABLE_{name}_{index}"
        lines += ["    " + line for line in _unpack_lines(field, f"value{index}", table)]
    values = ", ".join(f"value{index}" for index in range(len(fields)))
    return [*lines, f"    return {name}({values})"]


def _unpack_lines(field: FieldLayout, value: str, table: str) -> list[str]:
    mask = (1 << field.length) - 1
    if field.kind is bool:
        true, _ = bool_raws(field)
        return [f"{value} = bits & {mask << field.start:#x} == {true << field.start:#x}"]
    raw = f"bits >> {field.start} & {mask:#x}"
    if issubclass(field.kind, enum.Enum):
        return [f"{value} = {table}[{raw}]", f"if {value} is None: return None"]
    if field.signed:
        sign = 1 << field.length - 1
        raw = f"({raw} ^ {sign:#x}) - {sign:#x}"
    lines = [f"raw_{value} = {raw}"]
    if field.raw_maximum - field.raw_minimum < mask:
        bounds = f"{field.raw_minimum} <= raw_{value} <= {field.raw_maximum}"
        lines.append(f"if not {bounds}: return None")
    if field.kind is int:
        text, offset = f"raw_{value}", repr(int(field.offset))
    else:
        text, offset = f"float(raw_{value}) * {float(field.scale)!r}", repr(float(field.offset))
    return [*lines, f"{value} = {text} + {offset}" if field.offset else f"{value} = {text}"]
