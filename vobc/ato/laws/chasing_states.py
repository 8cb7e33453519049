"""States of control by chasing time as a table of named guards; pure."""

import enum
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Final


class ChasingState(enum.Enum):
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


TRANSITIONS: Final[Mapping[ChasingState, tuple[tuple[Guard, ChasingState], ...]]] = {
    ChasingState.TRACTION: (
        (must_brake, ChasingState.BRAKE),
        (near_curve, ChasingState.COAST),
        (at_target, ChasingState.CRUISE),
    ),
    ChasingState.CRUISE: (
        (must_brake, ChasingState.BRAKE),
        (near_curve, ChasingState.COAST),
        (too_slow, ChasingState.TRACTION),
    ),
    ChasingState.COAST: (
        (must_brake, ChasingState.BRAKE),
        (runs_free_and_slow, ChasingState.TRACTION),
        (runs_free, ChasingState.CRUISE),
    ),
    # Never straight to traction: the brake has to let go first.
    ChasingState.BRAKE: ((braked_enough, ChasingState.COAST),),
}


def next_state(state: ChasingState, seen: Chase) -> ChasingState:
    """The first guard that holds decides; when none holds the state stays."""
    for guard, target in TRANSITIONS[state]:
        if guard(seen):
            return target
    return state
