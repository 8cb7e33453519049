"""Writes MDF 4 bus logging: a group each for data, error and remote frames, by asammdf."""

from collections.abc import Iterable
from pathlib import Path
from typing import Any, Final

import numpy as np

from metro_tools.canlog.damage import Damages, LogError
from metro_tools.canlog.formats.text import first_ns_of
from metro_tools.canlog.frames import (
    BRS,
    ERROR,
    ESI,
    EXTENDED,
    FD,
    FD_LENGTHS,
    REMOTE,
    TX,
    Frames,
    concat,
    widened,
)
from metro_tools.canlog.writing import Numbers, lost

NS_PER_S: Final = 1_000_000_000
EXACT_NS: Final = 1 << 52
"""A float64 of seconds gives every nanosecond back up to here."""
SOURCE_BUS, BUS_TYPE_CAN = 2, 2
BUS_EVENT: Final = 0x2 | 0x4
_CODES: Final = np.array([min(c for c, n in enumerate(FD_LENGTHS) if n >= k) for k in range(65)])


def write(path: Path, blocks: Iterable[Frames], losses: Damages) -> None:
    """All frames; the file is made in memory, so that a log has to fit into it."""
    try:
        from asammdf import MDF, Signal
        from asammdf.blocks.source_utils import Source
    except ImportError:
        raise LogError("MF4 needs asammdf: pip install 'metro-vobc-bench[logs]'") from None
    frames = concat(list(blocks))
    start_ns = first_ns_of(frames) if len(frames) else 0
    past_ns = frames.at_ns - start_ns
    lost(losses, np.abs(past_ns) >= EXACT_NS, "nanoseconds", "so long a log rounds its stamps")
    numbers = Numbers(losses).of(frames)
    order = np.argsort(past_ns, kind="stable")
    if (np.diff(past_ns) < 0).any():
        losses.add("order", "frame", None, "the format sorts frames by their stamps")
    source = Source(
        name="CAN", path="CAN", comment="", source_type=SOURCE_BUS, bus_type=BUS_TYPE_CAN
    )
    with MDF(version="4.10") as file:
        # Whole milliseconds: what the head of the format is made from has no more.
        file.header.abs_time = start_ns
        for name, flag in (
            ("CAN_DataFrame", 0),
            ("CAN_ErrorFrame", ERROR),
            ("CAN_RemoteFrame", REMOTE),
        ):
            mine = order[(frames.flags[order] & (ERROR | REMOTE)) == flag]
            if len(mine):
                samples = _samples(name, frames[mine], numbers[mine])
                stamps_s = past_ns[mine] / NS_PER_S
                file.append(
                    [Signal(samples=samples, timestamps=stamps_s, name=name, source=source)],
                    acq_source=source,
                    common_timebase=True,
                )
                # A group of frames is told from one of signals by this flag of its head.
                head: Any = file.groups[-1].channel_group
                head.flags |= BUS_EVENT
        file.save(str(path), overwrite=True, compression=1)


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
