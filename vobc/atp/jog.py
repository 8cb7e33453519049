"""Correction of a missed stop by jogs: their number, distance and speed."""

import enum
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Final

from can_dbc.vobc import Cause
from vobc.atp.config import AtpConfig

MOVED_M: Final = 0.1
"""Movement that ends standstill. It exceeds the give of a held train and the pulse error of a
standing one."""
FINEST_M: Final = 0.1
"""Least remaining distance of a jog from the stopping point. If the interval does not fit the
window even then, a jog does not help."""

TAG_AHEAD_M: Final = 0.05
"""Estimated distance past the stopping point up to which a jog forwards needs no protection of the
rear, because the stop's tag may still be ahead."""
TAG_READ_M: Final = 0.05
"""Distance past a tag from which the antenna has surely read it."""


class JogState(enum.Enum):
    NONE = "nothing to mend"
    READY = "stands off its stopping point, and attempts are left"
    UNDER_WAY = "an attempt is being made"
    USED_UP = "stands off its stopping point after the last attempt"


@dataclass(frozen=True, slots=True)
class JogFacts:
    """Inputs of the jog rules in one cycle."""

    limits: AtpConfig
    low_m: float
    """Least distance of the front past the stopping point. Negative before it."""
    best_m: float
    high_m: float
    standstill: bool
    moved_m: float
    """Distance since the train last stood, signed."""
    most_moved_m: float
    """Upper bound of that distance, in either direction."""
    speed_high_mps: float
    """Upper bound of the speed, in either direction."""
    back_room_m: float
    """Distance from the rearmost place of the rear back to the protected place. Negative beyond it,
    and without protection."""
    attempts: int
    """Jogs begun so far."""
    tag_m: float = math.inf
    """Distance of the front past the stopping point when the antenna reaches the next tag that was
    not read yet. Infinity: none is known."""

    @property
    def aligned(self) -> bool:
        window_m = self.limits.door_window_m
        return -window_m <= self.low_m and self.high_m <= window_m

    @property
    def half_width_m(self) -> float:
        return (self.high_m - self.low_m) / 2.0

    @property
    def fits(self) -> bool:
        """The interval would fit the window if the middle of it stood at the stopping point."""
        return self.half_width_m + FINEST_M <= self.limits.door_window_m

    @property
    def tag_ahead(self) -> bool:
        """A tag may be ahead that was not read yet, and the train can read it inside the window."""
        return self.low_m <= self.tag_m <= self.limits.door_window_m - TAG_READ_M


Guard = Callable[[JogFacts], bool]


def out_of_reach(inputs: JogFacts) -> bool:
    return abs(inputs.best_m) > inputs.limits.jog_m


def stands_aligned(inputs: JogFacts) -> bool:
    return inputs.standstill and inputs.aligned


def stands_off(inputs: JogFacts) -> bool:
    """The train stands within reach of a jog that would help.

    A jog helps if the interval would fit the window. It also helps if a tag may be ahead that was
    not read yet, as that narrows the interval, or if the front is beyond the window.
    """
    if not inputs.standstill or inputs.aligned or out_of_reach(inputs):
        return False
    return inputs.fits or inputs.tag_ahead or abs(inputs.best_m) > inputs.limits.door_window_m


def stands_off_for_the_last_time(inputs: JogFacts) -> bool:
    return stands_off(inputs) and inputs.attempts >= inputs.limits.jog_attempts


def stands_wide(inputs: JogFacts) -> bool:
    """The train stands where another jog would not help."""
    return inputs.standstill and not stands_off(inputs)


def moves(inputs: JogFacts) -> bool:
    return abs(inputs.moved_m) > MOVED_M


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
        # Otherwise only another stop ends this state, with the consent of a driver or the centre.
        (out_of_reach, JogState.NONE),
        (stands_aligned, JogState.NONE),
    ),
}


def next_state(state: JogState, inputs: JogFacts) -> JogState:
    """Follow the first guard that holds. If none holds, the state stays."""
    for guard, target in TRANSITIONS[state]:
        if guard(inputs):
            return target
    return state


def exceeded(state: JogState, inputs: JogFacts) -> bool:
    """A jog too fast, too far, or without rear protection, or one more than permitted."""
    if state is JogState.USED_UP:
        return moves(inputs)
    if state is not JogState.UNDER_WAY:
        return False
    limits = inputs.limits
    return (
        inputs.speed_high_mps > limits.jog_mps
        or inputs.most_moved_m > limits.jog_m
        or (inputs.moved_m < -MOVED_M and inputs.back_room_m < 0.0)
    )


def overshot(state: JogState, inputs: JogFacts, *, began_m: float, standing: bool) -> bool:
    """The front is certainly past the stopping point by too much, and the train still moves.

    Args:
        began_m: `best_m` where the present jog began. A jog back begins beyond the limit.
    """
    if standing or inputs.low_m <= inputs.limits.overshoot_m:
        return False
    return state is JogState.NONE or began_m <= inputs.limits.overshoot_m


def mends_itself(inputs: JogFacts) -> bool:
    """A jog back can correct the overshoot. The whole interval must be within its reach."""
    return inputs.low_m > 0.0 and inputs.high_m <= inputs.limits.overshoot_mended_m


def back_m(inputs: JogFacts) -> float:
    """Distance that the train may still go back: to its stopping point, if its rear is
    protected.
    """
    wanted_m = inputs.best_m + inputs.limits.door_window_m
    if inputs.best_m <= 0.0:
        return 0.0
    return max(0.0, min(wanted_m, inputs.back_room_m))


@dataclass(frozen=True, slots=True)
class JogVerdict:
    permitted: bool = False
    """Permitted by the rules of the stop. Other rules decide whether the train may move at all."""
    to_tag: bool = False
    """The interval is too wide for the window, and a tag ahead would narrow it."""
    back_m: float = 0.0
    attempts: int = 0
    emergency: Cause = Cause.NONE
    self_release: bool = False
    used_up: bool = False
    out_of_reach: bool = False
    """It stands too far past the stopping point and continues to the next station, with consent."""


class JogGuard:
    """State of the jogs at one stop: attempts, and where the present one began."""

    def __init__(self) -> None:
        self.state = JogState.NONE
        self.attempts = 0
        self._stop_m: float | None = None
        self._began_m = 0.0
        self._to_tag = False
        """The present jog goes forwards to a tag."""

    def heads_for(self, stop_m: float | None) -> bool:
        """Whether the train heads for a stop. A new stop resets the attempts.

        None ends an attempt. If the same stop returns later, its attempts count on.
        """
        same = stop_m == self._stop_m
        if stop_m is not None and not same:
            self._stop_m = stop_m
            self.attempts = 0
        if not same:
            self.state = JogState.NONE
        return stop_m is not None

    def step(self, inputs: JogFacts, *, standing: bool) -> JogVerdict:
        before = self.state
        self.state = next_state(before, inputs)
        if self.state is JogState.UNDER_WAY and before is not JogState.UNDER_WAY:
            self.attempts += 1
        if self.state in (JogState.NONE, JogState.READY):
            self._began_m = inputs.best_m
        emergency = Cause.NONE
        if overshot(self.state, inputs, began_m=self._began_m, standing=standing):
            emergency = Cause.OVERSHOT
        elif exceeded(self.state, inputs):
            emergency = Cause.JOG_EXCEEDED
        at_work = self.state in (JogState.READY, JogState.UNDER_WAY)
        room_m = back_m(inputs)
        if self.state is not JogState.UNDER_WAY:
            self._to_tag = self.state is JogState.READY and inputs.tag_ahead and not inputs.fits
        forwards = self._began_m <= TAG_AHEAD_M or self._to_tag
        return JogVerdict(
            permitted=at_work and (forwards or room_m >= inputs.best_m),
            to_tag=self._to_tag,
            back_m=room_m if at_work else 0.0,
            attempts=self.attempts,
            emergency=emergency,
            self_release=mends_itself(inputs),
            used_up=self.state is JogState.USED_UP,
            out_of_reach=inputs.standstill and inputs.best_m > inputs.limits.jog_m,
        )
