"""True properties of the brakes."""

import math
from dataclasses import dataclass
from enum import Enum

from plant_emulator.train_config.ranges import Spread, check, check_spread
from plant_emulator.train_config.tables import EfficiencyMap, EffortPoint, check_effort


class DeadTimeKind(Enum):
    """Which changes of the demand the dead time of the service brake delays."""

    TRANSPORT = "transport"
    """Delay every change of the demand, by the same time within one application."""
    APPLICATION = "application"
    """Delay only the first build-up; an applied brake follows at once."""


@dataclass(frozen=True, slots=True)
class ElectricBrakeConfig:
    """The electric brake. It fades out towards the stop, where friction takes over."""

    share_ratio: float
    """Largest share of the service brake's force that the motors take."""
    max_force_n: float
    max_power_w: float
    fade_begin_mps: float
    fade_end_mps: float
    """Speed below which the electric brake gives no force."""
    efficiency_ratio: float
    """Share of the electric brake's power at the rail that reaches the line."""
    effort: tuple[EffortPoint, ...] = ()
    """Greatest force over speed. It replaces greatest force and power, but not the fading."""
    efficiency: EfficiencyMap | None = None
    """Efficiency by speed and load. It replaces `efficiency_ratio`."""

    def __post_init__(self) -> None:
        check_effort(self.effort)
        check(self, "share_ratio", 0.0, 1.0)
        check(self, "max_force_n", 0.0, 1.0e7)
        check(self, "max_power_w", 0.0, 1.0e8)
        check(self, "fade_end_mps", 0.01, 100.0)
        check(self, "fade_begin_mps", 0.01, 100.0)
        check(self, "efficiency_ratio", 0.0, 1.0)
        if self.fade_end_mps >= self.fade_begin_mps:
            raise ValueError(
                f"fade_end_mps {self.fade_end_mps} is not under "
                f"fade_begin_mps {self.fade_begin_mps}"
            )


@dataclass(frozen=True, slots=True)
class PneumaticConfig:
    """Build-up of friction when it takes its share over, in addition to that of the service
    brake.
    """

    dead_time_s: Spread
    """Dead time, sampled once a run."""
    lag_s: float
    gain_ratio: Spread
    """Share of its demand that friction gives, sampled once a run."""

    def __post_init__(self) -> None:
        check_spread(self, "dead_time_s", 0.0, 5.0)
        check(self, "lag_s", 0.0, 5.0)
        check_spread(self, "gain_ratio", 0.1, 2.0)


@dataclass(frozen=True, slots=True)
class ServiceBrakeConfig:
    """The service brake.

    It compensates the load, so decelerations hold for any load on level track.
    """

    max_decel_mps2: float
    dead_time_kind: DeadTimeKind
    dead_time_s: Spread
    """Dead time, sampled for each application. An application starts when the demand rises from
    zero."""
    lag_s: Spread
    """First-order build-up after the dead time, sampled once a run."""
    gain_ratio: Spread
    """Share of the demanded deceleration that the train gets, sampled once a run."""
    electric: ElectricBrakeConfig
    pneumatic: PneumaticConfig

    def __post_init__(self) -> None:
        check(self, "max_decel_mps2", 0.1, 3.0)
        check_spread(self, "dead_time_s", 0.0, 5.0)
        check_spread(self, "lag_s", 0.0, 5.0)
        check_spread(self, "gain_ratio", 0.1, 2.0)


@dataclass(frozen=True, slots=True)
class EmergencyBrakeConfig:
    """Friction brake on a separate line. It applies when the command goes missing."""

    decel_mps2: float
    dead_time_s: float
    lag_s: float
    """Lag. With the dead time it gives 10 % of the force after dead + 0.105 * lag, at most 0.5 s,
    and 90 % after dead + 2.303 * lag, at most 1.6 s."""
    release_s: float
    """Dead time of the release."""

    def __post_init__(self) -> None:
        check(self, "decel_mps2", 0.1, 3.0)
        check(self, "dead_time_s", 0.0, 0.5)
        check(self, "lag_s", 0.0, 1.0)
        check(self, "release_s", 0.0, 5.0)
        tenth_s = self.dead_time_s - self.lag_s * math.log(0.9)
        most_s = self.dead_time_s - self.lag_s * math.log(0.1)
        if tenth_s > 0.5 or most_s > 1.6:
            raise ValueError(
                f"dead_time_s {self.dead_time_s} and lag_s {self.lag_s} give 10 % after "
                f"{tenth_s:.2f} s and 90 % after {most_s:.2f} s; allowed are 0.5 s and 1.6 s"
            )


@dataclass(frozen=True, slots=True)
class HoldingBrakeConfig:
    decel_mps2: float
    """Deceleration it can give; at least 0.3, so that a full train holds on 30 permille."""
    dead_time_s: float
    lag_s: float
    engage_under_mps: float
    """Speed below which the holding brake engages on a moving train."""

    def __post_init__(self) -> None:
        check(self, "decel_mps2", 0.3, 3.0)
        check(self, "dead_time_s", 0.0, 5.0)
        check(self, "lag_s", 0.0, 5.0)
        check(self, "engage_under_mps", 0.0, 5.0)


@dataclass(frozen=True, slots=True)
class BrakeConfig:
    service: ServiceBrakeConfig
    emergency: EmergencyBrakeConfig
    holding: HoldingBrakeConfig
    full_pressure_kpa: float
    """Cylinder pressure at the emergency brake's deceleration."""

    def __post_init__(self) -> None:
        check(self, "full_pressure_kpa", 1.0, 1000.0)
