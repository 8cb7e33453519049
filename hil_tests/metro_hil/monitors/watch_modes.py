"""Invariants of operating modes: jogs, higher modes, restricted speed, wake-up (10, 11, 12, 18)."""

from can_dbc.vobc import Missing, OperatingMode
from metro_hil.monitors.context import Context
from metro_hil.monitors.description import Spoken
from metro_hil.monitors.gauge import Gauge
from metro_hil.monitors.place import LinePlaces
from plant_emulator.truth import Truth

NS_PER_S = 1_000_000_000
JOG = float(OperatingMode.JOG)
CREEP = float(OperatingMode.CREEP)
RESTRICTED = float(OperatingMode.RESTRICTED)
AUTHORISED = float(OperatingMode.AUTHORISED)
ON_SIGHT = (RESTRICTED, CREEP)
"""Modes without an authority, so that no authority can be passed."""
UNPLACED = int(Missing.AUTHORITY | Missing.LOCALISATION)
ORDER_NS = 5 * NS_PER_S
"""Time after which an order or request that has ended may still be acted on: the radio is slow."""
MOVED_MPS = 0.1
"""Speed that the play of couplers does not exceed."""
SAME_STOP_M = 20.0
"""Distance within which jogs belong to the same stopping point."""
WAKING_TAGS = 2.0


class ModeWatch:
    """Judges steps in which the train moves, and all frames of the controller."""

    __slots__ = (
        "_authorised_ns",
        "_checked_cold",
        "_cold_limit_m",
        "_creep_ns",
        "_distance_m",
        "_jog_from_m",
        "_jog_mps",
        "_jog_stop_m",
        "_jogs",
        "_jogs_max",
        "_margin_mps",
        "_mode",
        "_moving",
        "_place",
        "_restricted_mps",
        "_restricted_ns",
        "_runaway_mps2",
        "_runaway_s",
        "_start_tags",
        "attempts",
        "covered",
        "distance",
        "jog_speed",
        "restricted",
        "up",
        "wake_up",
    )

    def __init__(
        self,
        context: Context,
        place: LinePlaces,
        *,
        distance: Gauge,
        jog_speed: Gauge,
        attempts: Gauge,
        covered: Gauge,
        up: Gauge,
        restricted: Gauge,
        wake_up: Gauge,
    ) -> None:
        self.distance, self.jog_speed, self.attempts = distance, jog_speed, attempts
        self.covered, self.up, self.restricted, self.wake_up = covered, up, restricted, wake_up
        self._place = place
        self._distance_m, self._jogs_max = context.jog_m, context.jog_attempts
        self._margin_mps = context.flat_margin_mps
        self._jog_mps, self._restricted_mps = context.jog_mps, context.restricted_mps
        self._runaway_mps2 = context.runaway_mps2
        self._runaway_s = context.sensing_s + 2.0 * context.cycle_s + context.traction_cut_s
        self._cold_limit_m = context.cold_movement_m
        self._mode = 0.0
        self._moving = False
        self._jog_from_m = self._jog_stop_m = 0.0
        self._jogs = 0
        self._authorised_ns = -1
        """Instant at which the mode became authorised, until the next VOBC_STATUS; otherwise -1."""
        self._creep_ns = self._restricted_ns = -ORDER_NS
        self._start_tags = -1.0
        self._checked_cold = False

    def sample(self, truth: Truth, now_ns: int, spoken: Spoken) -> None:
        """Take a step in which the train moves, or the first one at rest."""
        speed_mps = abs(truth.speed_mps)
        if speed_mps < MOVED_MPS:
            if truth.speed_mps == 0.0:
                self._moving = False
            return
        begins, self._moving = not self._moving, True
        if begins:
            self._jog_from_m = truth.front_m
        if spoken.mode == JOG:
            self._check_jog(truth, now_ns, begins=begins)
        elif spoken.mode in ON_SIGHT:
            self.restricted.see(self._most_mps(truth, self._restricted_mps) - speed_mps, now_ns)

    def _check_jog(self, truth: Truth, now_ns: int, *, begins: bool) -> None:
        if begins:
            if abs(truth.front_m - self._jog_stop_m) > SAME_STOP_M:
                self._jogs, self._jog_stop_m = 0, truth.front_m
            self._jogs += 1
            self.attempts.see(float(self._jogs_max - self._jogs), now_ns)
        speed_mps = truth.speed_mps
        self.jog_speed.see(self._most_mps(truth, self._jog_mps) - abs(speed_mps), now_ns)
        if truth.emergency == 0.0:
            self.distance.see(self._distance_m - abs(truth.front_m - self._jog_from_m), now_ns)
        if speed_mps < 0.0:
            self.covered.see(truth.rear_m - truth.authority_rear_m, now_ns)

    def _most_mps(self, truth: Truth, permitted_mps: float) -> float:
        """Return the permitted speed plus margin and the runaway's gain until traction is cut."""
        fall_mps2 = self._place.worst_fall_under_mps2(truth.front_m)
        gained_mps = (self._runaway_mps2 + fall_mps2) * self._runaway_s
        return permitted_mps + self._margin_mps + gained_mps

    def news(self, truth: Truth, now_ns: int, spoken: Spoken) -> None:
        """Take what was reported since the last step."""
        if self._start_tags < 0.0:
            self._start_tags = truth.tags_read
        if truth.order_creep > 0.0:
            self._creep_ns = now_ns
        if truth.order_restricted > 0.0 or spoken.restricted_pressed > 0.0:
            self._restricted_ns = now_ns
        if spoken.mode != self._mode:
            self._mode = spoken.mode
            if spoken.mode == CREEP:
                self.up.said(now_ns - self._creep_ns < ORDER_NS, now_ns)
            elif spoken.mode == RESTRICTED:
                self.up.said(now_ns - self._restricted_ns < ORDER_NS, now_ns)
            self._authorised_ns = spoken.mode_ns if spoken.mode == AUTHORISED else -1
        if 0 <= self._authorised_ns < spoken.status_ns:
            self._authorised_ns = -1
            placed = spoken.localised > 0.0 and not int(spoken.missing) & UNPLACED
            self.up.said(placed and truth.authority_now_m > truth.front_m, now_ns)
        if not self._checked_cold and spoken.cold_ns > 0 and spoken.localised > 0.0:
            self._checked_cold = True
            proven = spoken.cold_moved_m <= self._cold_limit_m
            read = truth.tags_read - self._start_tags >= WAKING_TAGS
            self.wake_up.said(proven or read, now_ns)
