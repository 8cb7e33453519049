"""Invariant of switches (23): authorities end before a switch that is not locked, and it brakes."""

from can_dbc.vobc import OperatingMode
from metro_hil.monitors.context import Context
from metro_hil.monitors.description import Spoken
from metro_hil.monitors.gauge import Gauge
from plant_emulator.truth import NO_SWITCH_M, Truth
from zenoh_config.messages import MovementAuthority

NS_PER_S = 1_000_000_000
ISSUED_NS = NS_PER_S // 5
"""Time after the loss of a switch from which on the wayside knows of it."""
BRAKES_S = 0.3
"""Time from a received authority to the demand for the brake, besides two cycles."""
MOVING_MPS = 0.5
SUPERVISED = (float(OperatingMode.AUTHORISED), float(OperatingMode.JOG))


class SwitchWatch:
    """Compares the newest authority with the first switch that is not locked on the path."""

    __slots__ = (
        "_brakes_ns",
        "_end_m",
        "_late_ns",
        "_newest_ns",
        "_since_ns",
        "_switch_m",
        "brakes",
        "locked",
    )

    def __init__(self, context: Context, *, locked: Gauge, brakes: Gauge) -> None:
        self.locked, self.brakes = locked, brakes
        late_s = 2.0 * context.cycle_s + context.slack_s + context.lateness_s
        self._late_ns = round((BRAKES_S + late_s + context.input_age_s) * NS_PER_S)
        self._switch_m, self._since_ns = NO_SWITCH_M, context.start_ns
        self._end_m, self._newest_ns, self._brakes_ns = NO_SWITCH_M, -1, -1

    def heard(self, authority: MovementAuthority) -> None:
        """Take a sound authority as it reached the controller."""
        if authority.echo_stamp_ns <= self._newest_ns:
            return
        self._newest_ns, self._end_m = authority.echo_stamp_ns, authority.end_m
        if self._switch_m < NO_SWITCH_M and authority.stamp_ns > self._since_ns + ISSUED_NS:
            self.locked.see(self._switch_m - authority.end_m, authority.stamp_ns)

    def sample(self, truth: Truth, now_ns: int, spoken: Spoken) -> None:
        """Take a step of a train on a network with switches."""
        if truth.unlocked_switch_m != self._switch_m:
            self._switch_m, self._since_ns = truth.unlocked_switch_m, now_ns
        beyond = truth.front_m > self._end_m and self._switch_m < NO_SWITCH_M
        if not beyond or spoken.mode not in SUPERVISED or truth.speed_mps < MOVING_MPS:
            self._brakes_ns = -1
            return
        if self._brakes_ns < 0:
            self._brakes_ns = now_ns
            self.brakes.see(self._late_ns / NS_PER_S, now_ns)
        elif spoken.emergency_commanded == 0.0 and truth.emergency == 0.0:
            self.brakes.see((self._late_ns - (now_ns - self._brakes_ns)) / NS_PER_S, now_ns)
