"""Result of a decoder for data that must not be used."""

import enum
from dataclasses import dataclass


class Reason(enum.Enum):
    """Why a frame was rejected."""

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
    """Received data that must not be used."""

    can_id: int
    data: bytes
    reason: Reason
    detail: str
    """Detail for people."""
