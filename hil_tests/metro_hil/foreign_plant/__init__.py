"""A train in another program, driven in lockstep: a command, or an FMU by way of its host.

`docs/reference/plant_interface.md` describes the messages between bench and program.
"""
