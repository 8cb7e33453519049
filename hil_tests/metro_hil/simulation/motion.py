"""How a train truly moves: constant accelerations one after the other, brakes that take their time.

Metres are path distance in running direction, from wherever the line begins.
"""

from typing import Final

NS_PER_S: Final = 1_000_000_000
BUILD_UP_NS: Final = 900_000_000
"""From any brake demand until the brake is on; until then the train rolls on."""
ROLL_BACK_MPS: Final = 0.4


class SimulatedMotion:
    """Front and speed of one train; it is told what to do and brought forward to any instant."""

    __slots__ = (
        *("accel_mps2", "at_ns", "back_m", "demand_mps2", "due_ns", "front_m", "speed_mps"),
        *("emergency", "emergency_mps2", "jogged_m", "most_m"),
    )

    def __init__(self, at_ns: int, front_m: float, *, emergency_mps2: float) -> None:
        """`emergency_mps2` is what its emergency brake truly reaches; positive."""
        self.at_ns, self.front_m = at_ns, front_m
        self.speed_mps = self.accel_mps2 = self.demand_mps2 = 0.0
        self.due_ns = at_ns
        """When the demand takes effect."""
        self.emergency = False
        self.emergency_mps2 = emergency_mps2
        self.back_m = 0.0
        """So much it is still to roll back."""
        self.most_m = front_m
        """As far as the front ever came."""
        self.jogged_m = 0.0
        """So much of the way back was meant, or is to be; what it went forwards again is less."""

    def advance(self, now_ns: int) -> None:
        """To an instant that is not in the past."""
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
        """Traction and less brake act at once, more brake after its build-up. Not in emergency."""
        if self.emergency or accel_mps2 == self.demand_mps2:
            return
        falling = accel_mps2 < min(self.accel_mps2, 0.0) - 1e-9
        self.demand_mps2 = accel_mps2
        if falling:
            # Traction goes first, and a brake already on its way is not made to wait again.
            self.accel_mps2 = min(self.accel_mps2, 0.0)
            if self.due_ns <= now_ns:
                self.due_ns = now_ns + BUILD_UP_NS
        else:
            self.accel_mps2 = accel_mps2
            self.due_ns = now_ns

    def apply_emergency(self, now_ns: int) -> None:
        """Latched until released."""
        if self.emergency:
            return
        self.emergency = True
        self.demand_mps2 = -self.emergency_mps2
        self.accel_mps2 = min(self.accel_mps2, 0.0)
        self.due_ns = now_ns + BUILD_UP_NS

    def release_emergency(self) -> None:
        """At standstill."""
        assert self.speed_mps == 0.0
        self.emergency = False
        self.demand_mps2 = self.accel_mps2 = 0.0

    @property
    def rolled_m(self) -> float:
        """So much it has gone back since it was farthest."""
        return self.most_m - self.front_m

    def stop_m(self, decel_mps2: float, reaction_s: float) -> float:
        """Where the front comes to rest with such a brake."""
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
