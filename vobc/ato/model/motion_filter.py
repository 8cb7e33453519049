"""Kalman filter of speed, unexplained acceleration and brake gains, in scalar form.

Under the brake, a wrong gain and a wrong resistance have the same effect at any one moment. They
separate when the demand changes. Until then their prior variances determine how an error is shared.
Friction that takes over from the motors has its own gain beside that of the whole brake.
"""

import math
from typing import Final

from vobc.ato.settings.ato import WEAK_RATIO

SPEED_SIGMA_MPS: Final = 0.03
"""Standard deviation of a measured speed, including oscillation of the coaches."""
DISTURBANCE_WALK: Final = 0.004**2
"""Growth of the disturbance variance in (m/s²)² per second, as resistance changes with speed."""
DISTURBANCE_SIGMA_MPS2: Final = 0.03
DISTURBANCE_RENEWED_MPS2: Final = 0.015
"""Standard deviation at the start of an application: resistance, wind and map errors."""
GAIN_WALK: Final = 0.002**2
FRICTION_SIGMA_RATIO: Final = 0.13
"""Standard deviation of friction relative to the whole brake."""
SURPRISE_MPS: Final = 0.25
"""Speed error that neither brake nor track can cause. It means that another source brakes."""
SURPRISE_COST: Final = 100.0
"""Cost of a hypothesis with such an error, from which it does not learn."""
BLIND_MPS: Final = 0.08
"""Speed below which measurements are too old to be used, as the train soon stands. A held train
says nothing about its brake."""
GAIN_MAX_RATIO: Final = 0.3
DISTURBANCE_MAX_MPS2: Final = 0.5
GAIN_REFUSED_RATIO: Final = 0.25
"""Gain deviation from which the brake is faulty. Its estimate is discarded after the application.
"""
GAIN_RENEWED_RATIO: Final = 0.02
"""Least standard deviation at the start of an application, as the load may have changed."""


class MotionFilter:
    __slots__ = (
        "_dd",
        "_dg",
        "_dh",
        "_dt_s",
        "_gain_sigma_ratio",
        "_gg",
        "_gh",
        "_hh",
        "_vd",
        "_vg",
        "_vh",
        "_vv",
        "disturbance_mps2",
        "friction_ratio",
        "gain_ratio",
        "speed_mps",
    )

    def __init__(self, dt_s: float, gain_sigma_ratio: float = -WEAK_RATIO / 2.0) -> None:
        """`gain_sigma_ratio`: standard deviation of the gain before it was measured."""
        self._dt_s = dt_s
        self._gain_sigma_ratio = gain_sigma_ratio
        self.gain_ratio = 0.0
        """Relative excess of the brake over the demand."""
        self.friction_ratio = 0.0
        """Further relative excess of its friction."""
        self._gg = self._gain_sigma_ratio**2
        self._hh = FRICTION_SIGMA_RATIO**2
        self.start(0.0)

    def start(self, speed_mps: float) -> None:
        """Begin with a known speed and no disturbance. The gains are kept."""
        self.speed_mps = speed_mps
        self.disturbance_mps2 = 0.0
        self._vv = SPEED_SIGMA_MPS**2
        self._dd = DISTURBANCE_SIGMA_MPS2**2
        self._vd = self._vg = self._vh = self._dg = self._dh = self._gh = 0.0

    def forget(self, speed_mps: float) -> None:
        """Discard the estimates, because another source moved the train."""
        self.gain_ratio = self.friction_ratio = 0.0
        self._gg = self._gain_sigma_ratio**2
        self._hh = FRICTION_SIGMA_RATIO**2
        self.start(speed_mps)

    @property
    def least_gain_ratio(self) -> float:
        """Two standard deviations below the estimated gain."""
        return self.gain_ratio - 2.0 * math.sqrt(max(self._gg, GAIN_RENEWED_RATIO**2))

    @property
    def most_gain_ratio(self) -> float:
        """Two standard deviations above the estimated gain."""
        return self.gain_ratio + 2.0 * math.sqrt(max(self._gg, GAIN_RENEWED_RATIO**2))

    def copy(self, other: "MotionFilter") -> None:
        """Continue from the state of another filter."""
        self.speed_mps, self.disturbance_mps2 = other.speed_mps, other.disturbance_mps2
        self.gain_ratio, self.friction_ratio = other.gain_ratio, other.friction_ratio
        self._vv, self._vd, self._vg, self._vh = other._vv, other._vd, other._vg, other._vh
        self._dd, self._dg, self._dh = other._dd, other._dg, other._dh
        self._gg, self._gh, self._hh = other._gg, other._gh, other._hh

    def renew_disturbance(self) -> None:
        """Learn the disturbance quickly again, because the brake no longer hides it."""
        self._vd = self._dg = self._dh = 0.0
        self._dd = DISTURBANCE_SIGMA_MPS2**2

    def renew_gain(self) -> None:
        """Begin a new application. The estimates of a faulty brake are discarded."""
        if abs(self.gain_ratio) >= GAIN_REFUSED_RATIO:
            self.gain_ratio = 0.0
            self._gg = self._gain_sigma_ratio**2
        if abs(self.friction_ratio) >= GAIN_REFUSED_RATIO:
            self.friction_ratio = 0.0
        self._vh = self._dh = self._gh = 0.0
        self._gg = max(self._gg, GAIN_RENEWED_RATIO**2)
        self._hh = FRICTION_SIGMA_RATIO**2
        # Under traction the disturbance also contained traction errors.
        self.disturbance_mps2 = self._vd = self._dg = self._dh = 0.0
        self._dd = DISTURBANCE_RENEWED_MPS2**2

    def step(
        self,
        measured_mps: float,
        *,
        push_mps2: float,
        braked_mps2: float,
        friction_mps2: float = 0.0,
        blur_m2_per_s2: float = 0.0,
    ) -> float:
        """One cycle. The result is the squared error of the measured speed in standard deviations.

        Args:
            push_mps2: known acceleration.
            braked_mps2: brake demand.
            friction_mps2: part of it that late friction provides.
            blur_m2_per_s2: additional variance of the speed in (m/s)² after this cycle.
        """
        dt_s = self._dt_s
        self._vv += blur_m2_per_s2
        self.speed_mps += (
            push_mps2
            - braked_mps2 * (1.0 + self.gain_ratio)
            - friction_mps2 * self.friction_ratio
            + self.disturbance_mps2
        ) * dt_s
        self._spread(dt_s, -braked_mps2 * dt_s, -friction_mps2 * dt_s)
        if measured_mps < BLIND_MPS and self.speed_mps < 2.0 * BLIND_MPS:
            self.speed_mps = max(0.0, self.speed_mps)
            return 0.0
        innovation_mps = measured_mps - self.speed_mps
        if abs(innovation_mps) > SURPRISE_MPS:
            return SURPRISE_COST
        vv, vd, vg, vh = self._vv, self._vd, self._vg, self._vh
        weight = 1.0 / (vv + SPEED_SIGMA_MPS * SPEED_SIGMA_MPS)
        share = weight * innovation_mps
        self.speed_mps += vv * share
        self.disturbance_mps2 = _within(self.disturbance_mps2 + vd * share, DISTURBANCE_MAX_MPS2)
        self.gain_ratio = _within(self.gain_ratio + vg * share, GAIN_MAX_RATIO)
        self.friction_ratio = _within(self.friction_ratio + vh * share, GAIN_MAX_RATIO)
        self._vv = vv - vv * weight * vv
        self._vd = vd - vv * weight * vd
        self._vg = vg - vv * weight * vg
        self._vh = vh - vv * weight * vh
        self._dd -= vd * weight * vd
        self._dg -= vd * weight * vg
        self._dh -= vd * weight * vh
        self._gg -= vg * weight * vg
        self._gh -= vg * weight * vh
        self._hh -= vh * weight * vh
        return share * innovation_mps

    def _spread(self, by_d: float, by_g: float, by_h: float) -> None:
        """Covariance after one cycle with the given influence of disturbance and gains on the
        speed.
        """
        vd, vg, vh = self._vd, self._vg, self._vh
        dg, dh, gh = self._dg, self._dh, self._gh
        new_vd = vd + by_d * self._dd + by_g * dg + by_h * dh
        new_vg = vg + by_d * dg + by_g * self._gg + by_h * gh
        new_vh = vh + by_d * dh + by_g * gh + by_h * self._hh
        self._vv += by_d * (vd + new_vd) + by_g * (vg + new_vg) + by_h * (vh + new_vh)
        self._vd, self._vg, self._vh = new_vd, new_vg, new_vh
        self._dd += DISTURBANCE_WALK * self._dt_s
        self._gg += GAIN_WALK * self._dt_s


def _within(value: float, bound: float) -> float:
    return min(bound, max(-bound, value))
