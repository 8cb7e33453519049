"""The ceiling: speed limits from the line, the braking curves and the end of authority."""

import itertools
import math
from collections.abc import Sequence
from typing import Final, NamedTuple

from can_dbc.vobc import TargetKind
from firmware_py.trackdb import LineMap
from vobc.atp.braking import SafeBraking
from vobc.atp.config import AtpConfig
from vobc.atp.profile import BrakingProfile
from vobc.vocabulary import Ceiling, Interval, Restriction, SupervisedTarget

PROFILES_MAX: Final = 256
"""Greatest number of stored profiles. An interval that grows in steps along a whole line needs
fewer."""


class _Four(NamedTuple):
    """The four speeds of a ceiling, or their margins or leads."""

    permitted: float
    warning: float
    service: float
    emergency: float


_NOTHING: Final = _Four(0.0, 0.0, 0.0, 0.0)


class CeilingMap:
    """All speed restrictions of a line for one train.

    Each of the four curves is the safe braking curve, shifted by the time needed to act (`lead`).
    It ends above the limit by the tolerated `margin`. There is no tolerance at the end of
    authority.
    """

    def __init__(
        self, config: AtpConfig, braking: SafeBraking, line: LineMap, *, train_length_m: float
    ) -> None:
        """Raises ValueError for a line that is too steep downhill for the guaranteed brake rate."""
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
        """Ceiling of a train whose front is somewhere in the interval.

        Targets ahead count from the high end of the interval. A limit holds until the rear is clear
        of it, measured from the low end. Nothing is permitted if the front may be at or beyond the
        end of authority, or if the place is not finite.
        """
        foremost_m = front_m.high
        to_end_m = authority_end_m - foremost_m
        width_m = foremost_m - front_m.low
        if not to_end_m > 0.0 or not 0.0 <= width_m < math.inf:
            passed = SupervisedTarget(TargetKind.END, 0.0, to_end_m)
            return Ceiling(0.0, 0.0, 0.0, 0.0, to_end_m, passed)
        profile = self._profile(math.ceil(width_m / self._step_m))
        limit_mps = self._limit_under_mps(front_m.low - self._length_m, foremost_m, restrictions)
        least = [limit_mps + margin_mps for margin_mps in self._margins_mps]
        target = None
        visible_m = foremost_m + self._horizon_m
        for start_m, target_mps in self._drops:
            if start_m > visible_m:
                break
            if start_m > foremost_m and self._lowers(
                least, profile, foremost_m, start_m, target_mps, self._margins_mps
            ):
                target = SupervisedTarget(TargetKind.LINE_LIMIT, target_mps, start_m - foremost_m)
        for ahead in restrictions:
            if foremost_m < ahead.start_m <= visible_m and self._lowers(
                least, profile, foremost_m, ahead.start_m, ahead.limit_mps, self._margins_mps
            ):
                distance_m = ahead.start_m - foremost_m
                target = SupervisedTarget(TargetKind.RESTRICTION, ahead.limit_mps, distance_m)
        if authority_end_m <= visible_m and self._lowers(
            least, profile, foremost_m, authority_end_m, 0.0, _NOTHING
        ):
            target = SupervisedTarget(TargetKind.END, 0.0, to_end_m)
        emergency = least[3]
        service = min(least[2], emergency)
        warning = min(least[1], service)
        return Ceiling(min(least[0], warning), warning, service, emergency, to_end_m, target)

    def _limit_under_mps(
        self, rear_m: float, front_m: float, restrictions: Sequence[Restriction]
    ) -> float:
        """The lowest limit under a train that covers [rear, front]. Sections are half-open."""
        limit_mps = self._line.least_limit_mps(rear_m, front_m)
        for under in restrictions:
            if under.start_m <= front_m and rear_m < under.end_m:
                limit_mps = min(limit_mps, under.limit_mps)
        return limit_mps

    def _lowers(
        self,
        least: list[float],
        profile: BrakingProfile,
        front_m: float,
        at_m: float,
        target_mps: float,
        margins_mps: _Four,
    ) -> bool:
        """Lower the four speeds to the curves towards one target ahead.

        True: the permitted speed becomes lower.
        """
        permitted_mps = least[0]
        work_j_per_kg = profile.work_j_per_kg(at_m)
        for index, lead_s in enumerate(self._leads_s):
            least[index] = profile.speed_mps(
                front_m,
                work_j_per_kg,
                target_mps=target_mps + margins_mps[index],
                lead_s=lead_s,
                below_mps=least[index],
            )
        return least[0] < permitted_mps

    def _profile(self, steps: int) -> BrakingProfile:
        """Braking profile for the width of the interval, in steps. Each is computed once."""
        profile = self._profiles.get(steps)
        if profile is None:
            if len(self._profiles) >= PROFILES_MAX:
                self._profiles.clear()
            under_m = self._length_m + steps * self._step_m
            profile = BrakingProfile(self._braking, self._line, under_m=under_m)
            self._profiles[steps] = profile
        return profile

    def _distance_that_never_binds_m(self) -> float:
        """Distance from which every curve lies above the highest speed of the line, even on the
        steepest part.
        """
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
