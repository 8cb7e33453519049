"""The ceiling: what the line, the braking curves and the end of authority permit the train now."""

import itertools
import math
from collections.abc import Sequence
from typing import Final, NamedTuple

from firmware_py.trackdb import LineMap
from vobc.atp.braking import SafeBraking
from vobc.atp.config import AtpConfig
from vobc.atp.profile import BrakingProfile
from vobc.vocabulary import Ceiling, Interval, Restriction

PROFILES_MAX: Final = 256
"""Kept at most; an interval that grows by steps all along a line needs fewer."""


class _Four(NamedTuple):
    """The four speeds of a ceiling, or what makes them differ."""

    permitted: float
    warning: float
    service: float
    emergency: float


_NOTHING: Final = _Four(0.0, 0.0, 0.0, 0.0)


class CeilingMap:
    """All restrictions of a line for one train; `at` looks at them from one place.

    Each of the four curves is the safe braking curve, seen so much earlier as somebody needs to act
    (`lead`), and ends so much over the limit as is tolerated (`margin`). Nothing is tolerated at
    the end of authority.
    """

    def __init__(
        self, config: AtpConfig, braking: SafeBraking, line: LineMap, *, train_length_m: float
    ) -> None:
        """Raises ValueError for a line that falls more than the guaranteed brake rate can hold."""
        self._line = line
        self._braking = braking
        self._length_m = train_length_m
        self._step_m = config.interval_step_m
        self._margins_mps = _Four(
            0.0,
            config.warning_margin_mps,
            config.service_margin_mps,
            config.emergency_margin_mps,
        )
        warning_s = config.service_lead_s + config.warning_lead_s
        self._leads_s = _Four(
            warning_s + config.permitted_lead_s, warning_s, config.service_lead_s, 0.0
        )
        self._drops = [
            (later.start_m, later.limit_mps)
            for earlier, later in itertools.pairwise(line.speed_sections)
            if later.limit_mps < earlier.limit_mps
        ]
        self._profiles: dict[int, BrakingProfile] = {}
        self._horizon_m = self._distance_that_never_binds_m()

    def at(
        self,
        front_m: Interval,
        authority_end_m: float,
        restrictions: Sequence[Restriction] = (),
    ) -> Ceiling:
        """The ceiling of a train whose front lies somewhere in the interval.

        The front may be as far ahead, the rear as far behind as the interval lets them: what lies
        ahead counts from its high end, and a limit holds until the rear of its low end is clear.
        Nothing is permitted to a train whose front may be at the end of authority or beyond it, nor
        to one of which no finite place is known.
        """
        foremost_m = front_m.high
        to_end_m = authority_end_m - foremost_m
        width_m = foremost_m - front_m.low
        if not to_end_m > 0.0 or not 0.0 <= width_m < math.inf:
            return Ceiling(0.0, 0.0, 0.0, 0.0, to_end_m)
        profile = self._profile(math.ceil(width_m / self._step_m))
        limit_mps = self._limit_under_mps(front_m.low - self._length_m, foremost_m, restrictions)
        least = [limit_mps + margin_mps for margin_mps in self._margins_mps]
        visible_m = foremost_m + self._horizon_m
        for start_m, target_mps in self._drops:
            if start_m > visible_m:
                break
            if start_m > foremost_m:
                self._lower(least, profile, foremost_m, start_m, target_mps, self._margins_mps)
        for ahead in restrictions:
            if foremost_m < ahead.start_m <= visible_m:
                self._lower(
                    least, profile, foremost_m, ahead.start_m, ahead.limit_mps, self._margins_mps
                )
        if authority_end_m <= visible_m:
            self._lower(least, profile, foremost_m, authority_end_m, 0.0, _NOTHING)
        emergency = least[3]
        service = min(least[2], emergency)
        warning = min(least[1], service)
        return Ceiling(min(least[0], warning), warning, service, emergency, to_end_m)

    def _limit_under_mps(
        self, rear_m: float, front_m: float, restrictions: Sequence[Restriction]
    ) -> float:
        """The least limit under a train that covers [rear, front]; sections are half-open."""
        limit_mps = self._line.least_limit_mps(rear_m, front_m)
        for under in restrictions:
            if under.start_m <= front_m and rear_m < under.end_m:
                limit_mps = min(limit_mps, under.limit_mps)
        return limit_mps

    def _lower(
        self,
        least: list[float],
        profile: BrakingProfile,
        front_m: float,
        at_m: float,
        target_mps: float,
        margins_mps: _Four,
    ) -> None:
        """Bring the four down to the curves towards one point ahead."""
        work_j_per_kg = profile.work_j_per_kg(at_m)
        for index, lead_s in enumerate(self._leads_s):
            least[index] = profile.speed_mps(
                front_m,
                work_j_per_kg,
                target_mps=target_mps + margins_mps[index],
                lead_s=lead_s,
                below_mps=least[index],
            )

    def _profile(self, steps: int) -> BrakingProfile:
        """Made once for each width of the interval, in steps."""
        profile = self._profiles.get(steps)
        if profile is None:
            if len(self._profiles) >= PROFILES_MAX:
                self._profiles.clear()
            under_m = self._length_m + steps * self._step_m
            profile = BrakingProfile(self._braking, self._line, under_m=under_m)
            self._profiles[steps] = profile
        return profile

    def _distance_that_never_binds_m(self) -> float:
        """From here on every curve lies over the highest speed of the line, wherever it falls."""
        line = self._line
        worst_permille = line.worst_gradient_permille(line.start_m, line.end_m)
        try:
            curve = self._braking.on(worst_permille)
        except ValueError as error:
            raise ValueError(
                f"line {line.name}: gradient_permille {worst_permille}: {error}"
            ) from None
        top_mps = max(section.limit_mps for section in line.speed_sections)
        top_mps += self._margins_mps.emergency
        return curve.stopping_m(top_mps, lead_s=self._leads_s.permitted)
