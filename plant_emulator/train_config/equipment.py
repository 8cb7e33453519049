"""True properties of traction, wheels, doors and supply."""

from dataclasses import dataclass

from plant_emulator.train_config.ranges import check
from plant_emulator.train_config.tables import EfficiencyMap, EffortPoint, check_effort


@dataclass(frozen=True, slots=True)
class TractionConfig:
    rated_force_n: float
    """Force of all motors together, at the rail."""
    max_power_w: float
    """Power at the rail; force is at most power / speed."""
    effort_ratio: float
    """Share of rated force and power that is available after heat and failed motors."""
    dead_time_s: float
    lag_s: float
    slew_n_per_s: float
    cut_s: float
    """Time from losing the permission to the open contactor; at most 0.30 s."""
    efficiency_ratio: float
    effort: tuple[EffortPoint, ...] = ()
    """Greatest force over speed. It replaces rated force and power, which then only scale loads."""
    efficiency: EfficiencyMap | None = None
    """Efficiency by speed and load. It replaces `efficiency_ratio`."""

    def __post_init__(self) -> None:
        check_effort(self.effort)
        check(self, "rated_force_n", 1.0, 1.0e7)
        check(self, "max_power_w", 1.0, 1.0e8)
        check(self, "effort_ratio", 0.0, 1.0)
        check(self, "dead_time_s", 0.0, 5.0)
        check(self, "lag_s", 0.0, 5.0)
        check(self, "slew_n_per_s", 1.0, 1.0e12)
        check(self, "cut_s", 0.0, 0.30)
        check(self, "efficiency_ratio", 0.1, 1.0)


@dataclass(frozen=True, slots=True)
class RailConfig:
    """Wheel and rail. A wheel that is loaded beyond adhesion slips or slides."""

    adhesion_ratio: float
    """Adhesion: largest force along the rail divided by weight on the wheels."""
    slip_limit_ratio: float
    """Slip divided by train speed at which the wheel-slide protection limits it."""
    slip_limit_mps: float
    """Slip limit at low speed; the larger of the two limits counts."""
    slip_recovery_mps2: float
    """Rate at which wheels return to the train's speed."""

    def __post_init__(self) -> None:
        check(self, "adhesion_ratio", 0.005, 1.0)
        check(self, "slip_limit_ratio", 0.0, 1.0)
        check(self, "slip_limit_mps", 0.0, 10.0)
        check(self, "slip_recovery_mps2", 0.1, 100.0)


@dataclass(frozen=True, slots=True)
class DoorConfig:
    unlock_s: float
    """Time from the demand to the first movement."""
    open_s: float
    close_s: float
    """Time from the end of the demand to closed and locked."""
    obstructed_closings: int
    """Number of the first closings that meet an obstacle and reopen."""
    reopen_s: float
    """Time that the doors stay open after an obstacle before they try again."""

    def __post_init__(self) -> None:
        for name in ("unlock_s", "open_s", "close_s", "reopen_s"):
            check(self, name, 0.0, 60.0)
        if not 0 <= self.obstructed_closings <= 1000:
            raise ValueError(f"obstructed_closings {self.obstructed_closings} is not in 0..1000")


@dataclass(frozen=True, slots=True)
class ResistorConfig:
    """The brake resistor.

    It turns energy that the line does not accept into heat, up to its limits.
    """

    max_power_w: float
    heat_max_j: float
    """Heat capacity from cold to the hottest permitted state."""
    fade_s: float
    """Time constant of the power limit: the resistor never takes more power than would heat it
    fully within this time. Its power therefore falls slowly enough for friction to follow."""
    cool_s: float
    """Time constant of cooling."""

    def __post_init__(self) -> None:
        check(self, "max_power_w", 0.0, 1.0e8)
        check(self, "heat_max_j", 0.0, 1.0e10)
        check(self, "fade_s", 0.1, 1000.0)
        check(self, "cool_s", 1.0, 1.0e5)
        if self.max_power_w * self.fade_s > self.heat_max_j:
            raise ValueError(
                f"max_power_w {self.max_power_w:g} makes it hotter than heat_max_j "
                f"{self.heat_max_j:g} within fade_s {self.fade_s:g}"
            )


@dataclass(frozen=True, slots=True)
class SupplyConfig:
    """The line as one source behind a resistance, and the train's consumption besides traction."""

    no_load_v: float
    source_ohm: float
    full_effort_v: float
    """Voltage above which traction gives its full effort."""
    no_effort_v: float
    """Voltage below which traction gives no effort."""
    auxiliary_w: float
    resistor: ResistorConfig | None = None
    """Without a resistor the electric brake ends when the line is not receptive."""

    def __post_init__(self) -> None:
        check(self, "no_load_v", 1.0, 5000.0)
        check(self, "source_ohm", 0.0, 10.0)
        check(self, "full_effort_v", 1.0, 5000.0)
        check(self, "no_effort_v", 0.0, 5000.0)
        check(self, "auxiliary_w", 0.0, 1.0e7)
        if self.no_effort_v >= self.full_effort_v:
            raise ValueError(
                f"no_effort_v {self.no_effort_v} is not under full_effort_v {self.full_effort_v}"
            )
