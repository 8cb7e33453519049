"""Inputs of the controller: its train, its mission, and the image of one cycle."""

import enum
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

from can_dbc.alarms import TrainAlarms
from can_dbc.brake import BrakeStatus
from can_dbc.cab import Desk
from can_dbc.diagnostics import TcmsStatus
from can_dbc.doors import DoorStatus
from can_dbc.energy import LineSupply
from can_dbc.odometer import ColdMovement, Doppler, Imu, Tacho
from can_dbc.tags import TagReaderHealth
from can_dbc.traction import TractionStatus
from firmware_py.settings import check_ranges
from firmware_py.trackdb import Station
from vobc.vocabulary.received import Received

NEVER_S: Final = math.inf
"""Age of an input that was never received."""


@dataclass(frozen=True, slots=True)
class TrainBelief:
    """Assumed properties of the train. The plant has the true ones."""

    length_m: float
    tare_kg: float
    full_load_kg: float
    """Greatest passenger mass. It is assumed until the train has been weighed."""
    rotating_mass_ratio: float
    """Inertia of rotating parts, as a share of the tare mass."""
    antenna_offset_m: float
    """Distance from the front coupler back to the centre of the tag antenna."""
    wheel_diameter_m: float
    pulses_per_turn: int
    rated_force_n: float
    """Tractive effort at the rail of the whole train, below the power limit."""
    rated_power_w: float
    service_decel_max_mps2: float
    """Greatest deceleration of the service brake."""
    car_lengths_m: tuple[float, ...] = ()
    """Lengths of the cars from the front, for a train whose door unit opens the doors of single
    cars. Without them the doors open only beside a platform that is as long as the train."""

    def __post_init__(self) -> None:
        check_ranges(self, RANGES_OF_TRAIN)
        for length_m in self.car_lengths_m:
            if not CAR_M[0] <= length_m <= CAR_M[1]:
                raise ValueError(f"car_lengths_m {length_m} is not in {CAR_M[0]:g}..{CAR_M[1]:g}")

    @property
    def nominal_m_per_pulse(self) -> float:
        return math.pi * self.wheel_diameter_m / self.pulses_per_turn


RANGES_OF_TRAIN: Final[Mapping[str, tuple[float, float]]] = {
    "length_m": (1.0, 500.0),
    "tare_kg": (1.0e3, 2.0e6),
    "full_load_kg": (0.0, 2.0e6),
    "rotating_mass_ratio": (0.0, 0.5),
    "antenna_offset_m": (0.0, 500.0),
    "wheel_diameter_m": (0.3, 1.5),
    "pulses_per_turn": (1, 10_000),
    "rated_force_n": (1.0e3, 3.0e6),
    "rated_power_w": (1.0e3, 1.0e8),
    "service_decel_max_mps2": (0.2, 2.0),
}
"""Plausible range of each value."""
CAR_M: Final = (1.0, 100.0)
"""Plausible range of the length of a car."""


@dataclass(frozen=True, slots=True)
class Mission:
    """Start of the train and its stops in running order."""

    start: Station
    stops: tuple[Station, ...]


class PlaceProof(enum.Enum):
    """How a starting controller knows its place."""

    SET_UP = "staff set the train up there"
    REMEMBERED = "switched off there"
    """Valid once the cold-movement detector confirms it."""
    UNKNOWN = "unknown"
    """Two references restore it."""


@dataclass(frozen=True, slots=True)
class OdometryRecord:
    """State of odometry to be restored after a power cycle."""

    front_m: float
    bound_m: float
    """The front is within front_m ± bound_m."""
    m_per_pulse: float
    """Best estimate of the distance per pulse. It is only a prior; the bounds start from the
    declared ones."""
    proof: PlaceProof = PlaceProof.SET_UP


@dataclass(frozen=True, slots=True)
class TachoSample:
    """One tacho frame and its age at the instant of the cycle."""

    frame: Tacho
    age_s: float


@dataclass(frozen=True, slots=True)
class TagReading:
    """One tag as the reader reported it. Odometry still has to check it."""

    tag_id: int
    pulses: int
    """Counter of tacho A when the antenna was over the tag's centre, modulo 65536."""
    age_s: float
    """Time since the antenna was over the centre: by the reader's clock at sending, plus line time.
    """


@dataclass(frozen=True, slots=True)
class Authority:
    """An accepted movement authority, checked for address, term and sequence."""

    end_m: float
    """Chainage that the front must never pass."""
    term: int
    sequence: int
    rear_m: float | None = None
    """Chainage back to which the rear is protected. None: the train must not move back."""


@dataclass(frozen=True, slots=True)
class Restriction:
    """A temporary speed restriction."""

    start_m: float
    end_m: float
    limit_mps: float


@dataclass(frozen=True, slots=True)
class Orders:
    """Accepted orders of centre and platform. They are a state, not a history."""

    awake: bool
    hold: bool
    """Do not depart."""
    skip_next: bool
    stop_next: bool
    """Stop at the next station, whatever the plan says, and stay."""
    emergency: bool
    """Apply the emergency brake and keep it."""
    releases: int
    """Number of resets by the centre so far. An increase is a new reset."""
    creep: bool
    restricted: bool
    doors_left: bool
    """The centre permits doors to open on this side of the present platform."""
    doors_right: bool
    platform_doors_locked: bool
    restrictions: tuple[Restriction, ...] = ()
    """All that hold, at every place of the line."""
    released_emergency: int = 0
    """Number of the emergency that the last reset of the centre is for."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CycleInput:
    """All inputs of one cycle, frozen.

    A source that was never received is None with an age of NEVER_S.
    """

    now_ns: int
    dt_s: float
    """Time since the cycle before. In the first cycle: the nominal period."""
    overruns: int = 0
    """Cycles missed directly before this one."""
    tacho: Tacho | None = None
    tacho_age_s: float = NEVER_S
    tacho_samples: tuple[TachoSample, ...] = ()
    """All tacho frames since the cycle before, oldest first. They come faster than the cycle."""
    doppler: Doppler | None = None
    doppler_age_s: float = NEVER_S
    imu: Imu | None = None
    imu_age_s: float = NEVER_S
    traction: TractionStatus | None = None
    traction_age_s: float = NEVER_S
    brake: BrakeStatus | None = None
    brake_age_s: float = NEVER_S
    doors: DoorStatus | None = None
    doors_age_s: float = NEVER_S
    desk: Desk | None = None
    desk_age_s: float = NEVER_S
    tag_reader: TagReaderHealth | None = None
    tag_reader_age_s: float = NEVER_S
    supply: LineSupply | None = None
    supply_age_s: float = NEVER_S
    load: TcmsStatus | None = None
    load_age_s: float = NEVER_S
    tags: tuple[TagReading, ...] = ()
    """Telegrams completed since the cycle before, oldest first."""
    authority: Authority | None = None
    authority_age_s: float = NEVER_S
    """Age by the train's own clock, since it sent the position report that the authority answers.
    """
    alarms: TrainAlarms | None = None
    alarms_age_s: float = NEVER_S
    cold: ColdMovement | None = None
    cold_age_s: float = NEVER_S
    orders: Orders | None = None
    orders_age_s: float = NEVER_S
    """Age by the train's own clock, since it sent the status that the orders answer."""
    tag_gap: bool = False
    """Telegrams of the tag reader are missing, or may be, since the cycle before."""


def cycle_input(
    *,
    now_ns: int,
    dt_s: float,
    overruns: int,
    tacho: Received[Tacho] | None,
    tacho_samples: tuple[TachoSample, ...],
    doppler: Received[Doppler] | None,
    imu: Received[Imu] | None,
    traction: Received[TractionStatus] | None,
    brake: Received[BrakeStatus] | None,
    doors: Received[DoorStatus] | None,
    desk: Received[Desk] | None,
    tag_reader: Received[TagReaderHealth] | None,
    supply: Received[LineSupply] | None,
    load: Received[TcmsStatus] | None,
    tags: tuple[TagReading, ...],
    authority: Received[Authority] | None,
    alarms: Received[TrainAlarms] | None,
    cold: Received[ColdMovement] | None,
    orders: Received[Orders] | None,
    tag_gap: bool,
) -> CycleInput:
    """The image of a cycle at `now_ns`. Value and age of a source come from one `Received`."""
    return CycleInput(
        now_ns=now_ns,
        dt_s=dt_s,
        overruns=overruns,
        tacho=None if tacho is None else tacho.value,
        tacho_age_s=_age_s(tacho, now_ns),
        tacho_samples=tacho_samples,
        doppler=None if doppler is None else doppler.value,
        doppler_age_s=_age_s(doppler, now_ns),
        imu=None if imu is None else imu.value,
        imu_age_s=_age_s(imu, now_ns),
        traction=None if traction is None else traction.value,
        traction_age_s=_age_s(traction, now_ns),
        brake=None if brake is None else brake.value,
        brake_age_s=_age_s(brake, now_ns),
        doors=None if doors is None else doors.value,
        doors_age_s=_age_s(doors, now_ns),
        desk=None if desk is None else desk.value,
        desk_age_s=_age_s(desk, now_ns),
        tag_reader=None if tag_reader is None else tag_reader.value,
        tag_reader_age_s=_age_s(tag_reader, now_ns),
        supply=None if supply is None else supply.value,
        supply_age_s=_age_s(supply, now_ns),
        load=None if load is None else load.value,
        load_age_s=_age_s(load, now_ns),
        tags=tags,
        authority=None if authority is None else authority.value,
        authority_age_s=_age_s(authority, now_ns),
        alarms=None if alarms is None else alarms.value,
        alarms_age_s=_age_s(alarms, now_ns),
        cold=None if cold is None else cold.value,
        cold_age_s=_age_s(cold, now_ns),
        orders=None if orders is None else orders.value,
        orders_age_s=_age_s(orders, now_ns),
        tag_gap=tag_gap,
    )


def _age_s(received: Received[Any] | None, now_ns: int) -> float:
    return NEVER_S if received is None else received.age_s(now_ns)
