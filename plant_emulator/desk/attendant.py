"""Chooses the operator of the desk in a run: a recording, a driver model, or none."""

from collections.abc import Callable
from typing import Final

from can_dbc.cab import CabMode, Desk
from firmware_py.settings import SettingsError, nearest
from plant_emulator.desk.display import DeskDisplay
from plant_emulator.desk.drivers import DRIVERS
from plant_emulator.desk.hands import unattended
from plant_emulator.desk.recording import DeskRecording

NS_PER_S: Final = 1_000_000_000

Attendant = Callable[[DeskDisplay, int], Desk]
"""Returns the desk frame to send, from the display and the present instant."""


def attendant(
    driver: str | None, recording: DeskRecording | None, *, mode: CabMode, start_ns: int
) -> Attendant | None:
    """Return the operator of the desk, or None for an unattended desk.

    Args:
        mode: mode of the desk before the first line of a recording.
        start_ns: the instant from which a recording counts.
    """
    if driver is not None:
        return DRIVERS[driver]().drive
    if recording is None:
        return None
    played, before = recording, unattended(mode)

    def play(display: DeskDisplay, now_ns: int) -> Desk:
        return played.at((now_ns - start_ns) / NS_PER_S, before)

    return play


def check_driver(name: str) -> str:
    """Return the name of a known driver model; raises SettingsError for any other name."""
    if name not in DRIVERS:
        raise SettingsError(f"driver: {name!r}: {nearest(name, list(DRIVERS))}")
    return name
