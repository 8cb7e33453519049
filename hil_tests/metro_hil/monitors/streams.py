"""Margins of formulas over time, sample by sample, in memory bounded by the intervals.

An `InstantStream` depends on the present and the past, and has its margin at once. A `Later` looks
ahead: it gives one margin for each sample in order, delayed by its horizon.

Samples need not be evenly spaced: an interval holds the samples whose instants lie in it.
"""

import math
from collections import deque
from collections.abc import Callable
from typing import Final

Margin = Callable[[object], float]
"""Margin of an atom, or of atoms joined by min and max, for an object with the signals."""

NO_END: Final = -1
LONG_AGO_NS: Final = -(1 << 62)


class SlidingWindow:
    """The maximum or minimum over a window of the past that moves with every sample.

    It keeps a queue of candidates, each better than those after it, so every value enters and
    leaves once.
    """

    __slots__ = ("_begin_ns", "_best", "_end_ns", "_forever", "_sign", "_waiting")

    def __init__(self, begin_ns: int, end_ns: int, *, greatest: bool) -> None:
        """The window lasts from `end_ns` ago (NO_END: the start) to `begin_ns` ago, inclusive."""
        self._begin_ns = begin_ns
        self._end_ns = end_ns
        self._forever = end_ns == NO_END
        self._sign = 1.0 if greatest else -1.0
        self._waiting: deque[tuple[int, float]] = deque()
        """Values that are too young for the window."""
        self._best: deque[tuple[int, float]] = deque()

    def push(self, t_ns: int, value: float) -> float:
        """Take one more sample and return the best value in the window; ±inf if it is empty."""
        self.add(t_ns, value)
        return self.over(LONG_AGO_NS if self._forever else t_ns - self._end_ns)

    def add(self, t_ns: int, value: float) -> None:
        value *= self._sign
        if self._begin_ns == 0:
            self._enter(t_ns, value)
            return
        waiting = self._waiting
        waiting.append((t_ns, value))
        youngest_ns = t_ns - self._begin_ns
        while waiting and waiting[0][0] <= youngest_ns:
            old_ns, old = waiting.popleft()
            self._enter(old_ns, old)

    def _enter(self, t_ns: int, value: float) -> None:
        best = self._best
        while best and best[-1][1] <= value:
            best.pop()
        # If values never expire, a value after a better one never counts.
        if not self._forever or not best:
            best.append((t_ns, value))

    def over(self, oldest_ns: int) -> float:
        """Return the best of all values added from `oldest_ns` on, which never goes back."""
        best = self._best
        while best and best[0][0] < oldest_ns:
            best.popleft()
        return self._sign * (best[0][1] if best else -math.inf)


class InstantStream:
    """A stream that has its margin at once."""

    __slots__ = ()

    def value(self, t_ns: int, signals: object) -> float:
        """Return the margin of this sample; called once for every sample, in order."""
        raise AssertionError


class Now(InstantStream):
    __slots__ = ("_margin",)

    def __init__(self, margin: Margin) -> None:
        self._margin = margin

    def value(self, t_ns: int, signals: object) -> float:
        return self._margin(signals)


class Joined(InstantStream):
    """The minimum or maximum of the margins of all parts."""

    __slots__ = ("_parts", "_sign")

    def __init__(self, parts: list[InstantStream], *, greatest: bool) -> None:
        self._parts = parts
        self._sign = 1.0 if greatest else -1.0

    def value(self, t_ns: int, signals: object) -> float:
        sign = self._sign
        best = -math.inf
        # Evaluate every part, because parts with a past need every sample.
        for part in self._parts:
            value = sign * part.value(t_ns, signals)
            if value > best:
                best = value
        return sign * best


class Past(InstantStream):
    """`once` and `historically`."""

    __slots__ = ("_body", "_window")

    def __init__(self, body: InstantStream, window: SlidingWindow) -> None:
        self._body = body
        self._window = window

    def value(self, t_ns: int, signals: object) -> float:
        return self._window.push(t_ns, self._body.value(t_ns, signals))


class Later:
    """A stream that looks ahead; `ready` holds its margins, one for each sample in order."""

    __slots__ = ("ready",)

    def __init__(self) -> None:
        self.ready: deque[tuple[int, float]] = deque()

    def step(self, t_ns: int, signals: object) -> None:
        """Take one sample; called once for every sample, in order."""
        raise AssertionError


class ReadyStream(Later):
    """An instant stream among streams that look ahead."""

    __slots__ = ("_body",)

    def __init__(self, body: InstantStream) -> None:
        super().__init__()
        self._body = body

    def step(self, t_ns: int, signals: object) -> None:
        self.ready.append((t_ns, self._body.value(t_ns, signals)))


class JoinedLater(Later):
    __slots__ = ("_parts", "_sign")

    def __init__(self, parts: list[Later], *, greatest: bool) -> None:
        super().__init__()
        self._parts = parts
        self._sign = 1.0 if greatest else -1.0

    def step(self, t_ns: int, signals: object) -> None:
        count = -1
        for part in self._parts:
            part.step(t_ns, signals)
            if count < 0 or len(part.ready) < count:
                count = len(part.ready)
        sign = self._sign
        for _ in range(count):
            best = -math.inf
            at_ns = 0
            for part in self._parts:
                at_ns, value = part.ready.popleft()
                value *= sign
                if value > best:
                    best = value
            self.ready.append((at_ns, sign * best))


class PastLater(Later):
    """`once` and `historically` over a body that looks ahead."""

    __slots__ = ("_body", "_window")

    def __init__(self, body: Later, window: SlidingWindow) -> None:
        super().__init__()
        self._body = body
        self._window = window

    def step(self, t_ns: int, signals: object) -> None:
        body = self._body
        body.step(t_ns, signals)
        while body.ready:
            at_ns, value = body.ready.popleft()
            self.ready.append((at_ns, self._window.push(at_ns, value)))


class BoundedFuture(Later):
    """`always` and `eventually` with an end."""

    __slots__ = ("_begin_ns", "_body", "_end_ns", "_pending", "_window")

    def __init__(self, body: Later, begin_ns: int, end_ns: int, *, greatest: bool) -> None:
        super().__init__()
        self._body = body
        self._begin_ns = begin_ns
        self._end_ns = end_ns
        self._window = SlidingWindow(0, end_ns, greatest=greatest)
        self._pending: deque[int] = deque()
        """Samples whose interval is not over."""

    def step(self, t_ns: int, signals: object) -> None:
        body, pending, window = self._body, self._pending, self._window
        body.step(t_ns, signals)
        while body.ready:
            at_ns, value = body.ready.popleft()
            # Intervals that ended between the last sample and this one do not contain this one.
            while pending and pending[0] + self._end_ns < at_ns:
                self._put_out(pending.popleft())
            window.add(at_ns, value)
            pending.append(at_ns)
            while pending and pending[0] + self._end_ns <= at_ns:
                self._put_out(pending.popleft())

    def _put_out(self, at_ns: int) -> None:
        self.ready.append((at_ns, self._window.over(at_ns + self._begin_ns)))


class UntilLater(Later):
    """`first until[begin:end] second`.

    The maximum over the instants of the interval of the following minimum: `second` at that instant
    and `first` at all samples before it. If `released`, all signs are inverted.
    """

    __slots__ = ("_begin_ns", "_end_ns", "_first", "_second", "_seen", "_sign")

    def __init__(
        self, first: Later, second: Later, begin_ns: int, end_ns: int, *, released: bool
    ) -> None:
        super().__init__()
        self._first, self._second = first, second
        self._begin_ns, self._end_ns = begin_ns, end_ns
        self._sign = -1.0 if released else 1.0
        self._seen: deque[tuple[int, float, float]] = deque()
        """Samples from the oldest one whose interval is not over."""

    def step(self, t_ns: int, signals: object) -> None:
        first, second, seen, sign = self._first, self._second, self._seen, self._sign
        first.step(t_ns, signals)
        second.step(t_ns, signals)
        while first.ready and second.ready:
            at_ns, held = first.ready.popleft()
            _, met = second.ready.popleft()
            while seen and seen[0][0] + self._end_ns < at_ns:
                self._put_out()
            seen.append((at_ns, sign * held, sign * met))
            while seen and seen[0][0] + self._end_ns <= at_ns:
                self._put_out()

    def _put_out(self) -> None:
        start_ns = self._seen[0][0]
        begin_ns, end_ns = start_ns + self._begin_ns, start_ns + self._end_ns
        best, least = -math.inf, math.inf
        for at_ns, held, met in self._seen:
            if at_ns > end_ns or least <= best:
                break
            if at_ns >= begin_ns:
                best = max(best, min(met, least))
            least = min(least, held)
        self._seen.popleft()
        self.ready.append((start_ns, self._sign * best))
