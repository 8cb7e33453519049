"""The controller as a device: its rhythm, its log, and where it starts from."""

from vobc.process.commission import Commission, read_commission
from vobc.process.cycle_log import CYCLE_COLUMNS, CycleLog
from vobc.process.device import VobcDevice
from vobc.process.start import commissioned_start, remembered_start, unknown_start

__all__ = [
    "CYCLE_COLUMNS",
    "Commission",
    "CycleLog",
    "VobcDevice",
    "commissioned_start",
    "read_commission",
    "remembered_start",
    "unknown_start",
]
