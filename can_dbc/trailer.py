"""The safety trailer: alive counter and CRC in the last three bytes of a protected frame."""

from binascii import crc_hqx
from collections import Counter
from collections.abc import Callable
from typing import Final

from can_dbc import dbc_file
from can_dbc.messages import Message
from can_dbc.rejection import Reason

CRC_START: Final = 0xFFFF
MAX_STEP: Final = 3
"""Largest step of the alive counter that still counts as lost frames; a larger one is a jump."""
NEVER_NS: Final = -(1 << 63)


def crc_of_data_id(message: Message) -> int:
    """Return the CRC state after the data id, low byte first.

    The data id is part of the CRC but never sent.
    """
    return crc_hqx(dbc_file.data_id(message).to_bytes(2, "little"), CRC_START)


def opener(message: Message) -> Callable[[bytes], int]:
    """Return a function that checks length and CRC.

    It gives the payload bits with the counter above them, or -1 for a broken frame.
    """
    length, start = message.length, crc_of_data_id(message)
    crc_at = length - 2
    crc_shift = 8 * crc_at
    mask = (1 << crc_shift) - 1
    from_bytes = int.from_bytes

    def opened(data: bytes) -> int:
        if len(data) != length:
            return -1
        word = from_bytes(data, "little")
        if crc_hqx(data[:crc_at], start) != word >> crc_shift:
            return -1
        return word & mask

    return opened


def damage(message: Message, data: bytes) -> tuple[Reason, str]:
    """Return why `opener` rejected the data."""
    if len(data) != message.length:
        detail = f"{len(data)} bytes, {message.name} has {message.length}"
        return Reason.WRONG_LENGTH, detail
    wanted = crc_hqx(data[:-2], crc_of_data_id(message))
    found = int.from_bytes(data[-2:], "little")
    return Reason.WRONG_CRC, f"CRC is {found:#06x}, should be {wanted:#06x}"


def stuck(value: int) -> tuple[Reason, str]:
    return Reason.STUCK_COUNTER, f"counter is {value} again"


def jumped(value: int, last: int) -> tuple[Reason, str]:
    return Reason.JUMPED_COUNTER, f"counter is {value} after {last}"


class AliveCounter:
    """Supervises the alive counter of one message.

    The first value after the start, or after a silence longer than the timeout, is accepted. An
    accepted stream stays accepted, whatever is received between its frames. Another stream replaces
    it only after the accepted one has been silent for longer than the timeout, and only by counting
    on. So repeated frames are rejected while the true sender still sends.
    """

    __slots__ = (
        "_can_id",
        "_candidate",
        "_lost",
        "_refused_ns",
        "_silence_ns",
        "heard_ns",
        "value",
    )

    def __init__(self, can_id: int, lost: Counter[int], silence_ns: int) -> None:
        self._can_id = can_id
        self._lost = lost
        self._silence_ns = silence_ns
        self.heard_ns = NEVER_NS
        """Instant of the last frame of the accepted stream, counting on or stuck."""
        self.value = 0
        """Last value of the accepted stream."""
        self._refused_ns = NEVER_NS
        self._candidate = 0
        """Last value that jumped; `_refused_ns` is its instant."""

    def fault(self, value: int, heard_ns: int) -> tuple[Reason, str] | None:
        """Return the fault of an intact frame's counter; None if the frame may be accepted."""
        step = value - self.value & 0xFF
        silent = heard_ns - self.heard_ns > self._silence_ns
        if not (silent and self._may_begin(value, heard_ns)):
            if step == 0:
                # A stuck sender ends the silence, so it is never accepted as a new stream.
                self.heard_ns = heard_ns
                return stuck(value)
            if step > MAX_STEP:
                self._candidate = value
                self._refused_ns = heard_ns
                return jumped(value, self.value)
            if step > 1:
                self._lost[self._can_id] += step - 1
        self.value = value
        self.heard_ns = heard_ns
        return None

    def _may_begin(self, value: int, heard_ns: int) -> bool:
        """Return whether no other stream was received, or the value counts on from the one that
        jumped.
        """
        alone = heard_ns - self._refused_ns > self._silence_ns
        return alone or value - self._candidate & 0xFF == 1
