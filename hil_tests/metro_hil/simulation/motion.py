"""True motion of a train: constant accelerations in turn, with brakes that build up slowly.

Positions are path distances in running direction from the start of the line.
"""

from typing import Final

NS_PER_S: Final = 1_000_000_000
BUILD_UP_NS: Final = 900_000_000
"""Time from a brake demand to its effect; until then the train coasts."""
ROLL_BACK_MPS: Final = 0.4


class SimulatedMotion:
    """Front position and speed of one train; takes demands and moves forward to any instant."""

    __slots__ = (
        *("accel_mps2", "at_ns", "back_m", "demand_mps2", "due_ns", "front_m", "speed_mps"),
        *("emergency", "emergency_mps2", "jogged_m", "most_m"),
    )

    def __init__(self, at_ns: int, front_m: float, *, emergency_mps2: float) -> None:
        """`emergency_mps2` is the true emergency brake rate; positive."""
        self.at_ns, self.front_m = at_ns, front_m
        self.speed_mps = self.accel_mps2 = self.demand_mps2 = 0.0
        self.due_ns = at_ns
        """Instant at which the demand takes effect."""
        self.emergency = False
        self.emergency_mps2 = emergency_mps2
        self.back_m = 0.0
        """Distance that the train is still to roll back."""
        self.most_m = front_m
        """Farthest position that the front ever reached."""
        self.jogged_m = 0.0
        """Part of the way back that was or will be a jog; running forwards again reduces it."""

    def advance(self, now_ns: int) -> None:
        """Move forward to an instant that is not in the past."""
        if self.due_ns > self.at_ns and self.due_ns <= now_ns:
            self._run(self.due_ns)
            self.accel_mps2 = self.demand_mps2
        self._run(now_ns)

    def _run(self, until_ns: int) -> None:
        duration_s = (until_ns - self.at_ns) / NS_PER_S
        self.at_ns = until_ns
        accel_mps2, speed_mps = self.accel_mps2, self.speed_mps
        if speed_mps <= 0.0 and accel_mps2 <= 0.0:
            if self.back_m > 0.0:
                way_m = min(self.back_m, ROLL_BACK_MPS * duration_s)
                self.back_m -= way_m
                self.front_m -= way_m
            return
        after_mps = speed_mps + accel_mps2 * duration_s
        if after_mps <= 0.0:
            self.front_m += speed_mps * speed_mps / (-2.0 * accel_mps2)
            self.speed_mps = 0.0
        else:
            self.front_m += 0.5 * (speed_mps + after_mps) * duration_s
            self.speed_mps = after_mps
            self.back_m = 0.0
        if self.front_m > self.most_m:
            self.most_m = self.front_m
            self.jogged_m = 0.0
        elif self.jogged_m > self.rolled_m:
            self.jogged_m = self.rolled_m

    def demand(self, now_ns: int, accel_mps2: float) -> None:
        """Set the demand, except in emergency.

        More braking takes effect only after the build-up.
        """
        if self.emergency or accel_mps2 == self.demand_mps2:
            return
        falling = accel_mps2 < min(self.accel_mps2, 0.0) - 1e-9
        self.demand_mps2 = accel_mps2
        if falling:
            # Traction ends first, and a brake that already builds up does not start again.
            self.accel_mps2 = min(self.accel_mps2, 0.0)
            if self.due_ns <= now_ns:
                self.due_ns = now_ns + BUILD_UP_NS
        else:
            self.accel_mps2 = accel_mps2
            self.due_ns = now_ns

    def apply_emergency(self, now_ns: int) -> None:
        """Apply the emergency brake; it stays applied until its release."""
        if self.emergency:
            return
        self.emergency = True
        self.demand_mps2 = -self.emergency_mps2
        self.accel_mps2 = min(self.accel_mps2, 0.0)
        self.due_ns = now_ns + BUILD_UP_NS

    def release_emergency(self) -> None:
        """Release the emergency brake at standstill."""
        assert self.speed_mps == 0.0
        self.emergency = False
        self.demand_mps2 = self.accel_mps2 = 0.0

    @property
    def rolled_m(self) -> float:
        """Distance that the train has gone back from its farthest position."""
        return self.most_m - self.front_m

    def stop_m(self, decel_mps2: float, reaction_s: float) -> float:
        """Return where the front comes to rest with this deceleration and reaction time."""
        speed_mps = self.speed_mps
        return self.front_m + speed_mps * reaction_s + speed_mps**2 / (2.0 * decel_mps2)

    @property
    def farthest_m(self) -> float:
        """Where the front comes to rest if the emergency brake is applied now, or already was."""
        wait_ns = BUILD_UP_NS
        if self.emergency:
            wait_ns = max(0, self.due_ns - self.at_ns)
        way_m = self.speed_mps * wait_ns / NS_PER_S
        return self.front_m + way_m + self.speed_mps**2 / (2.0 * self.emergency_mps2)
