"""Checks the identifiers of frames that a binary format gives as whole numbers."""

from dataclasses import replace

import numpy as np

from canlog.damage import EXTENDED_MAX, STANDARD_MAX, Damages
from canlog.frames import ERROR, EXTENDED, Frames


def possible(frames: Frames, damages: Damages, place: int | None = None) -> Frames:
    """Return the frames whose identifiers a bus can carry, and count the others as damage.

    An identifier of more than 11 bits that is not marked as extended is taken as a 29-bit one.
    """
    unmarked = (frames.flags & np.uint8(EXTENDED | ERROR)) == 0
    unmarked &= frames.identifier > STANDARD_MAX
    if unmarked.any():
        words = "more than 11 bits without the mark of 29 bits; taken as 29 bits"
        damages.add("unmarked identifier", "byte", place, words, int(unmarked.sum()))
        flags = frames.flags | (unmarked * np.uint8(EXTENDED))
        frames = replace(frames, flags=flags)
    bad = frames.identifier > EXTENDED_MAX
    if not bad.any():
        return frames
    damages.add(
        "impossible identifier", "byte", place, "more than 29 bits; left out", int(bad.sum())
    )
    return frames[~bad]
