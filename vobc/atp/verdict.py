"""Result of protection in one cycle."""

from dataclasses import dataclass

from can_dbc.doors import ALL_CARS
from can_dbc.vobc import (
    Cause,
    Inhibit,
    Intervention,
    Missing,
    OperatingMode,
    ReasonCode,
    Supervision,
    Withheld,
)
from vobc.atp.doors import DoorEnable
from vobc.vocabulary import Ceiling


@dataclass(frozen=True, slots=True)
class ProtectionVerdict:
    """Result of protection in one cycle. Operation can only request less."""

    supervision: Supervision
    cause: str
    missing: Missing
    ceiling: Ceiling | None
    doors_locked: bool
    """Reported by a fresh message. A silent door unit counts as unlocked."""
    emergency_released: bool
    service_brake: bool
    """Full service brake, whatever operation requests."""
    traction_permitted: bool
    hold: bool
    """The holding brake stays applied."""
    doors: DoorEnable
    mode: OperatingMode = OperatingMode.STANDBY
    emergency_cause: Cause = Cause.NONE
    emergency_number: int = 0
    """Causes that were latched since the start. A reset of the centre names this number."""
    intervention: Intervention = Intervention.HELD
    """What protection does, with `reason`. Only for display."""
    reason: ReasonCode = ReasonCode.NONE
    departure_inhibits: Inhibit = Inhibit.NONE
    """Reasons why the train must not depart."""
    doors_withheld: Withheld = Withheld.NONE
    door_cars: int = ALL_CARS
    """Cars to which enabled doors are limited: bit 0 is the front car."""
    reverse_permitted: bool = False
    """Traction may act backwards, for a jog."""
    jog_permitted: bool = False
    jog_to_tag: bool = False
    jog_back_m: float = 0.0
    """Distance back from the present place that the train may jog."""
    jog_attempts: int = 0
    stop_now: bool = False
    """Operation must stop the train now. Protection brakes only if it does not."""
    stop_next: bool = False
    """The stop at the next station must not be skipped."""
    keep_doors_open: bool = False
    creep: bool = False
    """Operation may drive on sight at the permitted speed."""
    replicas_agree: bool = True
    alarm_raised: bool = False
    door_bypass: bool = False
