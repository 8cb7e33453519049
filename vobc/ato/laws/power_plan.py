"""Plans power-limited runs on board: acceleration, coasting, and braking with limited power.

Braking is a table by speed, and coasting is computed in steps along the line. Both take a fraction
of a millisecond, so the power limit can be searched for while the train rolls.
"""

import math
from collections.abc import Sequence
from typing import Final, NamedTuple

from firmware_py.trackdb import LineMap
from vobc.ato.laws.limited_way import LimitedWay, lowered
from vobc.ato.motion import gradient, trapezoid
from vobc.ato.motion.profile import ReferenceBrakingCurve
from vobc.ato.settings.ato import AtoConfig

GRAIN_MPS: Final = 0.2
"""Step of the braking table."""
STEP_M: Final = 10.0
"""Step of the coasting computation."""
LEAST_MPS: Final = 1.0
LEAST_MPS2: Final = 0.02
HALVINGS: Final = 12
TOLERANCE_S: Final = 0.25
"""Time difference below which two plans count as equal."""
CHOICES: Final = 20
"""Number of notch-off speeds that are compared."""


class Braked(NamedTuple):
    """Distance and time of a braking from one speed to the stop."""

    way_m: float
    time_s: float


class Grain(NamedTuple):
    """One step of speed."""

    middle_mps: float
    curve_mps2: float
    """Deceleration on the stopping curve."""
    drag_mps2: float
    """Deceleration by resistance and mean gradient before the stop."""


class PowerBrake:
    """Braking into one stop with one power limit. Where the stopping curve needs less power, it
    applies.

    The limit is for the brake alone. Resistance and a mean gradient act in addition.
    """

    __slots__ = ("_ways",)

    def __init__(self, grains: Sequence[Grain], *, power_w: float, mass_kg: float) -> None:
        ways = [Braked(0.0, 0.0)]
        way_m = time_s = 0.0
        per_kg = power_w / mass_kg
        for middle_mps, curve_mps2, drag_mps2 in grains:
            decel_mps2 = max(LEAST_MPS2, min(curve_mps2, per_kg / middle_mps + drag_mps2))
            way_m += middle_mps * GRAIN_MPS / decel_mps2
            time_s += GRAIN_MPS / decel_mps2
            ways.append(Braked(way_m, time_s))
        self._ways = ways

    def from_speed(self, speed_mps: float) -> Braked:
        """Linear interpolation between the entries of the table."""
        at = max(0.0, speed_mps) / GRAIN_MPS
        grain = min(int(at), len(self._ways) - 2)
        low, high = self._ways[grain], self._ways[grain + 1]
        share_ratio = at - grain
        return Braked(
            low.way_m + share_ratio * (high.way_m - low.way_m),
            low.time_s + share_ratio * (high.time_s - low.time_s),
        )


class PowerPlan(NamedTuple):
    """Plan of the run to a stop."""

    notch_off_mps: float
    power_w: float
    time_s: float
    """Time from planning to standstill."""
    coast_from_m: float | None = None
    """Past lower limits the train holds the notch-off speed up to this place. None: it coasts from
    that speed on."""


class PowerPlanner:
    """Plans to one stop. `mass_kg` includes rotating masses."""

    __slots__ = ("_config", "_curve", "_grains", "_line", "_mass_kg", "_resist_mps2", "_stop_m")

    def __init__(
        self,
        config: AtoConfig,
        line: LineMap,
        stop_m: float,
        curve: ReferenceBrakingCurve,
        *,
        load_kg: float,
    ) -> None:
        settings = config.power_limited
        self._config = config
        self._curve = curve
        self._line = line
        self._stop_m = stop_m
        rotating_ratio = config.rotating_mass_percent / 100.0
        self._mass_kg = settings.tare_kg * (1.0 + rotating_ratio) + load_kg
        reach_m = min(400.0, stop_m - line.start_m)
        mean_permille = line.mean_gradient_permille(stop_m - max(1.0, reach_m), stop_m)
        helps_mps2 = gradient.decel_on_mps2(config, mean_permille)
        resistance = config.resistance
        scale = gradient.decel_on_mps2(config, 1.0)
        self._resist_mps2 = (
            scale * resistance.a_n_per_kn,
            scale * resistance.b_n_per_kn_per_mps,
            scale * resistance.c_n_per_kn_per_mps2,
        )
        constant, linear, square = self._resist_mps2
        high_mps = max(section.limit_mps for section in line.speed_sections)
        middles = [(grain + 0.5) * GRAIN_MPS for grain in range(int(high_mps / GRAIN_MPS) + 10)]
        self._grains = [
            Grain(
                middle_mps,
                curve.at_speed(middle_mps).decel_mps2,
                helps_mps2 + constant + middle_mps * (linear + middle_mps * square),
            )
            for middle_mps in middles
        ]

    @property
    def mass_kg(self) -> float:
        return self._mass_kg

    def brake(self, power_w: float) -> PowerBrake:
        return PowerBrake(self._grains, power_w=power_w, mass_kg=self._mass_kg)

    def plan(self, front_m: float, speed_mps: float, left_s: float, top_mps: float) -> PowerPlan:
        """Equation (1) on complete runs: x by the weight, then the power limit by the time.

        Without enough time the result is `top_mps` with full power. Past lower limits the weight
        does not count: the brake into the stop has its full power.
        """
        settings = self._config.power_limited
        if self.lowered(front_m):
            return self._plan_past_limits(front_m, speed_mps, left_s, top_mps)
        full = self.brake(settings.brake_power_w)
        low_mps = max(speed_mps, min(settings.slowest_mps, top_mps))
        choices = [low_mps + (top_mps - low_mps) * share / CHOICES for share in range(CHOICES + 1)]
        times_s = [self._time_s(front_m, speed_mps, off_mps, full) for off_mps in choices]
        fastest_s = min(times_s)
        scored = sorted(
            ((off_mps / top_mps) ** 2 + settings.weight_factor * time_s / fastest_s, off_mps)
            for off_mps, time_s in zip(choices, times_s, strict=True)
            if time_s <= left_s
        )
        best: PowerPlan | None = None
        for _, off_mps in scored:
            power_w = self._power_w(front_m, speed_mps, off_mps, left_s)
            time_s = self._time_s(front_m, speed_mps, off_mps, self.brake(power_w))
            if best is None or time_s > best.time_s:
                best = PowerPlan(off_mps, power_w, time_s)
            # If a speed is too high for the distance, no power limit makes the run last that long.
            if best.time_s > left_s - TOLERANCE_S:
                break
        return best or PowerPlan(top_mps, settings.brake_power_w, fastest_s)

    def lowered(self, front_m: float) -> bool:
        """Return whether a lower limit lies between this place and the stop."""
        return lowered(self._config, self._line, front_m, self._stop_m)

    def _plan_past_limits(
        self, front_m: float, speed_mps: float, left_s: float, top_mps: float
    ) -> PowerPlan:
        settings = self._config.power_limited
        way = self._way(front_m)
        low_mps = max(speed_mps, min(settings.slowest_mps, top_mps))
        best = way.plan(speed_mps, left_s, low_mps=low_mps, top_mps=top_mps)
        if best is None:
            fastest = way.run(speed_mps, top_mps, self._stop_m)
            return PowerPlan(top_mps, settings.brake_power_w, fastest.time_s, self._stop_m)
        return PowerPlan(best.held_mps, settings.brake_power_w, best.time_s, best.coast_from_m)

    def coast_from_m(
        self, front_m: float, speed_mps: float, left_s: float, held_mps: float
    ) -> float | None:
        """Place from which to coast so that the run lasts `left_s`; None: it is late anyway."""
        found = self._way(front_m).in_time(speed_mps, held_mps, left_s)
        return None if found is None else found.coast_from_m

    def _way(self, front_m: float) -> LimitedWay:
        return LimitedWay(
            self._config,
            self._line,
            front_m,
            self._stop_m,
            self._curve,
            drag_mps2=self._resist_mps2,
            mass_kg=self._mass_kg,
        )

    def limit_w(self, front_m: float, speed_mps: float, left_s: float) -> float:
        """Power limit with which a train that coasts from here arrives just in time."""
        return self._power_w(front_m, speed_mps, speed_mps, left_s)

    def coasted_s(self, front_m: float, speed_mps: float, power_w: float) -> float:
        """Time to standstill for a train that coasts from here and brakes with this limit.

        0: the train is too near for such a brake. Infinite: it stalls.
        """
        brake = self.brake(power_w)
        if self._stop_m - front_m < brake.from_speed(max(speed_mps, LEAST_MPS)).way_m:
            return 0.0
        return self._time_s(front_m, speed_mps, speed_mps, brake)

    def _power_w(self, front_m: float, speed_mps: float, off_mps: float, left_s: float) -> float:
        settings = self._config.power_limited
        low_w, high_w = settings.power_min_w, settings.brake_power_w
        for _ in range(HALVINGS):
            middle_w = (low_w + high_w) / 2.0
            if self._time_s(front_m, speed_mps, off_mps, self.brake(middle_w)) > left_s:
                low_w = middle_w
            else:
                high_w = middle_w
        return high_w

    def _time_s(self, front_m: float, speed_mps: float, off_mps: float, brake: PowerBrake) -> float:
        """Time to standstill. Infinite: the train stalls or cannot reach that speed."""
        config = self._config
        time_s = 0.0
        now_mps = max(speed_mps, LEAST_MPS)
        if off_mps > speed_mps:
            limits = config.limits
            accel_mps2 = min(
                limits.accel_mps2,
                config.power_limited.traction_power_w / (self._mass_kg * off_mps),
            )
            mean_mps2 = (limits.accel_mps2 + accel_mps2) / 2.0
            jerk_mps3 = limits.jerk_mps3
            time_s = trapezoid.ramp_s(
                off_mps - speed_mps, accel_mps2=mean_mps2, jerk_mps3=jerk_mps3
            )
            front_m += trapezoid.ramp_m(
                speed_mps, off_mps, accel_mps2=mean_mps2, jerk_mps3=jerk_mps3
            )
            now_mps = off_mps
        if self._stop_m - front_m < brake.from_speed(now_mps).way_m:
            return math.inf
        return time_s + self._coasted_s(front_m, now_mps, brake)

    def _coasted_s(self, front_m: float, now_mps: float, brake: PowerBrake) -> float:
        constant, linear, square = self._resist_mps2
        time_s = 0.0
        while True:
            left_m = self._stop_m - front_m
            braked = brake.from_speed(now_mps)
            spare_m = left_m - braked.way_m
            if spare_m <= 0.0:
                return time_s + braked.time_s
            drag_mps2 = constant + now_mps * (linear + now_mps * square)
            drag_mps2 += gradient.decel_at_mps2(self._config, self._line, front_m)
            step_m = min(STEP_M, spare_m + 0.01)
            squared = now_mps * now_mps - 2.0 * drag_mps2 * step_m
            if squared < LEAST_MPS * LEAST_MPS:
                return math.inf
            after_mps = math.sqrt(squared)
            time_s += 2.0 * step_m / (now_mps + after_mps)
            front_m += step_m
            now_mps = after_mps
