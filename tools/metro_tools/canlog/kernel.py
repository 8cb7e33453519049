"""The compiled kernel for text and objects, where there is a C compiler; else numpy does the same.

`kernel.c` is compiled once for each version of it into the user's cache, and tests hold both ways
to the same columns. CANLOG_KERNEL=off leaves it out.
"""

import ctypes
import functools
import hashlib
import os
import platform
import shutil
import subprocess
import tempfile
from importlib import resources
from pathlib import Path
from typing import Any, Final

import numpy as np

from metro_tools.canlog.frames import Frames, blank
from metro_tools.canlog.line_block import Block

FLAGS: Final = ("-O3", "-shared", "-fPIC", "-std=c11", "-ffp-contract=off")
"""Without contraction a product and a sum round twice, as they do in Python."""
COMPILERS: Final = ("cc", "gcc", "clang")
COMPILE_S: Final = 60
NAME_BYTES: Final = 64
WORD_BYTES: Final = 8
NAMES_MAX: Final = 256
USUAL_LINE: Final = 24
"""Bytes; lines of frames have more, and room is made when others are shorter."""
SWITCH: Final = "CANLOG_KERNEL"
BLF_OBJECT_BYTES: Final = 48


@functools.cache
def library() -> Any:
    """The loaded kernel, None where it cannot be had."""
    if os.environ.get(SWITCH, "") == "off" or not np.little_endian:
        return None
    source = (resources.files("metro_tools.canlog") / "kernel.c").read_bytes()
    compiler = next((found for name in COMPILERS if (found := shutil.which(name))), None)
    mark = hashlib.sha256(source + platform.machine().encode() + " ".join(FLAGS).encode())
    try:
        folder = _cache_folder()
        path = folder / f"kernel-{mark.hexdigest()[:16]}.so"
        if not path.is_file():
            if compiler is None:
                return None
            _compile(compiler, source, path)
        return _declared(ctypes.CDLL(str(path)))
    except (OSError, subprocess.SubprocessError):
        return None


def _cache_folder() -> Path:
    """Ours alone: what is loaded from it runs as we do."""
    base = os.environ.get("XDG_CACHE_HOME") or str(Path.home() / ".cache")
    folder = Path(base) / "canlog"
    folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    told = folder.stat()
    if told.st_uid != os.getuid() or told.st_mode & 0o022:
        raise OSError(f"{folder}: others may write to it")
    return folder


def _compile(compiler: str, source: bytes, path: Path) -> None:
    """Into a name of its own first, so that two processes cannot see half a file."""
    with tempfile.TemporaryDirectory(dir=path.parent) as folder:
        text, made = Path(folder) / "kernel.c", Path(folder) / "kernel.so"
        text.write_bytes(source)
        subprocess.run(  # noqa: S603
            [compiler, *FLAGS, str(text), "-o", str(made)],
            check=True,
            capture_output=True,
            timeout=COMPILE_S,
        )
        made.replace(path)


def _declared(found: Any) -> Any:
    found.canlog_candump.restype = found.canlog_blf.restype = ctypes.c_int64
    number, place = ctypes.c_int64, ctypes.c_void_p
    found.canlog_candump.argtypes = [ctypes.c_char_p, *[number] * 3, *[place] * 11]
    found.canlog_blf.argtypes = [ctypes.c_char_p, number, number, number, *[place] * 7]
    whole = ctypes.c_int
    found.canlog_integers.restype = found.canlog_doubles.restype = None
    found.canlog_group.restype = None
    found.canlog_group.argtypes = [place, number, whole, *[place] * 8]
    found.canlog_integers.argtypes = [
        *[place, number, whole, whole, whole, ctypes.c_uint64, ctypes.c_uint64, place]
    ]
    found.canlog_doubles.argtypes = [
        *[place, number, whole, whole, whole, ctypes.c_double, ctypes.c_double, place]
    ]
    return found


def parse_candump(text: bytes, channels: list[str], width: int) -> Block | None:
    """What `parse_block` gives; None when there is no kernel."""
    kernel = library()
    if kernel is None or any(len(name.encode()) >= NAME_BYTES for name in channels):
        return None
    names, sizes, known = _names(channels)
    rows, most = -1, len(text) // USUAL_LINE + 1
    while rows < 0:
        made = blank(most, width=width)
        odd, told = np.empty((most, 4), np.int64), np.zeros(2, np.int64)
        rows = kernel.canlog_candump(
            text, len(text), width, most, *_places(made), names.ctypes.data, sizes.ctypes.data,
            ctypes.byref(known), odd.ctypes.data, told.ctypes.data,
        )  # fmt: skip
        # A line takes a byte and its end at the least.
        most = len(text) // 2 + 1
    for at in range(len(channels), known.value):
        name = bytes(names[at, : sizes[at]])
        channels.append(name.decode("ascii", "backslashreplace"))
    odd = odd[: told[0]]
    frames = made[:rows]
    frames = Frames(
        frames.at_ns, frames.identifier, frames.flags, frames.channel, frames.length, frames.data,
        tuple(channels),
    )  # fmt: skip
    return Block(frames, odd[:, 0], odd[:, 1], odd[:, 2], odd[:, 3], int(told[1]))


def _places(made: Frames) -> list[int]:
    columns = (made.at_ns, made.identifier, made.flags, made.channel, made.length, made.data)
    return [int(column.ctypes.data) for column in columns]


def _names(channels: list[str]) -> tuple[Any, Any, Any]:
    """The table of names that the kernel looks up and adds to."""
    names = np.zeros((NAMES_MAX, NAME_BYTES), np.uint8)
    sizes = np.zeros(NAMES_MAX, np.int32)
    for at, name in enumerate(channels):
        # A name that was no ASCII was told with escapes, which no bytes of a log are equal to.
        raw = name.encode("ascii", "replace")
        names[at, : len(raw)], sizes[at] = np.frombuffer(raw, np.uint8), len(raw)
    return names, sizes, ctypes.c_int32(len(channels))


def take_blf(buffer: bytes, start_ns: int) -> tuple[Any, Any, int] | None:
    """Frames with their channels' numbers, and where the first object that is not whole begins.

    None when there is no kernel, or the buffer holds more than whole classic data frames.
    """
    kernel = library()
    if kernel is None:
        return None
    most = len(buffer) // BLF_OBJECT_BYTES + 1
    made = blank(0)
    at_ns, identifier = np.empty(most, np.int64), np.empty(most, np.uint32)
    flags, length = np.empty(most, np.uint8), np.empty(most, np.uint8)
    channel, data = np.empty(most, np.uint16), np.empty(most, np.uint64)
    consumed = ctypes.c_int64()
    columns = (at_ns, identifier, flags, channel, length, data)
    rows = kernel.canlog_blf(
        buffer, len(buffer), start_ns, most, *(column.ctypes.data for column in columns),
        ctypes.byref(consumed),
    )  # fmt: skip
    if rows < 0:
        return None
    made = Frames(
        at_ns[:rows], identifier[:rows], flags[:rows], np.zeros(0, np.uint8), length[:rows],
        data[:rows].view(np.uint8).reshape(-1, 8),
    )  # fmt: skip
    return made, channel[:rows], int(consumed.value)


def scaled(
    words: Any, bits: tuple[int, int, bool], scale: float, offset: float, out: Any
) -> Any | None:
    """(n,) raw * scale + offset of the signal with these bits; None when there is no kernel.

    Args:
        words: (n,) uint64.
        bits: how many lie right of it, how many it has, whether it is signed.
        out: (n,) to be filled: int64 or uint64 for whole scales and offsets whose results fit,
            else float64.
    """
    kernel = library()
    if kernel is None or not words.flags.c_contiguous:
        return None
    if out.dtype.kind == "f":
        kernel.canlog_doubles(words.ctypes.data, len(words), *bits, scale, offset, out.ctypes.data)
    else:
        whole = (int(scale) % (1 << 64), int(offset) % (1 << 64))
        kernel.canlog_integers(words.ctypes.data, len(words), *bits, *whole, out.ctypes.data)
    return out


def grouped(group: Any, none: int, starts: Any, frames: Frames) -> tuple[Any, ...] | None:
    """Rows, stamps, data words and lengths of frames sorted by group; None without a kernel.

    Args:
        group: (n,) uint16, `none` for frames that are left out.
        starts: place of the first frame of each group, int64.
    """
    kernel = library()
    columns = (frames.at_ns, frames.data, frames.length)
    if kernel is None or frames.data.shape[1] != WORD_BYTES:
        return None
    if not all(column.flags.c_contiguous for column in columns):
        return None
    count = int((group != none).sum())
    out = (
        np.empty(count, np.int64),
        np.empty(count, np.int64),
        np.empty(count, np.uint64),
        np.empty(count, np.uint8),
    )
    places = starts.copy()
    kernel.canlog_group(
        group.ctypes.data, len(group), none, places.ctypes.data,
        *(column.ctypes.data for column in columns), *(column.ctypes.data for column in out),
    )  # fmt: skip
    return out
