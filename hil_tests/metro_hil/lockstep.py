"""Controller and plant in one process in virtual time: same code, same frames, as fast as it goes."""

from dataclasses import replace

from can_dbc.vobc import AtoPhase
from firmware_py.buses.inproc import InprocBus
from firmware_py.clock import LockstepClock, WallClock
from firmware_py.executive import Executive, Task, run
from firmware_py.recorder import CandumpWriter
from metro_hil.ending import ARRIVED, DURATION, ArrivalWatch, Ending
from metro_hil.journey import Journey
from metro_hil.options import RunOptions
from metro_hil.run_folder import RunFolder

BIT_RATE = 250_000
BUS_NAME = "vcan0"
LIMIT_S = 4.0 * 3600.0
WATCH_MS = 500.0
