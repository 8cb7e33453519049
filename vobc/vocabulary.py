"""The nouns: what a control cycle is given, what it answers, what its rooms tell each other."""

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
from can_dbc.nodes import Direction
from can_dbc.odometer import ColdMovement, Doppler, Imu, Tacho
from can_dbc.tags import TagReaderHealth
from can_dbc.traction import TractionStatus
from can_dbc.vobc import (
    AtoPhase,
    Cause,
    EventKind,
    Inhibit,
    Missing,
    OperatingMode,
    Supervision,
    Withheld,
)
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


@dataclass(frozen=True, slots=True)
class Interval:
    """A quantity that is known only to lie between two ends."""

    low: float
    best: float
    high: float


class TagRefusal(enum.Enum):
    """Why a tag was not believed."""

    UNKNOWN = "no such tag on this line"
    OUTSIDE_WINDOW = "outside of its expectation window"
    OUT_OF_ORDER = "out of order"
    REPEATED = "read before"


@dataclass(frozen=True, slots=True)
class RefusedTag:
    tag_id: int
    reason: TagRefusal
    off_m: float
    """From the nearer end of the window to where the tag claims the front to be; signed."""


@dataclass(frozen=True, slots=True)
class Motion:
    """What odometry makes of pulses and tags; the intervals hold the truth for declared errors."""

    front_m: Interval
    """Chainage of the front coupler."""
    speed_mps: Interval
    """Signed, positive forwards."""
    accel_mps2: float
    """Smoothed, signed."""
    travel_m: float
    """Distance by pulses alone since start, signed; no tag makes it jump."""
    standing: bool
    """Half a second of samples without a pulse: a quick sign, but no proof of standstill."""
    standstill: bool
    """Zero speed proven: upper speed bound under 1 km/h for 2 s."""
    localised: bool
    slip: bool
    accepted_tag_ids: tuple[int, ...]
    """Tags that corrected the position in this cycle."""
    refused_tags: tuple[RefusedTag, ...] = ()
    """Tags that were read in this cycle and not believed."""
    missed_tags: int = 0
    """Expected tags in a row that were not read."""
    lost_cause: str = ""
    """Why the train does not know where it is; empty while it does."""
    wheel_diameter_m: float = 0.0
    """As last calibrated."""


@dataclass(frozen=True, slots=True)
class Ceiling:
    """What protection permits now, all as speeds of the train."""

    permitted_mps: float
    """Least of civil limits under the train, braking curves ahead and end of authority."""
    warning_mps: float
    service_mps: float
    emergency_mps: float
    distance_to_authority_m: float
    """From the worst end of the front interval to the end of authority."""


@dataclass(frozen=True, slots=True)
class AtoInput:
    """What operation is given. It cannot change any of it."""

    now_ns: int
    dt_s: float
    enabled: bool
    """Desk in AUTO, protection not in emergency, nothing missing."""
    front_m: float
    speed_mps: float
    accel_mps2: float
    standstill: bool
    accepted_tag_ids: tuple[int, ...]
    gradient_permille: float
    """Mean under the train now."""
    ceiling_mps: float
    authority_end_m: float
    load_kg: float
    traction_ratio: float
    """Share of the rated effort that is available."""
    doors_locked: bool
    doors_open: bool
    """The platform side is fully open."""
    door_enabled: bool
    """Protection enables the platform side now."""
    holding_applied: bool
    departure_permitted: bool = True
    """Nothing of the departure interlock stands against it, the doors' own lock included."""
    skip_next: bool = False
    """Do not stop at the next station."""
    stop_next: bool = False
    """Stop at the next station, whatever the plan says, and stay."""
    stop_now: bool = False
    """Come to rest with the service brake wherever the train is."""
    keep_doors_open: bool = False
    """At a platform: open the doors, and leave them open."""
    jog_permitted: bool = False
    """Protection allows a jog now, backwards included where `jog_back_m` is more than 0."""
    jog_back_m: float = 0.0
    """How far back the train may move; its rear is protected so far."""
    creep: bool = False
    """Drive on sight at `ceiling_mps`; place and authority may be unknown."""
    protection_brakes: bool = False
    """The service brake comes from protection now, whatever is asked for."""
    kept_at_platform: bool = False
    """Something beside doors and authority stands against departure: the dwell goes on."""


@dataclass(frozen=True, slots=True)
class AtoDemand:
    """What operation asks for; arbitration decides what goes out."""

    accel_mps2: float
    """Effort per mass asked of traction (positive) or service brake (negative).

    What gradient and resistance do to the train comes on top; operation reckons with both, so that
    one application of the brake stays one application.
    """
    hold: bool
    """Keep or bring the holding brake on."""
    open_doors: bool
    """Doors on the platform side of the present station shall be open."""
    phase: AtoPhase
    target_mps: float
    """Speed of the reference now."""
    distance_to_stop_m: float
    """To the next stopping point; math.inf when there is none."""
    reverse: bool = False
    """Positive `accel_mps2` drives backwards; only for a jog."""
    jog_failed: bool = False
    """All attempts are used up and the train still does not stand right, or it does and its doors
    are not enabled for long: a person has to come."""
    stopping_at_m: float | None = None
    """Stopping point that the train heads for or stands at; None while it heads for none."""


class Source(enum.Enum):
    """Where the facts of a decision came from; the wire knows which frame or message that was."""

    TACHO = "TACHO"
    DOPPLER = "DOPPLER"
    IMU = "IMU"
    COLD = "COLD_MOVEMENT"
    BRAKE = "BRAKE_STATUS"
    TRACTION = "TRACTION_STATUS"
    DOORS = "DOOR_STATUS"
    DESK = "DESK"
    TAG_READER = "TAG_READER_HEALTH"
    ALARMS = "TRAIN_ALARMS"
    SUPPLY = "LINE_SUPPLY"
    TAG = "tag telegram"
    AUTHORITY = "movement authority"
    ORDERS = "orders"
    CLOCK = "clock"


@dataclass(frozen=True, slots=True)
class Event:
    """One thing that the controller decided or noticed in a cycle."""

    kind: EventKind
    words: str
    """What and why, for the log and for people."""
    sources: tuple[Source, ...] = ()
    """What it was decided from, the weightiest first."""
    number: int = 0
    """Goes out on the bus beside the kind: a `Cause`, a tag, a flag; 0 without one."""


@dataclass(frozen=True, slots=True)
class CycleOutput:
    """Everything the controller says in one cycle."""

    force_n: float
    direction: Direction
    traction_permitted: bool
    service_decel_mps2: float
    emergency_released: bool
    holding_released: bool
    enable_left: bool
    enable_right: bool
    open_left: bool
    open_right: bool
    supervision: Supervision
    ato_phase: AtoPhase
    missing: Missing
    motion: Motion | None
    ceiling: Ceiling | None
    target_mps: float
    accel_demand_mps2: float
    distance_to_stop_m: float
    cause: str
    """Why protection holds or brakes; empty while it does not."""
    mode: OperatingMode = OperatingMode.STANDBY
    emergency_cause: Cause = Cause.NONE
    departure_inhibits: Inhibit = Inhibit.NONE
    doors_withheld: Withheld = Withheld.NONE
    jog_attempts: int = 0
    replicas_agree: bool = True
    alarm_raised: bool = False
    """A person has to come: passenger alarm, fire, obstacle, or a stop that cannot be mended."""
    door_bypass: bool = False
    """The train may depart although its doors are not proven locked."""


MAX_SERVICE_DECEL_MPS2: Final = 2.0
"""Largest demand the wire can carry; the brake unit limits it to what it has."""

SAFE_OUTPUT: Final = CycleOutput(
    force_n=0.0,
    direction=Direction.NEUTRAL,
    traction_permitted=False,
    service_decel_mps2=MAX_SERVICE_DECEL_MPS2,
    emergency_released=False,
    holding_released=False,
    enable_left=False,
    enable_right=False,
    open_left=False,
    open_right=False,
    supervision=Supervision.EMERGENCY,
    ato_phase=AtoPhase.OFF,
    missing=Missing.NOTHING,
    motion=None,
    ceiling=None,
    target_mps=0.0,
    accel_demand_mps2=0.0,
    distance_to_stop_m=math.inf,
    cause="safe output",
)
