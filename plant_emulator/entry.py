"""Defines the console script `plant`."""

from firmware_py.program import TYPE_CHECKING, Program

if TYPE_CHECKING:
    from collections.abc import Callable


def _plant() -> "Callable[[], int]":
    from plant_emulator.cli import main

    return main


plant = Program("plant", _plant)
