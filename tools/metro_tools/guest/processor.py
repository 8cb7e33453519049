"""Properties of this machine's processor."""

import struct
from pathlib import Path
from typing import Final

from metro_tools.guest.kernels import Processor

AT_MINSIGSTKSZ: Final = 51
"""Entry of the auxiliary vector: bytes of the largest signal frame; Linux 5.14 and later."""
ENTRY: Final = struct.Struct("@LL")


def this_processor() -> Processor:
    """Return flags and size of the signal frame, if the host reports them."""
    return Processor(_flags(), _auxiliary().get(AT_MINSIGSTKSZ))


def _flags() -> frozenset[str]:
    try:
        lines = Path("/proc/cpuinfo").read_text(errors="replace").splitlines()
    except OSError:
        return frozenset()
    flags = next((line for line in lines if line.startswith("flags")), "")
    return frozenset(flags.partition(":")[2].split())


def _auxiliary() -> dict[int, int]:
    try:
        vector = Path("/proc/self/auxv").read_bytes()
    except OSError:
        return {}
    whole = len(vector) - len(vector) % ENTRY.size
    return dict(ENTRY.iter_unpack(vector[:whole]))
