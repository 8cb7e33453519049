"""The controller as a device: its rhythm, its log, and where it starts from."""

from vobc.process.cycle_log import CYCLE_COLUMNS, CycleLog
from vobc.process.device import VobcDevice
from vobc.process.start import commissioned_start, remembered_start, unknown_start

__all__ = [
    "CYCLE_COLUMNS",
    "CycleLog",
    "VobcDevice",
    "commissioned_start",
    "remembered_start",
    "unknown_start",
]
