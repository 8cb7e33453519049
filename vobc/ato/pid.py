"""A PID with anti-windup by conditional integration and bumpless hand-over."""

from vobc.ato.config import PidGains


class Pid:
    """Parallel form; the derivative is that of the given error over the given time step."""

    __slots__ = ("_integral_mps2", "_last_error_mps")

    def __init__(self) -> None:
        self._integral_mps2 = 0.0
        self._last_error_mps: float | None = None

    def reset(self) -> None:
        self._integral_mps2 = 0.0
        self._last_error_mps = None

    def take_over(self, gains: PidGains, *, error_mps: float, output_mps2: float) -> None:
        """Set the integral so that the next output at this error is `output_mps2`."""
        self._integral_mps2 = output_mps2 - gains.kp_per_s * error_mps
        self._last_error_mps = error_mps

    def step(
        self, gains: PidGains, error_mps: float, dt_s: float, *, low_mps2: float, high_mps2: float
    ) -> float:
        """The output within the bounds; the integral never pushes further past one."""
        last_mps = self._last_error_mps
        slope_mps2 = 0.0 if last_mps is None else (error_mps - last_mps) / dt_s
        self._last_error_mps = error_mps
        direct_mps2 = gains.kp_per_s * error_mps + gains.kd_ratio * slope_mps2
        grown_mps2 = self._integral_mps2 + gains.ki_per_s2 * error_mps * dt_s
        wanted_mps2 = direct_mps2 + grown_mps2
        pushes_out = (wanted_mps2 > high_mps2 and error_mps > 0.0) or (
            wanted_mps2 < low_mps2 and error_mps < 0.0
        )
        if not pushes_out:
            self._integral_mps2 = grown_mps2
        return min(high_mps2, max(low_mps2, direct_mps2 + self._integral_mps2))
