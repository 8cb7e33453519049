"""What traction, wheels, doors and supply really are."""

from dataclasses import dataclass

from plant_emulator.train_config.ranges import check


@dataclass(frozen=True, slots=True)
class TractionConfig:
    rated_force_n: float
    """Of all motors together, at the rail."""
    max_power_w: float
    """At the rail; force is at most power / speed."""
    effort_ratio: float
    """Share of rated force and power that heat and failed motors leave."""
    dead_time_s: float
    lag_s: float
    slew_n_per_s: float
    cut_s: float
    """From losing the permission to the open contactor. At most 0.30 s."""
    efficiency_ratio: float

    def __post_init__(self) -> None:
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
    """Wheel and rail. A wheel that is asked for more than adhesion slips or slides."""

    adhesion_ratio: float
    """Largest force along the rail over weight on the wheels."""
    slip_limit_ratio: float
    """Slip or slide over train speed at which the protection of the wheels catches it."""
    slip_limit_mps: float
    """The same at low speed; the larger one counts."""
    slip_recovery_mps2: float
    """How fast wheels find back to the train's speed."""

    def __post_init__(self) -> None:
        check(self, "adhesion_ratio", 0.005, 1.0)
        check(self, "slip_limit_ratio", 0.0, 1.0)
        check(self, "slip_limit_mps", 0.0, 10.0)
        check(self, "slip_recovery_mps2", 0.1, 100.0)


@dataclass(frozen=True, slots=True)
class DoorConfig:
    unlock_s: float
    """From the demand to the first movement."""
    open_s: float
    close_s: float
    """From the end of the demand to closed and locked."""
    obstructed_closings: int
    """How many of the first closings meet an obstacle and open again."""
    reopen_s: float
    """How long they stay open then, before they try again."""

    def __post_init__(self) -> None:
        for name in ("unlock_s", "open_s", "close_s", "reopen_s"):
            check(self, name, 0.0, 60.0)
        if not 0 <= self.obstructed_closings <= 1000:
            raise ValueError(f"obstructed_closings {self.obstructed_closings} is not in 0..1000")


@dataclass(frozen=True, slots=True)
class ResistorConfig:
    """The brake resistor: what a line does not take back becomes heat, as long as it bears that."""

    max_power_w: float
    heat_max_j: float
    """From cold to as hot as it may become."""
    fade_s: float
    """It never takes more power than would make it that hot within so long: what it bears fades
    away slowly enough for friction to follow."""
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
    """The line as one source behind a resistance, and what the train draws besides traction."""

    no_load_v: float
    source_ohm: float
    full_effort_v: float
    """Traction gives its full effort from here up."""
    no_effort_v: float
    """And nothing from here down."""
    auxiliary_w: float
    resistor: ResistorConfig | None = None
    """Without one the electric brake ends as soon as the line takes nothing back."""

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
