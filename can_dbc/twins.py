"""Checks that a vital message and its inverted twin are congruent."""

from collections.abc import Iterator

from can_dbc import dbc_file
from can_dbc.dbc_file import (
    COUNTER_NAME,
    CRC_NAME,
    TWIN_SUFFIX,
    DbcFile,
    MessageProtection,
    raw_limits,
    signals_of,
    table_of,
)
from can_dbc.messages import DbcSignal, Message


def mismatches(file: DbcFile, message: Message) -> Iterator[str]:
    """Yield every mismatch, without file and message; the caller adds them."""
    twin = file.messages.get(message.name + TWIN_SUFFIX)
    if dbc_file.protection(message) is not MessageProtection.VITAL:
        if twin is not None:
            yield f"has a twin {twin.name}; set Protection to VITAL or remove the twin"
        return
    if twin is None:
        yield f"is VITAL without a twin; add {message.name}{TWIN_SUFFIX} on the next identifier"
        return
    used = sum(signal.length for signal in message.signals)
    if used != 8 * message.length:
        yield f"is VITAL and leaves {8 * message.length - used} bits unused; widen a signal"
    for name, wanted in _twin_wants(message).items():
        found = _twin_has(twin)[name]
        if found != wanted:
            yield f"{twin.name}: {name} is {found}; the twin needs {wanted}"
    if not dbc_file.data_id(twin):
        yield f"{twin.name}: needs a SafetyDataId of its own, 1..65535"
    yield from _twin_signal_faults(message, twin)


def _twin_wants(message: Message) -> dict[str, object]:
    return _twin_has(message) | {"identifier": message.frame_id + 1}


def _twin_has(message: Message) -> dict[str, object]:
    return {
        "identifier": message.frame_id,
        "length": message.length,
        "senders": message.senders,
        "GenMsgSendType": message.send_type,
        "GenMsgCycleTime": message.cycle_time,
        "TimeoutMs": dbc_file.timeout_ms(message),
        "Protection": dbc_file.protection(message).name,
    }


def _twin_signal_faults(message: Message, twin: Message) -> Iterator[str]:
    """Check the signals.

    Scaling and tables of the twin are inverted too, so that any tool shows the same values.
    """
    ours, theirs = signals_of(message), signals_of(twin)
    for name in sorted(ours.keys() ^ theirs.keys()):
        yield f"{twin.name}: {name}: only in one of the twins; add it to both or remove it"
    for name in sorted(ours.keys() & theirs.keys()):
        wanted, found = _inverted(ours[name]), _facts(theirs[name])
        for fact, value in wanted.items():
            if found[fact] != value:
                yield f"{twin.name}: {name}: {fact} is {found[fact]}; the twin needs {value}"


def _facts(signal: DbcSignal) -> dict[str, object]:
    return {
        "start bit": signal.start,
        "length": signal.length,
        "signed": signal.is_signed,
        "scale": _rounded(signal.scale),
        "offset": _rounded(signal.offset),
        "range": (signal.minimum, signal.maximum),
        "unit": signal.unit,
        "value table": table_of(signal),
        "start value": signal.raw_initial or 0,
    }


def _inverted(signal: DbcSignal) -> dict[str, object]:
    """Return the properties of a signal with complemented bits and the same values."""
    facts = _facts(signal)
    if signal.name in (COUNTER_NAME, CRC_NAME):
        return facts
    ends = sum(raw_limits(signal))
    facts["start value"] = ends - int(signal.raw_initial or 0)
    if signal.choices:
        facts["value table"] = {ends - raw: name for raw, name in table_of(signal).items()}
        if signal.minimum is not None and signal.maximum is not None:
            facts["range"] = (ends - signal.maximum, ends - signal.minimum)
        return facts
    return facts | {
        "scale": _rounded(-signal.scale),
        "offset": _rounded(signal.offset + ends * signal.scale),
    }


def _rounded(value: float) -> float:
    """Round to the decimal digits of a DBC file, which removes the last bits of binary
    arithmetic.
    """
    return float(f"{value:.12g}")
