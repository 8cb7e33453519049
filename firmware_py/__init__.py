"""The board: time, scheduling, drivers and storage, shared by the controller and the plant."""

__version__ = "0.3.0"
