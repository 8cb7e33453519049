"""The automatic operation: drives from stop to stop, works the doors, dwells and departs."""

import math
from collections.abc import Sequence
from typing import Final

from can_dbc.vobc import AtoPhase
from firmware_py.trackdb import LineMap, Station
from vobc.ato import gradient
from vobc.ato.config import AtoConfig
from vobc.ato.mode import DRIVING, Situation, next_phase
from vobc.ato.shaper import Shaper
from vobc.ato.strategies import make_strategy
from vobc.ato.strategies.strategy import Drive, Strategy, Target
from vobc.vocabulary import AtoDemand, AtoInput

UNDER_WAY_MPS: Final = 0.3
"""Over this a departing train is under way; well over speed noise and rollback."""
MOVING_MPS: Final = 0.5
"""A train met in motion is taken over when it is faster than this."""
DISABLED_DECEL_MPS2: Final = 0.65
"""Asked while somebody else has the say and the train still moves."""
HOLD_HELP_MPS2: Final = 0.02
"""On a rising gradient the holding brake comes off when traction exceeds gravity by this."""
LEVEL_MPS2: Final = 0.01
LEAST_CEILING_MPS: Final = 1.0
"""Under a lower ceiling nothing sets off."""


class Ato:
    """Serves `stops` in order; one at `start_m` first, unless it has no dwell time.

    Raises ValueError for an unknown strategy name.
    """

    def __init__(
        self, config: AtoConfig, line: LineMap, start_m: float, stops: Sequence[Station]
    ) -> None:
        self._config = config
        self._line = line
        window_m = config.station.window_m
        self._stops = tuple(stop for stop in stops if stop.stop_m >= start_m - window_m)
        self._index = 0
        self._served = False
        self._jogs = 0
        self._dwelt_s = 0.0
        self._asked_open_s = 0.0
        self._hold = True
        self._held_s = 0.0
        self._released_s = config.station.release_s
        self._doors_wanted = False
        self._dt_s = 0.0
        self._strategy: Strategy | None = None
        # Refuses an unknown name now; the real one is made when the cycle time is known.
        make_strategy(config, line, 1.0)
        self._shaper = Shaper(config.limits)
        self._seen = Situation()
        self.phase = AtoPhase.OFF

    @property
    def next_stop(self) -> Station | None:
        """The stop that is approached or worked at; None when the list is empty."""
        return self._stops[self._index] if self._index < len(self._stops) else None

    @property
    def strategy(self) -> Strategy | None:
        """The control law at work; None before the first step."""
        return self._strategy

    def step(self, seen: AtoInput) -> AtoDemand:
        """One cycle. The first one's `dt_s` is the nominal period."""
        strategy = self._strategy or self._begin(seen)
        cycles = max(1, round(seen.dt_s / self._dt_s))
        strategy.observe(seen, cycles)
        before = self.phase
        self._look(seen)
        self.phase = next_phase(before, self._seen)
        if self.phase is not before:
            self._enter(before, seen)
        if self.phase in DRIVING:
            drive = strategy.drive(seen, self._target(seen))
            self._seen.braking = drive.braking
        else:
            drive = self._stand_or_brake(seen)
        self._decide_hold(seen, drive)
        accel_mps2 = self._shape(seen, drive)
        strategy.issued(accel_mps2)
        self._released_s = self._released_s + seen.dt_s if accel_mps2 >= 0.0 else 0.0
        return self._demand(seen, accel_mps2, drive)

    def _begin(self, seen: AtoInput) -> Strategy:
        self._dt_s = seen.dt_s
        self._strategy = make_strategy(self._config, self._line, seen.dt_s)
        return self._strategy

    def _demand(self, seen: AtoInput, accel_mps2: float, drive: Drive) -> AtoDemand:
        stop = self.next_stop
        return AtoDemand(
            accel_mps2=accel_mps2,
            hold=self._hold,
            open_doors=self._doors_wanted and seen.door_enabled,
            phase=self.phase,
            target_mps=drive.reference_mps,
            distance_to_stop_m=math.inf if stop is None else stop.stop_m - seen.front_m,
        )

    # What the guards look at.

    def _look(self, seen: AtoInput) -> None:
        work, situation = self._config.station, self._seen
        stop = self.next_stop
        to_stop_m = math.inf if stop is None else stop.stop_m - seen.front_m
        situation.enabled = seen.enabled
        self._held_s = self._held_s + seen.dt_s if seen.holding_applied and self._hold else 0.0
        situation.resting = seen.standstill and self._held_s >= work.settle_s
        situation.under_way = seen.speed_mps > (
            MOVING_MPS if self.phase is AtoPhase.OFF else UNDER_WAY_MPS
        )
        situation.in_stopping_zone = to_stop_m <= work.stopping_zone_m
        situation.at_stop = abs(to_stop_m) <= work.window_m
        situation.released = self._released_s >= work.release_s
        situation.doors_locked = seen.doors_locked
        situation.doors_enabled = seen.door_enabled and seen.holding_applied
        situation.has_door_work = stop is not None and stop.dwell_s > 0.0
        if self.phase is AtoPhase.STOPPED and not situation.has_door_work:
            self._served = self._index + 1 < len(self._stops)
        elif self.phase is AtoPhase.DOORS_OPEN:
            self._dwell(seen)
        situation.served = self._served
        situation.dwell_over = stop is not None and self._dwelt_s >= stop.dwell_s
        situation.may_go = self._may_go(seen)

    def _dwell(self, seen: AtoInput) -> None:
        self._asked_open_s += seen.dt_s
        if seen.doors_open or self._asked_open_s > self._config.station.doors_patience_s:
            self._dwelt_s += seen.dt_s

    def _may_go(self, seen: AtoInput) -> bool:
        """Whether the next movement may begin: to the next stop, or on to one missed short."""
        work = self._config.station
        working = self.phase is AtoPhase.DOORS_OPEN or self._served
        goal = self._index + 1 if working else self._index
        if goal >= len(self._stops) or seen.ceiling_mps < LEAST_CEILING_MPS:
            return False
        stop_m = self._stops[goal].stop_m
        room_m = self._reach(stop_m, seen.authority_end_m).at_m - seen.front_m
        if stop_m - seen.front_m <= work.jog_reach_m:
            return room_m > work.window_m and self._jogs < work.jog_attempts
        return room_m >= work.least_run_m

    def _target(self, seen: AtoInput) -> Target:
        stop = self.next_stop
        stop_m = self._line.end_m if stop is None else stop.stop_m
        return self._reach(stop_m, seen.authority_end_m)

    def _reach(self, stop_m: float, authority_end_m: float) -> Target:
        """The stop itself if the authority covers it, else a point short of the authority's end."""
        if authority_end_m >= stop_m:
            return Target(stop_m, True)
        return Target(authority_end_m - self._config.authority.margin_m, False)

    # What a change of phase brings.

    def _enter(self, before: AtoPhase, seen: AtoInput) -> None:
        assert self._strategy is not None
        phase = self.phase
        if phase is AtoPhase.DEPARTING:
            self._depart(seen)
            self._strategy.set_off(seen, self._shaper.demand_mps2)
        elif phase is AtoPhase.RUNNING and before is AtoPhase.OFF:
            self._hold = False
            self._strategy.set_off(seen, self._shaper.demand_mps2)
        elif phase is AtoPhase.DOORS_OPEN:
            self._doors_wanted = True
            self._asked_open_s = 0.0
        elif phase is AtoPhase.DOORS_CLOSING:
            self._doors_wanted = False
            self._served = True
        elif phase is AtoPhase.STOPPED:
            self._jogs = 0

    def _depart(self, seen: AtoInput) -> None:
        if self._served:
            self._served = False
            self._dwelt_s = 0.0
            self._index += 1
            self._jogs = 0
        stop = self.next_stop
        if stop is not None and stop.stop_m - seen.front_m <= self._config.station.jog_reach_m:
            self._jogs += 1

    # What goes out.

    def _stand_or_brake(self, seen: AtoInput) -> Drive:
        """Outside the driving phases: held at standstill, else braked to it."""
        assert self._strategy is not None
        if not self._hold:
            return Drive(-DISABLED_DECEL_MPS2, 0.0, False)
        if seen.standstill:
            self._strategy.rest()
        held = seen.holding_applied and seen.standstill
        return Drive(0.0 if held else -self._config.station.hold_decel_mps2, 0.0, False)

    def _decide_hold(self, seen: AtoInput, drive: Drive) -> None:
        """The holding brake comes on as the train comes to rest and stays until it departs."""
        assert self._strategy is not None
        uphill_mps2 = max(0.0, gradient.decel_on_mps2(self._config, seen.gradient_permille))
        if self.phase is AtoPhase.DEPARTING:
            needed_mps2 = uphill_mps2 + HOLD_HELP_MPS2 if uphill_mps2 > LEVEL_MPS2 else 0.0
            self._hold = self._hold and self._shaper.demand_mps2 < needed_mps2
            return
        work = self._config.station
        slow = self._strategy.speed_mps <= work.hold_speed_mps + uphill_mps2 * work.hold_lead_s
        if slow and drive.accel_mps2 <= 0.0:
            self._hold = True

    def _shape(self, seen: AtoInput, drive: Drive) -> float:
        wanted_mps2 = drive.accel_mps2
        if self._hold and self.phase is not AtoPhase.DEPARTING:
            wanted_mps2 = min(wanted_mps2, 0.0)
            if not (seen.holding_applied and seen.standstill):
                wanted_mps2 = -self._config.station.hold_decel_mps2
        accel_mps2 = self._shaper.step(wanted_mps2, seen.dt_s)
        unready = self._hold and self.phase not in DRIVING
        if accel_mps2 > 0.0 and (unready or (not seen.doors_locked and not self._seen.under_way)):
            accel_mps2 = self._shaper.drop_traction()
        return accel_mps2
