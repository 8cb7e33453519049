"""Smith predictor: the effect of the demands under way until the next demand acts.

An actuator is a dead time followed by a first-order lag. Demands are constant between cycles, so
the integrals over the past are exact. This also holds for dead times that are no multiple of the
cycle.
"""

import math
from collections.abc import Sequence
from itertools import zip_longest
from typing import Final, NamedTuple

TIME_EPSILON_S: Final = 1e-9


class DelayTap(NamedTuple):
    """A place in the past: number of slots back, and the share of that slot in the mean."""

    back: int
    share_ratio: float


class Pipeline:
    """History of one demand as running integrals, long enough for the longest dead time."""

    __slots__ = ("_dt_s", "_first", "_second", "_size", "_value", "head")

    def __init__(self, dt_s: float, longest_s: float) -> None:
        assert dt_s > 0.0
        self._dt_s = dt_s
        self._size = math.ceil(longest_s / dt_s) + 3
        self._first = [0.0] * self._size
        """Integral of the demand up to the start of each slot."""
        self._second = [0.0] * self._size
        """Integral of that integral."""
        self._value = [0.0] * self._size
        """Demand during each slot."""
        self.head = 0
        """Number of completed slots. Slot `head` starts now."""

    def push(self, value: float) -> None:
        """The demand was `value` for the last cycle."""
        dt_s, size = self._dt_s, self._size
        old = self.head % size
        new = (self.head + 1) % size
        self._value[old] = value
        self._first[new] = self._first[old] + value * dt_s
        self._second[new] = self._second[old] + dt_s * (self._first[old] + value * dt_s / 2.0)
        self.head += 1

    def clear(self) -> None:
        """Reset the history to zero demand."""
        for integral in (self._first, self._second, self._value):
            integral[:] = [0.0] * self._size

    def to_come(self, dead_time_s: float) -> list[float]:
        """Mean demand that arrives in each coming cycle, if there is no further demand."""
        cycles = math.floor(dead_time_s / self._dt_s + TIME_EPSILON_S)
        return [
            self.mean(self.tap(dead_time_s - (cycle + 1) * self._dt_s)) for cycle in range(cycles)
        ]

    def window(self, age_s: float) -> tuple[float, float]:
        """Single and double integral of the demand since `age_s` ago, both from zero there."""
        first_then, second_then = self._at(age_s)
        now = self.head % self._size
        single = self._first[now] - first_then
        double = self._second[now] - second_then - first_then * age_s
        return single, double

    def tap(self, age_s: float) -> DelayTap:
        """Prepare to read the mean over the one cycle that ended `age_s` ago."""
        slots = age_s / self._dt_s
        back = math.ceil(slots - TIME_EPSILON_S)
        assert back + 1 < self._size
        return DelayTap(back, back - slots)

    def mean(self, tap: DelayTap) -> float:
        back, share_ratio = tap
        newer = self._value[(self.head - back) % self._size]
        older = self._value[(self.head - back - 1) % self._size]
        return share_ratio * newer + (1.0 - share_ratio) * older

    def _at(self, age_s: float) -> tuple[float, float]:
        slots = age_s / self._dt_s
        back = math.ceil(slots - TIME_EPSILON_S)
        into_s = (back - slots) * self._dt_s
        if back == 0:
            now = self.head % self._size
            return self._first[now], self._second[now]
        assert back < self._size
        index = (self.head - back) % self._size
        first, second, value = self._first[index], self._second[index], self._value[index]
        return (
            first + value * into_s,
            second + into_s * (first + value * into_s / 2.0),
        )


class Remains:
    """Demands under way from earlier applications, each with a dead time of its own."""

    __slots__ = ("_dt_s", "_means")

    def __init__(self, dt_s: float) -> None:
        self._dt_s = dt_s
        self._means: list[float] = []
        """Mean of each coming cycle."""

    def __bool__(self) -> bool:
        return bool(self._means)

    def clear(self) -> None:
        self._means = []

    def add(self, means: Sequence[float]) -> None:
        """Add an application that has ended. `means` arrive in the coming cycles."""
        self._means = [sum(both) for both in zip_longest(self._means, means, fillvalue=0.0)]

    def step(self) -> None:
        """Advance by one cycle."""
        del self._means[:1]

    def after(self, time_s: float) -> float:
        """Mean over the cycle that begins after this time."""
        cycle = round(time_s / self._dt_s)
        return self._means[cycle] if cycle < len(self._means) else 0.0

    def window(self, horizon_s: float) -> tuple[float, float]:
        """Single and double integral from now until then."""
        single = double = 0.0
        for cycle, mean in enumerate(self._means):
            left_s = horizon_s - cycle * self._dt_s
            if left_s <= 0.0:
                break
            share_s = min(self._dt_s, left_s)
            single += mean * share_s
            double += mean * share_s * (left_s - share_s / 2.0)
        return single, double


class PredictedState(NamedTuple):
    """The predicted state when a demand given now begins to act."""

    front_m: float
    speed_mps: float


class MeanInputLag:
    """First-order lag whose input is the mean over each cycle."""

    __slots__ = ("_keep_ratio", "value")

    def __init__(self, lag_s: float, dt_s: float) -> None:
        self._keep_ratio = math.exp(-dt_s / lag_s)
        self.value = 0.0

    def step(self, mean_input: float) -> float:
        """Value at the end of the cycle."""
        self.value = mean_input + (self.value - mean_input) * self._keep_ratio
        return self.value


def response(
    pipeline: Pipeline,
    *,
    dead_time_s: float,
    lag_s: float,
    output_now: float,
    output_then: float,
    remains: Remains | None = None,
) -> tuple[float, float]:
    """Single and double integral of an actuator's output from now until the dead time has passed.

    For a first-order lag y' = (u - y) / tau, the integral of y is that of u less tau * (y - y0).
    Integrated once more, this gives the double integral. The result is exact.

    Args:
        output_now: present output of the lag, driven by the delayed demand.
        output_then: its output after the dead time, driven by all demands under way.
        remains: demands of earlier applications that are also under way.
    """
    single_in, double_in = pipeline.window(dead_time_s)
    if remains is not None:
        more_single, more_double = remains.window(dead_time_s)
        single_in += more_single
        double_in += more_double
    single = single_in - lag_s * (output_then - output_now)
    double = double_in - lag_s * (single - output_now * dead_time_s)
    return single, double


def settling(
    time_s: float, *, lag_s: float, output_now: float, asked: float
) -> tuple[float, float]:
    """The same for a lag with a constant input and no demands under way."""
    output_then = asked + (output_now - asked) * math.exp(-time_s / lag_s)
    single = asked * time_s - lag_s * (output_then - output_now)
    double = asked * time_s**2 / 2.0 - lag_s * (single - output_now * time_s)
    return single, double
