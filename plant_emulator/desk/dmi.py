"""The desk's speed display after the ETCS driver-machine interface: dial, target, status colour."""

import enum
import math
from typing import Final

from can_dbc.vobc import (
    Intervention,
    TargetKind,
    VobcLimits,
    VobcMotion,
    VobcSupervision,
)

KMH_PER_MPS: Final = 3.6
DIAL: Final = 56
"""Cells of the dial."""
TOP_KMH: Final = 80.0
"""Least end of the dial. A higher emergency limit moves it by whole steps."""
STEP_KMH: Final = 20.0
TARGET_BAR: Final = 20
"""Cells of the target bar."""
FAR_M: Final = 1000.0
"""Target distance that fills the bar, as in ETCS, m."""
NEAR_M: Final = 25.0
"""Distance below which the logarithmic scale of the target bar is nearly linear, m."""
INDICATION_MPS: Final = 2.0
"""Distance of the speed from a permitted speed that a target lowers, below which the driver should
act, m/s."""
STANDING_MPS: Final = 0.1
NOTHING: Final = "--"
TARGET_NAMES: Final = {
    TargetKind.LINE_LIMIT: "line limit",
    TargetKind.RESTRICTION: "restriction",
    TargetKind.END: "end of authority",
}


class StatusColour(enum.Enum):
    """Colour of the speed, with its meaning on the screen."""

    GREY = "grey", "no target lowers the permitted speed"
    WHITE = "white", "a target lowers the permitted speed"
    YELLOW = "yellow", "slow down for the target"
    ORANGE = "orange", "over the permitted speed"
    RED = "red", "protection brakes"

    def __init__(self, shown: str, meaning: str) -> None:
        self.shown = shown
        self.meaning = meaning


def colour_of(motion: VobcMotion, told: VobcSupervision) -> StatusColour:
    """The status colour."""
    speed_mps = abs(motion.speed_mps)
    if told.intervention in (Intervention.SERVICE_BRAKE, Intervention.EMERGENCY_BRAKE):
        return StatusColour.RED
    over = speed_mps > max(motion.ceiling_mps, STANDING_MPS)
    if over or told.intervention is Intervention.WARNING:
        return StatusColour.ORANGE
    if told.target_kind is TargetKind.NONE or speed_mps <= max(told.target_mps, STANDING_MPS):
        return StatusColour.GREY
    near = motion.ceiling_mps - speed_mps < INDICATION_MPS
    return StatusColour.YELLOW if near else StatusColour.WHITE


def dial(motion: VobcMotion, limits: VobcLimits | None, told: VobcSupervision | None) -> str:
    """The speed as a bar, with a letter at each limit and its end in km/h.

    Where letters share a cell, the lower limit is shown.
    """
    emergency_kmh = KMH_PER_MPS * motion.emergency_mps
    top_kmh = max(TOP_KMH, STEP_KMH * math.ceil(emergency_kmh / STEP_KMH))
    filled = _cell(abs(motion.speed_mps), top_kmh)
    cells = list("#" * filled + "." * (DIAL - filled))
    marks = [("E", motion.emergency_mps)]
    if limits is not None:
        marks += [("S", limits.service_mps), ("W", limits.warning_mps)]
    marks.append(("P", motion.ceiling_mps))
    if told is not None and told.target_kind is not TargetKind.NONE:
        marks.append(("T", told.target_mps))
    for letter, speed_mps in marks:
        cells[min(DIAL - 1, _cell(speed_mps, top_kmh))] = letter
    return f"[{''.join(cells)}] {top_kmh:.0f}"


def _cell(speed_mps: float, top_kmh: float) -> int:
    return round(DIAL * max(0.0, min(1.0, KMH_PER_MPS * speed_mps / top_kmh)))


def limits_text(motion: VobcMotion, limits: VobcLimits | None) -> str:
    """The four limits in km/h, the lowest first."""
    warning, service = NOTHING, NOTHING
    if limits is not None:
        warning, service = _kmh(limits.warning_mps), _kmh(limits.service_mps)
    return (
        f"permitted {_kmh(motion.ceiling_mps)}  warning {warning}  service {service}"
        f"  emergency {_kmh(motion.emergency_mps)}"
    )


def _kmh(speed_mps: float) -> str:
    return f"{KMH_PER_MPS * speed_mps:.1f}"


def target_text(told: VobcSupervision) -> str:
    """The most restrictive target with its distance as a bar, which empties towards the target."""
    name = TARGET_NAMES.get(told.target_kind)
    if name is None:
        return "none"
    share_ratio = math.log1p(max(0.0, told.target_distance_m) / NEAR_M) / math.log1p(FAR_M / NEAR_M)
    filled = round(TARGET_BAR * min(1.0, share_ratio))
    text = f"{_kmh(told.target_mps)} km/h in {told.target_distance_m:.0f} m, {name}"
    return f"{text:42} [{'#' * filled}{'.' * (TARGET_BAR - filled)}]"


def intervention_text(told: VobcSupervision) -> str:
    """What protection does, and why."""
    if told.intervention is Intervention.NONE:
        return "nothing"
    return f"{_as_text(told.intervention.name)}: {_as_text(told.reason.name)}"


def _as_text(name: str) -> str:
    return name.lower().replace("_", " ")
