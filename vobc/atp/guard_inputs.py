"""Inputs of the guards in protection's tables. Each cycle makes them once, frozen."""

import math
from typing import Final, NamedTuple

from can_dbc.vobc import Cause, OperatingMode
from vobc.atp.config import AtpConfig
from vobc.vocabulary import Ceiling, Interval

NOWHERE: Final = Ceiling(0.0, 0.0, 0.0, 0.0, 0.0)
"""Ceiling that permits nothing."""
STILL: Final = Interval(0.0, 0.0, 0.0)


class GuardInputs(NamedTuple):
    """All inputs of the guards. With a NaN input a guard decides for the brake."""

    limits: AtpConfig

    # Movement of the train.
    speed_mps: Interval = STILL
    standing: bool = False
    """The tacho samples show no pulse. This sign is quick, but no proof of standstill."""
    standstill: bool = False
    """Zero speed is proven."""
    rollback_m: float = 0.0
    """Distance back from the foremost place."""
    rollback_room_m: float = math.inf
    """Distance that remains to the line's limit of rollback if the emergency brake is applied now.
    """
    held_movement_m: float = 0.0
    """Distance from the place where the train was last to be held, in either direction."""
    jog_movement_m: float = 0.0
    """Distance from the place where the jog was granted, in either direction."""
    behind_jog_m: float = 0.0
    """Distance behind the place up to which the rear is protected for a jog."""

    # Presence of inputs.
    missing: int = 0
    """Inputs that are silent or not ready, as flags of `Missing`."""
    silent: int = 0
    """Inputs that are silent."""
    authority_age_s: float = 0.0
    restrictions_age_s: float = 0.0
    """Age of the orders that carry the restrictions."""
    ceiling: Ceiling = NOWHERE
    """Ceiling of the present mode."""
    full_mps: float = 0.0
    """Permitted speed under full supervision, whatever the present mode."""

    # Requests of people, centre and stations.
    sleep_ordered: bool = False
    person_at_desk: bool = False
    sight_asked: bool = False
    """The person at the desk asks to drive on sight, or the centre permits it."""
    creep_ordered: bool = False
    jog_granted: bool = False
    stop_by_mps: float = math.inf
    """Highest speed permitted by now after a request to stop now."""
    resets: int = 0
    """Sources that reset the emergency brake in this cycle, as flags of `Reset`."""
    overshot_little: bool = False
    """The overshoot of the stopping point is small enough for a jog to correct it."""

    # Faults.
    button_pressed: bool = False
    ordered_to_stop: bool = False
    """The centre orders the emergency brake."""
    station_cause: Cause = Cause.NONE
    """Reason why stations or passengers require the emergency brake."""
    brake_unit_braked: bool = False
    """The brake unit applied the emergency brake without a command."""
    overruns: int = 0
    clock_stepped: bool = False
    not_finite: bool = False
    """The cycle before produced a number that was not finite."""
    replicas_disagree: bool = False
    energy_exceeded: bool = False
    """By the second computation the train has too much energy for the targets ahead."""

    # Previous decisions of protection.
    mode: OperatingMode = OperatingMode.STANDBY
    latched: tuple[Cause, ...] = ()
    """Causes that keep the emergency brake on, the first one first."""

    @property
    def at_rest(self) -> bool:
        """Standstill is proven and there is no pulse.

        The speed of a creeping train may seem zero for long.
        """
        return self.standstill and self.standing
