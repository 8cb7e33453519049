"""The cycle log: one row for each control cycle."""

import math
from typing import Final, Protocol

from can_dbc.vobc import Missing
from vobc.vocabulary import CycleOutput

CYCLE_COLUMNS: Final = (
    "t_s",
    "front_low_m",
    "front_m",
    "front_high_m",
    "speed_mps",
    "speed_high_mps",
    "accel_mps2",
    "demand_mps2",
    "target_mps",
    "permitted_mps",
    "warning_mps",
    "service_mps",
    "emergency_mps",
    "distance_to_stop_m",
    "distance_to_authority_m",
    "mode",
    "supervision",
    "phase",
    "missing",
    "cause",
    "force_n",
    "decel_mps2",
    "emergency_released",
    "holding_released",
    "doors_enabled",
    "tags",
    "slip",
    "work_us",
    "lateness_us",
    "slips",
)
"""Columns of the cycle log. A value that is unknown in a cycle is an empty field."""


class CycleLog(Protocol):
    """Receives one value for each of CYCLE_COLUMNS."""

    def row(self, *values: object) -> None: ...


def cycle_row(
    t_s: float, output: CycleOutput, *, work_us: float, lateness_us: float, slips: int
) -> tuple[object, ...]:
    """One value for each of CYCLE_COLUMNS."""
    return (
        t_s,
        *_motion_fields(output),
        output.accel_demand_mps2,
        output.target_mps,
        *_ceiling_fields(output),
        output.mode,
        output.supervision,
        output.ato_phase,
        _missing_words(output.missing),
        output.cause,
        output.force_n,
        output.service_decel_mps2,
        output.emergency_released,
        output.holding_released,
        output.enable_left or output.enable_right,
        *_tag_fields(output),
        work_us,
        lateness_us,
        slips,
    )


def _missing_words(missing: Missing) -> str:
    return missing.name or "" if missing else ""


def _motion_fields(output: CycleOutput) -> tuple[object, ...]:
    motion = output.motion
    if motion is None:
        return (None,) * 6
    front, speed = motion.front_m, motion.speed_mps
    return front.low, front.best, front.high, speed.best, speed.high, motion.accel_mps2


def _ceiling_fields(output: CycleOutput) -> tuple[object, ...]:
    to_stop_m = output.distance_to_stop_m if math.isfinite(output.distance_to_stop_m) else None
    ceiling = output.ceiling
    if ceiling is None:
        return None, None, None, None, to_stop_m, None
    return (
        ceiling.permitted_mps,
        ceiling.warning_mps,
        ceiling.service_mps,
        ceiling.emergency_mps,
        to_stop_m,
        ceiling.distance_to_authority_m,
    )


def _tag_fields(output: CycleOutput) -> tuple[object, ...]:
    motion = output.motion
    if motion is None:
        return "", False
    return " ".join(str(tag_id) for tag_id in motion.accepted_tag_ids), motion.slip
