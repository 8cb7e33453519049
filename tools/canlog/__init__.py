"""Frame-level inspection of CAN logs: `read` gives numpy columns with exact times and verdicts."""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from canlog.damage import Damage, LogError
    from canlog.database import Bus, MessageSpec, SignalSpec, load_bus, parse_bus
    from canlog.frames import Frames
    from canlog.options import ReadOptions
    from canlog.reader import Log, Stream, read, stream
    from canlog.table import Table, table_of
    from canlog.verdict import Verdicts, judge
    from canlog.verdict_codes import ACCEPTED

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
_MODULES = {
    "damage": ("Damage", "LogError"),
    "database": ("Bus", "MessageSpec", "SignalSpec", "load_bus", "parse_bus"),
    "frames": ("Frames",),
    "options": ("ReadOptions",),
    "reader": ("Log", "Stream", "read", "stream"),
    "table": ("Table", "table_of"),
    "verdict": ("Verdicts", "judge"),
    "verdict_codes": ("ACCEPTED",),
}


def __getattr__(name: str) -> Any:
    """Import a name on first use, so that help needs neither numpy nor the codec."""
    import importlib

    for module, names in _MODULES.items():
        if name in names:
            found = globals()[name] = getattr(importlib.import_module(f"canlog.{module}"), name)
            return found
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
