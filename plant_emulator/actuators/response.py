"""Delay and lag of an actuator, and its reaction to a missing command."""

from collections import deque
from math import exp
from typing import Final

NS_PER_S: Final = 1_000_000_000
FAR_NS: Final = 1 << 62
SETTLED_RATIO: Final = 1.0e-6
"""Relative distance to its target at which a lag counts as settled."""


class DeadTime:
    """A demand that takes effect later. Averaging over each step avoids rounding the instant."""

    __slots__ = ("_due", "value")

    def __init__(self, value: float = 0.0) -> None:
        self.value = value
        """The demand in effect."""
        self._due: deque[tuple[int, float]] = deque()

    @property
    def settled(self) -> bool:
        """No demand is pending."""
        return not self._due

    def ask(self, due_ns: int, value: float) -> None:
        """Let `value` take effect at `due_ns`, but not before demands that were made earlier."""
        self._due.append((due_ns, value))

    def shift(self, by_ns: int, value: float | None = None) -> None:
        """Delay all pending demands by `by_ns`, or only those with this `value`."""
        self._due = deque(
            (due_ns + by_ns if value is None or asked == value else due_ns, asked)
            for due_ns, asked in self._due
        )

    def mean(self, start_ns: int, end_ns: int) -> float:
        """Return the mean demand over [start, end). Calls must cover consecutive steps."""
        if not self._due or self._due[0][0] >= end_ns:
            return self.value
        total, at_ns = 0.0, start_ns
        while self._due and self._due[0][0] < end_ns:
            due_ns, value = self._due.popleft()
            due_ns = max(due_ns, at_ns)
            total += self.value * (due_ns - at_ns)
            self.value, at_ns = value, due_ns
        total += self.value * (end_ns - at_ns)
        return total / (end_ns - start_ns)


class Lag:
    """First-order lag, exact for an input that is constant over the step."""

    __slots__ = ("_keep_ratio", "value")

    def __init__(self, lag_s: float, step_s: float, value: float = 0.0) -> None:
        self._keep_ratio = exp(-step_s / lag_s) if lag_s > 0.0 else 0.0
        self.value = value
        """Output at the end of the last step."""

    def step(self, target: float) -> float:
        """Return the mean output over the step, from its two ends."""
        before = self.value
        if before == target:
            return target
        after = target + (before - target) * self._keep_ratio
        if abs(after - target) < SETTLED_RATIO * (1.0 + abs(target)):
            after = target
        self.value = after
        if self._keep_ratio == 0.0:
            return after
        return 0.5 * (before + after)


class DelayLine:
    """Delays an input that changes every step by a fixed number of steps."""

    __slots__ = ("_waiting",)

    def __init__(self, dead_time_s: float, step_s: float) -> None:
        self._waiting = deque([0.0] * round(dead_time_s / step_s))

    @property
    def empty(self) -> bool:
        """Whether the line contains only zeros."""
        return not any(self._waiting)

    def step(self, value: float) -> float:
        waiting = self._waiting
        if not waiting:
            return value
        waiting.append(value)
        return waiting.popleft()


class Hold:
    """Returns the greatest input of the last `hold_ns`."""

    __slots__ = ("_candidates", "_hold_ns")

    def __init__(self, hold_ns: int) -> None:
        self._hold_ns = hold_ns
        self._candidates: deque[tuple[int, float]] = deque()
        """Expiry and value of each candidate, in falling order; the first is the answer."""

    def greatest(self, now_ns: int, value: float) -> float:
        """Return the input of greatest magnitude among `value` and those of the last `hold_ns`."""
        kept = self._candidates
        while kept and abs(kept[-1][1]) <= abs(value):
            kept.pop()
        while kept and kept[0][0] <= now_ns:
            kept.popleft()
        kept.append((now_ns + self._hold_ns, value))
        return kept[0][1]


class CommandWatch:
    """Supervises the arrival of a command and reports a timeout once."""

    __slots__ = ("_timeout_ns", "expires_ns", "losses", "silent")

    def __init__(self, timeout_ns: int) -> None:
        assert timeout_ns > 0
        self._timeout_ns = timeout_ns
        self.expires_ns = FAR_NS
        """Instant at which the command times out; far in the future after the timeout has been
        handled."""
        self.losses = 0
        self.silent = False
        """The command was present before and is missing now."""

    def heard(self, heard_ns: int) -> None:
        self.expires_ns = heard_ns + self._timeout_ns
        self.silent = False

    def excuse(self, held_up_ns: int) -> None:
        """Extend the timeout by the time for which the receiver itself was stopped."""
        if self.expires_ns != FAR_NS:
            self.expires_ns += held_up_ns

    def lost(self) -> None:
        """Record that the timeout has been handled."""
        self.losses += 1
        self.silent = True
        self.expires_ns = FAR_NS
