"""What a DBC file says of a bus, as plain values: messages by key, signals, nodes, periods."""

import functools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

from can_dbc import merged
from can_dbc.dbc_file import Database
from canlog.damage import LogError
from canlog.frames import KEY_EXTENDED

DEFAULT_BAUDRATE: Final = 500_000
TIMEOUT_PERIODS: Final = 3
"""A message is stale after this many periods where the file has no TimeoutMs."""
PROTECTION: Final = ("E2ECounterSignal", "E2ECrcSignal", "E2EProfile", "E2EDataId", "Protection")
"""Attributes of messages that say how counters and CRCs are made."""


@dataclass(frozen=True, slots=True)
class SignalSpec:
    """One signal of one message. Physical value = raw * scale + offset."""

    name: str
    start: int
    """As in the DBC file: the lowest bit, or the highest one of a Motorola signal."""
    length: int
    big_endian: bool
    signed: bool
    is_float: bool
    scale: float
    offset: float
    minimum: float | None
    maximum: float | None
    unit: str
    choices: Mapping[int, str]
    """Raw value to its name."""
    comment: str
    receivers: tuple[str, ...]
    is_multiplexer: bool
    multiplexer: str | None
    """The signal that decides whether this one is there."""
    multiplexer_ids: tuple[int, ...]
    """Raw values of it with which this one is there."""

    @property
    def lsb(self) -> float:
        """One step of the raw value; that of a float signal is 0."""
        return 0.0 if self.is_float else abs(self.scale)


@dataclass(frozen=True, slots=True)
class MessageSpec:
    """One message of the bus."""

    name: str
    key: int
    """Identifier, with KEY_EXTENDED where it has 29 bits."""
    length: int
    senders: tuple[str, ...]
    period_ms: int
    """0 where the file gives none."""
    timeout_ms: int
    """Older than this it is stale; 0 for never."""
    is_fd: bool
    comment: str
    signals: tuple[SignalSpec, ...]
    attributes: Mapping[str, Any] = field(default_factory=dict)
    """Those of the DBC file that tell how the message is protected, by name."""
    optional: bool = False
    """The bus may never carry it, though it is cyclic: see `_may_stay_away`."""

    @property
    def identifier(self) -> int:
        return self.key & ~KEY_EXTENDED

    @property
    def is_extended(self) -> bool:
        return bool(self.key & KEY_EXTENDED)

    def signal(self, name: str) -> SignalSpec:
        """Raises LogError."""
        for each in self.signals:
            if each.name == name:
                return each
        known = ", ".join(each.name for each in self.signals)
        raise LogError(f"{self.name}: no signal {name}; it has {known}")


@dataclass(frozen=True, slots=True)
class Bus:
    """All messages that DBC files know."""

    name: str
    """Of the files."""
    messages: Mapping[str, MessageSpec]
    by_key: Mapping[int, MessageSpec]
    nodes: Mapping[str, str] = field(default_factory=dict)
    """Name and comment."""
    baudrate: int = DEFAULT_BAUDRATE
    data_baudrate: int = 0
    """Of the fast part of CAN FD frames; 0 where the files tell none."""

    def message(self, name: str) -> MessageSpec:
        """Raises LogError with what is near."""
        import difflib

        found = self.messages.get(name)
        if found is None:
            near = difflib.get_close_matches(name, self.messages, n=1)
            hint = f"; did you mean {near[0]}?" if near else ""
            raise LogError(f"{self.name}: no message {name}{hint}")
        return found

    def name_of(self, key: int) -> str:
        """Name of a message, or its identifier in hexadecimal."""
        found = self.by_key.get(key)
        if found is not None:
            return found.name
        return f"{key & ~KEY_EXTENDED:08X}" if key & KEY_EXTENDED else f"{key:03X}"


def load_bus(dbc: "Path | str | Sequence[Path | str] | Bus | None" = None) -> Bus:
    """The bus of one or several DBC files; without any, that of this project.

    Raises:
        LogError: names the file that cannot be read or is none.
    """
    if isinstance(dbc, Bus):
        return dbc
    if dbc is None:
        return _own_bus()
    paths = [Path(dbc)] if isinstance(dbc, str | Path) else [Path(each) for each in dbc]
    database = Database(strict=False)
    for path in paths:
        try:
            text = path.read_bytes().decode("cp1252", "replace")
        except OSError as error:
            raise LogError(f"{path}: cannot be read: {error.strerror}") from error
        _add(database, text, str(path))
    return bus_of(database, ", ".join(str(path) for path in paths))


def parse_bus(text: str, name: str = "DBC") -> Bus:
    """The bus of the text of a DBC file. Raises LogError."""
    database = Database(strict=False)
    _add(database, text, name)
    return bus_of(database, name)


def _add(database: Any, text: str, name: str) -> None:
    try:
        database.add_dbc_string(text)
    except Exception as error:
        # The parser's errors share no base class; whatever it says is about this text.
        raise LogError(f"{name}: not a usable DBC file: {error}") from error


@functools.cache
def _own_bus() -> Bus:
    return parse_bus(merged.merged(), "can_dbc")


def bus_of(database: Any, name: str) -> Bus:
    """Of what cantools has parsed."""
    definitions = database.dbc.attribute_definitions if database.dbc is not None else {}
    defaults = {
        name: definitions[name].default_value
        for name in PROTECTION
        if name in definitions and definitions[name].default_value not in (None, "")
    }
    specs = [_message(each, defaults) for each in database.messages]
    return Bus(
        name=name,
        messages={spec.name: spec for spec in specs},
        by_key={spec.key: spec for spec in specs},
        nodes={node.name: str(node.comment or "") for node in database.nodes},
        baudrate=_rate(database, "Baudrate") or DEFAULT_BAUDRATE,
        data_baudrate=_rate(database, "BaudrateCANFD"),
    )


def _rate(database: Any, name: str) -> int:
    attributes = database.dbc.attributes if database.dbc is not None else {}
    found = attributes.get(name)
    return int(found.value) if found is not None and found.value else 0


def _message(message: Any, defaults: Mapping[str, Any]) -> MessageSpec:
    period_ms = int(message.cycle_time or 0)
    attributes = message.dbc.attributes if message.dbc is not None else {}
    timeout = attributes.get("TimeoutMs") or attributes.get("E2ETimeout")
    protection = {name: attributes[name].value for name in PROTECTION if name in attributes}
    return MessageSpec(
        name=message.name,
        key=message.frame_id | (KEY_EXTENDED if message.is_extended_frame else 0),
        length=message.length,
        senders=tuple(message.senders),
        period_ms=period_ms,
        timeout_ms=int(timeout.value) if timeout else TIMEOUT_PERIODS * period_ms,
        is_fd=bool(message.is_fd),
        comment=str(message.comment or ""),
        signals=tuple(_signal(each) for each in message.signals),
        attributes={**defaults, **protection},
        optional=_may_stay_away(message, attributes),
    )


def _may_stay_away(message: Any, attributes: Mapping[str, Any]) -> bool:
    """By GenMsgSendType, ifActive or cyclicIfActive, or by this project's attribute Optional."""
    optional = attributes.get("Optional")
    if_active = "ifactive" in str(message.send_type or "").lower()
    return if_active or (optional is not None and optional.value in (1, "yes"))


def _signal(signal: Any) -> SignalSpec:
    return SignalSpec(
        name=signal.name,
        start=signal.start,
        length=signal.length,
        big_endian=signal.byte_order == "big_endian",
        signed=signal.is_signed,
        is_float=signal.conversion.is_float,
        scale=signal.scale,
        offset=signal.offset,
        minimum=signal.minimum,
        maximum=signal.maximum,
        unit=signal.unit or "",
        choices={int(raw): str(name) for raw, name in (signal.choices or {}).items()},
        comment=str(signal.comment or ""),
        receivers=tuple(signal.receivers),
        is_multiplexer=signal.is_multiplexer,
        multiplexer=signal.multiplexer_signal,
        multiplexer_ids=tuple(signal.multiplexer_ids or ()),
    )
