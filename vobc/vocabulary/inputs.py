"""What the controller is told: its train, its mission, and the image of one cycle."""

import enum
import math
from dataclasses import dataclass
from typing import Final

from can_dbc.alarms import TrainAlarms
from can_dbc.brake import BrakeStatus
from can_dbc.cab import Desk
from can_dbc.diagnostics import TcmsStatus
from can_dbc.doors import DoorStatus
from can_dbc.energy import LineSupply
from can_dbc.odometer import ColdMovement, Doppler, Imu, Tacho
from can_dbc.tags import TagReaderHealth
from can_dbc.traction import TractionStatus
from firmware_py.trackdb import Station

NEVER_S: Final = math.inf
"""Age of something that was never heard."""


@dataclass(frozen=True, slots=True)
class TrainBelief:
    """What the controller believes of its own train. What the train really is, the plant knows."""

    length_m: float
    tare_kg: float
    full_load_kg: float
    """Passengers at most; assumed until the train has weighed them."""
    rotating_mass_ratio: float
    """Share of the tare mass that rotating parts add to its inertia."""
    antenna_offset_m: float
    """From the front coupler back to the centre of the tag antenna."""
    wheel_diameter_m: float
    pulses_per_turn: int
    rated_force_n: float
    """Tractive effort at the rail, whole consist, below the power limit."""
    rated_power_w: float
    service_decel_max_mps2: float
    """Largest demand that the service brake follows."""

    def __post_init__(self) -> None:
        for name in _POSITIVE_OF_TRAIN:
            if getattr(self, name) <= 0:
                raise ValueError(f"{name} {getattr(self, name)} is not positive")
        for name in ("full_load_kg", "rotating_mass_ratio", "antenna_offset_m"):
            if getattr(self, name) < 0:
                raise ValueError(f"{name} {getattr(self, name)} is negative")

    @property
    def nominal_m_per_pulse(self) -> float:
        return math.pi * self.wheel_diameter_m / self.pulses_per_turn


_POSITIVE_OF_TRAIN: Final = (
    "length_m",
    "tare_kg",
    "wheel_diameter_m",
    "pulses_per_turn",
    "rated_force_n",
    "rated_power_w",
    "service_decel_max_mps2",
)


@dataclass(frozen=True, slots=True)
class Mission:
    """Where the train starts and where it shall stop, in running order."""

    start: Station
    stops: tuple[Station, ...]


class PlaceProof(enum.Enum):
    """How a controller that starts comes to know its place."""

    SET_UP = "people set the train up there"
    REMEMBERED = "stood there when it was switched off"
    """True once the detector of cold movement bears it out."""
    UNKNOWN = "nobody knows"
    """Found again by two references."""


@dataclass(frozen=True, slots=True)
class OdometryRecord:
    """What odometry wants to find again after a power cycle."""

    front_m: float
    bound_m: float
    """The front stands within front_m ± bound_m."""
    m_per_pulse: float
    """Best estimate of the distance behind one pulse; a prior only, its bounds are earned again."""
    proof: PlaceProof = PlaceProof.SET_UP


@dataclass(frozen=True, slots=True)
class TachoSample:
    """One tacho frame and its age at the instant of the cycle."""

    frame: Tacho
    age_s: float


@dataclass(frozen=True, slots=True)
class TagReading:
    """One tag as the reader reported it; nothing about its truth is decided yet."""

    tag_id: int
    pulses: int
    """Counter of tacho A when the antenna was over the tag's centre, modulo 65536."""
    age_s: float
    """Since the antenna was over the centre, by the reader's clock at sending plus line time."""


@dataclass(frozen=True, slots=True)
class Authority:
    """A movement authority as it was accepted: checked for address, term and sequence."""

    end_m: float
    """Chainage that the front must never pass."""
    term: int
    sequence: int
    rear_m: float | None = None
    """The rear is protected back to here; None: the train must not move back."""


@dataclass(frozen=True, slots=True)
class Restriction:
    """A temporary speed restriction."""

    start_m: float
    end_m: float
    limit_mps: float


@dataclass(frozen=True, slots=True)
class Orders:
    """What centre and platform have to say, as it was accepted; a state, not a history."""

    awake: bool
    hold: bool
    """Do not depart."""
    skip_next: bool
    stop_next: bool
    """Stop at the next station, whatever the plan says, and stay."""
    emergency: bool
    """Apply the emergency brake and keep it."""
    releases: int
    """Resets by the centre so far; a step up is one fresh reset."""
    creep: bool
    restricted: bool
    doors_left: bool
    """The centre lets doors open on this side of the present platform."""
    doors_right: bool
    platform_doors_locked: bool
    restrictions: tuple[Restriction, ...] = ()


@dataclass(frozen=True, slots=True)
class CycleInput:
    """All the controller may know in one cycle, frozen; of a frame never heard None and NEVER_S."""

    now_ns: int
    dt_s: float
    """Since the cycle before; the nominal period in the first one."""
    overruns: int
    """Cycles missed directly before this one."""
    tacho: Tacho | None
    tacho_age_s: float
    tacho_samples: tuple[TachoSample, ...]
    """All tacho frames since the cycle before, oldest first; it comes faster than the cycle."""
    doppler: Doppler | None
    doppler_age_s: float
    imu: Imu | None
    imu_age_s: float
    traction: TractionStatus | None
    traction_age_s: float
    brake: BrakeStatus | None
    brake_age_s: float
    doors: DoorStatus | None
    doors_age_s: float
    desk: Desk | None
    desk_age_s: float
    tag_reader: TagReaderHealth | None
    tag_reader_age_s: float
    supply: LineSupply | None
    supply_age_s: float
    load: TcmsStatus | None
    load_age_s: float
    tags: tuple[TagReading, ...]
    """Telegrams that became complete since the cycle before, oldest first."""
    authority: Authority | None
    authority_age_s: float
    """By the train's own clock: since the position report that the authority answers was sent."""
    alarms: TrainAlarms | None = None
    alarms_age_s: float = NEVER_S
    cold: ColdMovement | None = None
    cold_age_s: float = NEVER_S
    orders: Orders | None = None
    orders_age_s: float = NEVER_S
    """By the train's own clock: since the status that the orders answer was sent."""
    tag_gap: bool = False
    """Telegrams of the tag reader are missing, or may be, since the cycle before."""
