"""A time span of a log, and the zero of its seconds."""

from dataclasses import dataclass
from typing import Final

import numpy as np

from canlog.reader import Log
from canlog.run import NS_PER_S

EPOCH_FROM_NS: Final = 10 * 365 * 86400 * NS_PER_S
"""Stamp from which a log is dated; logs that begin earlier count from their start."""


@dataclass(frozen=True, slots=True)
class TimeSpan:
    """Start and end of a span, and the instant that counts as zero."""

    zero_ns: int
    start_ns: int
    end_ns: int

    def seconds(self, at_ns: int) -> float:
        return (at_ns - self.zero_ns) / NS_PER_S


def zero_of(log: Log) -> int:
    """Return the zero of seconds: the start of the run, or the first frame of a dated log."""
    if log.run is not None:
        return log.run.start_ns
    return log.start_ns if log.start_ns > EPOCH_FROM_NS else 0


def date_text(at_ns: int) -> str:
    """Return date and time in UTC to the nanosecond; empty in a log without a date."""
    if at_ns <= EPOCH_FROM_NS:
        return ""
    return str(np.datetime64(at_ns, "ns")).replace("T", " ") + " UTC"
