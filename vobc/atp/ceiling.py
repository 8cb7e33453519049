"""The ceiling: what the line, the braking curves and the end of authority permit the train now."""

import itertools
from collections.abc import Sequence
from typing import NamedTuple

from firmware_py.trackdb import LineMap
from vobc.atp.braking import BrakingCurve, SafeBraking
from vobc.atp.config import AtpConfig
from vobc.vocabulary import Ceiling, Interval, Restriction


class _Four(NamedTuple):
    """The four speeds of a ceiling, or what makes them differ."""

    permitted: float
    warning: float
    service: float
    emergency: float


class CeilingMap:
    """All restrictions of a line for one train; `at` looks at them from one place.

    Each of the four curves is the safe braking curve, seen so much earlier as somebody needs to act
    (`lead`), and ends so much over the civil limit as is tolerated (`margin`). Nothing is tolerated
    at the end of authority.
    """

    def __init__(
        self, config: AtpConfig, braking: SafeBraking, line: LineMap, *, train_length_m: float
    ) -> None:
        self._line = line
        self._braking = braking
        self._length_m = train_length_m
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
        self._curves: dict[float, BrakingCurve] = {}
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
        """
        rear_m = front_m.low - self._length_m
        limit_mps = self._line.least_limit_mps(rear_m, front_m.high)
        least = [limit_mps + margin_mps for margin_mps in self._margins_mps]
        for start_m, target_mps in self._drops:
            if start_m > front_m.high + self._horizon_m:
                break
            if start_m > front_m.high:
                self._lower(least, rear_m, front_m.high, start_m, target_mps, self._margins_mps)
        to_end_m = authority_end_m - front_m.high
        if to_end_m < self._horizon_m:
            self._lower(least, rear_m, front_m.high, authority_end_m, 0.0, _NOTHING)
        emergency = least[3]
        service = min(least[2], emergency)
        warning = min(least[1], service)
        return Ceiling(min(least[0], warning), warning, service, emergency, to_end_m)

    def _lower(
        self,
        least: list[float],
        rear_m: float,
        front_m: float,
        at_m: float,
        target_mps: float,
        margins_mps: _Four,
    ) -> None:
        """Bring the four down to the curves towards one point ahead."""
        # Beyond its authority a train stands on its last metre; there is no stretch to look at.
        curve = self._curve(self._line.worst_gradient_permille(rear_m, max(at_m, front_m)))
        away_m = at_m - front_m
        for index, lead_s in enumerate(self._leads_s):
            speed_mps = curve.speed_mps(
                away_m, target_mps=target_mps + margins_mps[index], lead_s=lead_s
            )
            if speed_mps < least[index]:
                least[index] = speed_mps

    def _curve(self, gradient_permille: float) -> BrakingCurve:
        """Made once for each gradient: a line has few of them."""
        curve = self._curves.get(gradient_permille)
        if curve is None:
            curve = self._curves[gradient_permille] = self._braking.on(gradient_permille)
        return curve

    def _distance_that_never_binds_m(self) -> float:
        """From here on every curve lies over the highest speed of the line, wherever it falls."""
        line = self._line
        top_mps = max(section.limit_mps for section in line.speed_sections)
        top_mps += self._margins_mps.emergency
        curve = self._curve(line.worst_gradient_permille(line.start_m, line.end_m))
        lead_s = self._leads_s.permitted
        distance_m = 100.0
        while curve.speed_mps(distance_m, target_mps=0.0, lead_s=lead_s) < top_mps:
            distance_m *= 1.25
        return distance_m


_NOTHING = _Four(0.0, 0.0, 0.0, 0.0)
