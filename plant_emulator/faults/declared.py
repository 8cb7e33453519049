"""Declares all kinds of faults by place. Importing this module fills the catalogue."""

from plant_emulator.faults import (  # noqa: F401
    declared_bus,
    declared_loops,
    declared_process,
    declared_train,
    declared_wayside,
    declared_wires,
)
