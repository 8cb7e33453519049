"""The contents of a bus as plain values: messages by key, signals, nodes, periods."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Final, NamedTuple

from canlog.damage import LogError
from canlog.frames import KEY_EXTENDED

DEFAULT_BAUDRATE: Final = 500_000
TIMEOUT_PERIODS: Final = 3
"""Periods after which a message is stale if the file gives no TimeoutMs."""
PDU2_FORMAT: Final = 240
"""PDU format of J1939 from which on a message is a broadcast."""
EVERYONE: Final = 0xFF
"""Destination of J1939 messages for all nodes."""
STATE_BITS_MAX: Final = 8
"""Maximum length of a state; a longer signal with only two named values is a number."""
PROTECTION: Final = ("E2ECounterSignal", "E2ECrcSignal", "E2EProfile", "E2EDataId", "Protection")
"""Message attributes that declare alive counters and CRCs."""


CHANNEL_SIGN: Final = ":"
"""Separates the channel from a message that is on several channels."""
ORIGIN_SIGN: Final = "@"
"""Separates the source from a J1939 message that several nodes send."""


class LogPart(NamedTuple):
    """A message on one channel and, in J1939, from one source to one destination."""

    name: str
    channel: str
    origin: str = ""

    @property
    def columns(self) -> dict[str, str | int]:
        """Columns of an export that tell this part from others: channel, and J1939 addresses."""
        found: dict[str, str | int] = {"channel": self.channel}
        if self.origin:
            source, _, destination = self.origin.removeprefix(ORIGIN_SIGN).partition("-")
            found["source_address"] = int(source, 16)
            found["destination_address"] = int(destination, 16) if destination else EVERYONE
        return found

    @property
    def texts(self) -> tuple[str, ...]:
        """All names by which a user may ask for it."""
        names = (self.name, self.name + self.origin)
        return *names, *(f"{self.channel}{CHANNEL_SIGN}{each}" for each in names)


def part_names(parts: Iterable[LogPart]) -> dict[LogPart, str]:
    """Name parts: with the channel if several have a message, the origin if several send it."""
    parts = list(parts)
    channels: dict[str, set[str]] = {}
    origins: dict[tuple[str, str], set[str]] = {}
    for part in parts:
        channels.setdefault(part.name, set()).add(part.channel)
        origins.setdefault((part.name, part.channel), set()).add(part.origin)
    names = {}
    for part in parts:
        spread = len(channels[part.name]) > 1
        several = len(origins[part.name, part.channel]) > 1
        front = f"{part.channel}{CHANNEL_SIGN}" if spread else ""
        names[part] = f"{front}{part.name}{part.origin if several else ''}"
    return names


@dataclass(frozen=True, slots=True)
class SignalSpec:
    """One signal of one message. Physical value = raw * scale + offset."""

    name: str
    start: int
    """Start bit as in the DBC file: the lowest bit, or the highest one of a Motorola signal."""
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
    """Names by raw value."""
    comment: str
    receivers: tuple[str, ...]
    is_multiplexer: bool
    multiplexer: str | None
    """The signal that decides whether this one is present."""
    multiplexer_ids: tuple[int, ...]
    """Raw values of `multiplexer` for which this signal is present."""
    others: "tuple[SignalSpec, ...]" = ()
    """Signals of the same name at other bits, in other pages of the multiplexer."""

    @property
    def lsb(self) -> float:
        """Physical value of one step of the raw value; 0 for a float signal."""
        return 0.0 if self.is_float else abs(self.scale)

    @property
    def is_state(self) -> bool:
        """Whether its named values are states, and not marks such as "not available" of a number.

        A number has a unit or a factor, or has names only for values in the upper half of its
        range.
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
    """Identifier, with KEY_EXTENDED set if it has 29 bits."""
    length: int
    senders: tuple[str, ...]
    period_ms: int
    """Cycle time; 0 if the file gives none."""
    timeout_ms: int
    """Age at which a received message is stale; 0 for never."""
    is_fd: bool
    comment: str
    signals: tuple[SignalSpec, ...]
    attributes: Mapping[str, Any] = field(default_factory=dict)
    """DBC attributes, by name, that declare how the message is protected."""
    optional: bool = False
    """Whether a cyclic message may be absent: it is sent only while something is active."""
    is_j1939: bool = False
    """Whether the parameter group number identifies it: priority and source address may be any."""

    @property
    def identifier(self) -> int:
        return self.key & ~KEY_EXTENDED

    @property
    def is_extended(self) -> bool:
        return bool(self.key & KEY_EXTENDED)

    def origin(self, key: int) -> str:
        """Return source and destination of a J1939 frame as part of a name; empty for others."""
        if not self.is_j1939:
            return ""
        source, rest = key & 0xFF, key >> 8 & 0xFFFF
        broadcast = rest >> 8 >= PDU2_FORMAT or rest & 0xFF == EVERYONE
        destination = "" if broadcast else f"-{rest & 0xFF:02X}"
        return f"{ORIGIN_SIGN}{source:02X}{destination}"

    def signal(self, name: str) -> SignalSpec:
        """Return the signal of a name. Raises LogError if there is none."""
        for each in self.signals:
            if each.name == name:
                return each
        known = ", ".join(each.name for each in self.signals)
        raise LogError(f"{self.name}: no signal {name}; it has {known}")


@dataclass(frozen=True)
class Bus:
    """All messages that the given DBC files define."""

    name: str
    """File names."""
    messages: Mapping[str, MessageSpec]
    by_key: Mapping[int, MessageSpec]
    nodes: Mapping[str, str] = field(default_factory=dict)
    """Comments by name of the node."""
    baudrate: int = DEFAULT_BAUDRATE
    data_baudrate: int = 0
    """Bit rate of the fast part of CAN FD frames; 0 if the files give none."""
    warnings: tuple[str, ...] = ()
    """Flaws of the files, each with its file and lines."""
    by_channel: "Mapping[str, Bus]" = field(default_factory=dict)
    """Bus models by channel, of channels with files of their own; "" is the model of all others."""

    @cached_property
    def by_group(self) -> Mapping[int, MessageSpec]:
        """J1939 messages by their parameter group number."""
        return {
            group_number(spec.identifier): spec for spec in self.by_key.values() if spec.is_j1939
        }

    def on(self, channel: str) -> "Bus":
        """Return the bus that the files define for a channel."""
        if not self.by_channel:
            return self
        return self.by_channel.get(channel) or self.by_channel.get("", self)

    def spec_at(self, key: int) -> MessageSpec | None:
        """Return the message with a key or, in J1939, with its parameter group number."""
        found = self.by_key.get(key)
        if found is None and key & KEY_EXTENDED and self.by_group:
            found = self.by_group.get(group_number(key & ~KEY_EXTENDED))
        return found

    def message(self, name: str) -> MessageSpec:
        """Return the message of a name. Raises LogError that suggests a similar name."""
        import difflib

        found = self.messages.get(name)
        if found is None:
            near = difflib.get_close_matches(name, self.messages, n=1)
            hint = f"; did you mean {near[0]}?" if near else ""
            raise LogError(f"{self.name}: no message {name}{hint}")
        return found

    def name_of(self, key: int) -> str:
        """Name of a message, or its identifier in hexadecimal if it is unknown."""
        found = self.spec_at(key)
        if found is not None:
            return found.name
        return f"{key & ~KEY_EXTENDED:08X}" if key & KEY_EXTENDED else f"{key:03X}"


def group_number(identifier: int) -> int:
    """Return the parameter group number (PGN) of a 29-bit identifier of J1939.

    Below PDU format 240 the next byte is the destination and not part of the number.
    """
    number = identifier >> 8 & 0x3FFFF
    return number if number >> 8 & 0xFF >= PDU2_FORMAT else number & 0x3FF00
