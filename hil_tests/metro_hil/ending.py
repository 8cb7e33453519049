"""How a run ends: the conditions, and what it hands to the report."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from can_dbc.vobc import AtoPhase, Cause, Supervision

NEAR_M = 5.0
AFTER_ARRIVAL_S = 3.0
"""How long a run goes on with open doors at its last station."""
UNATTENDED_S = 30.0
"""How long a train may stand in emergency where nobody can let it go: longer than any release that
comes by itself."""

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
class EmergencyWatch:
    """Says why a run is over whose train stands in emergency and has nobody to let it go."""

    _since_ns: int | None = None

    def stands_for_good(self, now_ns: int, supervision: Supervision, cause: Cause) -> str | None:
        """The reason to end, or None; to be asked again and again."""
        if supervision is not Supervision.EMERGENCY:
            self._since_ns = None
            return None
        if self._since_ns is None:
            self._since_ns = now_ns
        if now_ns - self._since_ns < UNATTENDED_S * 1e9:
            return None
        words = f"in emergency for {UNATTENDED_S:.0f} s and nobody there to let go"
        return f"{words}: {cause_words(cause)}"


def cause_words(cause: Cause) -> str:
    """What the emergency brake is for, as short as the bus tells it."""
    return cause.name.replace("_", " ").lower()
