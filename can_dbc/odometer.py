"""Odometer frames: two tachos, Doppler radar, accelerometer and cold-movement detector."""

from dataclasses import dataclass

from can_dbc.binding import complete, frame
from can_dbc.nodes import Direction


@frame("odometer.dbc", "TACHO")
@dataclass(frozen=True, slots=True)
class Tacho:
    """Pulse counters of two axles, read at one instant; both increase forwards and decrease
    backwards.
    """

    pulses_a: int
    """Counter modulo 65536; the tag reader latches this one."""
    pulses_b: int
    """Counter modulo 1024."""
    direction: Direction
    """Direction by the phase of the pulses; NEUTRAL while no pulse has come for 200 ms."""
    healthy_a: bool
    healthy_b: bool
    stamp_ms: float
    """The odometer's clock at that instant, modulo 256. It distinguishes a frame that bus or hub
    delayed from one of a slow train."""


@frame("odometer.dbc", "DOPPLER")
@dataclass(frozen=True, slots=True)
class Doppler:
    speed_mps: float
    """Speed over ground, signed; blind below 0.5 m/s, where the quality is 0."""
    quality_percent: float
    healthy: bool


@frame("odometer.dbc", "IMU")
@dataclass(frozen=True, slots=True)
class Imu:
    accel_mps2: float
    """Acceleration along the train including gravity along the gradient, as an accelerometer
    measures it."""
    healthy: bool


@frame("odometer.dbc", "COLD_MOVEMENT")
@dataclass(frozen=True, slots=True)
class ColdMovement:
    """The cold-movement detector.

    It has its own battery and monitors the wheels while everything else is off.
    """

    moved_m: float
    """Largest distance from the place at which the controller was switched off, in either
    direction."""
    monitored: bool
    """The detector monitored all the time since then."""


complete("odometer.dbc")
