"""Radio messages between trains that command themselves, arbiters and wayside objects."""

import enum
from dataclasses import dataclass
from typing import Final, NamedTuple

from zenoh_config.messages import MAX_ADDRESS, SpeedRestriction

BROADCAST: Final = MAX_ADDRESS
"""Destination of messages to all receivers of an area."""
LAST_TRAIN: Final = 64_999
"""Highest address of a train; trains have the addresses 1..LAST_TRAIN."""
FIRST_ARBITER: Final = 65_001
LAST_ARBITER: Final = 65_099
"""Addresses of a line's arbiters. Interlocking, track sections and the line's centre use WAYSIDE,
0."""
SUPERVISION: Final = 65_100
"""Address of the supervision console; there may be several consoles, one after the other."""
TERM_MAX: Final = 2**48 - 1
"""Highest term. A hostile train that is elected again and again needs years to use them up."""
TERM_STEP_MAX: Final = 10_000
"""Greatest step from a term that an arbiter confirmed to a term that a train accepts.

A line does not use as many terms while a train is away. A train that was away for longer asks an
arbiter, whose answer confirms the present term.
"""
ARBITERS_MAX: Final = 5
"""Maximum number of arbiters of a line."""
ROSTER_MAX: Final = 128
"""Maximum number of trains in one area."""
SECTIONS_MAX: Final = 256
NO_TRAIN: Final = 0
"""Number in place of a train if there is none."""


@dataclass(frozen=True, slots=True)
class T2tMessage:
    """Common head of all messages."""

    source: int
    destination: int
    area: int
    term: int
    """Fencing token: the term of the sender's lease, or the highest term that it has seen in this
    area."""
    boot: int
    """Incarnation of the sender."""
    sequence: int
    """Strictly increasing within one incarnation of the sender, over all its messages."""
    stamp_ns: int
    """Sender's monotonic clock at sending. It has no meaning to others except as an echo."""


class LeaseKind(enum.IntEnum):
    ACQUIRE = 1
    RENEW = 2
    RELEASE = 3


@dataclass(frozen=True, slots=True)
class LeaseRequest(T2tMessage):
    """A train asks an arbiter for the command of an area under `term`: acquire, renew or
    release.
    """

    kind: LeaseKind
    nonce: int
    """Number that the answer echoes, so that answers to other attempts are ignored."""
    successor: int
    """In a renewal: the train that may acquire although this lease runs; 0 withdraws that."""
    less_ns: int = 0
    """Reduction of this grant against a whole lease. A holder that has received no answer for
    longer than usual requests only the remaining time."""
    arbiters: int = 1
    """Number of arbiters that the sender assumes. An arbiter that assumes another number does not
    answer, because majorities of different sets do not exclude each other."""
    lease_ms: int = 300
    """Duration of a whole lease that the sender assumes. An arbiter that assumes another one does
    not answer, because leases of different lengths do not exclude each other."""


class RosterEntry(NamedTuple):
    """One train of an area."""

    train: int
    rear_m: float
    """Place that the rear has passed, less the allowances, while the train does not reverse."""
    sieved: bool
    """Secondary detection has proven that no shadow train is next to it."""
    boot: int = 0
    """Incarnation of the train that this entry is about; another incarnation gains nothing from it.
    0: unknown."""
    stopped: bool = False
    """Supervision has ordered the train to stop; the next master holds it, too."""


class SignedGrant(NamedTuple):
    """The signature of an arbiter under its grant of the message's term to the holder."""

    arbiter: int
    end_ns: int
    """End of the lease by the holder's clock."""
    signature: bytes


@dataclass(frozen=True, slots=True)
class LeaseAnswer(T2tMessage):
    """An arbiter answers a train.

    `term` is the highest term that it has acknowledged in the area.
    """

    granted: bool
    nonce: int
    echo_ns: int
    """`stamp_ns` of the request: the lease counts from there by the holder's clock."""
    holder: int
    wait_ns: int
    """In a refusal: time until the blocking lease has expired at this arbiter."""
    roster_term: int
    roster_version: int
    roster: tuple[RosterEntry, ...]
    """Roster as last committed here, foremost train first, in track order."""
    grants: tuple[SignedGrant, ...] = ()
    """In a grant on a secured line: the arbiter's signature, which proves the term to trains."""


class Phase(enum.IntEnum):
    FENCING = 1
    """The lease is held but the roster is not yet committed under it: no authority is issued."""
    ISSUING = 2


@dataclass(frozen=True, slots=True)
class Heartbeat(T2tMessage):
    """The master announces the term to all.

    A train that receives it never obeys a lower one again.

    It also asks for the acknowledgement: every train answers a new term at once with a TrainReport.
    """

    phase: Phase
    standby: int
    roster_version: int
    grants: tuple[SignedGrant, ...] = ()
    """On a secured line: grants of a majority of arbiters, which prove the term."""


@dataclass(frozen=True, slots=True)
class TrainReport(T2tMessage):
    """A train reports to the master of an area.

    `term` is the highest term seen there, which it acknowledges.
    """

    localised: bool
    """False: all places in this report are void."""
    front_min_m: float
    front_max_m: float
    """The front coupler is in [front_min_m, front_max_m]."""
    rear_min_m: float
    """The rear coupler is not behind this place."""
    protected_m: float
    """The rear coupler will not stop behind this place, unless the train rolls or jogs back. For a
    moving train it is ahead of `rear_min_m`, but by no more than a jog."""
    speed_mps: float
    standstill: bool
    latent_m: float
    """Farthest place of the front under any outstanding authority of this area, in force or not,
    and under any braking from one that the train gave up."""
    held_end_m: float
    """End of the authority of this area that the train holds, but not beyond the rear of the train
    that it receives ahead. Without an authority it is the train's front."""
    easy_m: float
    """The train can still stop before this place with the service brake."""
    held_term: int
    """Term of the newest accepted authority of this area; the train never accepts one that is not
    newer."""
    held_sequence: int
    member: bool
    """The train holds an authority of this area, of any age; False while it applies."""
    behind: int
    """The train ahead of it in the area that it comes from, according to its authority there."""
    comes_from: int
    """The area whose authority it holds up to the border of this one; 0: none."""
    axles: int
    out_of_service: bool
    """The train must not become master or standby."""
    ready_nonce: int
    """Nonce of the planned switch that the train is ready for; 0: none."""
    echo_ns: int
    """`stamp_ns` of the newest heartbeat of this term that the train received; 0: none. By the
    master's clock, the report was sent after that instant."""


@dataclass(frozen=True, slots=True)
class AreaAuthority(T2tMessage):
    """The master authorises one train: its front must never pass `end_m`.

    It covers the metres of its area only. At the area's end, the authority of the next area
    continues it; without one it ends some metres before the border.
    """

    to_boot: int
    """Incarnation of the report that it answers."""
    echo_ns: int
    """`stamp_ns` of the answered report; it gives the age in the receiver's own clock."""
    end_m: float
    rear_m: float
    """The train may move back to this place."""
    behind: int
    """The next train ahead in this area; 0: none up to its end."""
    rank: int
    """Number of steps after the standby at which this train may apply for the lease when the master
    is silent."""
    restrictions: tuple[SpeedRestriction, ...]


class SyncEntry(NamedTuple):
    """Data that the standby needs of a train that may not communicate after the master is gone."""

    train: int
    rear_m: float
    end_m: float
    """Farthest end that the train may have been granted."""
    boot: int = 0
    """Incarnation, as in the roster."""


@dataclass(frozen=True, slots=True)
class StandbySync(T2tMessage):
    """The master informs its standby, before it sends the authorities described here."""

    roster_version: int
    entries: tuple[SyncEntry, ...]


@dataclass(frozen=True, slots=True)
class SyncAck(T2tMessage):
    """The standby acknowledges to the master."""

    synced: int
    """`sequence` of the newest StandbySync that it has stored."""


@dataclass(frozen=True, slots=True)
class RosterCommit(T2tMessage):
    """The master asks an arbiter to store this roster."""

    version: int
    roster: tuple[RosterEntry, ...]


@dataclass(frozen=True, slots=True)
class RosterAck(T2tMessage):
    """An arbiter confirms to the master that it stored the roster. `term` is that of the commit."""

    version: int


class SwitchKind(enum.IntEnum):
    PREPARE = 1
    READY = 2
    """Sent by the successor; other trains report it in their reports."""
    COMMIT = 3
    ABORT = 4
    RESIGN = 5
    """The master has returned its lease, and its standby must apply at once."""


@dataclass(frozen=True, slots=True)
class SwitchStep(T2tMessage):
    """One step of a planned switch of the master."""

    kind: SwitchKind
    nonce: int
    successor: int


class ClaimKind(enum.IntEnum):
    CLAIM = 1
    """Lock the object for passing."""
    RELEASE = 2
    """No train can pass the object any more: it may move or open."""


@dataclass(frozen=True, slots=True)
class ObjectClaim(T2tMessage):
    """A claim or release from the master to a switch, crossing or platform track."""

    number: int
    kind: ClaimKind
    nonce: int


class ObjectState(enum.IntEnum):
    FREE = 1
    """Not locked: no train may pass."""
    LOCKED = 2
    """Locked for passing until it is released."""
    FAILED = 3
    """The object does not know its own state: no train may pass, and it does not move."""


@dataclass(frozen=True, slots=True)
class ObjectStatus(T2tMessage):
    """A wayside object reports its state to the area.

    `term` is the highest that it has obeyed or seen.
    """

    number: int
    state: ObjectState
    claim_term: int
    """Term of the claim or release that it last carried out."""
    nonce: int
    """Nonce of that claim or release; a status with another nonce does not answer it."""
    release_wanted: bool
    """The object is requested to move or open as soon as no train can pass it."""


class SectionState(NamedTuple):
    section: int
    occupied: bool
    """Also true if the section is disturbed."""
    axles: int
    """Number of axles; 0 in an occupied section means that the count is not reliable."""


@dataclass(frozen=True, slots=True)
class TrackStatus(T2tMessage):
    """The wayside reports occupied sections and the restrictions of supervision to the master of an
    area.
    """

    echo_ns: int
    """`stamp_ns` of the newest heartbeat received from `destination`; all contents are younger."""
    sections: tuple[SectionState, ...]
    """All sections of the area."""
    restrictions: tuple[SpeedRestriction, ...]
    closed: tuple[SpeedRestriction, ...]
    """Closed stretches, which no authority enters. Their limit has no meaning."""


class OrderKind(enum.IntEnum):
    SWITCH_MASTER = 1
    OUT_OF_SERVICE = 2
    IN_SERVICE = 3
    STOP = 4
    """Remote emergency brake: the train's authority ends where it stands."""
    GO = 5


@dataclass(frozen=True, slots=True)
class LineOrder(T2tMessage):
    """An order of supervision to the master of an area; repeated until it takes effect."""

    kind: OrderKind
    train: int


class AdmissionState(enum.IntEnum):
    WAITS = 1
    """Another train must be admitted first, or a shadow train may be next to it."""
    COMMITTING = 2
    FULL = 3
    UNPLACED = 4
    """Its position contradicts what is known of the other trains."""


@dataclass(frozen=True, slots=True)
class Admission(T2tMessage):
    """The master tells a train that applies why it has no authority yet."""

    state: AdmissionState
    waits_for: int
    """The train that must be admitted first; 0: no particular one."""
