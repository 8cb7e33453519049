"""A stopping point that was missed: how often, how far and how fast the train may mend that."""

import enum
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Final

from can_dbc.vobc import Cause
from vobc.atp.config import AtpConfig

MOVED_M: Final = 0.1
"""More than a held train gives way, and than its pulses may say of one that stands."""
FINEST_M: Final = 0.1
"""A jog ends no closer to the stopping point than this; an interval that is too wide to lie in the
window even then gains nothing by it."""

TAG_AHEAD_M: Final = 0.05
"""A front that is believed so far past the stopping point at most may still have the stop's tag
ahead of it: where tags lie and what is believed are off by centimetres."""


class JogState(enum.Enum):
    NONE = "nothing to mend"
    READY = "stands off its stopping point, and attempts are left"
    UNDER_WAY = "an attempt is being made"
    USED_UP = "stands off its stopping point after the last attempt"


@dataclass(frozen=True, slots=True)
class JogFacts:
    """What the rules of a jog look at in one cycle."""

    limits: AtpConfig
    low_m: float
    """How far past the stopping point the front is at least; negative before it."""
    best_m: float
    high_m: float
    standstill: bool
    moved_m: float
    """Since the train last stood, signed."""
    most_moved_m: float
    """The most that it may be, either way."""
    speed_high_mps: float
    """Most that it may run, either way."""
    back_room_m: float
    """From the rearmost place of the rear back to what the authority protects; negative beyond
    it, and without such protection."""
    attempts: int
    """Begun so far."""

    @property
    def aligned(self) -> bool:
        window_m = self.limits.door_window_m
        return -window_m <= self.low_m and self.high_m <= window_m

    @property
    def half_width_m(self) -> float:
        return max(self.high_m - self.best_m, self.best_m - self.low_m)


Guard = Callable[[JogFacts], bool]


def out_of_reach(seen: JogFacts) -> bool:
    return abs(seen.best_m) > seen.limits.jog_m


def stands_aligned(seen: JogFacts) -> bool:
    return seen.standstill and seen.aligned


def stands_off(seen: JogFacts) -> bool:
    """Within reach of a jog that would help: only one on to the stop's tag, which lies where the
    stop does, makes an interval narrower.
    """
    if not seen.standstill or seen.aligned or out_of_reach(seen):
        return False
    window_m = seen.limits.door_window_m
    fits = seen.half_width_m + FINEST_M <= window_m
    return fits or seen.best_m <= TAG_AHEAD_M or seen.best_m > window_m


def stands_off_for_the_last_time(seen: JogFacts) -> bool:
    return stands_off(seen) and seen.attempts >= seen.limits.jog_attempts


def stands_wide(seen: JogFacts) -> bool:
    """At rest where another jog would not help."""
    return seen.standstill and not stands_off(seen)


def moves(seen: JogFacts) -> bool:
    return abs(seen.moved_m) > MOVED_M


TRANSITIONS: Final[Mapping[JogState, tuple[tuple[Guard, JogState], ...]]] = {
    JogState.NONE: (
        (stands_off_for_the_last_time, JogState.USED_UP),
        (stands_off, JogState.READY),
    ),
    JogState.READY: (
        (out_of_reach, JogState.NONE),
        (stands_wide, JogState.NONE),
        (moves, JogState.UNDER_WAY),
    ),
    JogState.UNDER_WAY: (
        (out_of_reach, JogState.NONE),
        (stands_off_for_the_last_time, JogState.USED_UP),
        (stands_off, JogState.READY),
        (stands_wide, JogState.NONE),
    ),
    JogState.USED_UP: (
        # Otherwise only another stop leads out of it: a person or the centre consents to that.
        (out_of_reach, JogState.NONE),
        (stands_aligned, JogState.NONE),
    ),
}


def next_state(state: JogState, seen: JogFacts) -> JogState:
    """The first guard that holds decides; when none holds the state stays."""
    for guard, target in TRANSITIONS[state]:
        if guard(seen):
            return target
    return state


def exceeded(state: JogState, seen: JogFacts) -> bool:
    """An attempt that is too fast, too far or not covered behind, or one too many."""
    if state is JogState.USED_UP:
        return moves(seen)
    if state is not JogState.UNDER_WAY:
        return False
    limits = seen.limits
    return (
        seen.speed_high_mps > limits.jog_mps
        or seen.most_moved_m > limits.jog_m
        or (seen.moved_m < -MOVED_M and seen.back_room_m < 0.0)
    )


def overshot(state: JogState, seen: JogFacts, *, began_m: float, standing: bool) -> bool:
    """The stopping point is surely passed by too much, and the train still moves.

    Args:
        began_m: `best_m` where the present jog began; a jog back begins beyond the limit.
    """
    if standing or seen.low_m <= seen.limits.overshoot_m:
        return False
    return state is JogState.NONE or began_m <= seen.limits.overshoot_m


def mends_itself(seen: JogFacts) -> bool:
    """An overshoot that a jog back can mend; the whole interval has to lie within its reach."""
    return seen.low_m > 0.0 and seen.high_m <= seen.limits.overshoot_mended_m


def back_m(seen: JogFacts) -> float:
    """How far back the train may still go: to its stopping point, as far as its rear is covered."""
    wanted_m = seen.best_m + seen.limits.door_window_m
    if seen.best_m <= 0.0:
        return 0.0
    return max(0.0, min(wanted_m, seen.back_room_m))


@dataclass(frozen=True, slots=True)
class JogVerdict:
    permitted: bool = False
    """As far as the stop is concerned; others say whether it may move at all."""
    back_m: float = 0.0
    attempts: int = 0
    emergency: Cause = Cause.NONE
    self_release: bool = False
    used_up: bool = False
    out_of_reach: bool = False
    """It stands too far past the stopping point: on to the next station, with consent."""


class JogGuard:
    """Remembers the stop in question, the attempts made there and where the present one began."""

    def __init__(self) -> None:
        self.state = JogState.NONE
        self.attempts = 0
        self._stop_m: float | None = None
        self._began_m = 0.0

    def heads_for(self, stop_m: float | None) -> bool:
        """Whether that is the stop of the cycle before; attempts are forgotten only for a new one.

        None, while nobody heads for a stop, ends an attempt, but a stop that comes back after that
        finds its attempts again.
        """
        same = stop_m == self._stop_m
        if stop_m is not None and not same:
            self._stop_m = stop_m
            self.attempts = 0
        if not same:
            self.state = JogState.NONE
        return stop_m is not None

    def step(self, seen: JogFacts, *, standing: bool) -> JogVerdict:
        before = self.state
        self.state = next_state(before, seen)
        if self.state is JogState.UNDER_WAY and before is not JogState.UNDER_WAY:
            self.attempts += 1
        if self.state in (JogState.NONE, JogState.READY):
            self._began_m = seen.best_m
        emergency = Cause.NONE
        if overshot(self.state, seen, began_m=self._began_m, standing=standing):
            emergency = Cause.OVERSHOT
        elif exceeded(self.state, seen):
            emergency = Cause.JOG_EXCEEDED
        at_work = self.state in (JogState.READY, JogState.UNDER_WAY)
        room_m = back_m(seen)
        return JogVerdict(
            permitted=at_work and (self._began_m <= TAG_AHEAD_M or room_m >= seen.best_m),
            back_m=room_m if at_work else 0.0,
            attempts=self.attempts,
            emergency=emergency,
            self_release=mends_itself(seen),
            used_up=self.state is JogState.USED_UP,
            out_of_reach=seen.standstill and seen.best_m > seen.limits.jog_m,
        )
