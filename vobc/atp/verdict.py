"""What protection says in one cycle."""

from dataclasses import dataclass

from can_dbc.vobc import Cause, Inhibit, Missing, OperatingMode, Supervision, Withheld
from vobc.atp.doors import DoorEnable
from vobc.vocabulary import Ceiling


@dataclass(frozen=True, slots=True)
class ProtectionVerdict:
    """What protection says in one cycle; operation may only ask for less."""

    supervision: Supervision
    cause: str
    missing: Missing
    ceiling: Ceiling | None
    doors_locked: bool
    """Heard freshly; a door unit that is silent has no locked doors."""
    emergency_released: bool
    service_brake: bool
    """Full service brake whatever operation asks for."""
    traction_permitted: bool
    hold: bool
    """The holding brake stays on."""
    doors: DoorEnable
    mode: OperatingMode = OperatingMode.STANDBY
    emergency_cause: Cause = Cause.NONE
    departure_inhibits: Inhibit = Inhibit.NONE
    """Why the train may not set off from where it stands."""
    doors_withheld: Withheld = Withheld.NONE
    reverse_permitted: bool = False
    """Traction may act backwards: a jog."""
    jog_permitted: bool = False
    jog_back_m: float = 0.0
    """How far back from where it stands the train may jog."""
    jog_attempts: int = 0
    stop_now: bool = False
    """Operation is to come to rest wherever it is; protection brakes only if it does not."""
    stop_next: bool = False
    """A stop at the next station is not to be left out."""
    keep_doors_open: bool = False
    creep: bool = False
    """Operation may drive on sight at the permitted speed."""
    replicas_agree: bool = True
    alarm_raised: bool = False
    door_bypass: bool = False
