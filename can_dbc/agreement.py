"""Checks that a frame class and its DBC message agree; reports every mismatch as a sentence."""

import dataclasses
import difflib
import enum
import functools
import typing
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Final, Protocol

from can_dbc import dbc_file, twins
from can_dbc.dbc_file import (
    COUNTER_NAME,
    CRC_NAME,
    TIMEOUT_PERIODS,
    DbcFile,
    MessageProtection,
    raw_limits,
    signals_of,
    table_of,
)
from can_dbc.messages import DbcSignal, Message

TRAILER_BYTES: Final = 3
MAX_BYTES: Final = 8
MAX_TABLE_BITS: Final = 10
"""Widest enumeration in bits: the codec stores one entry for every raw value."""

UNITS: Final[Mapping[str, str]] = {
    "mps": "m/s",
    "mps2": "m/s2",
    "mps3": "m/s3",
    "m": "m",
    "n": "N",
    "pa": "Pa",
    "kpa": "kPa",
    "v": "V",
    "a": "A",
    "ma": "mA",
    "w": "W",
    "kw": "kW",
    "kwh": "kWh",
    "kg": "kg",
    "s": "s",
    "ms": "ms",
    "us": "us",
    "hz": "Hz",
    "percent": "%",
    "permille": "permille",
    "ratio": "1",
}
"""DBC unit that the last part of a float field's name requires."""

PLAIN_BOOL: Final = {0: "FALSE", 1: "TRUE"}
TWO_BIT_BOOL: Final = {1: "FALSE", 2: "TRUE"}
"""Raw values of a two-bit boolean; the other two values count as FALSE."""


class Frame(Protocol):
    """A frozen dataclass of numbers, booleans and enumerations."""

    __dataclass_fields__: ClassVar[dict[str, dataclasses.Field[Any]]]


@dataclass(frozen=True, slots=True)
class FieldLayout:
    """One field with its bits in the payload."""

    name: str
    kind: type[Any]
    """float, int, bool or an enumeration."""
    start: int
    length: int
    signed: bool
    scale: float
    offset: float
    minimum: float
    maximum: float
    raw_minimum: int
    raw_maximum: int


def mismatches(kind: type[Frame], file: DbcFile, message: Message) -> Iterator[str]:
    """Yield every mismatch, each with file, message, signal and what to change."""
    where = f"{file.name}: {message.name}"
    for text in (
        *_bus_faults(message),
        *codec_faults(file, message),
        *_name_faults(kind, message),
    ):
        yield f"{where}: {text}"
    guarded = dbc_file.protection(message) is not MessageProtection.NONE
    signals = signals_of(message)
    for name, annotation in field_types(kind).items():
        signal = signals.get(name)
        if signal is not None:
            for text in _signal_faults(kind, name, annotation, signal, guarded=guarded):
                yield f"{where}: {name}: {text}"


def codec_faults(file: DbcFile, message: Message) -> Iterator[str]:
    """Yield why the codec cannot carry a message of any bus; the caller adds file and message."""
    if message.length > MAX_BYTES:
        yield f"is {message.length} bytes long; classic CAN carries {MAX_BYTES}"
    for signal in message.signals:
        if signal.byte_order != "little_endian":
            yield f"{signal.name}: is in Motorola order (@0); this bus uses Intel order (@1)"
        if signal.is_multiplexer or signal.multiplexer_ids:
            yield f"{signal.name}: is multiplexed; give each content a message of its own"
        if signal.is_float:
            yield f"{signal.name}: is a floating-point signal; use a scaled integer"
    if dbc_file.protection(message) is not MessageProtection.NONE:
        yield from _timing_faults(message)
    yield from _trailer_faults(message)
    yield from twins.mismatches(file, message)


@functools.lru_cache(maxsize=1)
def field_types(kind: type[Frame]) -> Mapping[str, type[Any]]:
    """Return the fields of a frame class in their order, with their types."""
    hints = typing.get_type_hints(kind)
    # A compiled class has type annotations only in its fields.
    return {field.name: hints.get(field.name, field.type) for field in dataclasses.fields(kind)}


def layouts(kind: type[Frame], message: Message) -> tuple[FieldLayout, ...]:
    """Return the layout of each field. The class must agree with its message."""
    signals = signals_of(message)
    return tuple(
        layout(field, signals[name], *_physical_range(signals[name]))
        for name, field in field_types(kind).items()
    )


def payload_bytes(message: Message) -> int:
    """Length of the payload without the trailer."""
    guarded = dbc_file.protection(message) is not MessageProtection.NONE
    return message.length - (TRAILER_BYTES if guarded else 0)


def layout(kind: type[Any], signal: DbcSignal, minimum: float, maximum: float) -> FieldLayout:
    """Return the layout of a field of this kind, with its range of values."""
    return FieldLayout(
        name=signal.name,
        kind=kind,
        start=signal.start,
        length=signal.length,
        signed=signal.is_signed,
        scale=signal.scale,
        offset=signal.offset,
        minimum=minimum,
        maximum=maximum,
        raw_minimum=_raw(minimum, signal),
        raw_maximum=_raw(maximum, signal),
    )


def _raw(value: float, signal: DbcSignal) -> int:
    return round((value - signal.offset) / signal.scale)


def _physical_range(signal: DbcSignal) -> tuple[float, float]:
    assert signal.minimum is not None
    assert signal.maximum is not None
    return float(signal.minimum), float(signal.maximum)


def _bus_faults(message: Message) -> Iterator[str]:
    if message.is_extended_frame:
        yield "has a 29-bit identifier; this bus has 11 bits, take one below 0x800"
    if len(message.senders) != 1:
        yield "has no single sender; name one node of BU_ behind the length"
    if dbc_file.protection(message) is MessageProtection.NONE:
        yield from _timing_faults(message)


def _timing_faults(message: Message) -> Iterator[str]:
    period_ms, timeout_ms = dbc_file.period_ms(message), dbc_file.timeout_ms(message)
    if dbc_file.is_cyclic(message):
        if period_ms <= 0:
            yield "is cyclic without a period; set GenMsgCycleTime in milliseconds"
        elif timeout_ms < TIMEOUT_PERIODS * period_ms:
            yield (
                f"TimeoutMs is {timeout_ms}; {TIMEOUT_PERIODS} periods of {period_ms} ms"
                f" are the least: set {TIMEOUT_PERIODS * period_ms} or more"
            )
        return
    if period_ms or timeout_ms:
        yield "is not cyclic but has a period or a timeout; remove it or make it cyclic"
    if dbc_file.protection(message) is not MessageProtection.NONE:
        yield "is protected but not cyclic; an alive counter needs GenMsgSendType cyclic"


def _trailer_faults(message: Message) -> Iterator[str]:
    signals = signals_of(message)
    crc_start = 8 * message.length - 16
    if dbc_file.protection(message) is MessageProtection.NONE:
        for name in (COUNTER_NAME, CRC_NAME):
            if name in signals:
                yield f"{name}: in an unprotected message; set Protection to SAFETY or remove it"
        if dbc_file.data_id(message):
            yield "SafetyDataId in an unprotected message; set Protection to SAFETY or remove it"
        return
    if not dbc_file.data_id(message):
        yield "is protected without a SafetyDataId; give it one of its own, 1..65535"
    for name, start, length in ((COUNTER_NAME, crc_start - 8, 8), (CRC_NAME, crc_start, 16)):
        wanted = f"{start}|{length}@1+ (1,0)"
        signal = signals.get(name)
        if signal is None:
            yield f"{name}: missing in a protected message; add it at {wanted}"
        elif not _is_plain(signal) or (signal.start, signal.length) != (start, length):
            yield f"{name}: must lie in the last three bytes, unscaled: {wanted}"


def _is_plain(signal: DbcSignal) -> bool:
    return not signal.is_signed and signal.scale == 1 and signal.offset == 0


def _name_faults(kind: type[Frame], message: Message) -> Iterator[str]:
    fields = field_types(kind)
    signals = signals_of(message).keys() - {COUNTER_NAME, CRC_NAME}
    for name in sorted(fields.keys() - signals):
        near = difflib.get_close_matches(name, signals - fields.keys(), n=1)
        hint = f"rename signal {near[0]}" if near else "add it or remove the field"
        yield f"{name}: a field of {kind.__name__} without a signal; {hint}"
    for name in sorted(signals - fields.keys()):
        yield f"{name}: a signal without a field; add it to {kind.__name__} or remove it"


def _signal_faults(
    kind: type[Frame], name: str, annotation: type[Any], signal: DbcSignal, *, guarded: bool
) -> Iterator[str]:
    field = f"{kind.__name__}.{name}"
    if annotation is float:
        yield from _unit_faults(field, name, signal)
        yield from _range_faults(signal)
    elif annotation is int:
        yield from _whole_faults(field, signal)
        yield from _range_faults(signal)
    elif annotation is bool:
        table = TWO_BIT_BOOL if guarded else PLAIN_BOOL
        bits = 2 if guarded else 1
        if signal.length != bits:
            yield f"is {signal.length} bits wide; a bool in this message takes {bits}"
        yield from _table_faults(field, table, signal)
    elif isinstance(annotation, type) and issubclass(annotation, enum.Enum):
        members = {member.value: label for label, member in annotation.__members__.items()}
        if signal.length > MAX_TABLE_BITS:
            yield f"is {signal.length} bits wide; an enumeration takes at most {MAX_TABLE_BITS}"
        yield from _table_faults(field, members, signal)
    else:
        yield f"{field} is {annotation!r}; use float, int, bool or an enumeration"


def _unit_faults(field: str, name: str, signal: DbcSignal) -> Iterator[str]:
    suffix = name.rsplit("_", 1)[-1]
    if suffix not in UNITS:
        yield f"{field} is a float whose name ends in no known unit; name it ..._mps, ..._m"
    elif (signal.unit or "") != UNITS[suffix]:
        yield (
            f"unit is {signal.unit or ''!r} but the name says {UNITS[suffix]!r};"
            " change the unit or the name"
        )
    if signal.choices:
        yield f"has a value table but {field} is a float; use an enumeration or drop the table"


def _whole_faults(field: str, signal: DbcSignal) -> Iterator[str]:
    if signal.scale != 1 or signal.offset != int(signal.offset):
        yield (
            f"scaling ({signal.scale},{signal.offset}) is no count but {field} is an int;"
            " make it a float, or the scale 1 and the offset whole"
        )
    if signal.unit:
        yield f"has unit {signal.unit!r} but {field} is an int; make it a float or drop the unit"
    if signal.choices:
        yield f"has a value table but {field} is an int; use an enumeration or drop the table"


def _range_faults(signal: DbcSignal) -> Iterator[str]:
    if signal.minimum is None or signal.maximum is None or signal.minimum >= signal.maximum:
        yield "has no range; give [minimum|maximum] with minimum below maximum"
        return
    if signal.scale <= 0:
        yield f"scale is {signal.scale}; only a twin counts backwards, make it positive"
        return
    low, high = raw_limits(signal)
    for value in _physical_range(signal):
        if not low <= _raw(value, signal) <= high:
            yield f"range end {value} does not fit {signal.length} bits; narrow it or add bits"


def _table_faults(field: str, wanted: Mapping[int, str], signal: DbcSignal) -> Iterator[str]:
    if signal.is_signed or signal.scale != 1 or signal.offset != 0 or signal.unit:
        yield f"{field} is a choice; its signal must be unsigned, (1,0) and without a unit"
    low, high = raw_limits(signal)
    if any(not low <= value <= high for value in wanted):
        yield f"{signal.length} bits cannot hold every value of {field}; widen the signal"
    found = table_of(signal)
    for value in sorted(found.keys() | wanted.keys()):
        if found.get(value) != wanted.get(value):
            yield (
                f"value table says {value} is {found.get(value, 'nothing')},"
                f" {field} says {wanted.get(value, 'nothing')}; make them equal"
            )
