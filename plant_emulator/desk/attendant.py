"""Who is at the desk of a run: a recording or a model of a driver; nobody needs neither."""

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
"""Is asked whenever the desk speaks: what it shows, and the instant."""


def attendant(
    driver: str | None, recording: DeskRecording | None, *, mode: CabMode, start_ns: int
) -> Attendant | None:
    """None for a desk that nobody touches.

    Args:
        mode: of the desk before the first line of a recording.
        start_ns: the instant that a recording counts from.
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
    """The name of a driver there is; raises SettingsError."""
    if name not in DRIVERS:
        raise SettingsError(f"driver: {name!r}: {nearest(name, list(DRIVERS))}")
    return name
