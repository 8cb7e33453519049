"""Bit activity on an unknown bus: which bits change, how often, and the entropy of each byte."""

from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np

from canlog.frames import Frames
from canlog.table import Groups

BYTE_VALUES: Final = 256


@dataclass(slots=True)
class Activity:
    """Bit activity of one identifier on one channel, counted over the blocks of a log."""

    key: int
    channel: str
    frames: int = 0
    width: int = 0
    """Data bytes of the longest frame."""
    flips: Any = field(default_factory=lambda: np.zeros((0, 8), np.int64))
    """(width, 8): how often each bit differs from the frame before, highest bit first."""
    values: Any = field(default_factory=lambda: np.zeros((0, BYTE_VALUES), np.int64))
    """(width, 256): how often each byte has each value."""
    _last: Any = None

    def feed(self, data: Any, lengths: Any) -> None:
        """Count the next frames: (n, w) bytes; only the first `lengths` (n,) bytes of each row
        count.
        """
        width = int(lengths.max(initial=0))
        self._widen(width)
        self.frames += len(data)
        for at in range(width):
            there = lengths > at
            column = data[there, at] if not there.all() else data[:, at]
            self.values[at] += np.bincount(column, minlength=BYTE_VALUES)
        if self._last is not None:
            before = np.zeros((1, data.shape[1]), np.uint8)
            known = min(len(self._last), data.shape[1])
            before[0, :known] = self._last[:known]
            data = np.concatenate([before, data])
        # A byte that a frame lacks counts as zero.
        wide = min(self.width, data.shape[1])
        changed = data[1:, :wide] ^ data[:-1, :wide]
        if len(changed):
            bits = np.unpackbits(np.ascontiguousarray(changed), axis=1)
            self.flips[:wide] += bits.sum(axis=0, dtype=np.int64).reshape(wide, 8)
        self._last = data[-1].copy()

    def _widen(self, width: int) -> None:
        if width > self.width:
            grown = ((0, width - self.width), (0, 0))
            self.flips, self.values = np.pad(self.flips, grown), np.pad(self.values, grown)
            self.width = width

    @property
    def flip_ratio(self) -> Any:
        """(width, 8): changes per step from one frame to the next."""
        return self.flips / max(self.frames - 1, 1)

    @property
    def entropy_bits(self) -> Any:
        """(width,): Shannon entropy of the values of each byte: 0 for a constant, at most 8."""
        totals = self.values.sum(axis=1, keepdims=True)
        share = self.values / np.maximum(totals, 1)
        with np.errstate(divide="ignore", invalid="ignore"):
            terms = np.where(share > 0, share * np.log2(share), 0.0)
        found: Any = np.abs(terms.sum(axis=1))
        return found


class ActivityView:
    """Bit activity by identifier and channel; `feed` takes the frames block by block."""

    def __init__(self) -> None:
        self.found: dict[tuple[int, str], Activity] = {}

    def feed(self, frames: Frames) -> None:
        groups = Groups(frames)
        for key, channel in groups.places:
            payloads = groups.payloads(key, channel=channel)
            one = self.found.setdefault((key, channel), Activity(key, channel))
            one.feed(payloads.data, payloads.length)
