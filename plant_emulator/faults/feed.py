"""The feed of a plant in real time: datagrams with the true state and the changes of faults.

Each datagram is little endian and begins with a kind (uint8) and an instant (int64, nanoseconds of
the machine's monotonic clock). Kind 1 continues with the truth as packed by `Truth.pack`. Kind 2
continues with the index of a fault in the scenario (uint32) and whether it is active from now on
(uint8, 0 or 1). Changes of an instant precede its truth.
"""

import struct
from dataclasses import dataclass
from typing import Final

from plant_emulator.truth import Truth

TRUTH_KIND: Final = 1
CHANGE_KIND: Final = 2
_HEAD: Final = struct.Struct("<Bq")
_CHANGE: Final = struct.Struct("<BqIB")


@dataclass(frozen=True, slots=True)
class TruthSample:
    """The true state at an instant."""

    truth: Truth
    now_ns: int


@dataclass(frozen=True, slots=True)
class FaultChange:
    """A fault began or ended."""

    index: int
    """Index of the fault in the scenario."""
    active: bool
    now_ns: int


def pack_truth(truth: Truth, now_ns: int) -> bytes:
    return _HEAD.pack(TRUTH_KIND, now_ns) + truth.pack()


def pack_change(index: int, active: bool, now_ns: int) -> bytes:
    return _CHANGE.pack(CHANGE_KIND, now_ns, index, active)


def read_message(data: bytes) -> TruthSample | FaultChange | None:
    """Parse a datagram of the two functions above; None for anything else."""
    if len(data) == _CHANGE.size and data[0] == CHANGE_KIND:
        _, now_ns, index, active = _CHANGE.unpack(data)
        return FaultChange(index, active == 1, now_ns) if active in (0, 1) else None
    if len(data) < _HEAD.size or data[0] != TRUTH_KIND:
        return None
    _, now_ns = _HEAD.unpack_from(data)
    truth = Truth()
    try:
        truth.unpack(data[_HEAD.size :])
    except struct.error:
        return None
    return TruthSample(truth, now_ns)
