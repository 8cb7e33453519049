"""The guest's three kernels, and the order in which a machine tries them. Pure."""

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from enum import Enum
from typing import Final

AUTOMATIC: Final = "auto"
SIGNAL_FRAME_MAX_BYTES: Final = 3632
"""Size of the signal frame on a processor with AVX-512 and protection keys, whose XSAVE area has
2,696 bytes. User-mode Linux before 6.13 has a buffer of exactly this size and crashes on a larger
one."""
AMX_FLAG: Final = "amx_tile"
"""Flag in /proc/cpuinfo of a processor whose XSAVE area has 11,008 bytes."""


class GuestKernel(Enum):
    """A kernel to boot; the value is its name for users and its folder in the cache."""

    STOCK = "stock"
    NEWER = "newer"
    QEMU = "qemu"


TITLES: Final = {
    GuestKernel.STOCK: "the distribution's user-mode Linux",
    GuestKernel.NEWER: "Debian unstable's user-mode Linux",
    GuestKernel.QEMU: "an emulated PC (QEMU, about 15 times slower) with Linux",
}


@dataclass(frozen=True, slots=True)
class Processor:
    """Properties of the processor that decide which user-mode kernel can run."""

    flags: Collection[str]
    """Flags as in /proc/cpuinfo."""
    signal_frame_bytes: int | None
    """AT_MINSIGSTKSZ, which grows with the XSAVE area; None if the host does not give it."""


@dataclass(frozen=True, slots=True)
class Choice:
    """Kernels in the order to try, and the reason of that order."""

    kernels: Sequence[GuestKernel]
    reason: str


def choose(wanted: str, processor: Processor) -> Choice:
    """Return one kernel if the user named it, otherwise all three; each later one is a fallback.

    Args:
        wanted: a value of `GuestKernel`, or `AUTOMATIC`.
        processor: properties of this machine's processor.
    """
    if wanted != AUTOMATIC:
        return Choice((GuestKernel(wanted),), "as requested")
    frame_bytes = processor.signal_frame_bytes or 0
    if AMX_FLAG in processor.flags:
        reason = "the processor has AMX, on which older kernels crash"
    elif frame_bytes > SIGNAL_FRAME_MAX_BYTES:
        reason = f"older kernels crash on the processor's signal frame of {frame_bytes} bytes"
    else:
        return Choice(
            (GuestKernel.STOCK, GuestKernel.NEWER, GuestKernel.QEMU), "it suits the processor"
        )
    return Choice((GuestKernel.NEWER, GuestKernel.STOCK, GuestKernel.QEMU), reason)


def booting_line(kernel: GuestKernel, release: str, reason: str) -> str:
    """Return the line that names the kernel before it boots, with the reason."""
    return f"kernel {kernel.value}: {TITLES[kernel]} {release} ({reason})"


def failure_text(failures: Sequence[tuple[GuestKernel, str]]) -> str:
    """Return why no kernel booted: each reason once."""
    texts = dict.fromkeys(text for _, text in failures)
    if len(texts) == 1:
        return next(iter(texts))
    return "no kernel gave a guest\n" + "\n".join(f"{k.value}: {text}" for k, text in failures)
