"""Generates the C library of a CAN bus from its DBC files: `wire.h` and `wire.c`.

What all messages share is written by hand in `native/`. This module adds one structure, its named
values and its functions for each message, with the numbers of the DBC file in them. A controller
in C takes the two files. The bench compiles them with `codec.c`, which gives them to Python.
"""

import enum
import functools
import re
import textwrap
from collections.abc import Iterable, Iterator, Sequence
from importlib import resources
from typing import Final

from can_dbc.agreement import FieldLayout
from can_dbc.binding import Binding, Frame, MessageProtection, binding_of, kinds
from can_dbc.dbc_file import Message, signals_of, table_of
from can_dbc.packing import bool_raws, value_table
from can_dbc.trailer import crc_of_data_id

MARK: Final = "/* messages */\n"
"""Line of a file in `native/` that the generated text replaces."""
WORD_BITS: Final = 64
WIDTH: Final = 100
EXTENDED: Final = 1 << 31
NS_PER_S: Final = 1_000_000_000


def sources() -> dict[str, bytes]:
    """Return the C files of Python's extension module by name."""
    texts = wire_files(shipped_bindings())
    texts["codec.c"] = _shared("codec.c")
    return {name: text.encode("ascii") for name, text in texts.items()}


@functools.cache
def compiled_kinds() -> frozenset[type[Frame]]:
    """Frame classes with a structure in wire.h: one for each message of this package."""
    return frozenset({binding_of(kind).message.frame_id: kind for kind in kinds()}.values())


def shipped_bindings() -> list[Binding]:
    """Each message of this package, by its identifier."""
    return sorted(map(binding_of, compiled_kinds()), key=lambda each: each.message.frame_id)


def wire_files(bound: Iterable[Binding]) -> dict[str, str]:
    """Return the text of `wire.h` and of `wire.c` for these messages.

    Messages with the same fields in the same bits share structure and functions.
    """
    chosen = sorted(bound, key=lambda each: each.message.frame_id)
    names = dict[tuple[FieldLayout, ...], str]()
    header: list[str] = []
    source: list[str] = []
    for each in chosen:
        if each.fields not in names:
            names[each.fields] = each.message.name
            header += [*_structure(each), *_named_values(each)]
            source += [*_pack(each), *_unpack(each), *_fields(each), ""]
    layouts = [names[each.fields] for each in chosen]
    header += [*_index(chosen), *_ids(chosen)]
    for each, layout in zip(chosen, layouts, strict=True):
        header += _functions(each, layout)
    source += ["const struct wire_message wire_messages[WIRE_MESSAGES] = {"]
    for each, layout in zip(chosen, layouts, strict=True):
        source += _message(each, layout)
    source += ["};"]
    return {
        "wire.h": _shared("wire.h").replace(MARK, "\n".join(header) + "\n"),
        "wire.c": _shared("wire.c").replace(MARK, "\n".join(source) + "\n"),
    }


def _shared(name: str) -> str:
    return (resources.files("can_dbc") / "native" / name).read_text(encoding="ascii")


def _comment(text: str, indent: str = "") -> Iterator[str]:
    """Yield a comment in lines of at most `WIDTH` characters."""
    plain = (
        text.encode("ascii", "replace").decode("ascii").replace("*/", "* /").replace("/*", "/ *")
    )
    lines = textwrap.wrap(plain, WIDTH - len(indent) - 6) or [""]
    for at, line in enumerate(lines):
        start = "/* " if at == 0 else " * "
        yield f"{indent}{start}{line}{' */' if at == len(lines) - 1 else ''}"


def _structure(bound: Binding) -> Iterator[str]:
    message, signals = bound.message, signals_of(bound.message)
    file = bound.file.name.rsplit("/", 1)[-1]
    period = f"every {bound.period_s * 1000:g} ms" if bound.period_s else "on occasion"
    facts = f"{file}: {message.frame_id:#05x}, {message.length} bytes, {period}."
    yield from _comment(f"{facts} {message.comment or ''}".strip())
    yield f"struct {message.name} {{"
    for field in bound.fields:
        signal = signals[field.name]
        unit = f"{signal.unit}. " if signal.unit else ""
        if text := f"{unit}{signal.comment or ''}".strip():
            yield from _comment(text, "    ")
        yield f"    {_type(field)} {field.name};"
    yield "};"
    yield ""


def _named_values(bound: Binding) -> Iterator[str]:
    """Yield an enumeration with the names of a field's values."""
    signals = signals_of(bound.message)
    for field in bound.fields:
        values = sorted(table_of(signals[field.name]).items())
        if values and field.kind is not bool:
            prefix = f"{bound.message.name}_{field.name}".upper()
            yield "enum {"
            for at, (raw, label) in enumerate(zip(*labels_of(values), strict=True)):
                comma = "," if at < len(values) - 1 else ""
                yield f"    {prefix}_{label} = {raw}{comma}"
            yield "};"
            yield ""


def labels_of(values: Sequence[tuple[int, str]]) -> tuple[list[int], list[str]]:
    """Return the numbers of a value table and their labels as parts of names, each only once."""
    numbers, labels = [], list[str]()
    for raw, text in values:
        label = re.sub(r"\W+", "_", text, flags=re.ASCII).strip("_").upper() or "NO_NAME"
        sign = "MINUS_" if raw < 0 else ""
        numbers.append(raw)
        labels.append(f"{label}_{sign}{abs(raw)}" if label in labels else label)
    return numbers, labels


def _type(field: FieldLayout) -> str:
    if field.kind is float:
        return "double"
    if field.kind is int:
        return "int64_t"
    return "bool" if field.kind is bool else "uint16_t"


def _index(chosen: Sequence[Binding]) -> Iterator[str]:
    yield "/* Places of the messages in wire_messages, by increasing identifier. */"
    yield "enum wire_place {"
    yield from (f"    WIRE_AT_{each.message.name}," for each in chosen)
    yield "    WIRE_MESSAGES"
    yield "};"
    yield ""
    yield "extern const struct wire_message wire_messages[WIRE_MESSAGES];"
    yield ""


def _ids(chosen: Sequence[Binding]) -> Iterator[str]:
    messages = sorted(
        (message for each in chosen for message in each.messages), key=lambda each: each.frame_id
    )
    yield from (f"#define WIRE_ID_{each.name} {_id(each)}" for each in messages)
    yield ""


def _functions(bound: Binding, layout: str) -> Iterator[str]:
    """Yield the two functions of a message, which take its own structure only."""
    name = bound.message.name
    yield f"static inline size_t wire_send_{name}(struct wire_sender *sender,"
    yield f"    const struct {layout} *values, struct wire_frame frames[WIRE_FRAMES_MAX])"
    yield "{"
    yield f"    return wire_encode(&wire_messages[WIRE_AT_{name}], sender, values, frames);"
    yield "}"
    yield ""
    yield f"static inline enum wire_verdict wire_receive_{name}(struct wire_receiver *receiver,"
    yield f"    const struct wire_frame *frame, int64_t at_ns, struct {layout} *values)"
    yield "{"
    yield f"    return wire_decode(&wire_messages[WIRE_AT_{name}], receiver, frame, at_ns, values);"
    yield "}"
    yield ""


def _pack(bound: Binding) -> Iterator[str]:
    name = bound.message.name
    yield f"static bool wire_pack_{name}(const void *from, uint64_t *bits)"
    yield "{"
    yield f"    const struct {name} *in = from;"
    conditions = [each for field in bound.fields for each in _sendable(field)]
    yield from _valid(conditions)
    yield "    uint64_t word = 0U;"
    indent = "    "
    if conditions:
        yield "    if (valid) {"
        indent = "        "
    for field in bound.fields:
        yield from _wrapped(f"{indent}word |= {_raw(field)}{_shift('<<', field.start)};")
    if conditions:
        yield "    }"
    yield "    *bits = word;"
    yield f"    return {'valid' if conditions else 'true'};"
    yield "}"
    yield ""


def _valid(conditions: Sequence[str]) -> Iterator[str]:
    for at, condition in enumerate(conditions):
        start = "        &&" if at else "    const bool valid ="
        yield f"{start} {condition}{';' if at == len(conditions) - 1 else ''}"


def _sendable(field: FieldLayout) -> Iterator[str]:
    """Yield the conditions for a value that can be sent."""
    value = f"in->{field.name}"
    if field.kind is float:
        yield f"({value} == {value})"  # Not NaN.
    elif issubclass(field.kind, enum.Enum):
        in_table = list(_in_table(field, value))
        yield from in_table or [f"({value} <= {_mask(field)})"]


def _raw(field: FieldLayout) -> str:
    value = f"in->{field.name}"
    if field.kind is bool:
        true, false = bool_raws(field)
        return f"({value} ? UINT64_C({true}) : UINT64_C({false}))"
    if issubclass(field.kind, enum.Enum):
        return f"(uint64_t){value}"
    numbers = f"{_double(field.minimum)}, {_double(field.maximum)}"
    numbers += f", {_int(field.raw_minimum)}, {_int(field.raw_maximum)}"
    if field.kind is int:
        raw = f"wire_counted({value}, {numbers}, {_int(int(field.offset))})"
    else:
        raw = f"wire_scaled({value}, {numbers}, {_double(field.offset)}, {_double(field.scale)})"
    return raw if field.length == WORD_BITS else f"({raw} & {_mask(field)})"


def _unpack(bound: Binding) -> Iterator[str]:
    """Yield the function from bits to values. It writes none unless all are valid."""
    name = bound.message.name
    yield f"static bool wire_unpack_{name}(uint64_t bits, void *to)"
    yield "{"
    yield f"    struct {name} *out = to;"
    yield from (
        f"    const {_raw_type(field)} {_local(field)} = {_bits(field)};" for field in bound.fields
    )
    conditions = [each for field in bound.fields for each in _receivable(field)]
    indent = "    "
    yield from _valid(conditions)
    if conditions:
        yield "    if (valid) {"
        indent = "        "
    yield from (f"{indent}out->{field.name} = {_scaled(field)};" for field in bound.fields)
    if conditions:
        yield "    }"
    yield f"    return {'valid' if conditions else 'true'};"
    yield "}"
    yield ""


def _wrapped(line: str) -> Iterator[str]:
    """Yield a statement; one that is too long continues before its mask."""
    if len(line) <= WIDTH:
        yield line
        return
    head, mask, tail = line.rpartition(" & ")
    yield head
    yield f"            {mask.lstrip()}{tail}"


def _local(field: FieldLayout) -> str:
    return f"raw_{field.name}"


def _raw_type(field: FieldLayout) -> str:
    return "int64_t" if field.kind in (int, float) else "uint64_t"


def _bits(field: FieldLayout) -> str:
    raw = f"(bits{_shift('>>', field.start)})" if field.start else "bits"
    if field.length < WORD_BITS:
        raw = f"({raw} & {_mask(field)})"
    if field.kind not in (int, float):
        return raw
    return f"wire_signed({raw}, {field.length}U)" if field.signed else f"(int64_t){raw}"


def _receivable(field: FieldLayout) -> Iterator[str]:
    """Yield the conditions for raw bits with a value."""
    raw = _local(field)
    if field.kind in (int, float):
        if field.raw_maximum - field.raw_minimum < (1 << field.length) - 1:
            yield f"({raw} >= {_int(field.raw_minimum)}) && ({raw} <= {_int(field.raw_maximum)})"
    elif field.kind is not bool:
        yield from _in_table(field, raw)


def _in_table(field: FieldLayout, value: str) -> Iterator[str]:
    """Yield the condition for a number in the value table; none if every number is in it."""
    table = value_table(field)
    assert table is not None
    known = [number for number, member in enumerate(table) if member is not None]
    if len(known) == len(table):
        return
    spans: list[list[int]] = []
    for number in known:
        if spans and spans[-1][1] == number - 1:
            spans[-1][1] = number
        else:
            spans.append([number, number])
    parts = []
    for first, last in spans:
        if first == last:
            parts.append(f"({value} == {first}U)")
        elif first == 0:
            parts.append(f"({value} <= {last}U)")
        else:
            parts.append(f"(({value} >= {first}U) && ({value} <= {last}U))")
    yield parts[0] if len(parts) == 1 else f"({' || '.join(parts)})"


def _scaled(field: FieldLayout) -> str:
    raw = _local(field)
    if field.kind is bool:
        return f"({raw} == {bool_raws(field)[0]}U)"
    if field.kind is int:
        return f"{raw} + {_int(int(field.offset))}" if field.offset else raw
    if field.kind is not float:
        return f"(uint16_t){raw}"
    text = f"((double){raw} * {_double(field.scale)})"
    return f"{text} + {_double(field.offset)}" if field.offset else text


def _fields(bound: Binding) -> Iterator[str]:
    name = bound.message.name
    yield f"static const struct wire_field wire_fields_{name}[] = {{"
    for field in bound.fields:
        yield f'    {{"{field.name}", {_kind(field)}, offsetof(struct {name}, {field.name})}},'
    yield "};"


def _kind(field: FieldLayout) -> str:
    names = {float: "WIRE_FLOAT", int: "WIRE_INT", bool: "WIRE_BOOL"}
    return names.get(field.kind, "WIRE_ENUM")


def _message(bound: Binding, layout: str) -> Iterator[str]:
    message = bound.message
    twin_id = "0U" if bound.twin is None else _id(bound.twin)
    twin_crc = 0 if bound.twin is None else guard_crc(bound, bound.twin)
    crc = guard_crc(bound, message)
    timeout_ns = round(bound.timeout_s * NS_PER_S) if bound.timeout_s < float("inf") else 0
    yield (
        f'    {{"{message.name}", {_id(message)}, {twin_id}, {message.length}U,'
        f" WIRE_{bound.protection.name}, {crc:#06x}U, {twin_crc:#06x}U,"
    )
    yield f"     INT64_C({round(bound.period_s * NS_PER_S)}), INT64_C({timeout_ns}),"
    yield f"     sizeof(struct {layout}), {len(bound.fields)}U, wire_fields_{layout},"
    yield f"     wire_pack_{layout}, wire_unpack_{layout}}},"


def wire_id(message: Message) -> int:
    """Return an identifier. One of 29 bits has the highest bit set, as in a DBC file."""
    return message.frame_id | (EXTENDED if message.is_extended_frame else 0)


def guard_crc(bound: Binding, message: Message) -> int:
    """Return the state of the CRC after the data identifier; 0 for an unprotected message."""
    return 0 if bound.protection is MessageProtection.NONE else crc_of_data_id(message)


def _id(message: Message) -> str:
    return f"{wire_id(message):#05x}U"


def _shift(operator: str, places: int) -> str:
    return f" {operator} {places}U" if places else ""


def _mask(field: FieldLayout) -> str:
    suffix = f"UINT64_C({(1 << field.length) - 1:#x})"
    return suffix if field.length > WORD_BITS // 4 else f"{(1 << field.length) - 1:#x}U"


def _double(value: float) -> str:
    return repr(float(value))


def _int(value: int) -> str:
    return str(value) if abs(value) < 1 << 31 else f"INT64_C({value})"
