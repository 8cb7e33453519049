"""Conversion between wire formats (frames, telegrams, radio messages) and the controller's data
types.
"""

from vobc.wire.evidence import SOURCE_IDS, SOURCE_KINDS, Evidence
from vobc.wire.frames import (
    analogue_frame,
    door_cars_frame,
    door_frame,
    emergency_message,
    event_frame,
    heartbeat,
    limit_frames,
    make_encoder,
    mode_frame,
    motion_frames,
    status_frame,
    target_frames,
    vital_frames,
)
from vobc.wire.inbox import RECEIVED_IDS, TACHO_SAMPLES_MAX, TAGS_MAX, Inbox
from vobc.wire.radio import RadioLink
from vobc.wire.refusals import Refusal, Refusals

__all__ = [
    "Evidence",
    "RECEIVED_IDS",
    "Inbox",
    "RadioLink",
    "Refusal",
    "Refusals",
    "SOURCE_IDS",
    "SOURCE_KINDS",
    "TACHO_SAMPLES_MAX",
    "TAGS_MAX",
    "analogue_frame",
    "door_cars_frame",
    "door_frame",
    "emergency_message",
    "event_frame",
    "heartbeat",
    "limit_frames",
    "make_encoder",
    "mode_frame",
    "motion_frames",
    "status_frame",
    "target_frames",
    "vital_frames",
]
