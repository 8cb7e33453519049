"""Invariants of a moving train: stopping distance, limits and rollback (1, 2, 4, 8)."""

import math

from metro_hil.monitors.context import Context
from metro_hil.monitors.gauge import Gauge
from metro_hil.monitors.place import GRAVITY_MPS2, LinePlaces
from metro_hil.monitors.watch_modes import JOG, ON_SIGHT
from plant_emulator.truth import Truth

NS_PER_S = 1_000_000_000
BUILT_UP_LAGS = 6.0
"""Number of time constants after which the emergency brake has built up, except for 0.3 %."""
FAR_M = 100.0
FAR_NS = NS_PER_S // 5
"""Interval between two checks while the margin is above `FAR_M`; no train uses that up
meanwhile."""
ROLLED_M = 0.02
"""Backward movement that slack in the couplers explains; it does not count as a rollback."""


class MotionWatch:
    """Judges steps in which the train moves."""

    __slots__ = (
        "_adhesion_needed_ratio",
        "_build_up_s",
        "_built_up_ns",
        "_cut_s",
        "_dead_s",
        "_decel_mps2",
        "_emergency_since_ns",
        "_foremost_m",
        "_full_mps2",
        "_lag_s",
        "_line_end_m",
        "_look_ns",
        "_margin_mps",
        "_place",
        "_quick_margin_mps",
        "_reaction_s",
        "_rollback_m",
        "_runaway_mps2",
        "_runaway_s",
        "_worst_decel_mps2",
        "_worst_fall_mps2",
        "authority_end",
        "civil_limit",
        "rollback",
        "stopping",
    )

    def __init__(
        self,
        context: Context,
        place: LinePlaces,
        *,
        stopping: Gauge,
        authority_end: Gauge,
        civil_limit: Gauge,
        rollback: Gauge,
    ) -> None:
        self._place, self._line_end_m = place, context.line.end_m
        self.stopping, self.authority_end = stopping, authority_end
        self.civil_limit, self.rollback = civil_limit, rollback
        emergency = context.train.brake.emergency
        self._dead_s, self._lag_s = emergency.dead_time_s, emergency.lag_s
        self._reaction_s = self._dead_s + self._lag_s
        self._built_up_ns = round((self._dead_s + BUILT_UP_LAGS * self._lag_s) * NS_PER_S)
        self._full_mps2 = emergency.decel_mps2
        self._decel_mps2 = context.guaranteed_decel_mps2
        self._cut_s = context.traction_cut_s
        rotating_ratio = context.train.rotating_mass_percent / 100.0
        self._adhesion_needed_ratio = self._decel_mps2 * (1.0 + rotating_ratio) / GRAVITY_MPS2
        self._worst_fall_mps2 = place.worst_fall_mps2
        self._worst_decel_mps2 = max(0.05, self._decel_mps2 - self._worst_fall_mps2)
        self._runaway_mps2 = context.runaway_mps2
        self._runaway_s = context.sensing_s + 2.0 * context.cycle_s + context.traction_cut_s
        self._build_up_s = context.build_up_s
        self._margin_mps = context.emergency_margin_mps
        self._quick_margin_mps = self._margin_mps + self._overshoot_mps(0.0)
        self._rollback_m = context.line.rollback_m
        self._foremost_m = -math.inf
        self._emergency_since_ns = -1
        self._look_ns = 0

    def sample(self, truth: Truth, now_ns: int, mode: float = 0.0) -> None:
        """Take one step.

        Args:
            mode: the last reported mode. On sight no authority limits the train, and a jog may go
                back.
        """
        front_m, speed_mps = truth.front_m, truth.speed_mps
        if mode not in ON_SIGHT:
            to_end_m = min(truth.authority_end_m, self._line_end_m) - front_m
            if to_end_m < self.authority_end.least:
                self.authority_end.see(to_end_m, now_ns)
            if speed_mps > 0.0:
                self._check_stopping(truth, to_end_m, now_ns)
        if speed_mps < 0.0:
            speed_mps = -speed_mps
        civil_limit = self.civil_limit
        limit_mps = self._place.limit_mps(front_m)
        # The overshoot is least without a fall, so a margin above the least so far need not be
        # exact.
        if limit_mps + self._quick_margin_mps - speed_mps < civil_limit.least:
            overshoot_mps = self._overshoot_mps(self._place.worst_fall_under_mps2(front_m))
            civil_limit.see(limit_mps + self._margin_mps + overshoot_mps - speed_mps, now_ns)
        if front_m >= self._foremost_m or mode == JOG:
            self._foremost_m = front_m
        elif self._foremost_m - front_m > ROLLED_M:
            self.rollback.see(self._rollback_m - (self._foremost_m - front_m), now_ns)

    def emergency(self, now_ns: int, wanted: bool) -> None:
        """The brake unit demands the emergency brake from now on, or no longer."""
        self._emergency_since_ns = now_ns if wanted else -1

    def _overshoot_mps(self, fall_mps2: float) -> float:
        """Return the speed gained after the limit until traction is cut and the brake acts."""
        runaway_mps = (self._runaway_mps2 + fall_mps2) * self._runaway_s
        return runaway_mps + fall_mps2 * self._build_up_s

    def _check_stopping(self, truth: Truth, to_end_m: float, now_ns: int) -> None:
        # A stopping distance for the line's steepest fall is never too short. It suffices while the
        # end is far.
        speed_mps, reaction_s = truth.speed_mps, self._reaction_s
        gain_mps2 = self._worst_fall_mps2
        if truth.accel_mps2 > 0.0:
            gain_mps2 += truth.accel_mps2
        reached_mps = speed_mps + gain_mps2 * reaction_s
        quick_m = reached_mps * reaction_s + reached_mps * reached_mps / (
            2.0 * self._worst_decel_mps2
        )
        if to_end_m - quick_m < self.stopping.least and (
            to_end_m - quick_m < FAR_M or now_ns >= self._look_ns
        ):
            self._look_ns = now_ns + FAR_NS
            if self._noted_guaranteed(truth, now_ns):
                self.stopping.see(to_end_m - self.stopping_m(truth, now_ns), now_ns)

    def guaranteed(self, truth: Truth, now_ns: int) -> bool:
        """Tell whether rail and brake give the rate that the braking distance assumes."""
        holds = truth.adhesion_ratio >= self._adhesion_needed_ratio
        since_ns = self._emergency_since_ns
        if holds and since_ns >= 0 and now_ns - since_ns > self._built_up_ns:
            holds = truth.emergency_mps2 >= self._decel_mps2
        return holds

    def _noted_guaranteed(self, truth: Truth, now_ns: int) -> bool:
        """The same, noted in the result if it is not so."""
        holds = self.guaranteed(truth, now_ns)
        if not holds and not self.stopping.note:
            self.stopping.note = (
                f"less than the guaranteed {self._decel_mps2:g} m/s² from {truth.t_s:.2f} s on "
                "for a while, in which it was not judged"
            )
        return holds

    def stopping_m(self, truth: Truth, now_ns: int) -> float:
        """Return the distance to standstill if the emergency brake is demanded now, or was before.

        Until traction is cut a driven train keeps its acceleration. Then it coasts on its gradient
        until the emergency brake has built up, whatever the service brake does. After that it
        decelerates at the guaranteed rate over the true heights of the line.
        """
        pulling_s, reaction_s = self._times_left_s(truth, now_ns)
        speed_mps = truth.speed_mps
        first_s = min(pulling_s, reaction_s)
        fall_mps2 = self._place.fall_mps2(truth.gradient_permille)
        gain_mps2 = max(fall_mps2, truth.accel_mps2) if truth.drive_n > 0.0 else fall_mps2
        way_m = (speed_mps + 0.5 * gain_mps2 * first_s) * first_s
        speed_mps += gain_mps2 * first_s
        rest_s = reaction_s - first_s
        way_m += (speed_mps + 0.5 * fall_mps2 * rest_s) * rest_s
        speed_mps += fall_mps2 * rest_s
        return way_m + self._place.braking_m(truth.front_m + way_m, speed_mps, self._decel_mps2)

    def _times_left_s(self, truth: Truth, now_ns: int) -> tuple[float, float]:
        """Return the time until traction is cut, and until an equivalent brake acts at once.

        A brake that builds up with a lag loses as much speed as one that acts at once, a lag later.
        """
        since_ns = self._emergency_since_ns
        if since_ns < 0:
            return self._cut_s, self._reaction_s
        passed_s = (now_ns - since_ns) / NS_PER_S
        built_up_ratio = min(1.0, truth.emergency_mps2 / self._full_mps2)
        reaction_s = max(0.0, self._dead_s - passed_s) + self._lag_s * (1.0 - built_up_ratio)
        return max(0.0, self._cut_s - passed_s), reaction_s
