"""A train that commands an area: takes reports, keeps roster and objects, issues authorities."""

from typing import Final

from firmware_py.trackdb.areas import AreaMap, ObjectSite
from vobc.t2t.admission import Scene, Waiting, admitted, is_sieved, standing_of
from vobc.t2t.authority import (
    Counted,
    Course,
    Space,
    Seen,
    Stretch,
    Bar,
    end_of_authority_m,
    unexplained,
)
from vobc.t2t.guards import Freshness, MasterGuards, Promise, Reach
from vobc.t2t.lease import Lease
from vobc.t2t.objects import Objects
from vobc.t2t.roster import Order, Roster
from vobc.t2t.speaker import Speaker
from vobc.t2t.switch import PlannedSwitch, SwitchState
from vobc.t2t.table import UNBOUNDED_M, Record, TrainTable, cleared_to_m
from vobc.t2t.vocabulary import T2tConfig
from zenoh_config.t2t import (
    BROADCAST,
    NOBODY,
    WAYSIDE_ADDRESS,
    Admission,
    AreaAuthority,
    Heartbeat,
    LineOrder,
    ObjectClaim,
    ObjectStatus,
    OrderKind,
    Phase,
    RosterAck,
    RosterCommit,
    RosterEntry,
    StandbySync,
    SwitchKind,
    SwitchStep,
    SyncAck,
    SyncEntry,
    T2tMessage,
    TrackStatus,
    TrainReport,
)
from zenoh_config.timers import NS_PER_MS

APPLICANTS_MAX: Final = 64
SPEED_MAX_MPS: Final = 40.0
"""No train is faster; only bounds where one was when sections were seen."""
S_PER_NS: Final = 1e-9
