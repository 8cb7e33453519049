"""Data types of train-to-train control on board: the inputs and outputs of one step."""

import enum
from dataclasses import dataclass
from typing import Final, NamedTuple

from zenoh_config.messages import SpeedRestriction
from zenoh_config.t2t import NO_TRAIN, T2tMessage
from zenoh_config.term_grants import GrantCheck
from zenoh_config.timers import TIMERS_A, LineTimers

NO_TERM: Final = 0


@dataclass(frozen=True, slots=True)
class T2tConfig:
    """Settings of one train for train-to-train control."""

    timers: LineTimers = TIMERS_A
    arbiters: tuple[int, ...] = (65_001,)
    """Addresses of the arbiters. A lease needs a majority of them."""
    rollback_m: float = 2.0
    """Upper bound of the distance that a train rolls back when its brakes are applied too late."""
    jog_m: float = 5.0
    """Greatest distance that supervision may allow a train to move back to correct a stop."""
    longest_authority_m: float = 3000.0
    """Greatest length of an authority ahead of the train's front. A longer one would only lock
    objects earlier than needed."""
    claim_ahead_m: float = 1200.0
    """Distance ahead of a train within which the master claims an object for it."""
    backoff_ms: int = 80
    """Shortest wait after a lost candidacy. The train waits between one and two of these periods;
    its seed decides how long."""
    overhang_m: float = 4.0
    """Greatest distance from the last axle to the coupler behind it. No axle counter detects this
    part."""
    grants: GrantCheck | None = None
    """Checks the signed grants of the arbiters on a secured line. None: a train believes the first
    sender of a term until an arbiter's answer shows another owner."""
    switch_ms: int = 1000
    """Least time after which the master gives up a planned switch that has not completed."""

    def __post_init__(self) -> None:
        if len(set(self.arbiters)) != len(self.arbiters) or len(self.arbiters) % 2 == 0:
            raise ValueError(f"arbiters {self.arbiters}: an odd number of different ones is needed")

    @property
    def majority(self) -> int:
        return len(self.arbiters) // 2 + 1

    @property
    def switch_limit_ms(self) -> int:
        """Time for a planned switch. It needs several messages each way, in a slow network more."""
        return max(self.switch_ms, 3 * self.timers.lease_ms)

    @property
    def behind_rear_m(self) -> float:
        """Track kept free behind the protected rear of the train ahead: rollback plus jog."""
        return self.rollback_m + self.jog_m

    @property
    def behind_axle_m(self) -> float:
        """Track kept free behind the last axle of a train that does not report."""
        return self.overhang_m + self.behind_rear_m


class OwnTrain(NamedTuple):
    """State of the train as its own controller knows it in this step."""

    localised: bool
    front_min_m: float
    front_max_m: float
    rear_min_m: float
    rests_m: float
    """Hindmost place where the rear can come to rest, however hard the train brakes. At standstill
    it equals rear_min_m."""
    speed_mps: float
    standstill: bool
    """Whether zero speed is proven."""
    reach_m: float
    """Farthest place that the front can reach if ATP commands the emergency brake now. It is at
    least front_max_m."""
    easy_m: float
    """Farthest place that the front can reach with the service brake. It is at least reach_m."""
    axles: int
    out_of_service: bool = False


class AreaMemory(NamedTuple):
    """Part of an area's state that the train must keep across restarts."""

    area: int
    seen_term: int = NO_TERM
    """Highest term that the train has received or held."""
    owner: int = NO_TRAIN
    """Address of the master that owns seen_term."""
    tried_term: int = NO_TERM
    """Highest term for which the train has ever applied."""


@dataclass(frozen=True, slots=True)
class TrainMemory:
    """The part of a train's state that survives power cuts."""

    boot: int = 0
    """Number of incarnations so far."""
    areas: tuple[AreaMemory, ...] = ()
    out_of_service: bool = False
    """Whether supervision has ordered the train out of service. It holds until supervision orders
    otherwise."""

    def of_area(self, area: int) -> AreaMemory:
        for each in self.areas:
            if each.area == area:
                return each
        return AreaMemory(area)

    def with_area(self, changed: AreaMemory) -> "TrainMemory":
        kept = [each for each in self.areas if each.area != changed.area]
        return TrainMemory(self.boot, tuple(sorted([*kept, changed])), self.out_of_service)


class HeldAuthority(NamedTuple):
    """The authority that the train may act on now. It combines the authorities of all areas
    concerned.
    """

    end_m: float
    rear_m: float
    echo_ns: int
    """Own time stamp of the report that the oldest authority in it answers. The age counts from
    there."""
    area: int
    """Area whose authority sets the end."""
    term: int
    sequence: int
    restrictions: tuple[SpeedRestriction, ...]


class TrainState(enum.Enum):
    """Relation of the train to the masters that command it."""

    LOST = "lost"
    """The train has lost its position. It reports only the term that it has acknowledged."""
    NON_COMMUNICATING = "non-communicating"
    """The train holds no authority, or the one that it holds is too old."""
    CONTROLLED = "controlled"
    CO_MANAGED = "co-managed"
    """The front has entered one area and the rear has not yet left the area before."""


class Role(enum.StrEnum):
    """Role of the train in one area."""

    OUTSIDE = "outside"
    """No part of the train is in the area, and the train does not apply."""
    APPLICANT = "applicant"
    MEMBER = "member"
    STANDBY = "standby"
    CANDIDATE = "candidate"
    """The train has asked the arbiters for the lease."""
    FENCING = "fencing"
    """The train has the lease, but a majority has not committed the roster under its term yet."""
    MASTER = "master"


@dataclass(frozen=True, slots=True)
class Stepped:
    """Result of one step of a train's core. The caller stores, applies and sends, in this order."""

    memory: TrainMemory | None
    """Memory that must be on disk before the caller acts on the rest. None: unchanged."""
    authority: HeldAuthority | None
    """Authority for ATP. The caller applies it before it sends `out`, because `out` acknowledges
    it."""
    out: tuple[T2tMessage, ...]
    state: TrainState = TrainState.LOST
    roles: tuple[tuple[int, Role], ...] = ()
    """Area and role, for each area that concerns the train."""
