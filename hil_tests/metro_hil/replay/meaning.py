"""Decodes payloads of the wires to text, and finds the signals in which two payloads differ."""

import dataclasses
import enum
from functools import cache
from typing import Any, Final

import canlog
from can_dbc.binding import binding_of, kinds
from firmware_py.ports import CanFrame, RadioMessage, SerialChunk
from firmware_py.tag_reader.telegram import TelegramParser
from metro_hil.replay.recording import Output
from zenoh_config.codec import unpack
from zenoh_config.messages import Refused

MEASURED: Final = {"VOBC_STATUS": frozenset({"work_us"})}
"""Signals that depend on the host's timing, not on the controller's decisions. They are not
compared if another program replays a recording in real time."""
CHECK_SIGNALS: Final = frozenset({"crc16"})
"""Signals that follow from the others."""
RATIO_UNIT: Final = "1"
TWIN: Final = "the twin of "
UNKNOWN: Final = "unknown identifier"

Signals = dict[str, str]


@cache
def _names() -> dict[str, str]:
    """Names by identifier in hexadecimal; a twin is named after its first frame."""
    found: dict[str, str] = {}
    for kind in kinds():
        bound = binding_of(kind)
        found[f"{bound.message.frame_id:03X}"] = bound.message.name
        if bound.twin is not None:
            found[f"{bound.twin.frame_id:03X}"] = TWIN + bound.message.name
    return found


def name_of(output: Output) -> str:
    """Name of a message on bus or radio; `bytes` for the tag reader's line."""
    if output.wire == "can":
        return _names().get(output.key, UNKNOWN)
    if output.wire == "radio":
        return type(unpack(output.data)).__name__
    return "bytes"


def signals_of(output: Output) -> Signals:
    """Value and unit of each signal as text; empty for payloads that cannot be decoded."""
    if output.wire == "can":
        return _frame_signals(output.key, output.data)
    if output.wire == "radio":
        return _fields(unpack(output.data))
    return {}


def _frame_signals(key: str, data: bytes) -> Signals:
    spec = canlog.load_bus().by_key.get(int(key, 16)) if key in _names() else None
    if spec is None or len(data) != spec.length:
        return {}
    table = canlog.table_of(spec, [data])
    found = {}
    for name in table.names:
        (label,) = table.labels(name)
        found[name] = _value(label or table[name].tolist()[0], table.units[name])
    return found


def _fields(message: Any) -> Signals:
    if isinstance(message, Refused):
        return {"refused": f"{message.reason.value}: {message.detail}"}
    names = [field.name for field in dataclasses.fields(message)]
    return {name: _value(getattr(message, name), "") for name in names}


def _value(value: object, unit: str) -> str:
    if isinstance(value, enum.Enum):
        return value.name.lower()
    text = f"{value:.9g}" if isinstance(value, float) else str(value)
    return f"{text} {unit}" if unit not in ("", RATIO_UNIT) else text


def measured_only(one: Output, other: Output) -> bool:
    """Whether two payloads differ only in signals that the host's timing determines."""
    measured = MEASURED.get(name_of(one))
    if measured is None:
        return False
    mine, theirs = signals_of(one), signals_of(other)
    different = {name for name in mine if mine[name] != theirs.get(name)}
    return bool(different & measured) and different <= measured | CHECK_SIGNALS


def frame_words(frame: CanFrame) -> tuple[str, str]:
    """Name and signals of a received frame."""
    if frame.error or frame.remote or frame.extended:
        return ("error frame" if frame.error else "no data frame of the bus"), frame.data.hex()
    key = f"{frame.can_id:03X}"
    name = _names().get(key, UNKNOWN)
    return f"{key} {name}", _joined(_frame_signals(key, frame.data)) or frame.data.hex().upper()


def message_words(message: RadioMessage) -> tuple[str, str]:
    heard = unpack(message.payload)
    return f"{message.key} {type(heard).__name__}", _joined(_fields(heard))


def chunk_words(parser: TelegramParser, chunk: SerialChunk) -> tuple[str, str]:
    """Text of the telegrams that a piece of the serial line completes; `parser` has all before."""
    heard = list(parser.feed(chunk.data))
    words = "; ".join(f"{type(each).__name__} {_plain(each)}" for each in heard)
    return "tags", words or chunk.data.hex().upper()


def _plain(value: Any) -> str:
    return _joined(_fields(value)) if dataclasses.is_dataclass(value) else str(value)


def _joined(signals: Signals) -> str:
    told = ((name, value) for name, value in signals.items() if name not in CHECK_SIGNALS)
    return ", ".join(f"{name} {value}" for name, value in told)
