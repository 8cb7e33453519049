"""Existing tools that convert a log to physical values; each function returns its number of
frames."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import asammdf
import can
import hilspy

READERS: dict[str, Callable[..., Any]] = {
    ".log": can.CanutilsLogReader,
    ".blf": can.BLFReader,
    ".asc": can.ASCReader,
    ".trc": can.TRCReader,
    ".mf4": can.MF4Reader,
}
HILSPY_FORMS = ("candump", "blf", "asc")


def python_can_and_cantools(path: Path, database: Any, most: int) -> int:
    """Read only the first frames, because each one takes the same work. The DBC file is loaded
    before."""
    frames = 0
    for message in READERS[path.suffix](str(path)):
        database.decode_message(message.arbitration_id, message.data, decode_choices=False)
        frames += 1
        if frames == most:
            break
    return frames


def hilspy_channel(path: Path, dbc: Path, most: int) -> int:
    """Read every value, as a user who decodes a log does."""
    form = "?format=candump" if path.suffix == ".log" else ""
    frames = 0
    with hilspy.open(f"file://{path}{form}", f"dbc:{dbc}") as channel:
        for message in channel:
            for _ in message.fields.values():
                pass
            frames += 1
            if frames == most:
                break
    return frames


def without_compression(path: Path) -> Path:
    """Write the same MF4 file without compression beside it."""
    plain = path.with_name(f"{path.stem}_plain.mf4")
    with asammdf.MDF(str(path)) as file:
        file.save(str(plain), overwrite=True, compression=0)
    return plain


def asammdf_extract(path: Path, dbc: Path, most: int) -> int:
    """Convert the whole file whatever `most` is, because asammdf cannot stop earlier."""
    del most
    frames = 0
    with asammdf.MDF(str(path)) as file:
        out: Any = file.extract_bus_logging({"CAN": [(str(dbc), 0)]})
        for index, group in enumerate(out.groups):
            frames += group.channel_group.cycles_nr
            for channel in group.channels[1:]:
                out.get(channel.name, group=index)
    return frames
