"""Output stages: conversion of the shaped demand into what the train receives.

No stage ever sends more traction or less brake than demanded, within its levels. On the axis of
demands this is the next level at or below.
"""

import math
from collections.abc import Callable, Mapping
from typing import Final, Protocol

from vobc.ato import current_loop
from vobc.ato.settings.output import OutputStage

SAME_MPS2: Final = 1e-9
"""Tolerance within which a demand is taken as a level."""
TREND_S: Final = 0.3
TREND_MPS3: Final = 0.3
"""Time constant and limit of the smoothed slope of the demand."""
LIGHT_MPS2: Final = 0.25
LIGHT_RATIO: Final = 0.6
"""Brake demand below which the dwell time is shortened by this factor."""
FAR_NOTCHES: Final = 4
"""Number of notches from which a change does not wait for the dwell time."""


class StageOutput(Protocol):
    def pick(self, wanted_mps2: float, dt_s: float, *, firm: bool) -> float:
        """Level that the shaper should aim at.

        Args:
            firm: at least the demanded brake; else the nearest level.
        """

    def step(self, demand_mps2: float, dt_s: float) -> float:
        """Demand that is actually sent in this cycle."""


class Continuous:
    """The train accepts any demand. The limits of acceleration and jerk apply to what is sent."""

    __slots__ = ()

    def pick(self, wanted_mps2: float, dt_s: float, *, firm: bool) -> float:
        return wanted_mps2

    def step(self, demand_mps2: float, dt_s: float) -> float:
        return demand_mps2


class Notches:
    """A master controller that rests on notches and moves between them along the shaper's ramp.

    A notch stays for the dwell time. It also stays until the demand is nearer to another one by the
    hysteresis. A distant demand does not wait. Traction never exceeds the demand, and any brake
    demand keeps at least the smallest notch. A demand that equals a notch was picked by the law and
    is used as it is.
    """

    __slots__ = (
        "_before_mps2",
        "_dwell_s",
        "_hysteresis_ratio",
        "_index",
        "_least_brake_mps2",
        "_levels_mps2",
        "_since_s",
        "_trend_mps3",
    )

    def __init__(self, config: OutputStage) -> None:
        brakes_mps2 = [-level_mps2 for level_mps2 in reversed(config.brake_levels_mps2)]
        self._levels_mps2 = (*brakes_mps2, 0.0, *config.traction_levels_mps2)
        self._index = len(brakes_mps2)
        self._hysteresis_ratio = config.hysteresis_ratio
        self._dwell_s = config.dwell_s
        self._least_brake_mps2 = -config.brake_levels_mps2[0]
        self._since_s = math.inf
        self._before_mps2 = 0.0
        self._trend_mps3 = 0.0

    def pick(self, wanted_mps2: float, dt_s: float, *, firm: bool) -> float:
        self._since_s += dt_s
        best = self._at_most(wanted_mps2)
        picked = abs(self._levels_mps2[best] - wanted_mps2) <= SAME_MPS2
        self._follow_trend(wanted_mps2, dt_s)
        if not (firm or picked):
            # A notch should fit the middle of the time it stays.
            if wanted_mps2 < 0.0:
                ahead_mps2 = wanted_mps2 + self._trend_mps3 * self._dwell_s / 2.0
                wanted_mps2 = min(self._least_brake_mps2, ahead_mps2)
            best = self._nearest(wanted_mps2)
        if best != self._index and (firm or picked or self._may_change(wanted_mps2, best)):
            self._index, self._since_s = best, 0.0
        return self._levels_mps2[self._index]

    def step(self, demand_mps2: float, dt_s: float) -> float:
        return demand_mps2

    def _follow_trend(self, wanted_mps2: float, dt_s: float) -> None:
        change_mps2, self._before_mps2 = wanted_mps2 - self._before_mps2, wanted_mps2
        if dt_s <= 0.0:
            return
        slope_mps3 = change_mps2 / dt_s
        slope_mps3 = max(-TREND_MPS3, min(TREND_MPS3, slope_mps3))
        self._trend_mps3 += (slope_mps3 - self._trend_mps3) * min(1.0, dt_s / TREND_S)

    def _may_change(self, wanted_mps2: float, best: int) -> bool:
        if abs(best - self._index) >= FAR_NOTCHES:
            return True
        levels_mps2 = self._levels_mps2
        here_mps2 = levels_mps2[self._index]
        # A light brake is about to stop the train. A strong notch must not stay then.
        light = -LIGHT_MPS2 < wanted_mps2 < 0.0
        if self._since_s < self._dwell_s * (LIGHT_RATIO if light else 1.0):
            return False
        if here_mps2 < 0.0 <= levels_mps2[best] or levels_mps2[best] < 0.0 <= here_mps2:
            return True
        towards = self._index + (1 if best > self._index else -1)
        gap_mps2 = abs(levels_mps2[towards] - here_mps2)
        # Traction is never rounded up, so its notches change where they are reached.
        share_ratio = 0.5 if here_mps2 < 0.0 else 1.0 if best > self._index else 0.0
        return abs(wanted_mps2 - here_mps2) >= (share_ratio + self._hysteresis_ratio) * gap_mps2

    def _nearest(self, wanted_mps2: float) -> int:
        """Index of the nearest brake level, never a release.

        For traction, the next level at or below.
        """
        below = self._at_most(wanted_mps2)
        above = below + 1
        levels_mps2 = self._levels_mps2
        if wanted_mps2 >= -SAME_MPS2 or levels_mps2[above] >= 0.0:
            return below
        nearer = levels_mps2[above] - wanted_mps2 < wanted_mps2 - levels_mps2[below]
        return above if nearer else below

    def _at_most(self, wanted_mps2: float) -> int:
        """Index of the highest level at or below the demand. If there is none, the strongest
        brake.
        """
        index = len(self._levels_mps2) - 1
        while index > 0 and self._levels_mps2[index] > wanted_mps2 + SAME_MPS2:
            index -= 1
        return index


class CurrentLoop:
    """Two 4 to 20 mA loops, for traction and brake, driven by a converter.

    The demand sent is what a receiver reads from the quantised currents.
    """

    __slots__ = ("_bits", "_brake_full_mps2", "_traction_full_mps2", "brake_ma", "traction_ma")

    def __init__(self, config: OutputStage) -> None:
        self._bits = config.loop_bits
        self._traction_full_mps2 = config.loop_traction_full_mps2
        self._brake_full_mps2 = config.loop_brake_full_mps2
        self.traction_ma = current_loop.current_ma(0.0, self._bits, up=False)
        self.brake_ma = self.traction_ma

    def pick(self, wanted_mps2: float, dt_s: float, *, firm: bool) -> float:
        return wanted_mps2

    def step(self, demand_mps2: float, dt_s: float) -> float:
        pull_ratio = max(0.0, demand_mps2) / self._traction_full_mps2
        brake_ratio = max(0.0, -demand_mps2) / self._brake_full_mps2
        self.traction_ma = current_loop.current_ma(pull_ratio, self._bits, up=False)
        self.brake_ma = current_loop.current_ma(brake_ratio, self._bits, up=True)
        if demand_mps2 < 0.0:
            return -current_loop.brake_ratio(self.brake_ma) * self._brake_full_mps2
        return current_loop.traction_ratio(self.traction_ma) * self._traction_full_mps2


def make_stage(config: OutputStage) -> StageOutput:
    """A new stage of the kind that the settings name."""
    return MAKERS[config.stage](config)


MAKERS: Final[Mapping[str, Callable[[OutputStage], StageOutput]]] = {
    "continuous": lambda config: Continuous(),
    "notches": Notches,
    "current_loop": CurrentLoop,
}
"""Maker of each stage of `settings.output.STAGES`."""
