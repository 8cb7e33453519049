"""Heartbeats, emergency messages and time as CANopen (CiA 301) lays them out, and the train's load."""

import enum
from dataclasses import dataclass

from can_dbc.binding import frame


class NodeState(enum.IntEnum):
    """CANopen NMT states as a heartbeat carries them."""

    BOOT_UP = 0
    STOPPED = 4
    OPERATIONAL = 5
    PRE_OPERATIONAL = 127


@dataclass(frozen=True, slots=True)
class Heartbeat:
    """Sent every second by every node; a message of its own for each."""

    state: NodeState


@dataclass(frozen=True, slots=True)
class Emergency:
    """CANopen EMCY: sent once when an error appears and once, with code 0, when it is gone."""

    error_code: int
    """CiA 301 table 26, or a code of the manufacturer's from 0xFF00 on."""
    error_register: int
    detail: int
    """The manufacturer's 40 bits; meaning depends on the code."""


@frame("diagnostics.dbc", "TCMS_STATUS")
@dataclass(frozen=True, slots=True)
class TcmsStatus:
    load_kg: float
    """Passengers on the whole train, by the air springs."""
    cars: int


@frame("diagnostics.dbc", "TIME_OF_DAY")
@dataclass(frozen=True, slots=True)
class TimeOfDay:
    since_midnight_ms: float
    days_since_1984: int
