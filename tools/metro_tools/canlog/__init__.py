"""Frame-level inspection of CAN logs: `read` gives numpy columns with exact time and verdicts."""

from metro_tools.canlog.damage import Damage, LogError
from metro_tools.canlog.database import Bus, MessageSpec, SignalSpec, load_bus, parse_bus
from metro_tools.canlog.frames import Frames
from metro_tools.canlog.options import ReadOptions
from metro_tools.canlog.read import Log, Stream, read, stream
from metro_tools.canlog.table import Table, table_of
from metro_tools.canlog.verdict import ACCEPTED, Verdicts, judge

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
