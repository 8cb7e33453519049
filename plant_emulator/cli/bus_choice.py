"""Chooses the bus for `auto`."""

from firmware_py.buses import BusError, resolve_auto
from plant_emulator.cli.options import AUTO


def chosen_bus(wanted: str) -> str:
    """Return the bus specification. Raises BusError if there is no bus."""
    if wanted != AUTO:
        return wanted
    choice = resolve_auto()
    if choice.spec is None:
        raise BusError(f"no bus: {choice.reason}; `vcan up` makes one")
    return choice.spec
