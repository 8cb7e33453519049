"""Frame-level inspection of CAN logs: `read` gives numpy columns with exact times and verdicts."""

from typing import TYPE_CHECKING, Any

from canlog.damage import Damage, LogError
from canlog.database import Bus, MessageSpec, SignalSpec, load_bus, parse_bus
from canlog.frames import Frames
from canlog.options import ReadOptions
from canlog.read import Log, Stream, read, stream
from canlog.table import Table, table_of
from canlog.verdict_codes import ACCEPTED

if TYPE_CHECKING:
    from canlog.verdict import Verdicts, judge

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


def __getattr__(name: str) -> Any:
    """Import the codec on first use: it takes longer to load than everything else."""
    if name not in ("Verdicts", "judge"):
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from canlog import verdict

    return getattr(verdict, name)
