"""What trains that command themselves, arbiters and wayside objects tell each other by radio."""

import enum
from dataclasses import dataclass
from typing import Final, NamedTuple

from zenoh_config.messages import MAX_ADDRESS, SpeedRestriction

BROADCAST: Final = MAX_ADDRESS
"""Destination of what everybody in an area shall hear."""
LAST_TRAIN: Final = 64_999
"""Trains that take part have the addresses 1..LAST_TRAIN."""
FIRST_ARBITER: Final = 65_001
LAST_ARBITER: Final = 65_099
"""Arbiters of a line; interlocking, track sections and the line's centre speak as WAYSIDE, 0."""
SUPERVISION: Final = 65_100
"""Whoever sits at a desk of supervision; there may be several, one after the other."""
ROSTER_MAX: Final = 128
"""Trains in one area."""
SECTIONS_MAX: Final = 256
NOBODY: Final = 0
"""Where a train is named and there is none."""


@dataclass(frozen=True, slots=True)
class T2tMessage:
    """The head of all of them."""

    source: int
    destination: int
    area: int
    term: int
    """Fencing token: of the sender's lease, or the highest that it has seen in this area."""
    boot: int
    """Incarnation of the sender."""
    sequence: int
    """Strictly increasing within one incarnation of the sender, over everything that it says."""
    stamp_ns: int
    """Sender's monotonic clock at sending; to others no time, only something to echo."""


class LeaseKind(enum.IntEnum):
    ACQUIRE = 1
    RENEW = 2
    RELEASE = 3


@dataclass(frozen=True, slots=True)
class LeaseRequest(T2tMessage):
    """A train to an arbiter: let me command this area under `term`, still, or no more."""

    kind: LeaseKind
    nonce: int
    """Comes back in the answer, so that an answer to another attempt is none to this one."""
    successor: int
    """In a renewal: who may acquire although this lease runs; NOBODY takes that back."""
    less_ns: int = 0
    """The grant of this request lasts so much less than a whole lease: a holder that has heard no
    answer for longer than usual asks for no more than that."""
    arbiters: int = 1
    """How many there are, and"""
    lease_ms: int = 300
    """how long a whole lease is, as the sender believes. An arbiter that believes otherwise says
    nothing: majorities of different sets, and leases of different lengths, exclude nobody."""


class RosterEntry(NamedTuple):
    """One train of an area."""

    train: int
    rear_m: float
    """Its rear is not behind this, for as long as it does not reverse; less the allowances."""
    sieved: bool
    """Secondary detection has shown that no other train hides near it."""
    boot: int = 0
    """The incarnation of the train that this is about; another gets nothing by it. 0: unknown."""
    stopped: bool = False
    """Supervision has ordered it to stop; whoever commands next holds it, too."""


@dataclass(frozen=True, slots=True)
class LeaseAnswer(T2tMessage):
    """An arbiter to a train. `term` is the highest term that it has promised in the area."""

    granted: bool
    nonce: int
    echo_ns: int
    """`stamp_ns` of the request: the lease is counted from there by the holder's clock."""
    holder: int
    wait_ns: int
    """With a refusal: so long until the lease that stands in the way has run out here."""
    roster_term: int
    roster_version: int
    roster: tuple[RosterEntry, ...]
    """As last committed here, foremost train first; the order is that on the track."""


class Phase(enum.IntEnum):
    FENCING = 1
    """The lease is held, the roster not yet committed under it: no authority is issued."""
    ISSUING = 2


@dataclass(frozen=True, slots=True)
class Heartbeat(T2tMessage):
    """The master to all: this is the term. Whoever hears it obeys no lower one ever after.

    It asks for the promise, too: every train answers a new term at once with a TrainReport.
    """

    phase: Phase
    standby: int
    roster_version: int


@dataclass(frozen=True, slots=True)
class TrainReport(T2tMessage):
    """A train to the master of an area; `term` is the highest it has seen there: its promise."""

    localised: bool
    """False: all places in this report are void."""
    front_min_m: float
    front_max_m: float
    """The front coupler stands in [front_min_m, front_max_m]."""
    rear_min_m: float
    """The rear coupler stands nowhere behind this."""
    protected_m: float
    """And comes to rest nowhere behind this, unless it rolls or jogs back then: in front of
    `rear_min_m` for a train that moves, but by no more than a jog."""
    speed_mps: float
    standstill: bool
    latent_m: float
    """No authority of this area that the train holds, in force or not, and no braking from one
    that it gave up, takes its front beyond this."""
    held_end_m: float
    """End of the authority of this area that it holds; while it holds none, its front."""
    easy_m: float
    """With the service brake it can still stop before this."""
    held_term: int
    """Of the newest authority of this area that it took; what is not newer it never takes."""
    held_sequence: int
    member: bool
    """It holds an authority of this area, of whatever age; False while it applies."""
    behind: int
    """Who is ahead of it in the area that it comes from, as its authority there says."""
    comes_from: int
    """The area whose authority it holds up to the border of this one; 0: none."""
    axles: int
    out_of_service: bool
    """It must not become master or standby."""
    ready_nonce: int
    """Of the planned switch that it is ready for; 0: none."""
    echo_ns: int
    """`stamp_ns` of the newest heartbeat of this term that it has heard: by the master's clock, it
    was not sent before that; 0: it has heard none."""


@dataclass(frozen=True, slots=True)
class AreaAuthority(T2tMessage):
    """The master to one train: the front must never pass `end_m`.

    It covers the metres of its area only. Where it reaches the area's end, the authority of the
    area that follows says how much farther; without one it ends some metres before the border.
    """

    to_boot: int
    """Incarnation that it answers."""
    echo_ns: int
    """`stamp_ns` of the report that it answers: its age in the receiver's own clock."""
    end_m: float
    rear_m: float
    """The train may move back to here."""
    behind: int
    """The next train ahead in this area; NOBODY: none up to its end."""
    rank: int
    """When the master falls silent, so many steps later than the standby may this train apply."""
    restrictions: tuple[SpeedRestriction, ...]


class SyncEntry(NamedTuple):
    """What the standby has to know of a train that might say nothing after the master is gone."""

    train: int
    rear_m: float
    end_m: float
    """The farthest that it may have been granted."""
    boot: int = 0
    """As in the roster."""


@dataclass(frozen=True, slots=True)
class StandbySync(T2tMessage):
    """The master to its standby, before the authorities that it describes are sent."""

    roster_version: int
    entries: tuple[SyncEntry, ...]


@dataclass(frozen=True, slots=True)
class SyncAck(T2tMessage):
    """The standby to the master."""

    synced: int
    """`sequence` of the newest StandbySync that it has taken in."""


@dataclass(frozen=True, slots=True)
class RosterCommit(T2tMessage):
    """The master to an arbiter: keep this roster."""

    version: int
    roster: tuple[RosterEntry, ...]


@dataclass(frozen=True, slots=True)
class RosterAck(T2tMessage):
    """An arbiter to the master: it is kept. `term` is that under which it was committed."""

    version: int


class SwitchKind(enum.IntEnum):
    PREPARE = 1
    READY = 2
    """By the successor; other trains say it in their reports."""
    COMMIT = 3
    ABORT = 4
    RESIGN = 5
    """The master has given its lease back, and its standby shall apply at once."""


@dataclass(frozen=True, slots=True)
class SwitchStep(T2tMessage):
    """One step of a planned switch of the master."""

    kind: SwitchKind
    nonce: int
    successor: int


class ClaimKind(enum.IntEnum):
    CLAIM = 1
    """Lock it for passing."""
    RELEASE = 2
    """No train can pass it any more: it may move or open."""


@dataclass(frozen=True, slots=True)
class ObjectClaim(T2tMessage):
    """The master to a switch, crossing or platform track."""

    number: int
    kind: ClaimKind
    nonce: int


class ObjectState(enum.IntEnum):
    FREE = 1
    """Not locked: no train may pass."""
    LOCKED = 2
    """Locked for passing until it is released."""
    FAILED = 3
    """It does not know its own state: no train may pass, and it does not move."""


@dataclass(frozen=True, slots=True)
class ObjectStatus(T2tMessage):
    """A wayside object to the area; `term` is the highest that it has obeyed or seen."""

    number: int
    state: ObjectState
    claim_term: int
    """Term of the claim or release that it last carried out."""
    nonce: int
    """Of that claim or release: a status that shows another is no answer to it."""
    release_wanted: bool
    """It is asked to move or to open as soon as no train can pass it."""


class SectionState(NamedTuple):
    section: int
    occupied: bool
    """True also when it is disturbed."""
    axles: int
    """0 of an occupied one: its count is not to be trusted."""


@dataclass(frozen=True, slots=True)
class TrackStatus(T2tMessage):
    """The wayside to the master of an area: occupied sections and what supervision decreed."""

    echo_ns: int
    """`stamp_ns` of the newest heartbeat heard of `destination`: all said here is younger."""
    sections: tuple[SectionState, ...]
    """All of the area."""
    restrictions: tuple[SpeedRestriction, ...]
    closed: tuple[SpeedRestriction, ...]
    """Closed stretches: no authority enters them. The limit means nothing."""


class OrderKind(enum.IntEnum):
    SWITCH_MASTER = 1
    OUT_OF_SERVICE = 2
    IN_SERVICE = 3
    STOP = 4
    """Remote emergency brake: the train's authority ends where it stands."""
    GO = 5


@dataclass(frozen=True, slots=True)
class LineOrder(T2tMessage):
    """Supervision to the master of an area; repeated until it shows."""

    kind: OrderKind
    train: int


class AdmissionState(enum.IntEnum):
    WAITS = 1
    """Another train has to come first, or something hides where it stands."""
    COMMITTING = 2
    FULL = 3
    UNPLACED = 4
    """Where it is contradicts what is known of the others."""


@dataclass(frozen=True, slots=True)
class Admission(T2tMessage):
    """The master to a train that applies and has no authority yet: why not."""

    state: AdmissionState
    waits_for: int
    """The train that has to come first; NOBODY: none in particular."""
