"""A PID with anti-windup by conditional integration and bumpless transfer."""

from vobc.ato.settings.pid import PidGains


class Pid:
    """Parallel form. Errors are in m/s, or in m for a position loop."""

    __slots__ = ("_integral_mps2", "_last_error")

    def __init__(self) -> None:
        self._integral_mps2 = 0.0
        self._last_error: float | None = None

    def reset(self) -> None:
        self._integral_mps2 = 0.0
        self._last_error = None

    def take_over(
        self, gains: PidGains, *, error: float, output_mps2: float, slope: float = 0.0
    ) -> None:
        """Set the integral so that the next output at this error and slope is `output_mps2`."""
        self._integral_mps2 = output_mps2 - gains.kp_per_s * error - gains.kd_ratio * slope
        self._last_error = error

    def step(
        self,
        gains: PidGains,
        error: float,
        dt_s: float,
        *,
        low_mps2: float,
        high_mps2: float,
        slope: float | None = None,
    ) -> float:
        """Output within the bounds. The integral does not grow beyond a bound.

        Args:
            slope: change of the error per second, if known better than from two errors.
        """
        if slope is None:
            last = self._last_error
            slope = 0.0 if last is None else (error - last) / dt_s
        self._last_error = error
        direct_mps2 = gains.kp_per_s * error + gains.kd_ratio * slope
        grown_mps2 = self._integral_mps2 + gains.ki_per_s2 * error * dt_s
        wanted_mps2 = direct_mps2 + grown_mps2
        pushes_out = (wanted_mps2 > high_mps2 and error > 0.0) or (
            wanted_mps2 < low_mps2 and error < 0.0
        )
        if not pushes_out:
            self._integral_mps2 = grown_mps2
        return min(high_mps2, max(low_mps2, direct_mps2 + self._integral_mps2))
