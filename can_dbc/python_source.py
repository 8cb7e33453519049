"""Generates the wire of a CAN bus in Python without dependencies: `wire.py`.

What all messages share is `native/wire.py.in`; this module adds the table of the messages and
constants for the numbers of value tables.
"""

import enum
from collections.abc import Iterable, Iterator
from importlib import resources
from typing import Final

from can_dbc.agreement import FieldLayout
from can_dbc.binding import Binding
from can_dbc.c_source import NS_PER_S, guard_crc, labels_of, wire_id
from can_dbc.dbc_file import signals_of, table_of
from can_dbc.packing import bool_raws, value_table

MARK: Final = "MESSAGES: Final[Mapping[str, Message]] = {}\n"


def wire_files(bound: Iterable[Binding]) -> dict[str, str]:
    """Return the text of `wire.py` for these messages."""
    chosen = sorted(bound, key=lambda each: each.message.frame_id)
    lines = ["MESSAGES: Final[Mapping[str, Message]] = {"]
    for each in chosen:
        lines += [f"    {line}" for line in _message(each)]
    lines += ["}", '"""The messages by name."""', ""]
    for each in chosen:
        lines += _constants(each)
    shared = (resources.files("can_dbc") / "native" / "wire.py.in").read_text(encoding="ascii")
    return {"wire.py": shared.replace(MARK, "\n".join(lines).rstrip() + "\n")}


def _message(bound: Binding) -> Iterator[str]:
    message, twin = bound.message, bound.twin
    timeout_ns = round(bound.timeout_s * NS_PER_S) if bound.timeout_s < float("inf") else 0
    yield f'"{message.name}": Message('
    yield f'    "{message.name}",'
    yield f"    {wire_id(message):#05x},"
    yield f"    {0 if twin is None else wire_id(twin):#05x},"
    yield f"    {message.length},"
    yield f"    Guard.{bound.protection.name},"
    yield f"    {guard_crc(bound, message):#06x},"
    yield f"    {0 if twin is None else guard_crc(bound, twin):#06x},"
    yield f"    {round(bound.period_s * NS_PER_S)},"
    yield f"    {timeout_ns},"
    yield "    ("
    yield from (f"        {_field(each)}," for each in bound.fields)
    yield "    ),"
    yield "),"


def _field(field: FieldLayout) -> str:
    table = value_table(field)
    kind = "enum" if issubclass(field.kind, enum.Enum) else field.kind.__name__
    words = [repr(field.name).replace("'", '"'), f'"{kind}"', field.start, field.length]
    words += [field.signed, float(field.scale), float(field.offset)]
    words += [float(field.minimum), float(field.maximum), field.raw_minimum, field.raw_maximum]
    if table is not None:
        known = [raw for raw, member in enumerate(table) if member is not None]
        words.append(_set(known))
    elif field.kind is bool:
        words.append(_set(sorted(bool_raws(field))))
    return f"Field({', '.join(map(str, words))})"


def _set(raws: list[int]) -> str:
    if raws == list(range(len(raws))):
        return f"frozenset(range({len(raws)}))"
    return f"frozenset(({', '.join(map(str, raws))},))"


def _constants(bound: Binding) -> Iterator[str]:
    """Yield a constant for each named value of an enumeration."""
    signals = signals_of(bound.message)
    for field in bound.fields:
        values = sorted(table_of(signals[field.name]).items())
        if values and field.kind is not bool:
            for raw, label in zip(*labels_of(values), strict=True):
                yield f"{bound.message.name}_{field.name}_{label}".upper() + f": Final = {raw}"
