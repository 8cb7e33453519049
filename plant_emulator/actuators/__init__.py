"""Actuators of the train: traction, brakes and doors.

Each reacts to its command and to a missing command.
"""
