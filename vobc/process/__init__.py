"""The controller as a device: its tasks, its logs, and its start."""

from vobc.process.commission import Commission, read_commission
from vobc.process.cycle_log import CYCLE_COLUMNS, CycleLog
from vobc.process.device import VobcDevice
from vobc.process.event_log import EVENTS_LOG, EventLines, EventLog
from vobc.process.start import commissioned_start, remembered_start, unknown_start

__all__ = [
    "CYCLE_COLUMNS",
    "Commission",
    "EVENTS_LOG",
    "CycleLog",
    "EventLines",
    "EventLog",
    "VobcDevice",
    "commissioned_start",
    "read_commission",
    "remembered_start",
    "unknown_start",
]
