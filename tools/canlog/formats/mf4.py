"""ASAM MDF 4 bus logging: the raw columns of its groups of CAN frames, by asammdf."""

import gc
import sys
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any, Final

import numpy as np

from canlog.damage import Damages, LogError, possible
from canlog.formats.mf4_write import write
from canlog.frames import (
    BRS,
    CLASSIC_BYTES,
    ERROR,
    ESI,
    EXTENDED,
    FD,
    FD_BYTES,
    FD_LENGTHS,
    REMOTE,
    TX,
    Bytes,
    Frames,
    concat,
    widened,
)
from canlog.options import ReadOptions

__all__ = ["read", "write"]

KINDS: Final = {"CAN_DataFrame": 0, "CAN_ErrorFrame": ERROR, "CAN_RemoteFrame": REMOTE}
NS_PER_S: Final = 1_000_000_000
_LENGTHS: Final = np.array(FD_LENGTHS, np.uint8)


def library() -> Any:
    """asammdf, or LogError that says what to install."""
    try:
        import asammdf
    except ImportError:
        raise LogError("MF4 needs asammdf: pip install 'metro-vobc-bench[logs]'") from None
    return asammdf


def read(path: Path, options: ReadOptions, damages: Damages) -> Iterator[Frames]:
    """The frames of all groups of CAN frames, merged by their stamps; bus 1 is called `can1`.

    Stamps of the format are seconds since the start as float64: exact to a nanosecond for logs of
    up to 50 days. Blocks of `options.block_frames` are read at a time.

    Raises:
        LogError: for a file that asammdf cannot open.
    """
    made = library().MDF
    try:
        # Its own look at the frames would cost reading all of them once more.
        with made(str(path), process_bus_logging=False) as file:
            start_ns = _start_ns(file.header)
            groups = [
                (index, name, group.channel_group.cycles_nr)
                for index, group in enumerate(file.groups)
                for name in KINDS
                if any(channel.name == name for channel in group.channels)
            ]
            blocks = [
                _group_blocks(file, index, name, count, start_ns, options, damages)
                for index, name, count in groups
                if count
            ]
            yield from merged(blocks)
    except LogError:
        raise
    except OSError as error:
        raise LogError(f"{path}: cannot be read: {error.strerror or error}") from error
    except Exception as error:
        # asammdf raises whatever its parsing meets in a damaged file.
        words = f"{path}: no usable MDF 4 file: {error!r}"
    else:
        return
    _forget()
    raise LogError(words)


def _forget() -> None:
    """Let a file go that asammdf could not open: its finaliser fails, too, and would be shown."""
    before, sys.unraisablehook = sys.unraisablehook, lambda _: None
    try:
        gc.collect()
    finally:
        sys.unraisablehook = before


def _start_ns(header: Any) -> int:
    found = getattr(header, "abs_time", None)
    if found is not None:
        return int(found)
    return int(np.datetime64(header.start_time.replace(tzinfo=None), "ns").astype(np.int64))


def _group_blocks(
    file: Any,
    index: int,
    name: str,
    count: int,
    start_ns: int,
    options: ReadOptions,
    damages: Damages,
) -> Iterator[Frames]:
    for offset in range(0, count, options.block_frames):
        size = min(options.block_frames, count - offset)
        try:
            told = file.get(name, group=index, raw=True, record_offset=offset, record_count=size)
            made = _frames(told.samples, told.timestamps, name, start_ns, damages)
            yield possible(made, damages)
        except Exception as error:
            # Whatever asammdf meets in a damaged block; the blocks behind it may be whole.
            damages.add("broken block", "frame", offset + 1, f"{name}: {error!r}", size)


def _frames(samples: Any, stamps_s: Any, name: str, start_ns: int, damages: Damages) -> Frames:
    n = len(samples)
    names = set(samples.dtype.names or ())

    def field(of: str, default: int = 0) -> Any:
        full = f"{name}.{of}"
        return samples[full] if full in names else np.full(n, default, np.uint8)

    identifier = field("ID").astype(np.uint32)
    flags = np.full(n, KINDS[name], np.uint8)
    extended = (field("IDE") != 0) | ((identifier & np.uint32(0x8000_0000)) != 0)
    way = field("Dir")
    sent = way == b"Tx" if way.dtype.kind == "S" else way != 0
    for bit, on in (
        (EXTENDED, extended), (FD, field("EDL") != 0), (BRS, field("BRS") != 0),
        (ESI, field("ESI") != 0), (TX, sent),
    ):  # fmt: skip
        flags |= on * np.uint8(bit)
    data = _data(field("DataBytes")) if f"{name}.DataBytes" in names else np.zeros((n, 8), np.uint8)
    code = np.minimum(field("DLC"), 15)
    length = field("DataLength").astype(np.uint8)
    if f"{name}.DataLength" not in names or KINDS[name] == REMOTE:
        length = np.where((flags & FD) != 0, _LENGTHS[code], np.minimum(code, 8)).astype(np.uint8)
    length = np.minimum(length, data.shape[1])
    data = np.where(np.arange(data.shape[1]) < length[:, None], data, 0).astype(np.uint8)
    at_ns = np.rint(np.asarray(stamps_s, np.float64) * NS_PER_S)
    if not np.isfinite(at_ns).all():
        damages.add("impossible stamp", "frame", None, f"{name}: no number; taken as the start")
        at_ns = np.nan_to_num(at_ns, nan=0.0, posinf=0.0, neginf=0.0)
    bus = field("BusChannel").astype(np.uint8)
    numbers = np.unique(bus)
    return Frames(
        at_ns.astype(np.int64) + start_ns,
        identifier & np.uint32(0x1FFF_FFFF),
        flags,
        np.searchsorted(numbers, bus).astype(np.uint8),
        length.astype(np.uint8),
        data,
        tuple(f"can{number}" for number in numbers.tolist()),
    )


def _data(column: Any) -> Bytes:
    """(n, 8) or (n, 64), whatever width the file has."""
    if column.ndim != 2:
        raise ValueError("its DataBytes are no bytes")
    data: Bytes = column.astype(np.uint8, copy=False)[:, :FD_BYTES]
    return widened(data, CLASSIC_BYTES if data.shape[1] <= CLASSIC_BYTES else FD_BYTES)


def merged(sources: Iterable[Iterator[Frames]]) -> Iterator[Frames]:
    """Blocks of several sources that are each in order, in the order of their stamps."""
    waiting: list[tuple[Frames, Iterator[Frames]]] = []
    for source in sources:
        first = next(source, None)
        if first is not None:
            waiting.append((first, source))
    while waiting:
        if len(waiting) == 1:
            block, source = waiting.pop()
            yield block
            yield from source
            return
        # Up to the earliest end of a block everything that comes before it is at hand.
        limit_ns = min(int(block.at_ns[-1]) for block, _ in waiting)
        taken: list[Frames] = []
        left: list[tuple[Frames, Iterator[Frames]]] = []
        for block, source in waiting:
            cut = int(np.searchsorted(block.at_ns, limit_ns, "right"))
            taken.append(block[:cut])
            rest = block[cut:] if cut < len(block) else next(source, None)
            if rest is not None:
                left.append((rest, source))
        joined = concat(taken)
        yield joined[np.argsort(joined.at_ns, kind="stable")]
        waiting = left
