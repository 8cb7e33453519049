"""Faults that the bench applies to the bus, to frames and to the controller's process."""
