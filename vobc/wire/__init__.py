"""Frames, telegrams and radio messages to the nouns of the controller, and back."""

from vobc.wire.frames import (
    door_frame,
    emergency_message,
    heartbeat,
    make_encoder,
    mode_frame,
    motion_frames,
    status_frame,
    target_frames,
    vital_frames,
)
from vobc.wire.inbox import HEARD_IDS, TACHO_SAMPLES_MAX, TAGS_MAX, Inbox
from vobc.wire.radio import RadioLink

__all__ = [
    "HEARD_IDS",
    "Inbox",
    "RadioLink",
    "TACHO_SAMPLES_MAX",
    "TAGS_MAX",
    "door_frame",
    "emergency_message",
    "heartbeat",
    "make_encoder",
    "mode_frame",
    "motion_frames",
    "status_frame",
    "target_frames",
    "vital_frames",
]
