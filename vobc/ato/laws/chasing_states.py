"""States of control by chasing time as a table of named guards; pure."""

import enum
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Final


class State(enum.Enum):
    """What the law does with the train."""

    TRACTION = "traction"
    CRUISE = "cruise"
    COAST = "coast"
    BRAKE = "brake"


@dataclass(slots=True)
class Chase:
    """What the guards look at. Refilled each cycle."""

    near_curve: bool = False
    """Traction has to go now, or the brake comes too late."""
    on_curve: bool = False
    """Braking towards a stop or a lower limit; entered early if so set."""
    too_fast: bool = False
    """Over the target speed by more than coasting may mend."""
    at_target: bool = False
    """Hardly under the target speed any more."""
    too_slow: bool = False
    """Under the target speed by more than cruising mends."""
    braked: bool = False
    """Not over the target speed."""


Guard = Callable[[Chase], bool]


def near_curve(seen: Chase) -> bool:
    return seen.near_curve


def must_brake(seen: Chase) -> bool:
    return seen.on_curve or seen.too_fast


def runs_free(seen: Chase) -> bool:
    return not seen.near_curve


def runs_free_and_slow(seen: Chase) -> bool:
    return not seen.near_curve and seen.too_slow


def at_target(seen: Chase) -> bool:
    return seen.at_target


def too_slow(seen: Chase) -> bool:
    return seen.too_slow


def braked_enough(seen: Chase) -> bool:
    return seen.braked and not seen.on_curve


TRANSITIONS: Final[Mapping[State, tuple[tuple[Guard, State], ...]]] = {
    State.TRACTION: (
        (must_brake, State.BRAKE),
        (near_curve, State.COAST),
        (at_target, State.CRUISE),
    ),
    State.CRUISE: (
        (must_brake, State.BRAKE),
        (near_curve, State.COAST),
        (too_slow, State.TRACTION),
    ),
    State.COAST: (
        (must_brake, State.BRAKE),
        (runs_free_and_slow, State.TRACTION),
        (runs_free, State.CRUISE),
    ),
    # Never straight to traction: the brake has to let go first.
    State.BRAKE: ((braked_enough, State.COAST),),
}


def next_state(state: State, seen: Chase) -> State:
    """The first guard that holds decides; when none holds the state stays."""
    for guard, target in TRANSITIONS[state]:
        if guard(seen):
            return target
    return state
