"""Sensors without contact to the wheels: Doppler radar and accelerometer."""

from typing import Final

from can_dbc.odometer import Doppler, Imu
from plant_emulator.noise import Gaussian, Generators, NoiseSource
from plant_emulator.train_config import SensorConfig

GOOD_QUALITY_PERCENT: Final = 95.0


class DopplerRadar:
    """Doppler radar that measures the first car's speed over ground."""

    __slots__ = ("_blind_mps", "_noise", "_scale", "blind", "wrong_ratio")

    def __init__(self, config: SensorConfig, generators: Generators) -> None:
        draws = generators.of
        self._scale = 1.0 + config.doppler_error_ratio.draw(draws(NoiseSource.DOPPLER_SCALE))
        self._noise = Gaussian(draws(NoiseSource.DOPPLER_NOISE), config.doppler_sigma_mps)
        self._blind_mps = config.doppler_blind_mps
        self.blind = False
        """A fault: the radar receives no echo from the ground."""
        self.wrong_ratio = 1.0
        """A fault: factor on the measured speed, noise excluded."""

    def reseed(self, generators: Generators) -> None:
        self._noise.reseed(generators.of(NoiseSource.DOPPLER_NOISE))

    def frame(self, speed_mps: float) -> Doppler:
        noise_mps = self._noise.draw()
        if self.blind or abs(speed_mps) < self._blind_mps:
            return Doppler(speed_mps=0.0, quality_percent=0.0, healthy=True)
        return Doppler(
            speed_mps=speed_mps * self._scale * self.wrong_ratio + noise_mps,
            quality_percent=GOOD_QUALITY_PERCENT,
            healthy=True,
        )


class Accelerometer:
    """Accelerometer that reports the mean of the first car's acceleration plus gravity since its
    last frame.
    """

    __slots__ = ("_before_mps", "_before_ns", "_bias_mps2", "_noise", "_own_bias_mps2")

    def __init__(self, config: SensorConfig, generators: Generators, start_ns: int) -> None:
        draws = generators.of
        self._own_bias_mps2 = config.imu_bias_mps2.draw(draws(NoiseSource.IMU_BIAS))
        self._bias_mps2 = self._own_bias_mps2
        self._noise = Gaussian(draws(NoiseSource.IMU_NOISE), config.imu_sigma_mps2)
        self._before_mps = 0.0
        self._before_ns = start_ns

    def reseed(self, generators: Generators) -> None:
        self._noise.reseed(generators.of(NoiseSource.IMU_NOISE))

    def shift(self, bias_mps2: float) -> None:
        """A fault: add this to the sensor's own bias."""
        self._bias_mps2 = self._own_bias_mps2 + bias_mps2

    def frame(self, now_ns: int, speed_mps: float, slope_mps2: float) -> Imu:
        """Args:
        slope_mps2: gravity along the track under the first car, positive where it climbs.
        """
        gone_ns = now_ns - self._before_ns
        change_mps = speed_mps - self._before_mps
        self._before_mps, self._before_ns = speed_mps, now_ns
        accel_mps2 = change_mps * 1.0e9 / gone_ns if gone_ns > 0 else 0.0
        return Imu(
            accel_mps2=accel_mps2 + slope_mps2 + self._bias_mps2 + self._noise.draw(), healthy=True
        )
