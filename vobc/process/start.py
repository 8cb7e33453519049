"""Assumed place of the train when its controller starts."""

import math

from firmware_py.storage.nvram import NvramRecord
from firmware_py.trackdb import LineMap
from vobc.config import VobcConfig
from vobc.process.identity import identity_of
from vobc.vocabulary import Mission, OdometryRecord, PlaceProof


def commissioned_start(
    config: VobcConfig, line: LineMap, mission: Mission, record: NvramRecord
) -> OdometryRecord:
    """The train was set up at the stopping point where its mission starts."""
    return OdometryRecord(
        front_m=mission.start.stop_m,
        bound_m=config.odometry.start_bound_m,
        m_per_pulse=_stored_m_per_pulse(config, line, record),
    )


def remembered_start(
    config: VobcConfig, line: LineMap, record: NvramRecord
) -> OdometryRecord | None:
    """Place where the train was switched off, if it stood and knew its place.

    A place of another line, survey, train or version is none here. The train may have been moved
    since. The place counts only once the cold-movement detector reports a small distance, which
    widens the interval.
    """
    own = identity_of(config, line).own(record)
    if own.front_m is None or not own.standing:
        return None
    return OdometryRecord(
        front_m=own.front_m,
        bound_m=config.odometry.cold_movement_m,
        m_per_pulse=_stored_m_per_pulse(config, line, own),
        proof=PlaceProof.REMEMBERED,
    )


def unknown_start(config: VobcConfig, line: LineMap, record: NvramRecord) -> OdometryRecord:
    """Nothing tells where the train stands, so it may be anywhere on its line."""
    return OdometryRecord(
        front_m=(line.start_m + line.end_m) / 2.0,
        bound_m=(line.end_m - line.start_m) / 2.0,
        m_per_pulse=_stored_m_per_pulse(config, line, record),
        proof=PlaceProof.UNKNOWN,
    )


def _stored_m_per_pulse(config: VobcConfig, line: LineMap, record: NvramRecord) -> float:
    """Scale of the last calibration. It is the best guess, and tags have to confirm it."""
    own = identity_of(config, line).own(record)
    wheel_m = own.wheel_diameter_m or config.train.wheel_diameter_m
    return math.pi * wheel_m / config.train.pulses_per_turn
