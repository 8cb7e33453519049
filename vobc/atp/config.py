"""What protection is set to: margins, the worst case it reckons with, how long silence may last."""

from dataclasses import dataclass, fields


@dataclass(frozen=True, slots=True)
class Timeouts:
    """An input older than this counts as lost."""

    tacho_s: float
    brake_s: float
    traction_s: float
    doors_s: float
    desk_s: float
    tag_reader_s: float
    alarms_s: float

    def __post_init__(self) -> None:
        for each in fields(self):
            if getattr(self, each.name) <= 0.0:
                raise ValueError(f"{each.name} {getattr(self, each.name)} is not positive")


@dataclass(frozen=True, slots=True)
class AtpConfig:
    warning_margin_mps: float
    """Over the permitted speed; reaching a margin counts as exceeding it."""
    service_margin_mps: float
    emergency_margin_mps: float
    guaranteed_decel_mps2: float
    """Guaranteed emergency brake rate on level track (GEBR)."""
    runaway_mps2: float
    """Most that traction gives while it should not."""
    sensing_s: float
    """From a movement of the wheel to the cycle that may know of it."""
    traction_cut_s: float
    """From the command to no tractive effort."""
    brake_build_up_s: float
    """From then on until the guaranteed rate counts as there from the first moment."""
    interval_step_m: float
    """Over changing gradients the front interval counts as wide as the next multiple of this."""
    replica_band_mps: float
    """The two computations of the emergency limit may differ by so much."""
    replica_cycles_max: int
    """In so many cycles in a row they may differ by more."""
    service_lead_s: float
    """Service braking begins so long before the train would reach the emergency curve."""
    warning_lead_s: float
    """The warning so long before service braking."""
    permitted_lead_s: float
    """The permitted speed lies so long before the warning."""
    authority_age_max_s: float
    """An older authority brakes the train by emergency."""
    authority_service_ratio: float
    """Share of that age from which the service brake comes."""
    orders_age_max_s: float
    """Older orders mean that the centre is silent; an emergency it ordered lasts all the same."""
    rollback_m: float
    held_movement_m: float
    """A held train that moves farther than this is not held."""
    overruns_max: int
    """Cycles missed in a row that are still forgiven."""
    clock_tolerance_s: float
    """A cycle may come so much sooner or later than cycle time and missed cycles explain."""
    brake_unit_s: float
    """So long after its release the brake unit may report the emergency brake without a break."""
    restricted_mps: float
    """On sight, with a person at the desk, or with doors that are bypassed."""
    creep_mps: float
    """On sight without a driver."""
    jog_mps: float
    """Up or back to a stopping point that was missed."""
    flat_warning_margin_mps: float
    """Over the three speeds above, where no place is needed to know the ceiling."""
    flat_service_margin_mps: float
    flat_emergency_margin_mps: float
    takeover_margin_mps: float
    """Full supervision takes over only so far under its permitted speed."""
    jog_m: float
    """One jog goes no farther."""
    jog_attempts: int
    """At one stop."""
    overshoot_m: float
    """Passing the stopping point by more brings the emergency brake."""
    overshoot_mended_m: float
    """Up to here a jog may mend it; the emergency brake releases itself at standstill."""
    stop_patience_s: float
    """Asked to stop now, operation may take so long to begin."""
    stop_decel_mps2: float
    """From then on it has to slow so much at least, or protection brakes."""
    door_window_m: float
    """Doors open only if the front surely stands so close to the stopping point."""
    timeouts: Timeouts

    def __post_init__(self) -> None:
        if not 0.0 < self.warning_margin_mps < self.service_margin_mps < self.emergency_margin_mps:
            raise ValueError(
                "0 < warning_margin_mps < service_margin_mps < emergency_margin_mps does not hold"
            )
        if not 0.0 < self.authority_service_ratio <= 1.0:
            raise ValueError(f"authority_service_ratio {self.authority_service_ratio} not in 0..1")
        flat = (
            self.flat_warning_margin_mps,
            self.flat_service_margin_mps,
            self.flat_emergency_margin_mps,
        )
        if not 0.0 < flat[0] < flat[1] < flat[2]:
            raise ValueError(
                "0 < flat_warning_margin_mps < flat_service_margin_mps < flat_emergency_margin_mps "
                "does not hold"
            )
        if self.overshoot_m > self.overshoot_mended_m:
            raise ValueError(
                f"overshoot_m {self.overshoot_m} is more than "
                f"overshoot_mended_m {self.overshoot_mended_m}"
            )
        for name in _POSITIVE:
            if getattr(self, name) <= 0.0:
                raise ValueError(f"{name} {getattr(self, name)} is not positive")
        for name in _NOT_NEGATIVE:
            if getattr(self, name) < 0.0:
                raise ValueError(f"{name} {getattr(self, name)} is negative")

    def runaway_s(self, cycle_s: float) -> float:
        """From reaching a speed until traction is surely cut.

        It may be reached just after a cycle has looked, and as many cycles may be missed before the
        next look as are forgiven in a row.
        """
        return self.sensing_s + (1 + self.overruns_max) * cycle_s + self.traction_cut_s


_POSITIVE = (
    "guaranteed_decel_mps2",
    "interval_step_m",
    "replica_band_mps",
    "authority_age_max_s",
    "orders_age_max_s",
    "clock_tolerance_s",
    "restricted_mps",
    "creep_mps",
    "jog_mps",
    "jog_m",
    "overshoot_m",
    "stop_decel_mps2",
    "rollback_m",
    "held_movement_m",
    "door_window_m",
)
_NOT_NEGATIVE = (
    "runaway_mps2",
    "sensing_s",
    "traction_cut_s",
    "brake_build_up_s",
    "service_lead_s",
    "warning_lead_s",
    "permitted_lead_s",
    "overruns_max",
    "replica_cycles_max",
    "brake_unit_s",
    "takeover_margin_mps",
    "jog_attempts",
    "stop_patience_s",
)
