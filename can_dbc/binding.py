"""Binds a frame class to its DBC message on import; a mismatch raises and says what to change."""

import functools
import importlib
import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Final, TypeVar

from can_dbc import agreement, dbc_file
from can_dbc.agreement import FieldLayout, Frame
from can_dbc.dbc_file import TWIN_SUFFIX, BindingError, DbcFile, MessageProtection
from can_dbc.messages import Message

__all__ = [
    "Binding",
    "BindingError",
    "Frame",
    "MessageProtection",
    "bind",
    "binding_of",
    "can_id",
    "complete",
    "frame",
    "is_vital",
    "kinds",
    "message",
    "period_s",
    "sender",
    "timeout_s",
]

F = TypeVar("F", bound=Frame)


@dataclass(frozen=True, slots=True)
class Binding:
    """A frame class and the message that carries it, checked to agree."""

    kind: type[Frame]
    file: DbcFile
    message: Message
    twin: Message | None
    """The inverted copy on the next identifier; only vital messages have one."""
    protection: MessageProtection
    fields: tuple[FieldLayout, ...]
    period_s: float
    timeout_s: float

    @property
    def messages(self) -> tuple[Message, ...]:
        """The messages sent for one frame, in this order."""
        return (self.message,) if self.twin is None else (self.message, self.twin)


_BINDINGS: Final[dict[type, Binding]] = {}


def frame(dbc: str | Path, message_name: str) -> Callable[[type[F]], type[F]]:
    """Bind the decorated dataclass to a message.

    Args:
        dbc: name of a file of this package, or a path to any other.
        message_name: name of the message in that file.

    Raises:
        BindingError: with a line for every mismatch.
    """

    def bound(kind: type[F]) -> type[F]:
        file = dbc_file.read(dbc) if isinstance(dbc, Path) else dbc_file.shipped(dbc)
        _BINDINGS[kind] = bind(kind, file, message_name)
        return kind

    return bound


def bind(kind: type[Frame], file: DbcFile, message_name: str) -> Binding:
    """Create the binding as `frame` does, without registering it."""
    found = file.message(message_name)
    faults = list(agreement.mismatches(kind, file, found))
    if faults:
        raise BindingError("\n".join(faults))
    return Binding(
        kind=kind,
        file=file,
        message=found,
        twin=file.messages.get(message_name + TWIN_SUFFIX),
        protection=dbc_file.protection(found),
        fields=agreement.layouts(kind, found),
        period_s=dbc_file.period_ms(found) / 1000.0,
        timeout_s=dbc_file.timeout_ms(found) / 1000.0 or math.inf,
    )


def register(bound: Binding) -> None:
    """Let `binding_of` find a binding that was made without `frame`."""
    _BINDINGS[bound.kind] = bound


def complete(dbc: str) -> None:
    """Refuse messages without a frame class. The last line of each module of this package.

    Args:
        dbc: name of a file of this package.

    Raises:
        BindingError: with a line for every message without a class.
    """
    file = dbc_file.shipped(dbc)
    bound = {
        message.name
        for each in _BINDINGS.values()
        if each.file is file
        for message in each.messages
    }
    if missing := [name for name in file.messages if name not in bound]:
        module = dbc.removesuffix(".dbc")
        raise BindingError(
            "\n".join(
                f"{dbc}: {name}: has no frame class; add one to can_dbc/{module}.py under "
                f'@frame("{dbc}", "{name}")'
                for name in missing
            )
        )


def kinds() -> tuple[type[Frame], ...]:
    """Return every frame class of this package, by increasing identifier."""
    return _shipped_kinds()


@functools.cache
def _shipped_kinds() -> tuple[type[Frame], ...]:
    """Import the modules that belong to the DBC files; each has the name of its file."""
    for name in dbc_file.names():
        importlib.import_module("can_dbc." + name.removesuffix(".dbc"))
        complete(name)
    files = [dbc_file.shipped(name) for name in dbc_file.names()]
    dbc_file.refuse_shared("all files", [m for file in files for m in file.messages.values()])
    shipped = {id(file) for file in files}
    bound = [each for each in _BINDINGS.values() if id(each.file) in shipped]
    return tuple(each.kind for each in sorted(bound, key=lambda each: each.message.frame_id))


@functools.cache
def known_ids() -> frozenset[int]:
    """Return every identifier of this package's DBC files."""
    return frozenset(each.frame_id for kind in kinds() for each in binding_of(kind).messages)


def binding_of(kind: type) -> Binding:
    """Return the binding of a class. Raises TypeError for a class without one."""
    try:
        return _BINDINGS[kind]
    except KeyError:
        raise TypeError(f"{kind.__name__} is bound to no DBC message; decorate it") from None


def message(kind: type) -> Message:
    """The message of a frame class."""
    return binding_of(kind).message


def can_id(kind: type) -> int:
    """Identifier of the message; for a vital message that of the first half."""
    return binding_of(kind).message.frame_id


def sender(kind: type) -> str:
    """Name of the node that sends the message."""
    return binding_of(kind).message.senders[0]


def period_s(kind: type) -> float:
    """Time between transmissions; 0 for a message that is not cyclic."""
    return binding_of(kind).period_s


def timeout_s(kind: type) -> float:
    """Age at which a receiver rejects the message as lost; infinite for one that is not cyclic."""
    return binding_of(kind).timeout_s


def is_vital(kind: type) -> bool:
    """Whether the message is sent as a pair with an inverted twin."""
    return binding_of(kind).protection is MessageProtection.VITAL
