"""The terms at the top of a formula, which look from the first sample on and give a verdict."""

import math
from enum import IntEnum

from metro_hil.monitors.formula import TimeInterval
from metro_hil.monitors.streams import NO_END, InstantStream, Later


class TermState(IntEnum):
    """Result of a term as far as it is certain."""

    OPEN = 0
    HOLDS = 1
    VIOLATED = 2
    UNKNOWN = 3
    """The run ended before the result was certain."""


class MonitorTerm:
    """One `always`, `eventually` or `until` at the top, or several joined."""

    __slots__ = ("at_ns", "came_about", "margin", "state")

    def __init__(self) -> None:
        self.state = TermState.OPEN
        self.came_about = True
        """False while a condition that has to occur at some time was true in every sample so
        far."""
        self.margin = math.inf
        """Margin of the judged samples; infinite without one."""
        self.at_ns = 0
        """Instant of the sample that determines the margin."""

    def step(self, t_ns: int, since_ns: int, signals: object) -> None:
        """Take one sample, `since_ns` after the first one."""
        raise AssertionError

    def finish(self, cut_short: bool) -> None:
        """End the run; `cut_short` means that it was ended early."""
        raise AssertionError

    @property
    def trivial(self) -> bool:
        """Whether the term holds only through what was true from the first sample on."""
        return self.state is TermState.HOLDS and not self.came_about


class Whole(MonitorTerm):
    """`always` and `eventually` from the first sample on."""

    __slots__ = (
        "_begin_ns",
        "_body",
        "_closed",
        "_end_ns",
        "_later",
        "_least",
        "_sign",
        "judged_ns",
    )

    def __init__(
        self, body: InstantStream | Later, interval: TimeInterval, *, greatest: bool
    ) -> None:
        super().__init__()
        self._body: InstantStream | None = body if isinstance(body, InstantStream) else None
        self._later: Later | None = body if isinstance(body, Later) else None
        self._begin_ns = interval.begin_ns
        self._end_ns = NO_END if interval.end_ns is None else interval.end_ns
        self._sign = -1.0 if greatest else 1.0
        self.came_about = not greatest
        self._least = math.inf
        self._closed = False
        self.judged_ns = -1
        """Instant of the last judged sample."""

    def step(self, t_ns: int, since_ns: int, signals: object) -> None:
        body = self._body
        if body is not None:
            self._take(t_ns, since_ns, body.value(t_ns, signals))
            return
        later = self._later
        assert later is not None
        later.step(t_ns, signals)
        while later.ready:
            at_ns, value = later.ready.popleft()
            self._take(at_ns, since_ns - (t_ns - at_ns), value)

    def _take(self, at_ns: int, since_ns: int, value: float) -> None:
        if self._closed:
            return
        if not self.came_about and self.state is TermState.OPEN and not value >= 0.0:
            self.came_about = True
        if self._begin_ns > 0 and since_ns < self._begin_ns:
            return
        if self._end_ns != NO_END and since_ns >= self._end_ns:
            self._closed = True
            if since_ns > self._end_ns:
                self._settle()
                return
        self.judged_ns = at_ns
        value *= self._sign
        # NaN counts as a violation: every comparison with it is false.
        if not value >= self._least:
            self._least = value
            self.margin = value * self._sign
            self.at_ns = at_ns
            if self._sign > 0.0:
                if not value >= 0.0:
                    self.state = TermState.VIOLATED
            elif self.margin >= 0.0:
                self.state = TermState.HOLDS
        if self._closed:
            self._settle()

    def _settle(self) -> None:
        if self.state is TermState.OPEN:
            self.state = TermState.HOLDS if self._sign > 0.0 else TermState.VIOLATED

    def finish(self, cut_short: bool) -> None:
        if self.state is not TermState.OPEN:
            return
        whole = self._closed or self._end_ns == NO_END
        if self.judged_ns < 0 or not whole or (self._sign < 0.0 and cut_short):
            self.state = TermState.UNKNOWN
        else:
            self._settle()


class UntilWhole(MonitorTerm):
    """`first until second` from the first sample on. If `released`: what must not occur."""

    __slots__ = ("_begin_ns", "_best", "_closed", "_end_ns", "_first", "_least", "_second", "_sign")

    def __init__(
        self, first: Later, second: Later, interval: TimeInterval, *, released: bool
    ) -> None:
        super().__init__()
        self._first, self._second = first, second
        self._begin_ns = interval.begin_ns
        self._end_ns = NO_END if interval.end_ns is None else interval.end_ns
        self._sign = -1.0 if released else 1.0
        self.came_about = released
        self._best, self._least = -math.inf, math.inf
        self._closed = False

    def step(self, t_ns: int, since_ns: int, signals: object) -> None:
        first, second = self._first, self._second
        first.step(t_ns, signals)
        second.step(t_ns, signals)
        while first.ready and second.ready:
            at_ns, held = first.ready.popleft()
            _, met = second.ready.popleft()
            self._take(at_ns, since_ns - (t_ns - at_ns), held * self._sign, met * self._sign)

    def _take(self, at_ns: int, since_ns: int, held: float, met: float) -> None:
        if self._closed:
            return
        if self._end_ns != NO_END and since_ns > self._end_ns:
            self._close()
            return
        if self.state is TermState.OPEN and not met >= 0.0:
            self.came_about = True
        if since_ns >= self._begin_ns:
            value = min(met, self._least)
            if value > self._best:
                self._best, self.at_ns = value, at_ns
        self._least = min(self._least, held)
        self._tell()
        if self._end_ns != NO_END and since_ns >= self._end_ns:
            self._close()

    def _tell(self) -> None:
        self.margin = self._sign * self._best
        if self._sign > 0.0:
            if self._best >= 0.0:
                self.state = TermState.HOLDS
            elif self._least < 0.0:
                self.state = TermState.VIOLATED
        elif self.margin < 0.0:
            self.state = TermState.VIOLATED
        elif -self._least >= 0.0:
            self.state = TermState.HOLDS

    def _close(self) -> None:
        self._closed = True
        if self.state is TermState.OPEN:
            self.state = TermState.VIOLATED if self._sign > 0.0 else TermState.HOLDS

    def finish(self, cut_short: bool) -> None:
        if self.state is TermState.OPEN:
            if cut_short or self._end_ns != NO_END or math.isinf(self._best):
                self.state = TermState.UNKNOWN
            else:
                self._close()


class Several(MonitorTerm):
    """Several terms, of which all or one must hold."""

    __slots__ = ("_any", "_parts")

    def __init__(self, parts: list[MonitorTerm], *, one_is_enough: bool) -> None:
        super().__init__()
        self._parts = parts
        self._any = one_is_enough

    def step(self, t_ns: int, since_ns: int, signals: object) -> None:
        for part in self._parts:
            part.step(t_ns, since_ns, signals)
        self._join()

    def finish(self, cut_short: bool) -> None:
        for part in self._parts:
            part.finish(cut_short)
        self._join()

    @property
    def trivial(self) -> bool:
        held = [part.trivial for part in self._parts if part.state is TermState.HOLDS]
        return self.state is TermState.HOLDS and (all(held) if self._any else any(held))

    def _join(self) -> None:
        decisive, other = TermState.VIOLATED, TermState.HOLDS
        if self._any:
            decisive, other = other, decisive
        states = [part.state for part in self._parts]
        if decisive in states:
            self.state = decisive
        elif all(state is other for state in states):
            self.state = other
        elif TermState.UNKNOWN in states:
            self.state = TermState.UNKNOWN
        pick = max if self._any else min
        part = pick(self._parts, key=_margin_of)
        self.margin, self.at_ns = part.margin, part.at_ns


def _margin_of(part: MonitorTerm) -> float:
    return part.margin
