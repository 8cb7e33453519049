"""Generates the wire of a CAN bus in Rust without dependencies: `wire.rs`.

What all messages share is `native/wire.rs.in`; this module adds a structure for each message, its
conversion to bits and back, and constants for the numbers of value tables.
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

MARK: Final = "// messages\n"
WORD_BITS: Final = 64
TYPES: Final = {float: "f64", int: "i64", bool: "bool"}


def wire_files(bound: Iterable[Binding]) -> dict[str, str]:
    """Return the text of `wire.rs` for these messages."""
    lines: list[str] = []
    for each in sorted(bound, key=lambda each: each.message.frame_id):
        lines += [*_structure(each), *_values(each), *_constants(each), ""]
    shared = (resources.files("can_dbc") / "native" / "wire.rs.in").read_text(encoding="ascii")
    return {"wire.rs": shared.replace(MARK, "\n".join(lines).rstrip() + "\n")}


def _structure(bound: Binding) -> Iterator[str]:
    signals = signals_of(bound.message)
    if bound.message.comment:
        yield f"/// {_plain(bound.message.comment)}"
    yield "#[derive(Clone, Copy, Debug, Default, PartialEq)]"
    yield f"pub struct {bound.message.name} {{"
    for field in bound.fields:
        signal = signals[field.name]
        text = f"{signal.unit + '. ' if signal.unit else ''}{signal.comment or ''}".strip()
        if text:
            yield f"    /// {_plain(text)}"
        yield f"    pub r#{field.name}: {TYPES.get(field.kind, 'u16')},"
    yield "}"
    yield ""


def _plain(text: str) -> str:
    return " ".join(text.encode("ascii", "replace").decode("ascii").split())


def _values(bound: Binding) -> Iterator[str]:
    yield f"impl Values for {bound.message.name} {{"
    yield from (f"    {line}" for line in _message(bound))
    yield ""
    yield "    fn pack(&self) -> Option<u64> {"
    for field in bound.fields:
        yield from (f"        {line}" for line in _check_of_value(field))
    yield "        let mut bits = 0;"
    for field in bound.fields:
        yield f"        bits |= {_raw(field)} << {field.start};"
    yield "        Some(bits)"
    yield "    }"
    yield ""
    yield "    fn unpack(bits: u64) -> Option<Self> {"
    for field in bound.fields:
        yield f"        let r#{field.name} = {_bits(field)};"
        if condition := _invalid(field, f"r#{field.name}"):
            yield f"        if {condition} {{"
            yield "            return None;"
            yield "        }"
    yield "        Some(Self {"
    for field in bound.fields:
        yield f"            r#{field.name}: {_value(field)},"
    yield "        })"
    yield "    }"
    yield "}"


def _message(bound: Binding) -> Iterator[str]:
    message, twin = bound.message, bound.twin
    timeout_ns = round(bound.timeout_s * NS_PER_S) if bound.timeout_s < float("inf") else 0
    yield "const MESSAGE: Message = Message {"
    yield f'    name: "{message.name}",'
    yield f"    id: {wire_id(message):#05x},"
    yield f"    twin_id: {0 if twin is None else wire_id(twin):#05x},"
    yield f"    length: {message.length},"
    yield f"    protection: Protection::{bound.protection.name.title()},"
    yield f"    crc: {guard_crc(bound, message):#06x},"
    yield f"    twin_crc: {0 if twin is None else guard_crc(bound, twin):#06x},"
    yield f"    period_ns: {round(bound.period_s * NS_PER_S)},"
    yield f"    timeout_ns: {timeout_ns},"
    yield "};"


def _check_of_value(field: FieldLayout) -> Iterator[str]:
    """Yield the refusal of a value that cannot be sent."""
    value = f"self.r#{field.name}"
    condition = ""
    if field.kind is float:
        condition = f"{value}.is_nan()"
    elif issubclass(field.kind, enum.Enum):
        condition = _invalid(field, value) or f"{value} > {(1 << field.length) - 1}"
    if condition:
        yield f"if {condition} {{"
        yield "    return None;"
        yield "}"


def _raw(field: FieldLayout) -> str:
    value = f"self.r#{field.name}"
    if field.kind is bool:
        true, false = bool_raws(field)
        return f"(if {value} {{ {true}u64 }} else {{ {false} }})"
    if issubclass(field.kind, enum.Enum):
        return f"u64::from({value})"
    numbers = f"({float(field.minimum)!r}, {float(field.maximum)!r})"
    numbers += f", ({field.raw_minimum}, {field.raw_maximum})"
    if field.kind is int:
        raw = f"counted({value}, {numbers}, {int(field.offset)})"
    else:
        raw = f"scaled({value}, {numbers}, {float(field.offset)!r}, {float(field.scale)!r})"
    return f"({raw} & {_mask(field)})"


def _bits(field: FieldLayout) -> str:
    raw = f"(bits >> {field.start} & {_mask(field)})"
    if field.kind is bool or issubclass(field.kind, enum.Enum):
        return raw
    return f"signed({raw}, {field.length})" if field.signed else f"{raw} as i64"


def _invalid(field: FieldLayout, raw: str) -> str:
    """Return the condition for a number that means nothing; empty if every one does."""
    if field.kind in (int, float):
        if field.raw_maximum - field.raw_minimum < (1 << field.length) - 1:
            return f"!({field.raw_minimum}..={field.raw_maximum}).contains(&{raw})"
        return ""
    table = value_table(field)
    if table is None:
        return ""
    known = [number for number, member in enumerate(table) if member is not None]
    if len(known) == len(table):
        return ""
    if known == list(range(known[0], known[-1] + 1)):
        return f"!({known[0]}..={known[-1]}).contains(&{raw})"
    return f"!matches!({raw}, {' | '.join(map(str, known))})"


def _value(field: FieldLayout) -> str:
    name = f"r#{field.name}"
    if field.kind is bool:
        return f"{name} == {bool_raws(field)[0]}"
    if field.kind is int:
        return f"{name} + {int(field.offset)}" if field.offset else name
    if field.kind is not float:
        return f"{name} as u16"
    text = f"{name} as f64 * {float(field.scale)!r}"
    return f"{text} + {float(field.offset)!r}" if field.offset else text


def _constants(bound: Binding) -> Iterator[str]:
    signals = signals_of(bound.message)
    for field in bound.fields:
        values = sorted(table_of(signals[field.name]).items())
        if values and field.kind is not bool:
            kind = "u16" if issubclass(field.kind, enum.Enum) else "i64"
            for raw, label in zip(*labels_of(values), strict=True):
                name = f"{bound.message.name}_{field.name}_{label}".upper()
                yield f"pub const {name}: {kind} = {raw};"


def _mask(field: FieldLayout) -> str:
    return f"{(1 << field.length) - 1:#x}"
