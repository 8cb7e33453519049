"""Every kind of message among trains that command themselves, in the order of its type number."""

from typing import Final

from zenoh_config.t2t import (
    Admission,
    AreaAuthority,
    Heartbeat,
    LeaseAnswer,
    LeaseRequest,
    LineOrder,
    ObjectClaim,
    ObjectStatus,
    RosterAck,
    RosterCommit,
    StandbySync,
    SwitchStep,
    SyncAck,
    T2tMessage,
    TrackStatus,
    TrainReport,
)
from zenoh_config.t2t_supervision import Decree, LineState, Removal, RemovalAnswer

T2T_TYPES: Final[tuple[type[T2tMessage], ...]] = (
    LeaseRequest,
    LeaseAnswer,
    Heartbeat,
    TrainReport,
    AreaAuthority,
    StandbySync,
    SyncAck,
    RosterCommit,
    RosterAck,
    SwitchStep,
    ObjectClaim,
    ObjectStatus,
    TrackStatus,
    LineOrder,
    Admission,
    Decree,
    LineState,
    Removal,
    RemovalAnswer,
)
"""All kinds in the order of their type numbers; additions go to the end."""
