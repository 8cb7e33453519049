"""Track database: what both the controller and the world know of the line, by chainage."""

from firmware_py.trackdb.line_map import (
    CurveSection,
    GradientSection,
    LineMap,
    PlatformSide,
    SpeedSection,
    Station,
    TagKind,
    TagSite,
    load_line,
)

__all__ = [
    "CurveSection",
    "GradientSection",
    "LineMap",
    "PlatformSide",
    "SpeedSection",
    "Station",
    "TagKind",
    "TagSite",
    "load_line",
]
