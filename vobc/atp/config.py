"""Settings of protection: margins, worst-case assumptions and input timeouts."""

from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Final

from firmware_py.settings import check_ranges

TIMEOUT_S: Final = (0.02, 5.0)
"""Plausible range of each timeout."""


@dataclass(frozen=True, slots=True)
class Timeouts:
    """Age beyond which an input counts as lost."""

    tacho_s: float
    brake_s: float
    traction_s: float
    doors_s: float
    desk_s: float
    tag_reader_s: float
    alarms_s: float

    def __post_init__(self) -> None:
        check_ranges(self, {each.name: TIMEOUT_S for each in fields(self)})


@dataclass(frozen=True, slots=True)
class AtpConfig:
    warning_margin_mps: float
    """Margins over the permitted speed. Reaching a margin counts as exceeding it."""
    service_margin_mps: float
    emergency_margin_mps: float
    guaranteed_decel_mps2: float
    """Guaranteed emergency brake rate on level track (GEBR)."""
    runaway_mps2: float
    """Greatest acceleration by traction in the runaway phase."""
    sensing_s: float
    """Delay from a movement of the wheel to the first cycle that can see it."""
    traction_cut_s: float
    """Delay from the cut-off command to the end of tractive effort."""
    brake_build_up_s: float
    """Delay from the end of traction until the guaranteed brake rate counts as fully effective."""
    interval_step_m: float
    """Step to which the width of the front interval is rounded up where the gradient changes."""
    replica_band_mps: float
    """Permitted difference between the two computations of the emergency limit."""
    replica_cycles_max: int
    """Number of successive cycles in which the difference may be larger."""
    service_lead_s: float
    """Lead of the service brake: time before the train would reach the emergency curve."""
    warning_lead_s: float
    """Lead of the warning before the service brake."""
    permitted_lead_s: float
    """Lead of the permitted speed before the warning."""
    authority_age_max_s: float
    """Age of an authority from which the emergency brake applies."""
    authority_service_ratio: float
    """Share of that age from which the service brake applies."""
    orders_age_max_s: float
    """Age of orders from which the centre counts as silent. Its last restrictions and an emergency
    that it ordered stay in force."""
    rollback_m: float
    held_movement_m: float
    """Movement beyond which a train that should be held counts as moving."""
    overruns_max: int
    """Number of successive missed cycles that are tolerated."""
    clock_tolerance_s: float
    """Tolerated difference between the interval of two cycles and the value expected from cycle
    time and missed cycles."""
    brake_unit_s: float
    """How long the brake unit may continuously report the emergency brake after its release."""
    restricted_mps: float
    """Speed on sight, with a person at the desk, or with bypassed doors."""
    creep_mps: float
    """Speed on sight without a driver."""
    jog_mps: float
    """Speed of a jog, forwards or backwards, to a stopping point that was missed."""
    flat_warning_margin_mps: float
    """Margins over the three fixed speeds above. These ceilings need no known place."""
    flat_service_margin_mps: float
    flat_emergency_margin_mps: float
    takeover_margin_mps: float
    """Difference below its permitted speed at which full supervision takes over a moving train."""
    jog_m: float
    """Greatest distance of one jog."""
    jog_attempts: int
    """Greatest number of jogs at one stop."""
    overshoot_m: float
    """Distance past the stopping point from which the emergency brake applies."""
    overshoot_mended_m: float
    """Overshoot up to which a jog may correct the stop. The emergency brake then releases itself at
    standstill."""
    stop_patience_s: float
    """Time that operation has to begin a stop after a request to stop now."""
    stop_decel_mps2: float
    """Least deceleration that protection expects after that time. Otherwise it brakes itself."""
    door_window_m: float
    """Doors open only if the whole front interval is this close to the stopping point."""
    timeouts: Timeouts
    restrictions_age_max_s: float = 60.0
    """Age of orders up to which their restrictions count as complete. The service and emergency
    brake apply at the same shares of it as of the age of an authority. The centre must assume that
    long that a train does not know a new restriction. A train without news has time to stop with
    the service brake."""

    def __post_init__(self) -> None:
        check_ranges(self, RANGES)
        if not self.warning_margin_mps < self.service_margin_mps < self.emergency_margin_mps:
            raise ValueError(
                "warning_margin_mps < service_margin_mps < emergency_margin_mps does not hold"
            )
        flat = (
            self.flat_warning_margin_mps,
            self.flat_service_margin_mps,
            self.flat_emergency_margin_mps,
        )
        if not flat[0] < flat[1] < flat[2]:
            raise ValueError(
                "flat_warning_margin_mps < flat_service_margin_mps < flat_emergency_margin_mps "
                "does not hold"
            )
        if self.overshoot_m > self.overshoot_mended_m:
            raise ValueError(
                f"overshoot_m {self.overshoot_m} is more than "
                f"overshoot_mended_m {self.overshoot_mended_m}"
            )

    def runaway_s(self, cycle_s: float) -> float:
        """Time from reaching a speed until traction is certainly cut.

        The speed may be reached just after a cycle has sampled it. Then as many cycles may be
        missed as are tolerated in a row.
        """
        return self.sensing_s + (1 + self.overruns_max) * cycle_s + self.traction_cut_s


RANGES: Final[Mapping[str, tuple[float, float]]] = {
    "warning_margin_mps": (0.1, 3.0),
    "service_margin_mps": (0.1, 4.0),
    "emergency_margin_mps": (0.1, 5.0),
    "guaranteed_decel_mps2": (0.3, 2.5),
    "runaway_mps2": (0.0, 2.5),
    "sensing_s": (0.0, 0.5),
    "traction_cut_s": (0.0, 2.0),
    "brake_build_up_s": (0.0, 4.0),
    "interval_step_m": (0.01, 10.0),
    "replica_band_mps": (0.001, 0.5),
    "replica_cycles_max": (0, 10),
    "service_lead_s": (0.0, 5.0),
    "warning_lead_s": (0.0, 5.0),
    "permitted_lead_s": (0.0, 5.0),
    "authority_age_max_s": (0.5, 15.0),
    "authority_service_ratio": (0.1, 1.0),
    "orders_age_max_s": (0.5, 30.0),
    "restrictions_age_max_s": (1.0, 300.0),
    "rollback_m": (0.1, 2.0),
    "held_movement_m": (0.1, 2.0),
    "overruns_max": (0, 5),
    "clock_tolerance_s": (0.01, 1.0),
    "brake_unit_s": (0.0, 10.0),
    "restricted_mps": (0.5, 12.0),
    "creep_mps": (0.5, 8.0),
    "jog_mps": (0.2, 2.0),
    "flat_warning_margin_mps": (0.05, 2.0),
    "flat_service_margin_mps": (0.05, 3.0),
    "flat_emergency_margin_mps": (0.05, 4.0),
    "takeover_margin_mps": (0.0, 5.0),
    "jog_m": (0.5, 10.0),
    "jog_attempts": (0, 10),
    "overshoot_m": (0.2, 10.0),
    "overshoot_mended_m": (0.2, 10.0),
    "stop_patience_s": (0.0, 15.0),
    "stop_decel_mps2": (0.05, 1.5),
    "door_window_m": (0.05, 1.0),
}
"""Plausible range of each value. Beyond it the value is a slip of the pen or of the unit."""
