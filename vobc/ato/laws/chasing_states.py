"""States of control by chasing time as a table of named guards. Pure functions."""

import enum
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Final


class ChasingState(enum.Enum):
    """Driving state of the law."""

    TRACTION = "traction"
    CRUISE = "cruise"
    COAST = "coast"
    BRAKE = "brake"


@dataclass(slots=True)
class Chase:
    """Inputs of the guards. They are refilled in each cycle."""

    near_curve: bool = False
    """Traction must end now, or the brake comes too late."""
    on_curve: bool = False
    """The train brakes towards a stop or a lower limit. With early transition the state begins
    early."""
    too_fast: bool = False
    """The speed exceeds the target by more than coasting corrects."""
    at_target: bool = False
    """The speed has nearly reached the target."""
    too_slow: bool = False
    """The speed is below the target by more than cruising corrects."""
    braked: bool = False
    """The speed does not exceed the target."""


Guard = Callable[[Chase], bool]


def near_curve(inputs: Chase) -> bool:
    return inputs.near_curve


def must_brake(inputs: Chase) -> bool:
    return inputs.on_curve or inputs.too_fast


def runs_free(inputs: Chase) -> bool:
    return not inputs.near_curve


def runs_free_and_slow(inputs: Chase) -> bool:
    return not inputs.near_curve and inputs.too_slow


def at_target(inputs: Chase) -> bool:
    return inputs.at_target


def too_slow(inputs: Chase) -> bool:
    return inputs.too_slow


def braked_enough(inputs: Chase) -> bool:
    return inputs.braked and not inputs.on_curve


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
    # BRAKE never leads straight to traction, because the brake has to release first.
    ChasingState.BRAKE: ((braked_enough, ChasingState.COAST),),
}


def next_state(state: ChasingState, inputs: Chase) -> ChasingState:
    """Follow the first guard that holds. If none holds, the state stays."""
    for guard, target in TRANSITIONS[state]:
        if guard(inputs):
            return target
    return state
