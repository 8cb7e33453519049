"""Smoothing of position and ceiling before the control laws use them."""

from typing import Final

FRONT_PULL_RATIO: Final = 0.15
FRONT_JUMP_M: Final = 0.5
CEILING_FALL_MPS2: Final = 1.5
"""Rate above which a decrease of the ceiling is a step and is not extrapolated."""
CEILING_PULL_RATIO: Final = 0.2


class SmoothFront:
    """Smooths the position between tags, where it moves in steps of a pulse.

    A tag takes effect at once.
    """

    __slots__ = ("front_m",)

    def __init__(self) -> None:
        self.front_m = 0.0

    def step(self, measured_m: float, *, moved_m: float, at_tag: bool) -> None:
        """Update the position.

        `moved_m` is the distance by the estimated speed since the last step.
        """
        expected_m = self.front_m + moved_m
        error_m = measured_m - expected_m
        if at_tag or abs(error_m) >= FRONT_JUMP_M:
            self.front_m = measured_m
        else:
            self.front_m = expected_m + FRONT_PULL_RATIO * error_m


class CeilingOutlook:
    """Measures how fast a braking curve of protection lowers the ceiling."""

    __slots__ = ("_fall_mps2", "_last_mps")

    def __init__(self) -> None:
        self._last_mps = 0.0
        self._fall_mps2 = 0.0

    def step(self, ceiling_mps: float, dt_s: float) -> None:
        slope_mps2 = (ceiling_mps - self._last_mps) / dt_s
        self._last_mps = ceiling_mps
        fall_mps2 = -slope_mps2 if -CEILING_FALL_MPS2 < slope_mps2 < 0.0 else 0.0
        self._fall_mps2 += CEILING_PULL_RATIO * (fall_mps2 - self._fall_mps2)

    def in_mps(self, horizon_s: float) -> float:
        """Expected ceiling after `horizon_s`."""
        return max(0.0, self._last_mps - self._fall_mps2 * horizon_s)
