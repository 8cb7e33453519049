"""Detection of edges and durations: resets, brake unit, clock, requested stops."""

import math
from typing import Final

from can_dbc.brake import BrakeStatus
from can_dbc.cab import Desk
from vobc.atp.config import AtpConfig
from vobc.atp.emergencies import Reset
from vobc.vocabulary import Orders

DESK: Final = int(Reset.DESK)
CENTRE: Final = int(Reset.CENTRE)


class Resets:
    """Detects new resets of desk and centre.

    A reset counts only if it was given to a train that could receive it. A button that is held at
    the desk, or that was pressed while the desk was silent, is none. The same applies to a reset of
    a centre whose orders were too old before.
    """

    def __init__(self) -> None:
        self._was_pressed = True
        self._counted: int | None = None

    def step(self, desk: Desk | None, orders: Orders | None, emergency_number: int) -> int:
        """Flags of `Reset`, each for one cycle.

        The centre counts its resets, and names the emergency that the last one is for. A step up
        is a reset if it names the present emergency. The first count after the start or after a
        silence is none. A step down is none either: the centre has restarted its count.

        Args:
            desk: None if no fresh message is there. The same applies to `orders`.
            emergency_number: number of the present emergency, or of the last one.
        """
        given = 0
        pressed = desk is not None and desk.reset_requested
        if pressed and not self._was_pressed:
            given |= DESK
        self._was_pressed = pressed or desk is None
        if orders is None:
            self._counted = None
            return given
        counted, self._counted = self._counted, orders.releases
        named = orders.released_emergency == emergency_number
        if named and counted is not None and orders.releases > counted:
            given |= CENTRE
        return given


class BrakeUnitWatch:
    """Detects a brake unit that applies the emergency brake although its release is commanded."""

    def __init__(self, config: AtpConfig) -> None:
        self._patience_s = config.brake_unit_s
        self._released_s = 0.0
        self._was_free = False

    def step(self, brake: BrakeStatus | None, *, released: bool, dt_s: float) -> bool:
        """Whether the unit brakes by itself.

        A unit that has already reported the brake off applies it for its own reason. Any other unit
        gets some time. The last report of a silent unit stays valid.

        Args:
            released: command of protection in the cycle before.
        """
        if not released:
            self._released_s, self._was_free = 0.0, False
            return False
        self._released_s += dt_s
        if brake is None or not brake.emergency_applied:
            self._was_free = self._was_free or brake is not None
            return False
        return self._was_free or self._released_s > self._patience_s


class StopWatch:
    """Gives operation time to begin a requested stop, then requires a least deceleration."""

    def __init__(self, config: AtpConfig) -> None:
        self._patience_s = config.stop_patience_s
        self._decel_mps2 = config.stop_decel_mps2
        self._asked_s = 0.0
        self._from_mps: float | None = None

    def stop_by_mps(self, asked: bool, *, speed_mps: float, dt_s: float) -> float:
        """The highest speed permitted by now. math.inf: no stop is requested."""
        if not asked:
            self._asked_s, self._from_mps = 0.0, None
            return math.inf
        if self._from_mps is None:
            self._from_mps = speed_mps
        self._asked_s += dt_s
        late_s = self._asked_s - self._patience_s
        if late_s < 0.0:
            return math.inf
        return max(0.0, self._from_mps - self._decel_mps2 * late_s)


def clock_stepped(dt_s: float, overruns: int, *, cycle_s: float, tolerance_s: float) -> bool:
    """Whether the elapsed time differs from the cycles, missed ones included."""
    return not (dt_s > 0.0 and abs(dt_s - cycle_s * (1 + overruns)) <= tolerance_s)
