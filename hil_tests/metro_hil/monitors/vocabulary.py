"""The signals of user expressions: name, unit, meaning, and where each comes from."""

import enum
import math
from dataclasses import dataclass
from typing import Final


class Origin(enum.Enum):
    """Where a signal comes from."""

    TRUTH = "truth"
    """From the plant; no controller receives it."""
    BUS = "bus"
    """From the last valid frame; before the first one, the most restrictive contents."""
    LINE = "line"
    """From truth and map together."""


@dataclass(frozen=True, slots=True)
class Signal:
    name: str
    unit: str
    """`1` for counts and ratios, `0/1` for booleans, otherwise the SI unit."""
    text: str
    origin: Origin

    @property
    def boolean(self) -> bool:
        return self.unit == BOOLEAN


BOOLEAN: Final = "0/1"

_TRUTH: Final = (
    ("t_s", "s", "time since the start of the run"),
    ("front_m", "m", "chainage of the front coupler"),
    ("rear_m", "m", "chainage of the rear coupler"),
    ("speed_mps", "m/s", "speed of the whole train, signed; exactly 0 at standstill"),
    ("accel_mps2", "m/s²", "acceleration of the whole train"),
    ("drive_n", "N", "tractive effort at the rail, signed"),
    ("brake_n", "N", "brake force at the rail, never negative"),
    ("gradient_permille", "‰", "mean gradient under the train; positive climbs"),
    ("adhesion_ratio", "1", "friction coefficient of the rail"),
    ("emergency", BOOLEAN, "the brake unit demands the emergency brake"),
    ("emergency_mps2", "m/s²", "deceleration by the emergency brake"),
    ("holding", BOOLEAN, "the holding brake acts"),
    ("doors_locked", BOOLEAN, "all doors are closed and locked"),
    ("left_open", BOOLEAN, "left doors, from unlocking to locking"),
    ("right_open", BOOLEAN, "right doors, from unlocking to locking"),
    ("left_cars", "1", "cars with open left doors: the sum of 1 for the front car, then 2, 4, 8 …"),
    ("right_cars", "1", "cars with open right doors, in the same way"),
    ("voltage_v", "V", "line voltage at the train"),
    ("odometer_error_m", "m", "excess in the count of tacho A since the start"),
    ("tags_read", "1", "tags that the reader has read since the start"),
    ("authority_end_m", "m", "farthest end of all authorities given; the start before the first"),
    ("civil_limit_mps", "m/s", "lowest limit of the line under the whole train"),
    ("traction_cut", BOOLEAN, "the contactor has cut traction"),
    ("unlocked_switch_m", "m", "first switch ahead that is not locked; 1000 km without one"),
    ("to_stop_m", "m", "distance to the next stopping point; negative up to 20 m beyond it"),
    ("authority_now_m", "m", "end of the newest authority; the start before the first"),
    ("authority_rear_m", "m", "position to which the newest authority lets the rear move back"),
    ("temporary_limit_mps", "m/s", "lowest temporary restriction under the train; the line's limit "
     "without one"),
    ("fire", BOOLEAN, "a smoke or fire detector has tripped"),
    ("obstacle", BOOLEAN, "the obstacle deflector has been touched"),
    ("platform_doors_locked", BOOLEAN, "all platform doors are closed and proven locked"),
    ("platform_doors_open", BOOLEAN, "a platform door is not closed"),
    ("doors_authorised_left", BOOLEAN, "orders: doors may open on the left"),
    ("doors_authorised_right", BOOLEAN, "orders: doors may open on the right"),
    ("order_awake", BOOLEAN, "orders: wake the train up"),
    ("order_hold", BOOLEAN, "orders: do not depart"),
    ("order_skip_next", BOOLEAN, "orders: do not stop at the next station"),
    ("order_stop_next", BOOLEAN, "orders: stop at the next station and stay"),
    ("order_emergency", BOOLEAN, "orders: emergency brake"),
    ("order_releases", "1", "orders: number of emergency resets so far"),
    ("order_creep", BOOLEAN, "orders: the train may creep"),
    ("order_restricted", BOOLEAN, "orders: a person may drive on sight"),
)  # fmt: skip
_BUS: Final = (
    ("claimed_front_m", "m", "VOBC_POSITION: best estimate of the front coupler's chainage"),
    ("uncertainty_m", "m", "VOBC_POSITION: distance from the claimed front to the farther end of "
     "the position interval"),
    ("position_age_s", "s", "time since VOBC_POSITION"),
    ("supervision", "1", "VOBC_STATUS: 0 no authority, 1 nominal, 2 warning, 3 service, "
     "4 emergency"),
    ("ato_phase", "1", "VOBC_STATUS: 0 off, 1 holding, 2 departing, 3 running, 4 approaching, "
     "5 stopping, 6 stopped, 7 doors open, 8 doors closing, 9 jogging, 10 creeping"),
    ("missing", "1", "VOBC_STATUS: what the controller waits for, as the sum of its flags"),
    ("localised", BOOLEAN, "VOBC_STATUS: the position of the train is known"),
    ("slip_detected", BOOLEAN, "VOBC_STATUS: wheels slip or slide"),
    ("cycle_slips", "1", "VOBC_STATUS: cycles missed since start, modulo 64"),
    ("work_us", "µs", "VOBC_STATUS: execution time of a cycle; 0 in virtual time"),
    ("status_age_s", "s", "time since VOBC_STATUS"),
    ("claimed_speed_mps", "m/s", "VOBC_MOTION: best estimate of the speed, positive forwards"),
    ("ceiling_mps", "m/s", "VOBC_MOTION: permitted speed"),
    ("emergency_limit_mps", "m/s", "VOBC_MOTION: speed at which the emergency brake is applied"),
    ("motion_age_s", "s", "time since VOBC_MOTION"),
    ("claimed_to_stop_m", "m", "VOBC_TARGET: distance to the next stopping point, negative beyond "
     "it"),
    ("claimed_to_authority_m", "m", "VOBC_TARGET: distance from the foremost possible front to the "
     "end of authority"),
    ("target_age_s", "s", "time since VOBC_TARGET"),
    ("service_decel_mps2", "m/s²", "BRAKE_CMD: deceleration demanded of the service brake"),
    ("emergency_commanded", BOOLEAN, "BRAKE_CMD: the emergency brake is not released"),
    ("holding_commanded", BOOLEAN, "BRAKE_CMD: the holding brake is not released"),
    ("brake_age_s", "s", "time since the last valid pair of BRAKE_CMD"),
    ("force_commanded_n", "N", "TRACTION_CMD: effort for the whole train, never negative"),
    ("direction", "1", "TRACTION_CMD: 1 forwards, -1 backwards, 0 neutral"),
    ("traction_permitted", BOOLEAN, "TRACTION_CMD: effort is allowed"),
    ("traction_age_s", "s", "time since the last valid pair of TRACTION_CMD"),
    ("enable_left", BOOLEAN, "DOOR_CMD or DOOR_CARS: left doors may be open"),
    ("enable_right", BOOLEAN, "DOOR_CMD or DOOR_CARS: right doors may be open"),
    ("open_left_commanded", BOOLEAN, "DOOR_CMD: open the left doors"),
    ("open_right_commanded", BOOLEAN, "DOOR_CMD: open the right doors"),
    ("doors_age_s", "s", "time since the last valid pair of DOOR_CMD"),
    ("reset_pressed", BOOLEAN, "DESK: the reset button is pressed"),
    ("desk_age_s", "s", "time since DESK"),
    ("restricted_pressed", BOOLEAN, "DESK: a person asks to drive on sight"),
    ("door_bypass_pressed", BOOLEAN, "DESK: a person asks for the door bypass"),
    ("mode", "1", "VOBC_MODE: 0 asleep, 1 standby, 2 restricted, 3 creep, 4 authorised, 5 jog"),
    ("emergency_cause", "1", "VOBC_MODE: number of the cause of an emergency; 0 without one"),
    ("departure_inhibits", "1", "VOBC_MODE: why the train may not depart, as the sum of flags"),
    ("doors_withheld", "1", "VOBC_MODE: why no door is enabled, as the sum of flags"),
    ("jog_attempts", "1", "VOBC_MODE: jogs made at this stop"),
    ("replicas_agree", BOOLEAN, "VOBC_MODE: both computations agree"),
    ("alarm_raised", BOOLEAN, "VOBC_MODE: a person has to come to the train"),
    ("mode_age_s", "s", "time since VOBC_MODE"),
)  # fmt: skip
_LINE: Final = (
    ("to_authority_m", "m", "distance from the true front to the end of authority"),
    (
        "stop_error_m",
        "m",
        "distance of the true front beyond the nearest stopping point; negative before it",
    ),
    ("platform_left", BOOLEAN, "the nearest station has a platform on the left"),
    ("standing", BOOLEAN, "the speed is exactly 0"),
    ("stopping_m", "m", "distance to standstill under the emergency brake, as in invariant 1"),
    ("rollback_m", "m", "distance back from the foremost position so far"),
    ("position_error_m", "m", "claimed front less true front, at the instant of the claim"),
)

SIGNALS: Final[tuple[Signal, ...]] = tuple(
    Signal(name, unit, text, origin)
    for origin, rows in ((Origin.TRUTH, _TRUTH), (Origin.BUS, _BUS), (Origin.LINE, _LINE))
    for name, unit, text in rows
)
NAMES: Final[tuple[str, ...]] = tuple(signal.name for signal in SIGNALS)
BOOLEANS: Final[frozenset[str]] = frozenset(signal.name for signal in SIGNALS if signal.boolean)
_STATES: Final = {
    "supervision": (0.0, 4.0),
    "ato_phase": (0.0, 10.0),
    "mode": (0.0, 5.0),
    "direction": (-1.0, 1.0),
}
_NEVER_NEGATIVE: Final = ("t_s", "tags_read", "uncertainty_m", "cycle_slips", "jog_attempts")
RANGES: Final[dict[str, tuple[float, float]]] = {
    **{name: (0.0, math.inf) for name in NAMES if name.endswith("_age_s")},
    **dict.fromkeys(_NEVER_NEGATIVE, (0.0, math.inf)),
    **dict.fromkeys(sorted(BOOLEANS), (0.0, 1.0)),
    **_STATES,
}
"""Minimum and maximum of signals that have bounds."""
