"""Odometry: where the train is and how fast it runs, from pulses, radar and tags."""

from vobc.odometry.config import OdometryConfig
from vobc.odometry.odometer import Odometry

__all__ = ["Odometry", "OdometryConfig"]
