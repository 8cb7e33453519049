"""Makes frame classes for the messages of any DBC file, for generated code and the codec."""

import dataclasses
import enum
import keyword
import math
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any, Final, cast

from can_dbc import agreement, dbc_file
from can_dbc.agreement import MAX_TABLE_BITS, PLAIN_BOOL, TWO_BIT_BOOL
from can_dbc.binding import Binding, BindingError, register
from can_dbc.dbc_file import (
    COUNTER_NAME,
    CRC_NAME,
    TWIN_SUFFIX,
    DbcFile,
    DbcSignal,
    Message,
    MessageProtection,
    raw_limits,
    signals_of,
    table_of,
)

C_WORDS: Final = """
    auto bool case char const default do double enum extern false float goto inline int long
    register restrict short signed sizeof static struct switch this true typedef union unsigned
    void volatile
"""
TRAILER: Final = (COUNTER_NAME, CRC_NAME)


def bindings(paths: Iterable[Path]) -> list[Binding]:
    """Return a binding for each message of these files, each with a frame class of its own.

    Raises BindingError with a line for every message that the codec cannot carry.
    """
    files = [dbc_file.read(path) for path in paths]
    everything = [message for file in files for message in file.messages.values()]
    dbc_file.refuse_shared("all files", everything)
    faults = [fault for file in files for fault in _faults(file)]
    if faults:
        raise BindingError("\n".join(faults))
    return [_bound(file, message) for file in files for message in _first_halves(file)]


def _first_halves(file: DbcFile) -> Iterator[Message]:
    """Yield the messages of a file without the inverted twins of its vital ones."""
    for message in file.messages.values():
        original = file.messages.get(message.name.removesuffix(TWIN_SUFFIX))
        is_twin = original is not None and original is not message
        if not (is_twin and dbc_file.protection(message) is MessageProtection.VITAL):
            yield message


def _faults(file: DbcFile) -> Iterator[str]:
    for message in _first_halves(file):
        where = f"{file.name}: {message.name}"
        for fault in agreement.codec_faults(file, message):
            yield f"{where}: {fault}"
        for signal in message.signals:
            if signal.scale <= 0:
                yield f"{where}: {signal.name}: scale is {signal.scale}; make it positive"
            if keyword.iskeyword(signal.name) or signal.name in C_WORDS.split():
                yield f"{where}: {signal.name}: is a word of C or Python; give it another name"


def _bound(file: DbcFile, message: Message) -> Binding:
    guarded = dbc_file.protection(message) is not MessageProtection.NONE
    signals = [
        each for name, each in signals_of(message).items() if not (guarded and name in TRAILER)
    ]
    layouts = tuple(_layout(_kind(message, each, guarded=guarded), each) for each in signals)
    kind = dataclasses.make_dataclass(
        message.name, [(each.name, each.kind) for each in layouts], frozen=True, slots=True
    )
    bound = Binding(
        kind=kind,
        file=file,
        message=message,
        twin=file.messages.get(message.name + TWIN_SUFFIX),
        protection=dbc_file.protection(message),
        fields=layouts,
        period_s=dbc_file.period_ms(message) / 1000.0,
        timeout_s=dbc_file.timeout_ms(message) / 1000.0 or math.inf,
    )
    register(bound)
    return bound


def _kind(message: Message, signal: DbcSignal, *, guarded: bool) -> type[Any]:
    """Return bool, int or float, or an enumeration where the table names every value in range."""
    table = table_of(signal)
    plain = not signal.is_signed and signal.scale == 1 and signal.offset == 0 and not signal.unit
    if plain and signal.length == 1 and table in ({}, PLAIN_BOOL):
        return bool
    if plain and guarded and signal.length == 2 and table == TWO_BIT_BOOL:
        return bool
    if plain and table and signal.length <= MAX_TABLE_BITS:
        low, high = _range(signal)
        if all(raw in table for raw in range(int(low), int(high) + 1)):
            members = {f"VALUE_{raw}": raw for raw in table}
            make: Any = enum.IntEnum
            return cast("type[Any]", make(f"{message.name}_{signal.name}", members))
    whole = signal.scale == 1 and signal.offset == int(signal.offset) and not signal.unit
    return int if whole else float


def _range(signal: DbcSignal) -> tuple[float, float]:
    """Return the range of a signal; that of its bits without one, and never beyond them."""
    low, high = (raw * signal.scale + signal.offset for raw in raw_limits(signal))
    least, most = signal.minimum, signal.maximum
    if least is None or most is None or least >= most:
        return float(low), float(high)
    return max(float(least), low), min(float(most), high)


def _layout(kind: type[Any], signal: DbcSignal) -> agreement.FieldLayout:
    return agreement.layout(kind, signal, *_range(signal))
