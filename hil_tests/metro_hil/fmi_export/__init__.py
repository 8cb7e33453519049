"""Exports the shipped train and controller as FMUs of FMI 3.0 with CAN by FMI-LS-BUS 1.0."""
