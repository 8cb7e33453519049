"""Two tachos that count the pulses of two axles, with a systematic error and the slip of the
wheels.
"""

from math import floor, pi
from typing import Final

from can_dbc.nodes import Direction
from can_dbc.odometer import Tacho
from plant_emulator.noise import Generators, NoiseSource
from plant_emulator.train_config import NOMINAL_WHEEL_M, SensorConfig

COUNTER_PERIOD: Final = 1 << 16
COUNTER_B_PERIOD: Final = 1 << 10
STAMP_PERIOD_MS: Final = 1 << 8
NS_PER_MS: Final = 1_000_000
NEUTRAL_AFTER_NS: Final = 200_000_000
START_PHASE: Final = 0.5
"""The count starts half-way between two pulses, so that the smallest movement of a wheel gives
none."""


class Wheelset:
    """One wheelset with its pulse disc."""

    __slots__ = (
        "_base_m",
        "_own_pulses_per_m",
        "_phase",
        "_pulses_per_m",
        "_slipped_m",
        "_start_m",
        "added_pulses_per_s",
        "before_m",
        "forced_slip_ratio",
        "rolled_m",
    )

    def __init__(self, pulses_per_m: float, start_m: float) -> None:
        self._own_pulses_per_m = self._pulses_per_m = pulses_per_m
        self._base_m = 0.0
        self._phase = START_PHASE
        self._start_m = start_m
        self.forced_slip_ratio = 0.0
        """A fault: speed of the tread relative to the train as a share of the train's speed;
        negative slides."""
        self.added_pulses_per_s = 0.0
        """A fault: pulses that interference adds, negative against the running direction."""
        self._slipped_m = 0.0
        self.before_m = 0.0
        """Distance that the tread had rolled at the beginning of the last step."""
        self.rolled_m = 0.0

    def step(self, car_m: float, slip_mps: float, step_s: float) -> None:
        self.before_m = self.rolled_m
        if self.forced_slip_ratio != 0.0:
            speed_mps = (car_m - self._start_m + self._slipped_m - self.before_m) / step_s
            slip_mps = self._forced(slip_mps, speed_mps)
        if slip_mps != 0.0:
            self._slipped_m += slip_mps * step_s
        self.rolled_m = car_m - self._start_m + self._slipped_m
        if self.added_pulses_per_s != 0.0:
            self._phase += self.added_pulses_per_s * step_s

    def restart(self) -> None:
        """A fault: the count begins at 0 again."""
        self._base_m, self._phase = self.rolled_m, START_PHASE

    def count(self, rolled_m: float) -> int:
        """Return the number of pulses up to this rolled distance, without wrapping."""
        return floor((rolled_m - self._base_m) * self._pulses_per_m + self._phase)

    def rescale(self, ratio: float) -> None:
        """A fault: multiply the pulses per metre by this ratio from here on; a negative ratio
        counts as 0.

        Pulses counted before stay, including the fraction of a pulse.
        """
        self._phase += (self.rolled_m - self._base_m) * self._pulses_per_m
        self._base_m = self.rolled_m
        self._pulses_per_m = self._own_pulses_per_m * max(0.0, ratio)

    def _forced(self, own_mps: float, speed_mps: float) -> float:
        """Combine the slip of the fault with that of the rail.

        If both have the same sign the greater one counts; otherwise they add. A sliding tread stops
        at most. The slip therefore never jumps when the fault begins or ends.
        """
        forced_mps = self.forced_slip_ratio * speed_mps
        if own_mps * forced_mps > 0.0:
            slip_mps = forced_mps if abs(forced_mps) > abs(own_mps) else own_mps
        else:
            slip_mps = own_mps + forced_mps
        if slip_mps * speed_mps < 0.0 and abs(slip_mps) > abs(speed_mps):
            return -speed_mps
        return slip_mps


class Tachos:
    __slots__ = (
        "_cars",
        "_counts",
        "_directions",
        "_forgotten",
        "_last_pulse_ns",
        "_pulses_per_turn",
        "_started_ns",
        "_step_s",
        "axles",
        "error",
        "healthy",
    )

    def __init__(
        self,
        config: SensorConfig,
        generators: Generators,
        *,
        cars: int,
        front_m: float,
        step_s: float,
    ) -> None:
        """Args:
        cars: number of masses in the model. An axle on a car beyond them counts for the last mass.
        """
        self.error = config.odometer_error_ratio.draw(generators.of(NoiseSource.ODOMETER_SCALE))
        """Scale error: counted distance = true distance * (1 + error) for a wheel of nominal
        diameter."""
        self._pulses_per_turn = config.pulses_per_turn
        nominal = config.pulses_per_turn / (pi * NOMINAL_WHEEL_M) * (1.0 + self.error)
        self._cars = tuple(min(tacho.car, cars) - 1 for tacho in config.tachos)
        self.axles = tuple(
            Wheelset(nominal * NOMINAL_WHEEL_M / tacho.wheel_diameter_m, front_m)
            for tacho in config.tachos
        )
        self._step_s = step_s
        self._counts = [0, 0]
        self._directions = [Direction.NEUTRAL, Direction.NEUTRAL]
        self._last_pulse_ns = [-NEUTRAL_AFTER_NS, -NEUTRAL_AFTER_NS]
        self._forgotten = 0
        """Pulses of axle A before the last restart of the unit."""
        self._started_ns = 0
        """Zero of the unit's clock."""
        self.healthy = [True, True]
        """Health that each tacho reports of itself."""

    def step(self, car_fronts_m: list[float], slip_a_mps: float, slip_b_mps: float) -> None:
        car_a, car_b = self._cars
        axle_a, axle_b = self.axles
        axle_a.step(car_fronts_m[car_a], slip_a_mps, self._step_s)
        axle_b.step(car_fronts_m[car_b], slip_b_mps, self._step_s)

    @property
    def counted_m(self) -> float:
        """Distance by counter A since the start, for a wheel of nominal diameter."""
        axle = self.axles[0]
        pulses = self._forgotten + axle.count(axle.rolled_m)
        return pulses * pi * NOMINAL_WHEEL_M / self._pulses_per_turn

    def restart(self, now_ns: int) -> None:
        """A fault: the unit has restarted; counters and clock begin at 0."""
        axle = self.axles[0]
        self._forgotten += axle.count(axle.rolled_m)
        for each in self.axles:
            each.restart()
        self._counts = [0, 0]
        self._directions = [Direction.NEUTRAL, Direction.NEUTRAL]
        self._started_ns = now_ns

    def pulses_a(self, share_ratio: float) -> int:
        """Return counter A at this share of the last step, as the tag reader latches it."""
        axle = self.axles[0]
        rolled_m = axle.before_m + share_ratio * (axle.rolled_m - axle.before_m)
        return axle.count(rolled_m) % COUNTER_PERIOD

    def frame(self, now_ns: int) -> Tacho:
        """Build the odometer's frame.

        The direction is that of axle A, from the phase of its pulses.
        """
        for index, axle in enumerate(self.axles):
            count = axle.count(axle.rolled_m)
            if count != self._counts[index]:
                forward = count > self._counts[index]
                self._directions[index] = Direction.FORWARD if forward else Direction.REVERSE
                self._counts[index] = count
                self._last_pulse_ns[index] = now_ns
            elif now_ns - self._last_pulse_ns[index] >= NEUTRAL_AFTER_NS:
                self._directions[index] = Direction.NEUTRAL
        return Tacho(
            pulses_a=self._counts[0] % COUNTER_PERIOD,
            pulses_b=self._counts[1] % COUNTER_B_PERIOD,
            direction=self._directions[0],
            healthy_a=self.healthy[0],
            healthy_b=self.healthy[1],
            stamp_ms=float((now_ns - self._started_ns) // NS_PER_MS % STAMP_PERIOD_MS),
        )
