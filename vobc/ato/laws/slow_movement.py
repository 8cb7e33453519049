"""Slow movements: jogs to a missed stopping point, in either direction, and creeping on sight."""

from typing import Final

from vobc.ato.laws.law import Drive
from vobc.ato.motion import gradient
from vobc.ato.motion.pid import Pid
from vobc.ato.settings.ato import AtoConfig
from vobc.vocabulary import AtoInput

LAST_MPS: Final = 0.12
"""Speed at the end of a jog. An error in the brake's delay then costs only centimetres."""
SPEED_PER_M: Final = 0.06
"""Increase of a jog's speed per metre of remaining distance."""
JOG_MPS: Final = 0.35
"""Greatest reference speed of a jog. 5 km/h are permitted."""
JOG_ACCEL_MPS2: Final = 0.15
STOP_DECEL_MPS2: Final = 0.25
"""Deceleration that ends a jog."""
DELAY_S: Final = 0.75
"""Assumed delay from the demand to the brake effort: the mean of typical brakes."""
ROLLING_MPS2: Final = 0.012
"""Running resistance at low speed."""
OVER_MPS: Final = 0.1
"""Excess over the reference at which a jog brakes. Below it the train coasts, because each
application of the brake costs a delay."""
CREEP_ACCEL_MPS2: Final = 0.4
CREEP_DECEL_MPS2: Final = 0.65
LEAST_CREEP_MPS: Final = 0.5
"""Reference below which a creeping train is brought to rest."""


class SlowDrive:
    """Speed control with a reference that rises and falls steadily.

    Speed, distance and demand count along the movement, in either direction.
    """

    __slots__ = ("_config", "_pid", "_reference_mps", "ending")

    def __init__(self, config: AtoConfig) -> None:
        self._config = config
        self._pid = Pid()
        self._reference_mps = 0.0
        self.ending = False
        """The train is being brought to rest, and this movement does not continue."""

    def begin(self, speed_mps: float) -> None:
        self._pid.reset()
        self._reference_mps = max(0.0, speed_mps)
        self.ending = False

    def end(self) -> None:
        self.ending = True

    def jog(self, inputs: AtoInput, distance_m: float, *, reverse: bool) -> Drive:
        """Move to a point `distance_m` away along the movement."""
        speed_mps = -inputs.speed_mps if reverse else inputs.speed_mps
        if distance_m <= self._stopping_m(max(0.0, speed_mps)):
            self.ending = True
        if self.ending:
            return Drive(-STOP_DECEL_MPS2, 0.0, True)
        target_mps = min(JOG_MPS, LAST_MPS + SPEED_PER_M * distance_m)
        self._approach(target_mps, inputs.dt_s, rise_mps2=JOG_ACCEL_MPS2, fall_mps2=JOG_ACCEL_MPS2)
        demand_mps2 = self._control(inputs, speed_mps, reverse=reverse)
        if demand_mps2 < 0.0 and speed_mps <= self._reference_mps + OVER_MPS:
            demand_mps2 = 0.0
        return Drive(demand_mps2, self._reference_mps, False)

    def creep(self, inputs: AtoInput) -> Drive:
        """Move below the ceiling without a known place. Come to rest where nothing is permitted."""
        target_mps = max(0.0, inputs.ceiling_mps - self._config.speed.margin_mps)
        self._approach(
            target_mps, inputs.dt_s, rise_mps2=CREEP_ACCEL_MPS2, fall_mps2=CREEP_DECEL_MPS2
        )
        self.ending = target_mps < LEAST_CREEP_MPS
        if self.ending:
            return Drive(-CREEP_DECEL_MPS2, self._reference_mps, True)
        demand_mps2 = self._control(inputs, inputs.speed_mps, reverse=False)
        return Drive(demand_mps2, self._reference_mps, False)

    def _stopping_m(self, speed_mps: float) -> float:
        brake = self._config.brake
        ramp_s = STOP_DECEL_MPS2 / self._config.limits.jerk_mps3
        delay_s = DELAY_S + brake.lag_s + ramp_s / 2.0
        return speed_mps * (delay_s + speed_mps / (2.0 * STOP_DECEL_MPS2))

    def _approach(
        self, target_mps: float, dt_s: float, *, rise_mps2: float, fall_mps2: float
    ) -> None:
        low_mps = self._reference_mps - fall_mps2 * dt_s
        high_mps = self._reference_mps + rise_mps2 * dt_s
        self._reference_mps = min(high_mps, max(low_mps, target_mps))

    def _control(self, inputs: AtoInput, speed_mps: float, *, reverse: bool) -> float:
        config = self._config
        uphill_mps2 = gradient.decel_on_mps2(config, inputs.gradient_permille)
        ahead_mps2 = (-uphill_mps2 if reverse else uphill_mps2) + ROLLING_MPS2
        limit_mps2 = config.limits.accel_mps2
        return ahead_mps2 + self._pid.step(
            config.speed.rising,
            self._reference_mps - speed_mps,
            inputs.dt_s,
            low_mps2=-limit_mps2 - ahead_mps2,
            high_mps2=limit_mps2 - ahead_mps2,
        )
