"""Kalman filter over speed, unexplained acceleration and brake gain, written out in scalars.

Under the brake a wrong gain and a wrong resistance look alike in any one moment. They part when the
demand changes, and what is known beforehand of both says how to share an error until then.
"""

from typing import Final

SPEED_SIGMA_MPS: Final = 0.03
"""Of a measured speed, the swinging of the coaches included."""
DISTURBANCE_WALK: Final = 0.008**2
"""Variance in (m/s²)² that the disturbance gains each second: resistance falls with the speed."""
DISTURBANCE_SIGMA_MPS2: Final = 0.05
GAIN_WALK: Final = 0.002**2
GAIN_SIGMA_RATIO: Final = 0.06
"""Spread of the gain before it was ever seen."""
SURPRISE_MPS: Final = 0.25
"""A measured speed so far off is nothing the brake or the track could do: somebody else brakes."""
GAIN_MAX_RATIO: Final = 0.3
DISTURBANCE_MAX_MPS2: Final = 0.5
GAIN_RENEWED_RATIO: Final = 0.02
"""Least spread at the start of an application: the train may have been loaded since."""


class MotionFilter:
    __slots__ = (
        "_dd",
        "_dg",
        "_dt_s",
        "_gg",
        "_vd",
        "_vg",
        "_vv",
        "disturbance_mps2",
        "gain_ratio",
        "speed_mps",
    )

    def __init__(self, dt_s: float) -> None:
        self._dt_s = dt_s
        self.gain_ratio = 0.0
        """By how much the brake gives more than was asked."""
        self._gg = GAIN_SIGMA_RATIO**2
        self.start(0.0)

    def start(self, speed_mps: float) -> None:
        """Begin with a known speed and no disturbance; the gain is kept."""
        self.speed_mps = speed_mps
        self.disturbance_mps2 = 0.0
        self._vv = SPEED_SIGMA_MPS**2
        self._dd = DISTURBANCE_SIGMA_MPS2**2
        self._vd = self._vg = self._dg = 0.0

    def forget(self, speed_mps: float) -> None:
        """What was learnt, was learnt of something else."""
        self.gain_ratio = 0.0
        self._gg = GAIN_SIGMA_RATIO**2
        self.start(speed_mps)

    def renew_gain(self) -> None:
        """A new application begins."""
        self._gg = max(self._gg, GAIN_RENEWED_RATIO**2)

    def step(self, measured_mps: float, *, push_mps2: float, braked_mps2: float) -> None:
        """One cycle: `push_mps2` acts for certain, `braked_mps2` was asked of the brake."""
        dt_s = self._dt_s
        self.speed_mps += (
            push_mps2 - braked_mps2 * (1.0 + self.gain_ratio) + self.disturbance_mps2
        ) * dt_s
        self._spread(dt_s, -braked_mps2 * dt_s)
        innovation_mps = measured_mps - self.speed_mps
        if abs(innovation_mps) > SURPRISE_MPS:
            self.forget(measured_mps)
            return
        vv, vd, vg = self._vv, self._vd, self._vg
        weight = 1.0 / (vv + SPEED_SIGMA_MPS * SPEED_SIGMA_MPS)
        self.speed_mps += vv * weight * innovation_mps
        self.disturbance_mps2 = _within(
            self.disturbance_mps2 + vd * weight * innovation_mps, DISTURBANCE_MAX_MPS2
        )
        self.gain_ratio = _within(self.gain_ratio + vg * weight * innovation_mps, GAIN_MAX_RATIO)
        self._vv = vv - vv * weight * vv
        self._vd = vd - vv * weight * vd
        self._vg = vg - vv * weight * vg
        self._dd -= vd * weight * vd
        self._dg -= vd * weight * vg
        self._gg -= vg * weight * vg

    def _spread(self, by_d: float, by_g: float) -> None:
        """Covariance after one cycle in which the speed took up `by_d` of d and `by_g` of g."""
        dt_s, vd, vg, dd, dg, gg = self._dt_s, self._vd, self._vg, self._dd, self._dg, self._gg
        new_vd = vd + by_d * dd + by_g * dg
        new_vg = vg + by_d * dg + by_g * gg
        self._vv += by_d * (vd + new_vd) + by_g * (vg + new_vg)
        self._vd, self._vg = new_vd, new_vg
        self._dd = dd + DISTURBANCE_WALK * dt_s
        self._gg = gg + GAIN_WALK * dt_s


def _within(value: float, bound: float) -> float:
    return min(bound, max(-bound, value))
