"""Odometry: place and speed of the train from tacho pulses, radar, accelerometer and tags."""

from vobc.odometry.config import OdometryConfig
from vobc.odometry.odometer import Odometry

__all__ = ["Odometry", "OdometryConfig"]
