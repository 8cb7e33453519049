"""Frame-level inspection of CAN logs: `read` gives numpy columns with exact time and verdicts."""

from canlog.damage import Damage, LogError
from canlog.database import Bus, MessageSpec, SignalSpec, load_bus, parse_bus
from canlog.frames import Frames
from canlog.options import ReadOptions
from canlog.read import Log, Stream, read, stream
from canlog.table import Table, table_of
from canlog.verdict import ACCEPTED, Verdicts, judge

__all__ = [
    "ACCEPTED",
    "Bus",
    "Damage",
    "Frames",
    "Log",
    "LogError",
    "MessageSpec",
    "ReadOptions",
    "SignalSpec",
    "Stream",
    "Table",
    "Verdicts",
    "judge",
    "load_bus",
    "parse_bus",
    "read",
    "stream",
    "table_of",
]
