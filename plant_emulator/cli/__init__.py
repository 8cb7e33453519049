"""`plant`: serves a train without a controller on a bus, a serial line and a radio."""

from plant_emulator.cli.command import main

__all__ = ["main"]
