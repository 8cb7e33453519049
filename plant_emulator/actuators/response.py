"""How late and how slowly an actuator follows its command, and what it does without one."""

from collections import deque
from math import exp
from typing import Final

NS_PER_S: Final = 1_000_000_000
FAR_NS: Final = 1 << 62
SETTLED_RATIO: Final = 1.0e-6
"""A lag that is this close to its target has arrived."""


class DeadTime:
    """A demand that arrives later. Between two steps it is averaged, so no instant is rounded."""

    __slots__ = ("_due", "value")

    def __init__(self, value: float = 0.0) -> None:
        self.value = value
        """What has arrived."""
        self._due: deque[tuple[int, float]] = deque()

    @property
    def settled(self) -> bool:
        """Nothing is under way."""
        return not self._due

    def ask(self, due_ns: int, value: float) -> None:
        """Let `value` arrive at `due_ns`, or with what was asked earlier if that comes later."""
        self._due.append((due_ns, value))

    def shift(self, by_ns: int, value: float | None = None) -> None:
        """Let what is under way arrive so much later; only what has this value, if one is given."""
        self._due = deque(
            (due_ns + by_ns if value is None or asked == value else due_ns, asked)
            for due_ns, asked in self._due
        )

    def mean(self, start_ns: int, end_ns: int) -> float:
        """Mean of what has arrived over [start, end); steps must follow each other."""
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
        """At the end of the last step."""

    def step(self, target: float) -> float:
        """Mean of the output over the step, by its two ends."""
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
    """An input that changes with every step, shifted by a fixed number of steps."""

    __slots__ = ("_waiting",)

    def __init__(self, dead_time_s: float, step_s: float) -> None:
        self._waiting = deque([0.0] * round(dead_time_s / step_s))

    @property
    def empty(self) -> bool:
        """Nothing but zeros is under way."""
        return not any(self._waiting)

    def step(self, value: float) -> float:
        waiting = self._waiting
        if not waiting:
            return value
        waiting.append(value)
        return waiting.popleft()


class Hold:
    """Gives back the greatest of what it was given over the last while."""

    __slots__ = ("_hold_ns", "_kept")

    def __init__(self, hold_ns: int) -> None:
        self._hold_ns = hold_ns
        self._kept: deque[tuple[int, float]] = deque()
        """Until when, and what; falling values, of which the first is the answer."""

    def greatest(self, now_ns: int, value: float) -> float:
        """By magnitude, of `value` and what was given over the last while."""
        kept = self._kept
        while kept and abs(kept[-1][1]) <= abs(value):
            kept.pop()
        while kept and kept[0][0] <= now_ns:
            kept.popleft()
        kept.append((now_ns + self._hold_ns, value))
        return kept[0][1]


class CommandWatch:
    """Remembers when a command was last heard; silence beyond the timeout is acted on once."""

    __slots__ = ("_timeout_ns", "expires_ns", "losses", "silent")

    def __init__(self, timeout_ns: int) -> None:
        assert timeout_ns > 0
        self._timeout_ns = timeout_ns
        self.expires_ns = FAR_NS
        """When silence will have lasted too long; far away while that has been acted on already."""
        self.losses = 0
        self.silent = False
        """A command that was there before is missing."""

    def heard(self, heard_ns: int) -> None:
        self.expires_ns = heard_ns + self._timeout_ns
        self.silent = False

    def excuse(self, held_up_ns: int) -> None:
        """Who was held up itself heard nothing in that time, and it counts as nobody's silence."""
        if self.expires_ns != FAR_NS:
            self.expires_ns += held_up_ns

    def lost(self) -> None:
        """The silence has been acted upon."""
        self.losses += 1
        self.silent = True
        self.expires_ns = FAR_NS
