"""Decides when a case in real time is over, and whether its controller is dead. Pure functions."""

from dataclasses import dataclass
from typing import Final

from metro_hil.model.end_condition import AFTER_ARRIVAL_S, ARRIVED, NEAR_M
from plant_emulator.truth import Truth

NS_PER_S: Final = 1_000_000_000
SILENT_NS: Final = 2 * NS_PER_S
"""Silence after which a controller counts as hung, whatever its process does."""
RESTART_NS: Final = 20 * NS_PER_S
"""Time that a restarted controller has for its first frame."""
STAND_S: Final = 2.0
"""Standstill after which a train without a controller counts as stopped for good."""
FOLLOW_NS: Final = 180 * NS_PER_S
"""Time for which a train without a controller is observed, to see where it stops."""
FOLLOW_BLIND_NS: Final = 10 * NS_PER_S
"""The same where no truth shows whether the train stands."""
STUCK_S: Final = 60.0
"""Standstill beyond the longest dwell after which a train counts as stuck; no fault may be due or
active."""

DURATION: Final = "duration over"
VIOLATION: Final = "stopped at the first violation"
DIED: Final = "the controller died"
KILLED: Final = "no controller any more, and the train stands"
STUCK: Final = "stands for good"


@dataclass(slots=True)
class TrueMotion:
    """Motion of the train according to the truth so far."""

    stop_m: float
    """Stopping point of the last station."""
    patience_s: float
    """Standstill after which the train counts as stuck."""
    t_s: float = 0.0
    front_m: float = 0.0
    first_m: float | None = None
    farthest_m: float = 0.0
    still_s: float | None = None
    """Start of the present standstill; None while the train moves."""
    open_s: float | None = None
    """Time since which the train has stood with open doors at its last station."""

    def take(self, truth: Truth) -> None:
        self.t_s, self.front_m = truth.t_s, truth.front_m
        if self.first_m is None:
            self.first_m = self.farthest_m = truth.front_m
        self.farthest_m = max(self.farthest_m, truth.front_m)
        still = truth.speed_mps == 0.0
        self.still_s = _since(still, self.still_s, truth.t_s)
        is_open = truth.left_open > 0.0 or truth.right_open > 0.0
        there = still and is_open and abs(truth.front_m - self.stop_m) <= NEAR_M
        self.open_s = _since(there, self.open_s, truth.t_s)

    def believe(self, t_s: float, front_m: float | None, *, doors_open: bool) -> None:
        """Without truth, use what the controller reports; it never proves a standstill."""
        self.t_s = t_s
        if front_m is None:
            return
        self.front_m = front_m
        if self.first_m is None:
            self.first_m = self.farthest_m = front_m
        self.farthest_m = max(self.farthest_m, front_m)
        there = doors_open and abs(front_m - self.stop_m) <= NEAR_M
        self.open_s = _since(there, self.open_s, t_s)

    @property
    def moved_m(self) -> float:
        return 0.0 if self.first_m is None else self.farthest_m - self.first_m

    @property
    def arrived(self) -> bool:
        return self.open_s is not None and self.t_s - self.open_s >= AFTER_ARRIVAL_S

    def stood(self, for_s: float) -> bool:
        return self.still_s is not None and self.t_s - self.still_s >= for_s


def _since(now: bool, since_s: float | None, t_s: float) -> float | None:
    if not now:
        return None
    return t_s if since_s is None else since_s


@dataclass(slots=True)
class Pulse:
    """Tells whether the controller is alive, from its process and its frames."""

    died: str = ""
    """How the controller ended or that it fell silent; empty while it is alive."""
    died_ns: int = 0

    def check(
        self,
        now_ns: int,
        *,
        ended: str,
        last_ns: int | None,
        restarted_ns: int | None,
        excused: bool,
    ) -> bool:
        """Return True once, when the controller is found dead.

        Args:
            ended: how its process ended by itself; empty while it runs.
            last_ns: instant of its last frame.
            restarted_ns: end of a fault that had killed it.
            excused: a fault of its process acts, or did a moment ago.
        """
        if self.died:
            return False
        if ended:
            return self._die(now_ns, ended)
        if excused or last_ns is None:
            return False
        limit_ns = last_ns + SILENT_NS
        if restarted_ns is not None and last_ns < restarted_ns:
            limit_ns = restarted_ns + RESTART_NS
        if now_ns > limit_ns:
            return self._die(now_ns, f"silent for {(now_ns - last_ns) / NS_PER_S:.1f} s")
        return False

    def _die(self, now_ns: int, words: str) -> bool:
        self.died, self.died_ns = words, now_ns
        return True


def over(
    motion: TrueMotion,
    pulse: Pulse,
    now_ns: int,
    *,
    began_ns: int,
    duration_s: float,
    violated: bool,
    killed_for_good: bool,
    pending: bool,
    truth_known: bool = True,
) -> str:
    """Return why the case is over; empty while it is not.

    Args:
        violated: a monitor is violated and the case stops in that event.
        pending: a fault will still begin or end by time alone.
    """
    if violated:
        return VIOLATION
    if pulse.died:
        followed = now_ns - pulse.died_ns > (FOLLOW_NS if truth_known else FOLLOW_BLIND_NS)
        return DIED if followed or motion.stood(STAND_S) else ""
    if motion.arrived:
        return ARRIVED
    if now_ns - began_ns >= duration_s * NS_PER_S:
        return DURATION
    if killed_for_good and motion.stood(STAND_S):
        return KILLED
    if motion.stood(motion.patience_s) and not pending:
        return STUCK
    return ""
