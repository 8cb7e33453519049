"""Writes MDF 4 bus logging with asammdf: one group each for data, error and remote frames."""

from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any, Final

import numpy as np

from canlog.damage import Damages, LogError
from canlog.formats.text import first_ns_of
from canlog.frames import (
    BRS,
    CLASSIC_BYTES,
    ERROR,
    ESI,
    EXTENDED,
    FD,
    FD_LENGTHS,
    REMOTE,
    TX,
    Frames,
    Ints,
    concat,
    empty,
    widened,
)
from canlog.writing import Numbers, lost

NS_PER_S: Final = 1_000_000_000
EXACT_NS: Final = 1 << 52
"""Time up to which a float64 of seconds holds every nanosecond exactly."""
SOURCE_BUS, BUS_TYPE_CAN = 2, 2
BUS_EVENT: Final = 0x2 | 0x4
_CODES: Final = np.array([min(c for c, n in enumerate(FD_LENGTHS) if n >= k) for k in range(65)])


GROUPS: Final = (("CAN_DataFrame", 0), ("CAN_ErrorFrame", ERROR), ("CAN_RemoteFrame", REMOTE))


def write(path: Path, blocks: Iterable[Frames], losses: Damages) -> None:
    """Write all frames, block by block.

    Stamps of a group must not run backwards, so frames are sorted over the length of a block. An
    even later frame begins another group; readers merge the groups by their stamps.
    """
    try:
        from asammdf import MDF
    except ImportError:
        raise LogError("MF4 needs asammdf: pip install 'metro-vobc-bench[logs]'") from None
    with MDF(version="4.10") as file:
        file.header.abs_time = 0
        out: _Writer | None = None
        for frames in in_order(blocks, losses):
            if out is None:
                out = _Writer(file, first_ns_of(frames), losses)
                # Whole milliseconds: asammdf stores the start time no finer.
                file.header.abs_time = out.start_ns
            out.add(frames)
        file.save(str(path), overwrite=True, compression=1)


def in_order(blocks: Iterable[Frames], losses: Damages) -> Iterator[Frames]:
    """Yield the frames sorted by their stamps, over the length of two blocks."""
    waiting, last_ns, sorted_ = empty(), 0, True
    for block in blocks:
        if not len(block):
            continue
        before_ns = np.concatenate([[last_ns if len(waiting) else block.at_ns[0]], block.at_ns])
        sorted_ &= bool((np.diff(before_ns) >= 0).all())
        last_ns = int(block.at_ns[-1])
        both = concat([waiting, block])
        both = both[np.argsort(both.at_ns, kind="stable")]
        if len(waiting):
            yield both[: len(waiting)]
        waiting = both[len(waiting) :]
    if len(waiting):
        yield waiting
    if not sorted_:
        losses.add("order", "frame", None, "the format sorts frames by their stamps")


class _Writer:
    """Writes blocks into groups of an open file, by kind of frame and by short or long data."""

    def __init__(self, file: Any, start_ns: int, losses: Damages) -> None:
        from asammdf.blocks.source_utils import Source

        self.start_ns = start_ns
        self._file, self._losses = file, losses
        self._numbers = Numbers(losses)
        self._source = Source(
            name="CAN", path="CAN", comment="", source_type=SOURCE_BUS, bus_type=BUS_TYPE_CAN
        )
        self._groups: dict[tuple[str, bool], tuple[int, int]] = {}
        """Index in the file and last stamp of each group, by name and whether its data is long."""

    def add(self, frames: Frames) -> None:
        past_ns = frames.at_ns - self.start_ns
        lost(
            self._losses,
            np.abs(past_ns) >= EXACT_NS,
            "nanoseconds",
            "a log of this length has rounded stamps",
        )
        channel = self._numbers.of(frames)
        for name, flag in GROUPS:
            mine = np.flatnonzero((frames.flags & (ERROR | REMOTE)) == flag)
            if len(mine):
                self._extend(name, frames[mine], past_ns[mine], channel[mine])

    def _extend(self, name: str, frames: Frames, past_ns: Ints, channel: Any) -> None:
        from asammdf import Signal

        samples, stamps_s = _samples(name, frames, channel), past_ns / NS_PER_S
        place = name, frames.data.shape[1] > CLASSIC_BYTES
        index, last_ns = self._groups.get(place, (None, 0))
        if index is not None and last_ns <= int(past_ns[0]):
            self._file.extend(index, [(stamps_s, None), (samples, None)])
        else:
            self._file.append(
                [Signal(samples=samples, timestamps=stamps_s, name=name, source=self._source)],
                acq_source=self._source,
                common_timebase=True,
            )
            index = len(self._file.groups) - 1
            # This flag in the head marks a group of frames rather than of signals.
            head: Any = self._file.groups[index].channel_group
            head.flags |= BUS_EVENT
        self._groups[place] = index, int(past_ns[-1])


def _samples(name: str, frames: Frames, channel: Any) -> Any:
    width = frames.data.shape[1]
    layout = [
        *[("BusChannel", "<u1"), ("ID", "<u4"), ("IDE", "<u1"), ("DLC", "<u1")],
        *[("DataLength", "<u1"), ("DataBytes", "(64,)u1" if width > 8 else "(8,)u1")],
        *[("Dir", "<u1"), ("EDL", "<u1"), ("BRS", "<u1"), ("ESI", "<u1")],
    ]
    if name == "CAN_RemoteFrame":
        layout = [each for each in layout if each[0] not in ("DataBytes", "EDL", "BRS", "ESI")]
    told = np.zeros(len(frames), np.dtype([(f"{name}.{of}", kind) for of, kind in layout]))
    names = {of for of, _ in layout}
    columns = {
        "BusChannel": channel,
        "ID": frames.identifier,
        "IDE": (frames.flags & EXTENDED) != 0,
        "DLC": np.where((frames.flags & FD) != 0, _CODES[frames.length], frames.length),
        "DataLength": frames.length,
        "DataBytes": widened(frames.data, 64 if width > 8 else 8),
        "Dir": (frames.flags & TX) != 0,
        "EDL": (frames.flags & FD) != 0,
        "BRS": (frames.flags & BRS) != 0,
        "ESI": (frames.flags & ESI) != 0,
    }
    for of in names:
        told[f"{name}.{of}"] = columns[of]
    return told
