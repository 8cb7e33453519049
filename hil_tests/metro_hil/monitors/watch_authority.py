"""Invariant of the age of authorities (24), from the radio messages to the controller."""

from can_dbc.vobc import OperatingMode
from metro_hil.monitors.context import Context
from metro_hil.monitors.description import Spoken
from metro_hil.monitors.gauge import Gauge
from plant_emulator.truth import Truth
from zenoh_config.messages import MovementAuthority

NS_PER_S = 1_000_000_000
MOVING_MPS = 0.5
SUPERVISED = (float(OperatingMode.AUTHORISED), float(OperatingMode.JOG))
LOOKED_AT_NS = NS_PER_S
"""Age up to which an authority cannot be too old, so nothing is checked."""


class AuthorityWatch:
    """Watches the age of the newest authority, which is that of the position report it answers."""

    __slots__ = ("_limit_ns", "_newest_ns", "aged")

    def __init__(self, context: Context, *, aged: Gauge) -> None:
        self.aged = aged
        # The limit includes the cycle that reports the loss on the bus.
        late_s = 2.0 * context.cycle_s + context.slack_s + context.lateness_s
        self._limit_ns = round((context.authority_age_s + late_s) * NS_PER_S)
        self._newest_ns = -1
        """Stamp of the report that the newest authority answers; negative before the first."""

    def heard(self, authority: MovementAuthority) -> None:
        """Take a sound authority as it reached the controller."""
        self._newest_ns = max(self._newest_ns, authority.echo_stamp_ns)

    def sample(self, truth: Truth, now_ns: int, spoken: Spoken) -> None:
        """Take a step in which the train moves."""
        age_ns = now_ns - self._newest_ns
        if self._newest_ns < 0 or age_ns < LOOKED_AT_NS or spoken.mode not in SUPERVISED:
            return
        # The brake satisfies the invariant, whatever moves the train.
        braked = spoken.emergency_commanded > 0.0 or truth.emergency > 0.0
        if not braked and truth.speed_mps > MOVING_MPS:
            self.aged.see((self._limit_ns - age_ns) / NS_PER_S, now_ns)
