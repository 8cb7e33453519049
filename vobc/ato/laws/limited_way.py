"""Plans a run past lower limits on board: a speed to hold, and the place from which to coast.

The run gains speed up to the held speed or the limit, slows for each lower limit, coasts from one
place on, and brakes on the stopping curve. Each held speed has one place with which the run takes
its time. The plan is the one with the least traction energy.
"""

import math
from typing import Final, NamedTuple

from firmware_py.trackdb import LineMap
from vobc.ato.motion import gradient
from vobc.ato.motion.profile import ReferenceBrakingCurve
from vobc.ato.settings.ato import AtoConfig

CELL_M: Final = 20.0
CELLS_MAX: Final = 200
LEAST_MPS: Final = 1.0
STALL_MPS: Final = 2.0
"""Planned speed below which a coasting train counts as stalled."""
SPEEDS: Final = 10
"""Number of held speeds that are compared."""
HALVINGS: Final = 9
LOWER_MPS: Final = 0.1


class HeldRun(NamedTuple):
    """One run past lower limits."""

    held_mps: float
    coast_from_m: float
    """Chainage of the train's front."""
    time_s: float
    energy_m2_per_s2: float
    """Traction energy for each kilogram, at the wheel."""


class LimitedWay:
    """The way from one place to a stop, in cells, with its limits and gradients."""

    __slots__ = (
        "_cell_m",
        "_config",
        "_drag",
        "_front_m",
        "_grades_mps2",
        "_power_per_kg",
        "_squares",
    )

    def __init__(
        self,
        config: AtoConfig,
        line: LineMap,
        front_m: float,
        stop_m: float,
        curve: ReferenceBrakingCurve,
        *,
        drag_mps2: tuple[float, float, float],
        mass_kg: float,
    ) -> None:
        """Args:
        curve: leads to the stop; its deceleration also slows for lower limits.
        drag_mps2: deceleration by resistance, as coefficients of the powers of the speed.
        """
        self._config = config
        self._front_m = front_m
        self._drag = drag_mps2
        self._power_per_kg = config.power_limited.traction_power_w / mass_kg
        cells = max(1, min(CELLS_MAX, math.ceil((stop_m - front_m) / CELL_M)))
        self._cell_m = cell_m = (stop_m - front_m) / cells
        length_m, margin_mps = config.train_length_m, config.speed.margin_mps
        squares = []
        for cell in range(cells + 1):
            at_m = front_m + cell * cell_m
            limit_mps = line.least_limit_mps(at_m - length_m, at_m) - margin_mps
            squares.append(max(LEAST_MPS, limit_mps) ** 2)
        squares[-1] = 0.0
        for cell in range(cells - 1, -1, -1):
            decel_mps2 = curve.at_speed(math.sqrt(max(squares[cell + 1], 1.0))).decel_mps2
            squares[cell] = min(squares[cell], squares[cell + 1] + 2.0 * decel_mps2 * cell_m)
        self._squares = squares
        self._grades_mps2 = [
            gradient.decel_at_mps2(config, line, front_m + (cell + 0.5) * cell_m)
            for cell in range(cells)
        ]

    def run(self, speed_mps: float, held_mps: float, coast_from_m: float) -> HeldRun:
        """Return the run with these choices; its time is infinite if the train stalls."""
        constant, linear, square = self._drag
        limits, cell_m = self._config.limits, self._cell_m
        held_square, at = held_mps * held_mps, speed_mps * speed_mps
        time_s, energy = 0.0, 0.0
        if speed_mps < STALL_MPS:
            # The jerk limit takes half of the time that the effort needs to build up.
            time_s = limits.accel_mps2 / (2.0 * limits.jerk_mps3)
        for cell, grade_mps2 in enumerate(self._grades_mps2):
            now_mps = math.sqrt(at)
            drag_mps2 = constant + now_mps * (linear + now_mps * square) + grade_mps2
            coasted = at - 2.0 * drag_mps2 * cell_m
            share = (coast_from_m - self._front_m) / cell_m - cell
            if share <= 0.0:
                after = coasted
            else:
                most_mps2 = min(
                    limits.accel_mps2, self._power_per_kg / max(LEAST_MPS, now_mps) - drag_mps2
                )
                pulled = at + 2.0 * most_mps2 * cell_m
                after = min(pulled, max(held_square, coasted))
                if share < 1.0:
                    after = share * after + (1.0 - share) * coasted
            after = min(max(after, 0.0), self._squares[cell + 1])
            if after > coasted:
                energy += (after - coasted) / 2.0
            after_mps = math.sqrt(after)
            if after_mps < STALL_MPS and self._squares[cell + 1] > STALL_MPS * STALL_MPS:
                return HeldRun(held_mps, coast_from_m, math.inf, energy)
            time_s += 2.0 * cell_m / (now_mps + after_mps)
            at = after
        return HeldRun(held_mps, coast_from_m, time_s, energy)

    def plan(
        self, speed_mps: float, left_s: float, *, low_mps: float, top_mps: float
    ) -> HeldRun | None:
        """Return the run of least energy that takes `left_s`; None if all are slower."""
        best: HeldRun | None = None
        for number in range(SPEEDS + 1):
            held_mps = low_mps + (top_mps - low_mps) * number / SPEEDS
            found = self.in_time(speed_mps, held_mps, left_s)
            if found is not None and (
                best is None or found.energy_m2_per_s2 < best.energy_m2_per_s2
            ):
                best = found
        return best

    def in_time(self, speed_mps: float, held_mps: float, left_s: float) -> HeldRun | None:
        """Return the run with this held speed that takes `left_s`; None if all are slower."""
        near_m = self._front_m
        far_m = near_m + self._cell_m * len(self._grades_mps2)
        found = self.run(speed_mps, held_mps, far_m)
        if found.time_s > left_s:
            return None
        for _ in range(HALVINGS):
            middle_m = (near_m + far_m) / 2.0
            tried = self.run(speed_mps, held_mps, middle_m)
            if tried.time_s > left_s:
                near_m = middle_m
            else:
                far_m, found = middle_m, tried
        return found


def lowered(config: AtoConfig, line: LineMap, front_m: float, stop_m: float) -> bool:
    """Return whether the front meets a lower limit after a higher one before the stop."""
    length_m = config.train_length_m
    ends_m = {front_m}
    for section in line.speed_sections:
        ends_m.update({section.start_m, section.end_m + length_m})
    high_mps = 0.0
    for start_m in sorted(end_m for end_m in ends_m if front_m <= end_m < stop_m):
        limit_mps = line.least_limit_mps(start_m + LOWER_MPS - length_m, start_m + LOWER_MPS)
        if limit_mps < high_mps - LOWER_MPS:
            return True
        high_mps = max(high_mps, limit_mps)
    return False
