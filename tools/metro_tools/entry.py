"""The console script `vcan`."""

from firmware_py.program import TYPE_CHECKING, Program

if TYPE_CHECKING:
    from collections.abc import Callable


def _vcan() -> "Callable[[], int]":
    from metro_tools.vcan import main

    return main


vcan = Program("vcan", _vcan)
