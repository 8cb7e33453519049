"""Decides when a run ends, and holds what the run then gives to the report."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from can_dbc.vobc import AtoPhase, Cause, Supervision, Withheld
from vobc.atp.emergencies import RULE_OF, Reset

NEAR_M = 5.0
AFTER_ARRIVAL_S = 3.0
"""Time for which a run continues with open doors at its last station, s."""
UNATTENDED_S = 30.0
"""Time after which a run ends whose train stands in emergency, or behind shut doors, without a
person to help, s. Every automatic release or jog comes sooner."""
MENDED_BY_MOVING = (
    Withheld.NOT_LOCALISED | Withheld.NO_PLATFORM | Withheld.MISALIGNED | Withheld.OFF_PLATFORM
)
"""Reasons to withhold doors that remain as long as the train does not move."""

ARRIVED = "arrived"
DURATION = "duration over"
INTERRUPTED = "interrupted"


@dataclass(frozen=True, slots=True)
class Ending:
    """Results that only the run itself knows; all others are measured from its logs."""

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
    """Number of frames that the tap missed."""
    lost_log_lines: int = 0
    """Number of log lines that the disk refused."""
    nodes: Sequence[str] = ()
    """What happened at each LS-BUS node."""


@dataclass(slots=True)
class ArrivalWatch:
    """Detects that the train has stood with open doors at its last station for a while."""

    stop_m: float
    doors: bool = True
    """False for a siding, where the doors stay shut."""
    _since_ns: int | None = None

    def arrived(self, now_ns: int, phase: AtoPhase, front_m: float) -> bool:
        at_rest = AtoPhase.DOORS_OPEN if self.doors else AtoPhase.STOPPED
        there = phase is at_rest and abs(front_m - self.stop_m) <= NEAR_M
        if not there:
            self._since_ns = None
            return False
        if self._since_ns is None:
            self._since_ns = now_ns
        return now_ns - self._since_ns >= AFTER_ARRIVAL_S * 1e9


@dataclass(slots=True)
class HeldEmergencyCondition:
    """Ends a run whose train stands in emergency without a person who can release the brake."""

    centre: bool = False
    """Whether an operator supervises the line; the run then waits for a release that the centre may
    give."""
    _since_ns: int | None = None

    def stands_for_good(self, now_ns: int, supervision: Supervision, cause: Cause) -> str | None:
        """The reason to end the run, or None; called in every cycle."""
        waits = self.centre and centre_may_let_go(cause)
        if supervision is not Supervision.EMERGENCY or waits:
            self._since_ns = None
            return None
        if self._since_ns is None:
            self._since_ns = now_ns
        if now_ns - self._since_ns < UNATTENDED_S * 1e9:
            return None
        words = f"in emergency for {UNATTENDED_S:.0f} s and no person there to release it"
        return f"{words}: {cause_words(cause)}"


@dataclass(slots=True)
class ShutDoorsCondition:
    """Ends a run whose train has stopped where its doors stay shut, without a person to open them.

    After a stop the position may be too uncertain for doors, for example because the machine was
    held up on the last metres. A tag would correct it, but a stopped train passes none.
    """

    _since_ns: int | None = None

    def shut_for_good(self, now_ns: int, phase: AtoPhase, withheld: Withheld) -> str | None:
        """The reason to end the run, or None; called in every cycle."""
        reasons = withheld & MENDED_BY_MOVING
        if phase is not AtoPhase.STOPPED or not reasons:
            self._since_ns = None
            return None
        if self._since_ns is None:
            self._since_ns = now_ns
        if now_ns - self._since_ns < UNATTENDED_S * 1e9:
            return None
        words = f"doors shut for {UNATTENDED_S:.0f} s at a stop and no person there to open them"
        return f"{words}: {withheld_words(reasons)}"


def centre_may_let_go(cause: Cause) -> bool:
    """Whether the centre may release the brake, once the train stands and the cause is gone."""
    rule = RULE_OF.get(cause)
    return rule is not None and Reset.CENTRE in rule.reset_by


def withheld_words(withheld: Withheld) -> str:
    """Reasons to withhold doors, named as on the bus."""
    names = [flag.name for flag in Withheld if flag in withheld and flag.name is not None]
    return ", ".join(names).replace("_", " ").lower()


def cause_words(cause: Cause) -> str:
    """Cause of the emergency brake, named as on the bus."""
    return cause.name.replace("_", " ").lower()
