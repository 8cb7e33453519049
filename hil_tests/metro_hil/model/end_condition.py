"""How a run ends: the conditions, and what it hands to the report."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from can_dbc.vobc import AtoPhase, Cause, Supervision, Withheld
from vobc.atp.emergencies import RULE_OF, Reset

NEAR_M = 5.0
AFTER_ARRIVAL_S = 3.0
"""How long a run goes on with open doors at its last station."""
UNATTENDED_S = 30.0
"""How long a train may stand in emergency where nobody can let it go, or behind doors that nobody
can open by hand: longer than any release, or jog, that comes by itself."""
MENDED_BY_MOVING = Withheld.NOT_LOCALISED | Withheld.NO_PLATFORM | Withheld.MISALIGNED
"""What stands against doors as long as the train stands where it does."""

ARRIVED = "arrived"
DURATION = "duration over"
INTERRUPTED = "interrupted"


@dataclass(frozen=True, slots=True)
class Ending:
    """What the run itself knows; everything else is measured from its logs."""

    exit_reason: str
    failed: bool
    frames: int
    bus_load_ratio: float
    rejected_frames: Mapping[str, int]
    real_time_factor: float | None = None
    steal_s: float | None = None
    realtime: Sequence[str] = ()
    truth_known: bool = True
    dropped_frames: int = 0
    """That the tap was told of but did not get."""
    lost_log_lines: int = 0
    """That the disk did not take."""


@dataclass(slots=True)
class ArrivalWatch:
    """Says when the train has stood with open doors at its last station for a while."""

    stop_m: float
    _since_ns: int | None = None

    def arrived(self, now_ns: int, phase: AtoPhase, front_m: float) -> bool:
        there = phase is AtoPhase.DOORS_OPEN and abs(front_m - self.stop_m) <= NEAR_M
        if not there:
            self._since_ns = None
            return False
        if self._since_ns is None:
            self._since_ns = now_ns
        return now_ns - self._since_ns >= AFTER_ARRIVAL_S * 1e9


@dataclass(slots=True)
class HeldEmergencyCondition:
    """Says why a run is over whose train stands in emergency and has nobody to let it go."""

    centre: bool = False
    """Somebody supervises the line: what the centre may let go is waited for."""
    _since_ns: int | None = None

    def stands_for_good(self, now_ns: int, supervision: Supervision, cause: Cause) -> str | None:
        """The reason to end, or None; to be asked again and again."""
        waits = self.centre and centre_may_let_go(cause)
        if supervision is not Supervision.EMERGENCY or waits:
            self._since_ns = None
            return None
        if self._since_ns is None:
            self._since_ns = now_ns
        if now_ns - self._since_ns < UNATTENDED_S * 1e9:
            return None
        words = f"in emergency for {UNATTENDED_S:.0f} s and nobody there to let go"
        return f"{words}: {cause_words(cause)}"


@dataclass(slots=True)
class ShutDoorsCondition:
    """Says why a run is over whose train has stopped where its doors stay shut, with nobody there.

    After a stop the place may be known too roughly for doors, say because the machine was held up
    on the last metres; a tag would mend it, but a train at its stop passes none.
    """

    _since_ns: int | None = None

    def shut_for_good(self, now_ns: int, phase: AtoPhase, withheld: Withheld) -> str | None:
        """The reason to end, or None; to be asked again and again."""
        reasons = withheld & MENDED_BY_MOVING
        if phase is not AtoPhase.STOPPED or not reasons:
            self._since_ns = None
            return None
        if self._since_ns is None:
            self._since_ns = now_ns
        if now_ns - self._since_ns < UNATTENDED_S * 1e9:
            return None
        words = f"doors shut for {UNATTENDED_S:.0f} s at a stop and nobody there to open them"
        return f"{words}: {withheld_words(reasons)}"


def centre_may_let_go(cause: Cause) -> bool:
    """By its own rule, once the train stands and the cause is gone."""
    rule = RULE_OF.get(cause)
    return rule is not None and Reset.CENTRE in rule.reset_by


def withheld_words(withheld: Withheld) -> str:
    """What stands against doors, as short as the bus tells it."""
    names = [flag.name for flag in Withheld if flag in withheld and flag.name is not None]
    return ", ".join(names).replace("_", " ").lower()


def cause_words(cause: Cause) -> str:
    """What the emergency brake is for, as short as the bus tells it."""
    return cause.name.replace("_", " ").lower()
