"""DBC files, each read once, and the attributes that this bus adds to them."""

import difflib
import enum
import functools
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Final

from can_dbc import parsed_files
from can_dbc.messages import DbcSignal as DbcSignal
from can_dbc.messages import Message as Message

COUNTER_NAME: Final = "alive_counter"
CRC_NAME: Final = "crc16"
TWIN_SUFFIX: Final = "_INV"
"""Suffix of the inverted twin's name."""
TIMEOUT_PERIODS: Final = 3
"""Number of periods after which a message is lost, unless TimeoutMs sets a longer time."""


class BindingError(Exception):
    """A DBC file and a frame class contradict each other; the text says where and what to
    change.
    """


class MessageProtection(enum.Enum):
    """Protection of a message, with the numbers of the DBC attribute of this name."""

    NONE = 0
    SAFETY = 1
    """Alive counter and CRC in the last three bytes."""
    VITAL = 2
    """Alive counter, CRC, and an inverted twin directly after the message."""


@dataclass(frozen=True, slots=True)
class DbcFile:
    """One parsed file."""

    name: str
    messages: Mapping[str, Message]
    nodes: Mapping[str, str]
    """Name and comment of each node."""

    def message(self, name: str) -> Message:
        """Return the message called `name`.

        Raises BindingError with the nearest name if there is none.
        """
        if name not in self.messages:
            near = difflib.get_close_matches(name, self.messages, n=1)
            hint = f"; did you mean {near[0]}?" if near else ""
            raise BindingError(f"{self.name}: {name}: no such message{hint}")
        return self.messages[name]


def names() -> list[str]:
    """The DBC files of this package, sorted."""
    folder = resources.files("can_dbc")
    return sorted(entry.name for entry in folder.iterdir() if entry.name.endswith(".dbc"))


@functools.cache
def shipped(name: str) -> DbcFile:
    """Return a file of this package by its name."""
    if name not in names():
        raise BindingError(f"{name}: no such file; shipped are {', '.join(names())}")
    text = text_of(name)
    found = parsed_files.find(name, text)
    return parse(text, name) if found is None else _file(name, *found)


def text_of(name: str) -> str:
    """Return the content of a file of this package."""
    return (resources.files("can_dbc") / name).read_text(encoding="ascii")


@functools.cache
def read(path: Path) -> DbcFile:
    """Return a file by its path."""
    try:
        text = path.read_text(encoding="cp1252")
    except OSError as error:
        raise BindingError(f"{path}: cannot be read: {error.strerror}") from error
    return parse(text, str(path))


def parse(text: str, name: str) -> DbcFile:
    """Parse the content of a DBC file; errors use `name` for it."""
    from can_dbc import dbc_parser

    try:
        found = dbc_parser.parsed(text)
    except dbc_parser.ParseError as error:
        raise BindingError(f"{name}: not a usable DBC file: {error}") from error
    refuse_shared(name, found.messages)
    return _file(name, *found)


def _file(name: str, messages: Iterable[Message], nodes: Mapping[str, str]) -> DbcFile:
    return DbcFile(name, messages={message.name: message for message in messages}, nodes=nodes)


def refuse_shared(where: str, messages: Iterable[Message]) -> None:
    """Raise BindingError if two messages share a name, an identifier or a data id."""
    owners: dict[str, Message] = {}
    for message in messages:
        marks = [f"name {message.name}", f"identifier {message.frame_id:#x}"]
        if data_id(message):
            marks.append(f"SafetyDataId {data_id(message)}")
        for mark in marks:
            other = owners.setdefault(mark, message)
            if other is not message:
                raise BindingError(
                    f"{where}: {message.name}: {mark} is also that of {other.name};"
                    " give each its own"
                )


def number(message: Message, attribute: str) -> int:
    """An integer attribute of a message; 0 if the file does not give it."""
    found = message.attributes.get(attribute, 0)
    if not isinstance(found, int):
        raise BindingError(f"{message.name}: {attribute} is {found!r}; define it as INT")
    return found


def protection(message: Message) -> MessageProtection:
    """The attribute Protection."""
    value = number(message, "Protection")
    try:
        return MessageProtection(value)
    except ValueError:
        wanted = ", ".join(f"{each.value} {each.name}" for each in MessageProtection)
        raise BindingError(f"{message.name}: Protection is {value}; use {wanted}") from None


def data_id(message: Message) -> int:
    """The attribute SafetyDataId: part of the CRC, never sent; 0 without one."""
    return number(message, "SafetyDataId")


def is_cyclic(message: Message) -> bool:
    """Whether the attribute GenMsgSendType is cyclic."""
    return message.send_type == "cyclic"


def period_ms(message: Message) -> int:
    """The attribute GenMsgCycleTime; 0 for a message that is not cyclic."""
    return message.cycle_time or 0


def timeout_ms(message: Message) -> int:
    """The attribute TimeoutMs; three periods if the file gives none."""
    return number(message, "TimeoutMs") or TIMEOUT_PERIODS * period_ms(message)


def signals_of(message: Message) -> dict[str, DbcSignal]:
    """Signals of a message by name."""
    return {signal.name: signal for signal in message.signals}


def raw_limits(signal: DbcSignal) -> tuple[int, int]:
    """Least and greatest raw value of a signal's bits."""
    if signal.is_signed:
        return -(1 << signal.length - 1), (1 << signal.length - 1) - 1
    return 0, (1 << signal.length) - 1


def table_of(signal: DbcSignal) -> dict[int, str]:
    """Raw values and their names."""
    return {**(signal.choices or {})}
