"""True properties of the sensors."""

from dataclasses import dataclass
from typing import Final

from plant_emulator.train_config.ranges import Spread, check, check_spread

NOMINAL_WHEEL_M: Final = 0.860
PULSES_PER_TURN: Final = 256


@dataclass(frozen=True, slots=True)
class TachoConfig:
    car: int
    """Number of the car that carries the axle, counted from 1 at the front."""
    wheel_diameter_m: float
    """Diameter of the worn wheel; the nominal wheel has NOMINAL_WHEEL_M."""

    def __post_init__(self) -> None:
        check(self, "wheel_diameter_m", 0.5, 1.2)


@dataclass(frozen=True, slots=True)
class SensorConfig:
    odometer_error_ratio: Spread
    """Scale error on both axles, sampled once a run: counted distance = true distance * (1 +
    error)."""
    tachos: tuple[TachoConfig, TachoConfig]
    """Tacho A and tacho B."""
    doppler_error_ratio: Spread
    doppler_sigma_mps: float
    doppler_blind_mps: float
    imu_bias_mps2: Spread
    imu_sigma_mps2: float
    antenna_m: float
    """Distance of the tag antenna's centre behind the front coupler."""
    tag_sigma_m: float
    tag_clip_m: float
    tag_stamp_s: Spread
    """Error of the time stamp at the antenna's centre."""
    tag_latency_s: Spread
    """Delay from the antenna's centre to the first byte on the line."""
    pulses_per_turn: int = PULSES_PER_TURN
    """Resolution of both tachos. The controller assumes `train.pulses_per_turn`."""

    def __post_init__(self) -> None:
        check(self, "pulses_per_turn", 16, 1024)
        check_spread(self, "odometer_error_ratio", -0.2, 0.2)
        check_spread(self, "doppler_error_ratio", -0.2, 0.2)
        check(self, "doppler_sigma_mps", 0.0, 10.0)
        check(self, "doppler_blind_mps", 0.0, 10.0)
        check_spread(self, "imu_bias_mps2", -2.0, 2.0)
        check(self, "imu_sigma_mps2", 0.0, 10.0)
        check(self, "antenna_m", 0.0, 100.0)
        check(self, "tag_sigma_m", 0.0, 1.0)
        check(self, "tag_clip_m", 0.0, 1.0)
        check_spread(self, "tag_stamp_s", -0.1, 0.1)
        check_spread(self, "tag_latency_s", 0.0, 1.0)
