"""Reads a log with another vehicle's DBC file into numpy columns."""

from pathlib import Path

import numpy as np

import canlog

HERE = Path(__file__).parent

log = canlog.read(HERE / "tram.log", HERE / "tram.dbc")
at_ns, speed_kmh = log.signal("DRIVE_STATE.speed_kmh")
gaps_ms = np.diff(at_ns) / 1e6
print(f"{len(log)} frames, top speed {np.max(speed_kmh):.1f} km/h")
print(f"longest silence of the drive: {np.max(gaps_ms):.0f} ms")
