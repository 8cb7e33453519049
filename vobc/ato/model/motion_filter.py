"""Kalman filter over speed, unexplained acceleration and gains of the brake, written in scalars.

Under the brake a wrong gain and a wrong resistance look alike in any one moment. They part when the
demand changes, and what is known beforehand of both says how to share an error until then. Friction
that takes over from the motors has a gain of its own beside that of the whole brake.
"""

import math
from typing import Final

SPEED_SIGMA_MPS: Final = 0.03
"""Of a measured speed, the swinging of the coaches included."""
DISTURBANCE_WALK: Final = 0.004**2
"""Variance in (m/s²)² that the disturbance gains each second: resistance changes with the speed."""
DISTURBANCE_SIGMA_MPS2: Final = 0.03
DISTURBANCE_RENEWED_MPS2: Final = 0.015
"""Spread at the start of an application: of resistance, wind and what the map does not know."""
GAIN_WALK: Final = 0.002**2
GAIN_SIGMA_RATIO: Final = 0.08
"""Spread of the gain before it was ever seen."""
FRICTION_SIGMA_RATIO: Final = 0.13
"""Spread of what friction gives more or less than the whole brake."""
SURPRISE_MPS: Final = 0.25
"""A measured speed so far off is nothing the brake or the track could do: somebody else brakes."""
SURPRISE_COST: Final = 100.0
"""Of a hypothesis that such a speed surprises; it learns nothing of it."""
BLIND_MPS: Final = 0.08
"""So slow, a measured speed is older than what it tells, and soon the train stands: a train that is
held says nothing of its brake."""
GAIN_MAX_RATIO: Final = 0.3
DISTURBANCE_MAX_MPS2: Final = 0.5
GAIN_REFUSED_RATIO: Final = 0.25
"""A brake that is off by so much is faulty: what was learnt of it goes with the application."""
GAIN_RENEWED_RATIO: Final = 0.02
"""Least spread at the start of an application: the train may have been loaded since."""


class MotionFilter:
    __slots__ = (
        "_dd",
        "_dg",
        "_dh",
        "_dt_s",
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

    def __init__(self, dt_s: float) -> None:
        self._dt_s = dt_s
        self.gain_ratio = 0.0
        """By how much the brake gives more than was asked."""
        self.friction_ratio = 0.0
        """By how much its friction gives still more."""
        self._gg = GAIN_SIGMA_RATIO**2
        self._hh = FRICTION_SIGMA_RATIO**2
        self.start(0.0)

    def start(self, speed_mps: float) -> None:
        """Begin with a known speed and no disturbance; the gains are kept."""
        self.speed_mps = speed_mps
        self.disturbance_mps2 = 0.0
        self._vv = SPEED_SIGMA_MPS**2
        self._dd = DISTURBANCE_SIGMA_MPS2**2
        self._vd = self._vg = self._vh = self._dg = self._dh = self._gh = 0.0

    def forget(self, speed_mps: float) -> None:
        """What was learnt, was learnt of something else."""
        self.gain_ratio = self.friction_ratio = 0.0
        self._gg = GAIN_SIGMA_RATIO**2
        self._hh = FRICTION_SIGMA_RATIO**2
        self.start(speed_mps)

    @property
    def least_gain_ratio(self) -> float:
        """Two standard deviations under what is believed of the gain."""
        return self.gain_ratio - 2.0 * math.sqrt(max(self._gg, GAIN_RENEWED_RATIO**2))

    def copy(self, other: "MotionFilter") -> None:
        """Go on from what another one has found."""
        self.speed_mps, self.disturbance_mps2 = other.speed_mps, other.disturbance_mps2
        self.gain_ratio, self.friction_ratio = other.gain_ratio, other.friction_ratio
        self._vv, self._vd, self._vg, self._vh = other._vv, other._vd, other._vg, other._vh
        self._dd, self._dg, self._dh = other._dd, other._dg, other._dh
        self._gg, self._gh, self._hh = other._gg, other._gh, other._hh

    def renew_gain(self) -> None:
        """A new application begins; what was learnt of a faulty brake goes."""
        if abs(self.gain_ratio) >= GAIN_REFUSED_RATIO:
            self.gain_ratio = 0.0
            self._gg = GAIN_SIGMA_RATIO**2
        if abs(self.friction_ratio) >= GAIN_REFUSED_RATIO:
            self.friction_ratio = 0.0
        self._vh = self._dh = self._gh = 0.0
        self._gg = max(self._gg, GAIN_RENEWED_RATIO**2)
        self._hh = FRICTION_SIGMA_RATIO**2
        # While traction worked its errors were in the disturbance, too.
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
        """One cycle; returns how ill the measured speed fits, as a square of standard deviations.

        Args:
            push_mps2: acts for certain.
            braked_mps2: was asked of the brake.
            friction_mps2: of that, asked of late friction.
            blur_m2_per_s2: variance in (m/s)² by which the speed is less certain after this cycle.
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
        """Covariance after one cycle in which the speed took up `by_d` of d and so on."""
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
