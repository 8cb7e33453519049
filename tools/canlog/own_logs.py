"""Chooses the DBC files for a log if the user names none."""

import json
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Final

import numpy as np

from canlog.damage import LogError
from canlog.database import Bus, load_bus, no_bus, own_bus
from canlog.frames import Frames
from canlog.options import ReadOptions
from canlog.reader import stream
from firmware_py.storage.whole_file import write_whole

OWN: Final = "own"
"""Word in place of a file that stands for this project's bus."""
MEMORY: Final = ".canlog.json"
"""File beside logs that lists the files to decode them with."""
KNOWN_RATIO: Final = 0.5
"""Share of a log's first frames whose identifier and length must match this project's bus."""


def own_or_none(paths: Sequence[Path], options: ReadOptions) -> Bus:
    """Return this project's bus, or one without messages if any of the logs is of another bus."""
    bus = own_bus()
    for path in paths:
        if path.is_dir() or not path.is_file():
            continue
        if not _is_own(_first_frames(path, options), bus):
            print(
                f"canlog: note: {path} is of another bus, so nothing is decoded; "
                f"--dbc FILE decodes it, --dbc {OWN} takes this project's messages",
                file=sys.stderr,
            )
            return no_bus()
    return bus


def _first_frames(path: Path, options: ReadOptions) -> Frames | None:
    try:
        source = stream(path, replace(options, refuse_empty=False))
        return next((block for block in source if len(block)), None)
    except LogError:
        # The reader that comes next reports the error.
        return None


def _is_own(frames: Frames | None, bus: Bus) -> bool:
    if frames is None:
        return True
    rows = np.flatnonzero(frames.is_data)
    if not len(rows):
        return True
    kinds = frames.key[rows].astype(np.uint64) << np.uint64(8) | frames.length[rows]
    own = 0
    for kind, count in zip(
        *(each.tolist() for each in np.unique(kinds, return_counts=True)), strict=True
    ):
        spec = bus.by_key.get(kind >> 8)
        own += count if spec is not None and spec.length == kind & 0xFF else 0
    return own >= KNOWN_RATIO * len(rows)


def remembered(paths: Sequence[Path]) -> Bus | None:
    """Return the bus of the files that a log's folder remembers; None if it remembers none.

    Raises:
        LogError: for a memory file that cannot be used.
    """
    for path in paths:
        memory = path.parent / MEMORY
        if path.is_dir() or not memory.is_file():
            continue
        try:
            files = json.loads(memory.read_text("utf-8"))["dbc"]
            assert isinstance(files, list)
        except (OSError, ValueError, KeyError, TypeError, AssertionError) as error:
            raise LogError(f"{memory}: cannot be used: {error!r}; remove it") from error
        print(f"canlog: note: decoded with {', '.join(files)}, as {memory} says", file=sys.stderr)
        if files == [OWN]:
            return own_bus()
        return load_bus([_beside(str(each), memory.parent) for each in files])
    return None


def _beside(text: str, folder: Path) -> str:
    channel, sign, name = text.rpartition("=")
    return f"{channel}{sign}{folder / name}"


def remember(paths: Sequence[Path], files: Sequence[str]) -> None:
    """Write the file names into the folder of each log. Raises LogError."""
    for path in paths:
        folder = path.parent
        told = []
        for each in files:
            channel, sign, name = str(each).rpartition("=")
            told.append(OWN if each == OWN else f"{channel}{sign}{Path(name).resolve()}")
        text = json.dumps({"dbc": told}, indent=1) + "\n"
        write_whole(folder / MEMORY, text)
        print(f"canlog: note: {folder / MEMORY} remembers {', '.join(told)}", file=sys.stderr)
