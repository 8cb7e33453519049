"""When a case in real time is over, and whether its controller is dead. Pure: told everything."""

from dataclasses import dataclass
from typing import Final

from metro_hil.model.end_condition import AFTER_ARRIVAL_S, ARRIVED, NEAR_M
from plant_emulator.truth import Truth

NS_PER_S: Final = 1_000_000_000
SILENT_NS: Final = 2 * NS_PER_S
"""A controller that says nothing for so long hangs, whatever its process does."""
RESTART_NS: Final = 20 * NS_PER_S
"""A controller that was started again is given so long to speak."""
STAND_S: Final = 2.0
"""A train without a controller that stands for so long stays there."""
FOLLOW_NS: Final = 180 * NS_PER_S
"""It is followed for so long, to see where it comes to stand."""
FOLLOW_BLIND_NS: Final = 10 * NS_PER_S
"""Where nobody can say whether it stands, the taps go on for so long."""
STUCK_S: Final = 60.0
"""So long after the longest dwell, with no fault to come or to go, a standing train stays."""

DURATION: Final = "duration over"
VIOLATION: Final = "stopped at the first violation"
DIED: Final = "the controller died"
KILLED: Final = "no controller any more, and the train stands"
STUCK: Final = "stands for good"


@dataclass(slots=True)
class TrueMotion:
    """What the truth told so far."""

    stop_m: float
    """Of the last station of the way."""
    patience_s: float
    """A train that stands for longer stays."""
    t_s: float = 0.0
    front_m: float = 0.0
    first_m: float | None = None
    farthest_m: float = 0.0
    still_s: float | None = None
    """Since when it stands; None while it moves."""
    open_s: float | None = None
    """Since when it has stood with open doors at its last station."""

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
        """Where nobody knows the truth, what the controller says of itself; never a standstill."""
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
    """Whether the controller lives: its process and what it says."""

    died: str = ""
    """How it ended by itself or fell silent; empty while it lives."""
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
        """True once, when it is found dead.

        Args:
            ended: how its process ended by itself, empty while it runs.
            last_ns: when it was last heard.
            restarted_ns: when a fault that had killed it ended.
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
    """Why the case is over; empty while it is not.

    Args:
        violated: a monitor is violated and the case asks to stop then.
        pending: time alone will begin or end a fault.
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
