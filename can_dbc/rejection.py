"""What a decoder says of bytes that must not be acted on."""

import enum
from dataclasses import dataclass


class Reason(enum.Enum):
    """Why a frame was not believed."""

    UNKNOWN_ID = enum.auto()
    WRONG_LENGTH = enum.auto()
    WRONG_CRC = enum.auto()
    STUCK_COUNTER = enum.auto()
    JUMPED_COUNTER = enum.auto()
    INVALID_VALUE = enum.auto()
    TWIN_MISMATCH = enum.auto()
    TWIN_TIMEOUT = enum.auto()


@dataclass(frozen=True, slots=True)
class Rejected:
    """Bytes that were heard but must not be acted on."""

    can_id: int
    data: bytes
    reason: Reason
    detail: str
    """For a person to read."""
