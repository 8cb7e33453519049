"""Messages and signals as the DBC files define them."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple


class DbcSignal(NamedTuple):
    """A signal with the bits and the scaling of its DBC file."""

    name: str
    start: int
    length: int
    byte_order: str
    """`little_endian` or `big_endian`."""
    is_signed: bool
    is_float: bool
    is_multiplexer: bool
    multiplexer_ids: Sequence[int] | None
    scale: float
    offset: float
    minimum: float | None
    maximum: float | None
    unit: str | None
    choices: Mapping[int, str] | None
    """Raw values and their names."""
    raw_initial: float | None
    receivers: Sequence[str]
    comment: str | None


class Message(NamedTuple):
    """A message with its attributes and signals."""

    name: str
    frame_id: int
    is_extended_frame: bool
    length: int
    senders: Sequence[str]
    send_type: str | None
    cycle_time: int | None
    comment: str | None
    attributes: Mapping[str, object]
    """Values of its DBC attributes, by name."""
    signals: Sequence[DbcSignal]
    """Sorted by their first bit."""
