"""The nodes of the train bus, and enumerations that several subsystems share."""

import enum


class Node(enum.IntEnum):
    """Node numbers as in CANopen; the DBC files use the names."""

    VOBC = 1
    BCU = 2
    """Brake control unit."""
    TCU = 3
    """Traction control unit."""
    DCU = 4
    """Door control unit."""
    ODO = 5
    """Odometer: two tachos, Doppler radar, accelerometer."""
    BTM = 6
    """Balise transmission module: tag antenna and reader."""
    DESK = 7
    HVB = 8
    """High-voltage box: line voltage, breaker, energy meter."""
    TCMS = 9
    """Train control and monitoring system."""


class Direction(enum.IntEnum):
    NEUTRAL = 0
    FORWARD = 1
    REVERSE = 2
