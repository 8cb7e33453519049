"""Track database: the data of the line, by chainage, that controller and world share."""

from firmware_py.trackdb.circuit import load_line
from firmware_py.trackdb.line_map import LineMap
from firmware_py.trackdb.sites import (
    CurveSection,
    GradientSection,
    LineZone,
    PlatformSide,
    SpeedSection,
    Station,
    StoppingPoint,
    TagKind,
    TagSite,
    TunnelSection,
)

__all__ = [
    "CurveSection",
    "GradientSection",
    "LineMap",
    "LineZone",
    "PlatformSide",
    "SpeedSection",
    "Station",
    "StoppingPoint",
    "TagKind",
    "TagSite",
    "TunnelSection",
    "load_line",
]
