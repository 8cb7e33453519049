"""The nouns of train-to-train control on board: what goes into a step and what comes out of it."""

import enum
from dataclasses import dataclass
from typing import Final, NamedTuple

from zenoh_config.messages import SpeedRestriction
from zenoh_config.t2t import NOBODY, T2tMessage
from zenoh_config.timers import TIMERS_A, LineTimers

NO_TERM: Final = 0


@dataclass(frozen=True, slots=True)
class T2tConfig:
    """What one train believes of trains that command themselves."""

    timers: LineTimers = TIMERS_A
    arbiters: tuple[int, ...] = (65_001,)
    """Their addresses; a lease needs the majority of them."""
    rollback_m: float = 2.0
    """A train whose brakes are applied too late rolls back less than this."""
    jog_m: float = 5.0
    """A train may be allowed to move back so far to correct a stop."""
    longest_authority_m: float = 3000.0
    """Beyond its front; longer ones would only bind objects early."""
    claim_ahead_m: float = 1200.0
    """An object so near ahead of a train is claimed for it."""
    backoff_ms: int = 80
    """After a lost candidacy a train waits between one and two of these, drawn from its seed."""
    overhang_m: float = 4.0
    """From the last axle to the coupler behind it, at most: no counter sees what is beyond."""
    switch_ms: int = 1000
    """A planned switch that is not through by then is given up."""

    def __post_init__(self) -> None:
        if len(set(self.arbiters)) != len(self.arbiters) or len(self.arbiters) % 2 == 0:
            raise ValueError(f"arbiters {self.arbiters}: an odd number of different ones is needed")

    @property
    def majority(self) -> int:
        return len(self.arbiters) // 2 + 1

    @property
    def behind_rear_m(self) -> float:
        """No authority of a train behind comes nearer to the protected rear of the one ahead."""
        return self.rollback_m + self.jog_m

    @property
    def behind_axle_m(self) -> float:
        """No train comes nearer to the last axle of one that says nothing."""
        return self.overhang_m + self.behind_rear_m


class OwnTrain(NamedTuple):
    """What the train's own controller knows in this step."""

    localised: bool
    front_min_m: float
    front_max_m: float
    rear_min_m: float
    rests_m: float
    """The rear comes to rest nowhere behind this, however hard it is braked; at standstill
    rear_min_m."""
    speed_mps: float
    standstill: bool
    """Zero speed is proven."""
    reach_m: float
    """The front gets no farther if the emergency brake is commanded now; at least front_max_m."""
    easy_m: float
    """The front gets no farther with the service brake; at least reach_m."""
    axles: int
    out_of_service: bool = False


class AreaMemory(NamedTuple):
    """What a train must never forget of one area."""

    area: int
    seen_term: int = NO_TERM
    """Highest heard or held."""
    owner: int = NOBODY
    """Whose term that is."""
    tried_term: int = NO_TERM
    """Highest ever applied for."""


@dataclass(frozen=True, slots=True)
class TrainMemory:
    """The part of a train's state that survives power cuts."""

    boot: int = 0
    """Incarnations so far."""
    areas: tuple[AreaMemory, ...] = ()
    out_of_service: bool = False
    """By order of supervision, until it says otherwise."""

    def of_area(self, area: int) -> AreaMemory:
        for each in self.areas:
            if each.area == area:
                return each
        return AreaMemory(area)

    def with_area(self, changed: AreaMemory) -> "TrainMemory":
        kept = [each for each in self.areas if each.area != changed.area]
        return TrainMemory(self.boot, tuple(sorted([*kept, changed])), self.out_of_service)


class HeldAuthority(NamedTuple):
    """What the train may act on now, put together from the areas that have a say."""

    end_m: float
    rear_m: float
    echo_ns: int
    """Own stamp that the oldest authority in it answers: its age is counted from there."""
    area: int
    """That sets the end."""
    term: int
    sequence: int
    restrictions: tuple[SpeedRestriction, ...]


class TrainState(enum.Enum):
    """How the train stands to those who command it."""

    LOST = "lost"
    """It does not know where it is: it reports nothing but its promise."""
    NON_COMMUNICATING = "non-communicating"
    """It holds no authority that is young enough."""
    CONTROLLED = "controlled"
    CO_MANAGED = "co-managed"
    """Between its front's entry into one area and its rear's exit from another."""


class Role(enum.StrEnum):
    """What the train is in one area."""

    OUTSIDE = "outside"
    """Nothing of it is there, and it does not apply."""
    APPLICANT = "applicant"
    MEMBER = "member"
    STANDBY = "standby"
    CANDIDATE = "candidate"
    """It has asked the arbiters for the lease."""
    FENCING = "fencing"
    """It has the lease; the roster is not committed under its term yet."""
    MASTER = "master"


@dataclass(frozen=True, slots=True)
class Stepped:
    """What a step of a train's core comes to. Do it in this order: store, apply, send."""

    memory: TrainMemory | None
    """To be on the disk before anything else of this is done; None: as it was."""
    authority: HeldAuthority | None
    """For the train's protection, before anything is sent: what goes out acknowledges it."""
    out: tuple[T2tMessage, ...]
    state: TrainState = TrainState.LOST
    roles: tuple[tuple[int, Role], ...] = ()
    """By area, of those that the train has to do with."""
