"""Names and identifiers of the train bus's messages; checks that bus faults name real ones."""

import difflib
import functools
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from fnmatch import fnmatchcase
from typing import Final

from can_dbc import binding
from can_dbc.agreement import FieldLayout
from can_dbc.binding import Binding
from can_dbc.nodes import Node
from can_dbc.packing import value_table
from firmware_py.settings import SettingsError
from plant_emulator.faults.declared_bus import (
    FrameCorrupt,
    FrameDelay,
    FrameDirection,
    FrameDrop,
    FrameDuplicate,
    FrameReorder,
    FrameReplay,
    Masquerade,
)
from plant_emulator.faults.plan import FaultPlan

EVERYTHING: Final = "*"
"""Pattern that also matches frames that no DBC file defines."""
FRAME_FAULTS: Final = (
    FrameDrop,
    FrameDelay,
    FrameDuplicate,
    FrameReorder,
    FrameReplay,
    FrameCorrupt,
)
"""Parameters of faults that select frames by pattern and direction."""


@dataclass(frozen=True, slots=True)
class KnownMessage:
    """One message of the DBC files."""

    name: str
    can_id: int
    sender: str
    acting: str
    """Node that acts on the message. Train management receives most messages, but only records
    them."""
    bound: Binding
    is_twin: bool

    @property
    def way(self) -> FrameDirection:
        """Direction of the message between controller and train."""
        return FrameDirection.TO_TRAIN if self.sender == Node.VOBC.name else FrameDirection.TO_VOBC


@functools.cache
def known_messages() -> Mapping[int, KnownMessage]:
    """All messages by ascending identifier."""
    found = {}
    for kind in binding.kinds():
        bound = binding.binding_of(kind)
        for message in bound.messages:
            hearing = {name for signal in message.signals for name in signal.receivers}
            found[message.frame_id] = KnownMessage(
                name=message.name,
                can_id=message.frame_id,
                sender=message.senders[0],
                acting=next(node.name for node in Node if node.name in hearing),
                bound=bound,
                is_twin=message is bound.twin,
            )
    return dict(sorted(found.items()))


@functools.cache
def known_names() -> Mapping[str, KnownMessage]:
    return {known.name: known for known in known_messages().values()}


def name_of(can_id: int) -> str:
    """The message's name, or the identifier if no DBC file defines it."""
    known = known_messages().get(can_id)
    return f"{can_id:#05x}" if known is None else known.name


@functools.cache
def matches(pattern: str, can_id: int) -> bool:
    known = known_messages().get(can_id)
    return pattern == EVERYTHING if known is None else fnmatchcase(known.name, pattern)


def concerns(pattern: str, way: FrameDirection, can_id: int, going: FrameDirection) -> bool:
    """Whether a fault with this pattern and direction concerns the frame with direction `going`."""
    return way in (FrameDirection.BOTH, going) and matches(pattern, can_id)


def check_bus_fault(plan: FaultPlan) -> None:
    """Raises SettingsError if a bus fault names frames that do not exist.

    The text names key, value and the nearest valid value. Other faults are accepted.
    """
    parameters = plan.parameters
    where = f"fault[{plan.index}]"
    if isinstance(parameters, FRAME_FAULTS):
        _check_pattern(parameters.frames, parameters.way, where)
    elif isinstance(parameters, Masquerade):
        _check_masquerade(parameters, where)


def _check_pattern(pattern: str, way: FrameDirection, where: str) -> None:
    found = [each for each in known_names().values() if fnmatchcase(each.name, pattern)]
    if not found:
        raise SettingsError(
            f"{where}.frames: {pattern!r} matches no message; {_nearest(pattern, known_names())}"
        )
    if not any(way in (FrameDirection.BOTH, each.way) for each in found):
        other = found[0].way.name.lower()
        raise SettingsError(
            f"{where}.way: {way.name.lower()}: no frame that matches {pattern!r} goes that way;"
            f" nearest valid value: {other}"
        )


def _check_masquerade(parameters: Masquerade, where: str) -> None:
    firsts = {name: known for name, known in known_names().items() if not known.is_twin}
    known = firsts.get(parameters.frame)
    if known is None:
        raise SettingsError(
            f"{where}.frame: {parameters.frame!r} is no message;"
            f" {_nearest(parameters.frame, firsts)}"
        )
    fields = {field.name: field for field in known.bound.fields}
    for name, value in (parameters.values or {}).items():
        field = fields.get(name)
        if field is None:
            raise SettingsError(
                f"{where}.values.{name}: {known.name} has no such signal; {_nearest(name, fields)}"
            )
        if not is_value_of(field, value):
            raise SettingsError(f"{where}.values.{name}: {value:g} is not {_wanted(field)}")


def is_value_of(field: FieldLayout, value: float) -> bool:
    """Whether a frame can carry the value; numbers outside the range are sent as its end."""
    if field.kind is bool:
        return value in (0.0, 1.0)
    table = value_table(field)
    if table is not None:
        return value.is_integer() and 0 <= value < len(table) and table[int(value)] is not None
    return field.kind is not int or value.is_integer()


def _wanted(field: FieldLayout) -> str:
    table = value_table(field)
    if table is not None:
        named = (f"{raw} {each.name}" for raw, each in enumerate(table) if each is not None)
        return f"one of {', '.join(named)}"
    return "0 or 1" if field.kind is bool else "a whole number"


def _nearest(name: str, known: Iterable[str]) -> str:
    names = list(known)
    close = difflib.get_close_matches(name.strip("*?"), names, n=1, cutoff=0.4)
    return f"nearest valid name: {close[0]}" if close else f"valid names: {', '.join(names)}"
