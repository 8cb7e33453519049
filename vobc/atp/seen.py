"""What the guards of protection's tables look at, filled anew in each cycle."""

import math
from dataclasses import dataclass
from typing import Final

from can_dbc.vobc import Cause, OperatingMode
from vobc.atp.config import AtpConfig
from vobc.vocabulary import Ceiling, Interval

NOWHERE: Final = Ceiling(0.0, 0.0, 0.0, 0.0, 0.0)
"""Nothing is permitted."""
STILL: Final = Interval(0.0, 0.0, 0.0)


@dataclass(slots=True)
class GuardInputs:
    """Everything that a guard may know. What is no number makes a guard decide for the brake."""

    limits: AtpConfig

    # How the train moves.
    speed_mps: Interval = STILL
    standing: bool = False
    """The tacho's samples show no pulse any more: quick, but no proof."""
    standstill: bool = False
    """Proven."""
    rollback_m: float = 0.0
    """How far the train went back from its foremost place."""
    held_movement_m: float = 0.0
    """How far it moved, either way, since it was last to be held."""
    jog_movement_m: float = 0.0
    """How far it moved, either way, since the jog was granted."""
    behind_jog_m: float = 0.0
    """How far it is behind the place up to which its rear is protected for a jog."""

    # What is there.
    missing: int = 0
    """What is silent or not ready, as flags of `Missing`."""
    silent: int = 0
    """What is not heard."""
    authority_age_s: float = 0.0
    ceiling: Ceiling = NOWHERE
    """Of the present mode."""
    full_mps: float = 0.0
    """Permitted under full supervision, whatever the present mode."""

    # What people, centre and stations ask.
    sleep_ordered: bool = False
    person_at_desk: bool = False
    sight_asked: bool = False
    """The person at the desk asks to drive on sight, or the centre lets them."""
    creep_ordered: bool = False
    jog_granted: bool = False
    stop_by_mps: float = math.inf
    """A train that was asked to stop now may not be faster than this any more."""
    resets: int = 0
    """Who resets the emergency brake in this very cycle, as flags of `Reset`."""
    overshot_little: bool = False
    """The stopping point was overshot no farther than a jog mends."""

    # What is wrong.
    button_pressed: bool = False
    ordered_to_stop: bool = False
    """The centre orders the emergency brake."""
    station_cause: Cause = Cause.NONE
    """Why stations and passengers need the emergency brake."""
    brake_unit_braked: bool = False
    """The brake unit applied the emergency brake, and nobody had told it to."""
    overruns: int = 0
    clock_stepped: bool = False
    not_finite: bool = False
    """The cycle before made a number that is none."""
    replicas_disagree: bool = False
    energy_exceeded: bool = False
    """By the second computation the train has too much energy for what lies ahead."""

    # What protection itself decided up to now.
    mode: OperatingMode = OperatingMode.STANDBY
    latched: tuple[Cause, ...] = ()
    """What keeps the emergency brake on, the first cause first."""

    @property
    def at_rest(self) -> bool:
        """Proven, and without a pulse: a train that creeps may seem to have zero speed for long."""
        return self.standstill and self.standing
