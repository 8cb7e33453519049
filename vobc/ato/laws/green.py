"""Green CBTC ([Lin]): the timing target speed, adjusted by the voltage at the pantograph.

V_top and V_time are those of `timing`. A voltage above the standard one shows that another train
brakes nearby, and the train speeds up to use the regenerated power. At a low voltage it slows down.
Without a voltage, a timetable or time to spare it acts like the law `timing`.
"""

import math

from vobc.ato.laws import green_speeds
from vobc.ato.laws.law import Target
from vobc.ato.laws.timing import NS_PER_S, TimedRun, TimingState
from vobc.vocabulary import AtoInput


class GreenRun(TimedRun):
    __slots__ = ()

    def _timing_mps(self, inputs: AtoInput, target: Target) -> float:
        if not self._config.green.literal_time or target.due_ns is None:
            return super()._timing_mps(inputs, target)
        left_s = (target.due_ns - inputs.now_ns) / NS_PER_S
        return green_speeds.literal_timing_speed_mps(
            target.at_m - inputs.front_m, left_s, self._config.timing.decel_mps2
        )

    def _combined_mps(self, inputs: AtoInput, top_mps: float, timing_mps: float) -> float:
        """Target speed by equation (12)."""
        settings = self._config.green
        voltage_v = settings.constant_v or inputs.line_voltage_v
        if voltage_v is None or self.state is not TimingState.AUTOMATIC or math.isinf(timing_mps):
            return min(top_mps, timing_mps)
        energy_mps = self._energy_mps(inputs, voltage_v)
        if settings.literal_target and (timing_mps >= top_mps or energy_mps >= top_mps):
            return top_mps
        return green_speeds.target_speed_mps(
            top_mps,
            timing_mps,
            energy_mps,
            alpha_ratio=settings.alpha_ratio,
            beta_ratio=settings.beta_ratio,
        )

    def _energy_mps(self, inputs: AtoInput, voltage_v: float) -> float:
        settings = self._config.green
        current_a = green_speeds.arm_current_a(
            voltage_v,
            settings.standard_v,
            feed_factor=settings.feed_factor,
            arm_ohm=settings.arm_ohm,
            train_count=settings.train_count_factor,
            exponent=settings.exponent_factor,
        )
        rotating_ratio = self._config.rotating_mass_percent / 100.0
        return green_speeds.energy_speed_mps(
            max(0.0, self.speed_mps),
            settings.tare_kg * (1.0 + rotating_ratio) + inputs.load_kg,
            voltage_v,
            current_a,
            standard_w=settings.standard_v * settings.standard_a,
            horizon_s=settings.horizon_s,
        )
