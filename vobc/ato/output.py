"""Output stages: what a shaped demand becomes on its way to the train.

All keep one promise: a stage never sends more traction and never less brake than it is asked for,
as far as its levels go. On the axis of demands that is the next level at or below.
"""

import math
from typing import Final, Protocol

from vobc.ato import current_loop
from vobc.ato.output_config import OutputStage

SAME_MPS2: Final = 1e-9
"""A demand so close to a level is meant to be it."""


class Stage(Protocol):
    def step(self, demand_mps2: float, dt_s: float) -> float:
        """The demand that really leaves in this cycle."""


class Continuous:
    """The train takes any demand; the limits of acceleration and jerk hold for what leaves."""

    __slots__ = ()

    def step(self, demand_mps2: float, dt_s: float) -> float:
        return demand_mps2


class Notches:
    """A master controller: notch by notch along the shaper's ramp, as the ramp reaches each one.

    Steps down are made at once. A step up waits for the dwell time after a step down, and until the
    demand is well over the notch; more of them go out one a cycle. A demand that rests on a notch
    has picked it, and gets it without waiting.
    """

    __slots__ = (
        "_before_mps2",
        "_dwell_s",
        "_hysteresis_ratio",
        "_index",
        "_levels_mps2",
        "_since_down_s",
    )

    def __init__(self, config: OutputStage) -> None:
        brakes_mps2 = [-level_mps2 for level_mps2 in reversed(config.brake_levels_mps2)]
        self._levels_mps2 = (*brakes_mps2, 0.0, *config.traction_levels_mps2)
        self._index = len(brakes_mps2)
        self._hysteresis_ratio = config.hysteresis_ratio
        self._dwell_s = config.dwell_s
        self._since_down_s = math.inf
        self._before_mps2 = 0.0

    def step(self, demand_mps2: float, dt_s: float) -> float:
        self._since_down_s += dt_s
        levels_mps2 = self._levels_mps2
        at_most = self._highest_within(demand_mps2)
        if at_most < self._index:
            self._index = at_most
            self._since_down_s = 0.0
        elif at_most > self._index:
            rests = abs(demand_mps2 - self._before_mps2) <= SAME_MPS2
            if rests and abs(demand_mps2 - levels_mps2[at_most]) <= SAME_MPS2:
                self._index += 1
            elif self._since_down_s >= self._dwell_s:
                self._index = min(self._index + 1, self._well_within(demand_mps2, at_most))
        self._before_mps2 = demand_mps2
        return levels_mps2[self._index]

    def _highest_within(self, demand_mps2: float) -> int:
        """The highest level at or under the demand; under all of them, the strongest brake."""
        index = len(self._levels_mps2) - 1
        while index > 0 and self._levels_mps2[index] > demand_mps2 + SAME_MPS2:
            index -= 1
        return index

    def _well_within(self, demand_mps2: float, at_most: int) -> int:
        levels_mps2 = self._levels_mps2
        above = min(at_most + 1, len(levels_mps2) - 1)
        gap_mps2 = levels_mps2[above] - levels_mps2[above - 1]
        enough_mps2 = levels_mps2[at_most] + self._hysteresis_ratio * gap_mps2
        return at_most if demand_mps2 >= enough_mps2 else at_most - 1


class CurrentLoop:
    """Two loops of 4 to 20 mA, one for traction and one for the brake, set by a converter.

    What leaves is the demand that a receiver reads from the quantised currents.
    """

    __slots__ = ("_bits", "_brake_full_mps2", "_traction_full_mps2", "brake_ma", "traction_ma")

    def __init__(self, config: OutputStage) -> None:
        self._bits = config.loop_bits
        self._traction_full_mps2 = config.loop_traction_full_mps2
        self._brake_full_mps2 = config.loop_brake_full_mps2
        self.traction_ma = current_loop.current_ma(0.0, self._bits, up=False)
        self.brake_ma = self.traction_ma

    def step(self, demand_mps2: float, dt_s: float) -> float:
        pull_ratio = max(0.0, demand_mps2) / self._traction_full_mps2
        brake_ratio = max(0.0, -demand_mps2) / self._brake_full_mps2
        self.traction_ma = current_loop.current_ma(pull_ratio, self._bits, up=False)
        self.brake_ma = current_loop.current_ma(brake_ratio, self._bits, up=True)
        if demand_mps2 < 0.0:
            return -current_loop.brake_ratio(self.brake_ma) * self._brake_full_mps2
        return current_loop.traction_ratio(self.traction_ma) * self._traction_full_mps2


def make_stage(config: OutputStage) -> Stage:
    """A fresh stage of the kind that the settings name."""
    if config.stage == "notches":
        return Notches(config)
    if config.stage == "current_loop":
        return CurrentLoop(config)
    return Continuous()
