"""Faults of the train itself: sensors, tag reader, actuators, supply, doors and desk."""

import enum
from dataclasses import dataclass

from can_dbc.cab import CabMode
from plant_emulator.faults.kinds import FaultPlace, Hazard, check_range, fault


class Axle(enum.Enum):
    """Which tacho the fault affects."""

    A = "a"
    B = "b"
    BOTH = "both"


class DoorsOf(enum.Enum):
    LEFT = "left"
    RIGHT = "right"
    BOTH = "both"


@fault("wheel_slip", FaultPlace.SENSOR, Hazard.MISLOCATED)
@dataclass(frozen=True, slots=True)
class WheelSlip:
    """Wheels turn faster than the train moves, by this share of its speed."""

    slip_ratio: float = 0.2
    axle: Axle = Axle.A
    ramp_s: float = 0.0
    """Time until the full slip is reached, and until it has gone after the end."""

    def __post_init__(self) -> None:
        check_range(self, "slip_ratio", 0.0, 5.0)
        check_range(self, "ramp_s", 0.0, 60.0)


@fault("wheel_slide", FaultPlace.SENSOR, Hazard.MISLOCATED)
@dataclass(frozen=True, slots=True)
class WheelSlide:
    """Wheels turn slower than the train moves, by this share of its speed; 1 is a locked wheel."""

    slide_ratio: float = 0.3
    axle: Axle = Axle.A
    ramp_s: float = 0.0

    def __post_init__(self) -> None:
        check_range(self, "slide_ratio", 0.0, 1.0)
        check_range(self, "ramp_s", 0.0, 60.0)


@fault("low_adhesion", FaultPlace.SENSOR, Hazard.NO_BRAKE, Hazard.MISLOCATED)
@dataclass(frozen=True, slots=True)
class LowAdhesion:
    """Leaves on the rail limit traction and brake to this adhesion; wheels slip and slide beyond
    it.
    """

    adhesion_ratio: float = 0.06

    def __post_init__(self) -> None:
        check_range(self, "adhesion_ratio", 0.0, 1.0)


@fault("tacho_stuck", FaultPlace.SENSOR, Hazard.MISLOCATED)
@dataclass(frozen=True, slots=True)
class TachoStuck:
    """A tacho stops counting but reports itself healthy."""

    axle: Axle = Axle.A


@fault("tacho_drift", FaultPlace.SENSOR, Hazard.MISLOCATED)
@dataclass(frozen=True, slots=True)
class TachoDrift:
    """A tacho's scale drifts."""

    ratio_per_s: float = 0.001
    axle: Axle = Axle.A

    def __post_init__(self) -> None:
        check_range(self, "ratio_per_s", -1.0, 1.0)


@fault("tacho_unhealthy", FaultPlace.SENSOR, Hazard.LOST_SERVICE)
@dataclass(frozen=True, slots=True)
class TachoUnhealthy:
    """A tacho reports itself as failed and stops counting."""

    axle: Axle = Axle.A


@fault("wheel_wear", FaultPlace.SENSOR, Hazard.MISLOCATED)
@dataclass(frozen=True, slots=True)
class WheelWear:
    """The wheels are smaller, so a distance gives more pulses."""

    diameter_ratio: float = 0.97
    axle: Axle = Axle.BOTH

    def __post_init__(self) -> None:
        check_range(self, "diameter_ratio", 0.5, 1.5)


@fault("tacho_interference", FaultPlace.SENSOR, Hazard.MISLOCATED, Hazard.LOST_SERVICE)
@dataclass(frozen=True, slots=True)
class TachoInterference:
    """Interference adds pulses to the tachos, by default to both at once; negative ones count
    backwards.
    """

    pulses_per_s: float = 50.0
    axle: Axle = Axle.BOTH

    def __post_init__(self) -> None:
        check_range(self, "pulses_per_s", -1000.0, 1000.0)


@fault("sensor_restart", FaultPlace.SENSOR, Hazard.MISLOCATED, Hazard.LOST_SERVICE)
@dataclass(frozen=True, slots=True)
class SensorRestart:
    """The odometer unit restarts.

    It sends nothing while the fault lasts. At its end pulse counts, stamps and alive counters begin
    at 0.
    """


@fault("load_cell", FaultPlace.SENSOR, Hazard.LOST_SERVICE, Hazard.OVERRUN)
@dataclass(frozen=True, slots=True)
class LoadCell:
    """The load cells report this share of the true passenger mass."""

    share_ratio: float = 0.0

    def __post_init__(self) -> None:
        check_range(self, "share_ratio", 0.0, 10.0)


@fault("train_longer", FaultPlace.SENSOR, Hazard.OVERSPEED, Hazard.DOOR_DANGER)
@dataclass(frozen=True, slots=True)
class TrainLonger:
    """The rear of the train is this much further back than the controller believes."""

    extra_m: float = 20.0

    def __post_init__(self) -> None:
        check_range(self, "extra_m", -200.0, 400.0)


@fault("doppler_outage", FaultPlace.SENSOR, Hazard.LOST_SERVICE)
@dataclass(frozen=True, slots=True)
class DopplerOutage:
    """The radar receives no echo and reports it."""


@fault("doppler_wrong", FaultPlace.SENSOR, Hazard.MISLOCATED)
@dataclass(frozen=True, slots=True)
class DopplerWrong:
    """The radar's speed is wrong by this share, but it reports itself healthy."""

    error_ratio: float = 0.2

    def __post_init__(self) -> None:
        check_range(self, "error_ratio", -1.0, 5.0)


@fault("imu_bias", FaultPlace.SENSOR, Hazard.MISLOCATED)
@dataclass(frozen=True, slots=True)
class ImuBias:
    """The accelerometer has this additional bias."""

    bias_mps2: float = 0.5

    def __post_init__(self) -> None:
        check_range(self, "bias_mps2", -20.0, 20.0)


@fault("tag_missed", FaultPlace.SENSOR, Hazard.MISLOCATED)
@dataclass(frozen=True, slots=True)
class TagMissed:
    """Tags are passed without being read."""

    tag_id: int | None = None
    """Only this tag; without it, all tags."""
    share_ratio: float = 1.0

    def __post_init__(self) -> None:
        check_range(self, "share_ratio", 0.0, 1.0)


@fault("tag_displaced", FaultPlace.SENSOR, Hazard.MISLOCATED)
@dataclass(frozen=True, slots=True)
class TagDisplaced:
    """Tags lie this much further along the line than in the map."""

    offset_m: float = 5.0
    tag_id: int | None = None

    def __post_init__(self) -> None:
        check_range(self, "offset_m", -1000.0, 1000.0)


@fault("tag_duplicate", FaultPlace.SENSOR, Hazard.MISLOCATED)
@dataclass(frozen=True, slots=True)
class TagDuplicate:
    """Tags are read twice.

    The second reading comes this much later and this far from the tag, with the train's true pulses
    there.
    """

    gap_s: float = 0.1
    gap_m: float = 0.0
    """Minimum distance from the tag to the antenna's centre, on either side."""
    tag_id: int | None = None

    def __post_init__(self) -> None:
        check_range(self, "gap_s", 0.0, 60.0)
        check_range(self, "gap_m", 0.0, 100.0)


@fault("tag_false", FaultPlace.SENSOR, Hazard.MISLOCATED)
@dataclass(frozen=True, slots=True)
class TagFalse:
    """A tag of this number is read once when the fault begins, wherever the train is."""

    tag_id: int = 1

    def __post_init__(self) -> None:
        check_range(self, "tag_id", 1, 0xFFFF_FFFF)


@fault("antenna_dead", FaultPlace.SENSOR, Hazard.MISLOCATED, Hazard.LOST_SERVICE)
@dataclass(frozen=True, slots=True)
class AntennaDead:
    """The antenna reads no tag; its self-test detects this unless the fault is hidden."""

    hidden: bool = False


@fault("brake_late", FaultPlace.ACTUATOR, Hazard.NO_BRAKE)
@dataclass(frozen=True, slots=True)
class BrakeLate:
    """The service brake responds this much later."""

    delay_s: float = 1.0

    def __post_init__(self) -> None:
        check_range(self, "delay_s", 0.0, 30.0)


@fault("brake_weak", FaultPlace.ACTUATOR, Hazard.NO_BRAKE)
@dataclass(frozen=True, slots=True)
class BrakeWeak:
    """The service brake gives this share of the demand."""

    gain_ratio: float = 0.5

    def __post_init__(self) -> None:
        check_range(self, "gain_ratio", 0.0, 2.0)


@fault("brake_stuck", FaultPlace.ACTUATOR, Hazard.NO_BRAKE, Hazard.LOST_SERVICE)
@dataclass(frozen=True, slots=True)
class BrakeStuck:
    """The service brake keeps the force that it gave when the fault began."""


@fault("brake_unit_failed", FaultPlace.ACTUATOR, Hazard.NO_BRAKE)
@dataclass(frozen=True, slots=True)
class BrakeUnitFailed:
    """This share of all brakes gives no force, including emergency and holding brake."""

    share_ratio: float = 0.25

    def __post_init__(self) -> None:
        check_range(self, "share_ratio", 0.0, 1.0)


@fault("emergency_late", FaultPlace.ACTUATOR, Hazard.NO_BRAKE)
@dataclass(frozen=True, slots=True)
class EmergencyLate:
    """The emergency brake builds up this much later."""

    delay_s: float = 0.5

    def __post_init__(self) -> None:
        check_range(self, "delay_s", 0.0, 30.0)


@fault("traction_runaway", FaultPlace.ACTUATOR, Hazard.OVERSPEED, Hazard.UNWANTED_MOTION)
@dataclass(frozen=True, slots=True)
class TractionRunaway:
    """Traction pushes with this acceleration whatever the command is, until it is cut off."""

    accel_mps2: float = 1.0
    obeys_cut_off: bool = True
    """Whether the emergency brake can still cut off traction."""

    def __post_init__(self) -> None:
        check_range(self, "accel_mps2", 0.0, 3.0)


@fault("traction_weak", FaultPlace.ACTUATOR, Hazard.LOST_SERVICE)
@dataclass(frozen=True, slots=True)
class TractionWeak:
    """Traction gives this share of the demand."""

    gain_ratio: float = 0.5

    def __post_init__(self) -> None:
        check_range(self, "gain_ratio", 0.0, 2.0)


@fault("traction_late", FaultPlace.ACTUATOR, Hazard.OVERSPEED)
@dataclass(frozen=True, slots=True)
class TractionLate:
    """Traction reduces its effort this much later than commanded."""

    delay_s: float = 1.0

    def __post_init__(self) -> None:
        check_range(self, "delay_s", 0.0, 30.0)


@fault("holding_late", FaultPlace.ACTUATOR, Hazard.UNWANTED_MOTION)
@dataclass(frozen=True, slots=True)
class HoldingLate:
    """The holding brake applies this much later."""

    delay_s: float = 2.0

    def __post_init__(self) -> None:
        check_range(self, "delay_s", 0.0, 30.0)


@fault("holding_sticks", FaultPlace.ACTUATOR, Hazard.LOST_SERVICE, Hazard.UNWANTED_MOTION)
@dataclass(frozen=True, slots=True)
class HoldingSticks:
    """The holding brake releases this much later."""

    delay_s: float = 2.0

    def __post_init__(self) -> None:
        check_range(self, "delay_s", 0.0, 30.0)


@fault("line_voltage", FaultPlace.SUPPLY, Hazard.LOST_SERVICE, Hazard.NO_BRAKE)
@dataclass(frozen=True, slots=True)
class LineVoltage:
    """The substation's no-load voltage changes; 0 is an outage, a high one accepts no returned
    current.
    """

    voltage_v: float = 480.0

    def __post_init__(self) -> None:
        check_range(self, "voltage_v", 0.0, 5000.0)


@fault("power_section_off", FaultPlace.SUPPLY, Hazard.LOST_SERVICE, Hazard.NO_BRAKE)
@dataclass(frozen=True, slots=True)
class PowerSectionOff:
    """A power section of the line has no voltage, as after a short circuit.

    A train of which any part is in it has neither traction nor electric brake.
    """

    section: str = "S1"


@fault("breaker_open", FaultPlace.SUPPLY, Hazard.LOST_SERVICE)
@dataclass(frozen=True, slots=True)
class BreakerOpen:
    """The main breaker is open, so there is neither traction nor electric brake."""


@fault("door_lock_lost", FaultPlace.DOORS, Hazard.DOOR_DANGER)
@dataclass(frozen=True, slots=True)
class DoorLockLost:
    """The train line through the locks is interrupted; the doors themselves are closed."""


@fault("door_opens", FaultPlace.DOORS, Hazard.DOOR_DANGER)
@dataclass(frozen=True, slots=True)
class DoorOpens:
    """Doors open without command and enable."""

    side: DoorsOf = DoorsOf.RIGHT


@fault("door_obstacle", FaultPlace.DOORS, Hazard.DOOR_DANGER, Hazard.LOST_SERVICE)
@dataclass(frozen=True, slots=True)
class DoorObstacle:
    """The doors meet an obstacle at every closing."""

    side: DoorsOf = DoorsOf.BOTH


@fault("door_deaf", FaultPlace.DOORS, Hazard.LOST_SERVICE)
@dataclass(frozen=True, slots=True)
class DoorDeaf:
    """Doors do not open although they are commanded to."""

    side: DoorsOf = DoorsOf.BOTH


@fault("passenger_alarm", FaultPlace.DESK, Hazard.LOST_SERVICE)
@dataclass(frozen=True, slots=True)
class PassengerAlarm:
    """A passenger pulls the alarm and releases it when the fault ends."""


@fault("emergency_button", FaultPlace.DESK, Hazard.LOST_SERVICE)
@dataclass(frozen=True, slots=True)
class EmergencyButton:
    """The emergency button on the desk is pressed."""


@fault("desk_mode", FaultPlace.DESK, Hazard.UNWANTED_MOTION)
@dataclass(frozen=True, slots=True)
class DeskMode:
    """The mode key on the desk is turned."""

    mode: CabMode = CabMode.OFF


@fault("desk_lever", FaultPlace.DESK, Hazard.UNWANTED_MOTION, Hazard.OVERSPEED)
@dataclass(frozen=True, slots=True)
class DeskLever:
    """The lever is moved; negative brakes."""

    lever_percent: float = 100.0

    def __post_init__(self) -> None:
        check_range(self, "lever_percent", -100.0, 100.0)


@fault("desk_reset", FaultPlace.DESK, Hazard.UNWANTED_MOTION)
@dataclass(frozen=True, slots=True)
class DeskReset:
    """The desk requests the reset of a latched emergency."""
