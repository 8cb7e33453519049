"""The board: time, rhythm, drivers and memory, shared by the controller and the plant."""

__version__ = "0.1.0"
