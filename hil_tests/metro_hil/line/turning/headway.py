"""Headway where trains turn round, beside its analytic limit.

A track at a turnback takes one train at a time. So two trains turn there at least this far apart:

    headway = switch + authority + run in + turn + wait + run out

- `switch`: time in which the switch moves for the next train.
- `authority`: time until that train has the authority.
- `run in`: shortest run to the stop, from where the train would brake if the signal showed stop.
- `turn`: time from standing until the controller of the other cab permits movement, or the layover.
- `wait`: time for which the signal on the way out would stop the train, while the switch moves.
- `run out`: shortest time until the rear has released the switch.
"""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

from metro_hil.line.turning.plan import Entry, FleetPlan, TripPlan, approach
from metro_hil.line.turning.train import TripRecord
from metro_hil.metrics.fastest_run import (
    LimitedStretch,
    fastest_run_s,
    journey_fastest_s,
    limited_stretches,
)
from metro_hil.model.end_condition import AFTER_ARRIVAL_S
from plant_emulator.wayside.interlocking import CLEAR_M, MOVE_S, sections_of

AUTHORITY_S: Final = 0.3
"""Mean time from a proven route to the authority on board: half the interval of the reports, an
answer of the wayside and a cycle."""
START_S: Final = 2.05
"""Time from the start of the controller in the other cab until protection permits movement."""


@dataclass(frozen=True, slots=True)
class HeadwayLimit:
    """Terms of the least headway at a turnback, s."""

    station: str
    run_in_s: float
    turn_s: float
    wait_s: float
    run_out_s: float
    switch_s: float = MOVE_S
    authority_s: float = AUTHORITY_S

    @property
    def total_s(self) -> float:
        running_s = self.run_in_s + self.turn_s + self.wait_s + self.run_out_s
        return self.switch_s + self.authority_s + running_s


@dataclass(frozen=True, slots=True)
class Turnback:
    """How trains turned at a station, beside the limit."""

    limit: HeadwayLimit
    turns: int
    headways_s: tuple[float, ...]
    """Times between two trains that left the switch behind them."""
    occupied_s: tuple[float, ...]
    """For each turn of a train that was not hindered before it, the time from where the train
    needed the route until its rear released the switch on its way out."""

    @property
    def least_s(self) -> float:
        """Least headway that the turns would have allowed."""
        return min(self.occupied_s) + self.limit.switch_s + self.limit.authority_s


def turnbacks(plan: FleetPlan, trips: Sequence[TripRecord]) -> list[Turnback]:
    """Each place where trains changed ends, in the order of the service.

    Args:
        trips: of all trains.
    """
    found = []
    each_round = len(plan.service.trips)
    for index in range(each_round):
        came, leaves = plan.trips[index - 1], plan.trips[index]
        turned = [each for each in trips if each.index % each_round == index and each.turned]
        if not turned or came.entry is None:
            continue
        cleared_s = sorted(each.clear_s for each in turned if each.clear_s is not None)
        headways_s = tuple(later - sooner for sooner, later in itertools.pairwise(cleared_s))
        before = {(each.train, each.index): each for each in trips}
        occupied_s = tuple(
            occupied
            for each in turned
            if (occupied := _occupied_s(before.get((each.train, each.index - 1)), each)) is not None
        )
        limit = headway_limit(plan, came, came.entry, leaves)
        found.append(Turnback(limit, len(turned), headways_s, occupied_s))
    return found


def headway_limit(plan: FleetPlan, came: TripPlan, entry: Entry, leaves: TripPlan) -> HeadwayLimit:
    """The analytic limit at the end of a trip."""
    ato = plan.config.ato
    limits, length_m = ato.limits, ato.train_length_m
    last = came.journey.end.name
    line, start_m = leaves.journey.line, leaves.journey.start.stop_m
    section = sections_of(plan.network, leaves.trip.path)[0]
    clear_m = section.crossings[-1].at_m + CLEAR_M + length_m
    way = limited_stretches(line, start_m, clear_m, train_length_m=length_m)
    # A run to rest over twice the way is at its top where the way ends.
    both_s = fastest_run_s(
        _joined([*way, *way[::-1]]), accel_mps2=limits.accel_mps2, jerk_mps3=limits.jerk_mps3
    )
    brake_s = approach(line, ato, start_m, section.signal_m).brake_s
    return HeadwayLimit(
        last,
        run_in_s=journey_fastest_s(came.journey, ato)[last] - entry.brake_s,
        turn_s=AFTER_ARRIVAL_S + max(START_S, leaves.trip.layover_s),
        wait_s=max(0.0, MOVE_S + AUTHORITY_S - brake_s),
        run_out_s=both_s / 2.0,
    )


def _joined(way: Sequence[LimitedStretch]) -> list[LimitedStretch]:
    joined: list[LimitedStretch] = []
    for each in way:
        if joined and joined[-1].limit_mps == each.limit_mps:
            length_m = joined[-1].length_m + each.length_m
            joined[-1] = LimitedStretch(length_m, each.limit_mps)
        else:
            joined.append(each)
    return joined


def _occupied_s(came: TripRecord | None, leaves: TripRecord) -> float | None:
    if came is None or came.entered_s is None or leaves.clear_s is None:
        return None
    return leaves.clear_s - came.entered_s
