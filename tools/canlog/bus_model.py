"""What a bus carries, as plain values: messages by key, signals, nodes, periods."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Final

from canlog.damage import LogError
from canlog.frames import KEY_EXTENDED

DEFAULT_BAUDRATE: Final = 500_000
TIMEOUT_PERIODS: Final = 3
"""A message is stale after this many periods where the file has no TimeoutMs."""
PDU2_FORMAT: Final = 240
"""From this PDU format on messages of J1939 go to all."""
STATE_BITS_MAX: Final = 8
"""A longer signal with only two named values is a number."""
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
    others: "tuple[SignalSpec, ...]" = ()
    """The same name with other bits, in other pages of the multiplexer."""

    @property
    def lsb(self) -> float:
        """One step of the raw value; that of a float signal is 0."""
        return 0.0 if self.is_float else abs(self.scale)

    @property
    def is_state(self) -> bool:
        """Whether its named values are states, and not marks such as "not available" of a number.

        A number has a unit or a factor, or names only values in the upper half of its range.
        """
        if not self.choices or self.is_float:
            return False
        values = 1 << self.length
        if 2 * len(self.choices) >= values:
            return True
        if len(self.choices) == 1 or self.scale != 1 or self.unit not in ("", "-", "1"):
            return False
        if len(self.choices) == 2 and self.length > STATE_BITS_MAX:
            return False
        return any(0 <= raw < values // 2 for raw in self.choices)


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
    """The bus may never carry it, though it is cyclic: it is sent only if something is active."""
    is_j1939: bool = False
    """Told by its parameter group number: priority and source address may be any."""

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


@dataclass(frozen=True)
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
    warnings: tuple[str, ...] = ()
    """Flaws of the files, each with its file and lines."""
    by_channel: "Mapping[str, Bus]" = field(default_factory=dict)
    """Of channels that have files of their own; that of all others is named with nothing."""

    @cached_property
    def by_group(self) -> Mapping[int, MessageSpec]:
        """Messages of J1939 by their parameter group number."""
        return {
            group_number(spec.identifier): spec for spec in self.by_key.values() if spec.is_j1939
        }

    def on(self, channel: str) -> "Bus":
        """What the files know of a channel."""
        if not self.by_channel:
            return self
        return self.by_channel.get(channel) or self.by_channel.get("", self)

    def spec_at(self, key: int) -> MessageSpec | None:
        """The message with a key, or with its parameter group number in J1939."""
        found = self.by_key.get(key)
        if found is None and key & KEY_EXTENDED and self.by_group:
            found = self.by_group.get(group_number(key & ~KEY_EXTENDED))
        return found

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
        found = self.spec_at(key)
        if found is not None:
            return found.name
        return f"{key & ~KEY_EXTENDED:08X}" if key & KEY_EXTENDED else f"{key:03X}"


def group_number(identifier: int) -> int:
    """The parameter group number (PGN) in a 29-bit identifier of J1939.

    Below PDU format 240 the byte behind it is the destination and no part of the number.
    """
    number = identifier >> 8 & 0x3FFFF
    return number if number >> 8 & 0xFF >= PDU2_FORMAT else number & 0x3FF00
