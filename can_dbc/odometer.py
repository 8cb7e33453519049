"""Odometer frames: two tachos, Doppler radar, accelerometer and detector of cold movement."""

from dataclasses import dataclass

from can_dbc.binding import complete, frame
from can_dbc.nodes import Direction


@frame("odometer.dbc", "TACHO")
@dataclass(frozen=True, slots=True)
class Tacho:
    """Pulse counters of two axles, read at one instant; both rise forwards and fall backwards."""

    pulses_a: int
    """Modulo 65536; the counter that the tag reader latches."""
    pulses_b: int
    """Modulo 1024."""
    direction: Direction
    """By the phase of the pulses; NEUTRAL while no pulse has come for 200 ms."""
    healthy_a: bool
    healthy_b: bool
    stamp_ms: float
    """The odometer's own clock at that instant, modulo 256: a frame that the bus or a hub held up
    is an old sample, not a slow train."""


@frame("odometer.dbc", "DOPPLER")
@dataclass(frozen=True, slots=True)
class Doppler:
    speed_mps: float
    """Over ground, signed; blind below 0.5 m/s, where quality is 0."""
    quality_percent: float
    healthy: bool


@frame("odometer.dbc", "IMU")
@dataclass(frozen=True, slots=True)
class Imu:
    accel_mps2: float
    """Along the train, gravity along the gradient included, as an accelerometer feels it."""
    healthy: bool


@frame("odometer.dbc", "COLD_MOVEMENT")
@dataclass(frozen=True, slots=True)
class ColdMovement:
    """The detector has a battery of its own and watches the wheels while everything else is off."""

    moved_m: float
    """Largest distance from the place at which the controller was switched off, either way."""
    monitored: bool
    """It was awake all the time since then."""


complete("odometer.dbc")
