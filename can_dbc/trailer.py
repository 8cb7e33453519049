"""The safety trailer: alive counter and CRC in the last three bytes of a protected frame."""

from binascii import crc_hqx
from collections import Counter
from collections.abc import Callable
from typing import Final

from cantools.database.can import Message

from can_dbc import dbc_file
from can_dbc.rejection import Reason

CRC_START: Final = 0xFFFF
MAX_STEP: Final = 3
"""Largest step of the alive counter that still counts as some frames lost."""
NEVER_NS: Final = -(1 << 63)


def crc_of_data_id(message: Message) -> int:
    """The state of the CRC after the data id, low byte first: it is run in but never sent."""
    return crc_hqx(dbc_file.data_id(message).to_bytes(2, "little"), CRC_START)


def opener(message: Message) -> Callable[[bytes], int]:
    """Checks length and CRC: payload bits with the counter above them, or -1 for a broken frame."""
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
    """Why `opener` refused."""
    if len(data) != message.length:
        detail = f"{len(data)} bytes, {message.name} has {message.length}"
        return Reason.WRONG_LENGTH, detail
    wanted = crc_hqx(data[:-2], crc_of_data_id(message))
    found = int.from_bytes(data[-2:], "little")
    return Reason.WRONG_CRC, f"CRC is {found:#06x}, should be {wanted:#06x}"


class AliveCounter:
    """Follows the alive counter of one message.

    The first value after start, or after a silence longer than the timeout, is taken as it is. A
    stream of frames that is believed goes on being believed, whatever is heard between its frames:
    another one takes its place only once it is silent for longer than the timeout, and by counting
    on. So frames that somebody repeats do not get through beside a sender that still sends.
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
        """When the believed stream was heard, counting on or stuck."""
        self.value = 0
        """Its last value."""
        self._refused_ns = NEVER_NS
        self._candidate = 0
        """The last value that jumped, and when."""

    def fault(self, value: int, heard_ns: int) -> tuple[Reason, str] | None:
        """What is wrong with the counter of an intact frame; None when it may be believed."""
        step = value - self.value & 0xFF
        silent = heard_ns - self.heard_ns > self._silence_ns
        if not (silent and self._may_begin(value, heard_ns)):
            if step == 0:
                # It breaks the silence: a sender that is stuck never becomes new.
                self.heard_ns = heard_ns
                return Reason.STUCK_COUNTER, f"counter is {value} again"
            if step > MAX_STEP:
                self._candidate = value
                self._refused_ns = heard_ns
                return Reason.JUMPED_COUNTER, f"counter is {value} after {self.value}"
            if step > 1:
                self._lost[self._can_id] += step - 1
        self.value = value
        self.heard_ns = heard_ns
        return None

    def _may_begin(self, value: int, heard_ns: int) -> bool:
        """Nothing else was heard either, or the value counts on from the one that jumped."""
        alone = heard_ns - self._refused_ns > self._silence_ns
        return alone or value - self._candidate & 0xFF == 1
