"""The console scripts `vcan` and `vcan-guest`."""

from firmware_py.program import TYPE_CHECKING, Program

if TYPE_CHECKING:
    from collections.abc import Callable


def _vcan() -> "Callable[[], int]":
    from metro_tools.vcan import main

    return main


def _vcan_guest() -> "Callable[[], int]":
    from metro_tools.guest.cli import main

    return main


vcan = Program("vcan", _vcan)
vcan_guest = Program("vcan-guest", _vcan_guest)
