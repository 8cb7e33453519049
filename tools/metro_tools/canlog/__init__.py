"""Frame-level inspection of CAN logs: `read` gives numpy columns with exact time and verdicts."""

from metro_tools.canlog.damage import Damage, LogError
from metro_tools.canlog.database import Bus, MessageSpec, SignalSpec, load_bus, parse_bus
from metro_tools.canlog.frames import Frames
from metro_tools.canlog.options import ReadOptions
from metro_tools.canlog.read import Log, Stream, read, stream
from metro_tools.canlog.table import Table

__all__ = [
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
    "load_bus",
    "parse_bus",
    "read",
    "stream",
]
