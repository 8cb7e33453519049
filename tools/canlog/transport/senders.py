"""Tells who sent a reassembled message, and what it is called."""

from collections.abc import Iterator
from typing import Final

import numpy as np

from canlog.bus_model import EVERYONE, PDU2_FORMAT, Bus, MessageSpec
from canlog.frames import KEY_EXTENDED, Ints
from canlog.transport.messages import Messages
from canlog.transport.names import FAULTS

PRIORITY: Final = 7 << 26
"""Bits of the priority in an identifier of J1939."""
DEFAULT_PRIORITY: Final = 6 << 26
"""Priority of J1939 messages unless the sender chooses another, in its place."""


def by_sender(found: Messages) -> Iterator[tuple[tuple[str, int, int], Ints]]:
    """Yield channel, key and group of each sender, and the rows of its messages."""
    columns = found.key, found.group, found.channel
    order = np.lexsort(columns)
    cuts = np.zeros(max(0, len(order) - 1), np.bool_)
    for column in columns:
        cuts |= np.diff(column[order]) != 0
    for rows in np.split(order, np.flatnonzero(cuts) + 1):
        if len(rows):
            at = int(rows[0])
            channel = found.channels[int(found.channel[at])]
            yield (channel, int(found.key[at]), int(found.group[at])), rows


def addresses(key: int) -> tuple[int | None, int | None]:
    """Return source and destination of a 29-bit identifier; None for 11 bits."""
    return (key & 0xFF, key >> 8 & 0xFF) if key & KEY_EXTENDED else (None, None)


def message_key(group: int, key: int, priority: int = DEFAULT_PRIORITY) -> int:
    """Return the key that a single frame of a parameter group would have from the same sender.

    Args:
        key: key of the frames with the data.
        priority: its three bits, in their place.
    """
    addressed = (group >> 8 & 0xFF) < PDU2_FORMAT
    group = group & 0x3FF00 if addressed else group & 0x3FFFF
    return KEY_EXTENDED | priority | group << 8 | key & (0xFFFF if addressed else 0xFF)


def sender_spec(bus: Bus, channel: str, group: int) -> MessageSpec | None:
    """Return the message that a DBC file defines for a parameter group; None for ISO-TP, -1."""
    return bus.on(channel).by_group.get(group) if group >= 0 else None


def sender_name(bus: Bus, channel: str, key: int, group: int) -> str:
    """Return message and source, as `CI@05`, with the destination unless it is everyone."""
    if group < 0:
        return f"{bus.on(channel).name_of(key)} ISO-TP"
    spec = sender_spec(bus, channel, group)
    name = spec.name if spec is not None else FAULTS.get(group, f"PGN {group}")
    source, destination = addresses(key)
    return f"{name}@{source:02X}" + ("" if destination == EVERYONE else f"-{destination:02X}")
