"""Invariants of emergency brake, traction, departure and missing frames (5, 6, 7, 33, 34)."""

from can_dbc.vobc import Cause, Supervision
from metro_hil.monitors.context import Context
from metro_hil.monitors.description import NEVER_NS, Spoken
from metro_hil.monitors.gauge import Gauge
from metro_hil.monitors.place import LinePlaces
from plant_emulator.truth import Truth

NS_PER_S = 1_000_000_000
PULL_N = 1.0
"""Force below which there is no tractive effort."""
LEFT_MPS = 0.1
"""Speed above which a train has departed; it excludes the play of couplers."""
COASTING_MPS = 0.5
"""Speed below which odometry may report standstill."""
EMERGENCY = float(Supervision.EMERGENCY)
RESTART_NS = NS_PER_S // 4
"""Gap between two VOBC_STATUS that no controller leaves without missing a cycle."""
OVERSHOT = float(Cause.OVERSHOT)
"""The only cause whose emergency brake may release itself, at standstill: a jog corrects it."""


class EmergencyWatch:
    """Judges what the emergency brake must end and what must not end it."""

    __slots__ = (
        "_applied_moving",
        "_cause",
        "_commanded",
        "_cut_ns",
        "_latched",
        "_releasable_ns",
        "_released_ns",
        "_releases",
        "_reset_lifetime_ns",
        "_reset_ns",
        "_reset_was_pressed",
        "_since_ns",
        "_slips",
        "_start_ns",
        "_status_ns",
        "_takeover_ns",
        "_traction_acted",
        "_unit_released_ns",
        "held",
        "ignored",
        "traction_off",
    )

    def __init__(
        self, context: Context, *, held: Gauge, traction_off: Gauge, ignored: Gauge
    ) -> None:
        self.held, self.traction_off, self.ignored = held, traction_off, ignored
        self._cut_ns = round(context.traction_cut_s * NS_PER_S)
        self._reset_lifetime_ns = round(context.reset_lifetime_s * NS_PER_S)
        self._since_ns = -1
        self._traction_acted = False
        """Traction acted when the emergency brake was demanded, and has not been seen off since."""
        self._commanded = False
        """Whether the newest frame commands the emergency brake; false before the first frame."""
        self._start_ns = context.start_ns
        self._applied_moving = False
        self._latched = False
        self._reset_ns = -1
        self._reset_was_pressed = True
        self._releases = 0.0
        self._cause = 0.0
        """Cause of the latched emergency, as last reported."""
        # Faults may delay both the report and the answer on the bus.
        self._takeover_ns = round((context.takeover_s + context.input_age_s) * NS_PER_S)
        self._unit_released_ns = -1
        """Instant at which the brake unit stopped demanding it while the train moved on."""
        self._releasable_ns = round(context.brake_unit_s * NS_PER_S)
        self._released_ns = NEVER_NS
        """Instant at which the controller last released it."""
        self._status_ns = context.start_ns
        self._slips = 0.0
        """Missed cycles in the last VOBC_STATUS."""

    def sample(self, truth: Truth, now_ns: int, spoken: Spoken) -> None:
        """Take a step in which the brake unit demands the emergency brake."""
        self._unit_released_ns = -1
        if self._since_ns < 0:
            self._since_ns = now_ns
            self._traction_acted = truth.drive_n > PULL_N
        since_ns = now_ns - self._since_ns
        pulls = truth.drive_n > PULL_N
        if self._traction_acted or pulls:
            # Judge the first step without effort as well: traction ended somewhere within it.
            self._traction_acted = pulls
            self.traction_off.see((self._cut_ns - since_ns) / NS_PER_S, now_ns)
        if (
            since_ns > self._cut_ns
            and spoken.force_commanded_n > PULL_N
            and spoken.traction_permitted > 0.0
        ):
            self.ignored.said(not pulls, now_ns)
        if self._applied_moving and truth.speed_mps == 0.0 and spoken.emergency_commanded > 0.0:
            # The brake was held to standstill; its release shows whether it stays on until a reset.
            self._applied_moving = False
            self.held.said(True, now_ns)

    def ended(self, truth: Truth, now_ns: int) -> None:
        """The brake unit no longer demands the emergency brake.

        An emergency brake that it applied before it reported the last one off is not
        distinguishable, and does not count.
        """
        self._since_ns = -1
        told = now_ns - self._released_ns > self._releasable_ns
        if told and abs(truth.speed_mps) > LEFT_MPS:
            self._unit_released_ns = now_ns

    def without(self, truth: Truth, now_ns: int) -> None:
        """Take a step without the emergency brake in which the train moves."""
        if self._unit_released_ns < 0:
            return
        if truth.speed_mps == 0.0:
            self._unit_released_ns = -1
        elif now_ns - self._unit_released_ns > self._takeover_ns:
            self._unit_released_ns = -1
            self.held.said(False, now_ns)

    def news(self, truth: Truth, now_ns: int, spoken: Spoken) -> None:
        """Take a step in which a frame of the controller or the desk has arrived."""
        if spoken.brake_ns == self._start_ns:
            return
        commanded = spoken.emergency_commanded > 0.0
        moving = truth.speed_mps != 0.0
        self._follow_reset(now_ns, spoken, standing=not moving)
        if truth.order_releases > self._releases:
            self._releases = truth.order_releases
            if not moving:
                self._reset_ns = now_ns
        if commanded and moving:
            self._applied_moving = True
        if self._was_restarted(spoken):
            # It does not know what was latched before; that it brakes without a position is new.
            self._latched = False
        told = spoken.supervision == EMERGENCY
        released = self._commanded and not commanded
        if released:
            self._released_ns = now_ns
        if (self._latched and not told) or (released and (self._latched or moving)):
            self._judge_release(now_ns, moving=moving)
        if released:
            self._applied_moving = False
        if spoken.emergency_cause > 0.0:
            self._cause = spoken.emergency_cause
        elif not told:
            self._cause = 0.0
        self._latched = told
        self._commanded = commanded

    def _judge_release(self, now_ns: int, *, moving: bool) -> None:
        """A release is right at standstill, after a reset or for a cause that releases itself."""
        reset = self._reset_ns >= 0 and now_ns - self._reset_ns <= self._reset_lifetime_ns
        mended = self._cause == OVERSHOT
        self.held.said(not moving and (reset or mended or not self._latched), now_ns)
        self._reset_ns = -1

    def _was_restarted(self, spoken: Spoken) -> bool:
        """Tell whether the controller was restarted: it was silent and counts no missed cycles."""
        silent_ns = spoken.status_ns - self._status_ns
        missed = spoken.cycle_slips > self._slips
        self._status_ns, self._slips = spoken.status_ns, spoken.cycle_slips
        return silent_ns > RESTART_NS and not missed

    def _follow_reset(self, now_ns: int, spoken: Spoken, *, standing: bool) -> None:
        pressed = spoken.reset_pressed > 0.0
        if pressed and not self._reset_was_pressed and standing:
            self._reset_ns = now_ns
        self._reset_was_pressed = pressed


class SilenceWatch:
    """Judges what happens when vital frames are missing."""

    __slots__ = (
        "_brake_ns",
        "_brake_worst_ns",
        "_doors_ns",
        "_inputs_ns",
        "_inputs_worst_ns",
        "_traction_ns",
        "brake",
        "doors",
        "inputs",
        "traction",
    )

    def __init__(
        self,
        context: Context,
        *,
        brake_timeout_s: float,
        traction_timeout_s: float,
        doors_timeout_s: float,
        brake: Gauge,
        traction: Gauge,
        doors: Gauge,
        inputs: Gauge,
    ) -> None:
        self.brake, self.traction, self.doors, self.inputs = brake, traction, doors, inputs
        slack_s, config = context.slack_s, context.train.doors
        self._brake_ns = round((brake_timeout_s + slack_s) * NS_PER_S)
        self._traction_ns = round(
            (traction_timeout_s + slack_s + context.traction_cut_s) * NS_PER_S
        )
        # Each obstacle makes the doors open once more.
        closing_s = config.close_s + config.obstructed_closings * (config.reopen_s + config.close_s)
        self._doors_ns = round((doors_timeout_s + slack_s + closing_s) * NS_PER_S)
        self._inputs_ns = round(
            (context.input_silence_s + 2.0 * context.cycle_s + slack_s) * NS_PER_S
        )
        self._brake_worst_ns = self._inputs_worst_ns = -1

    def released(self, truth: Truth, now_ns: int, spoken: Spoken) -> None:
        """Take a step in which the brake unit does not demand the emergency brake."""
        age_ns = now_ns - spoken.brake_ns
        if age_ns > self._brake_worst_ns:
            self._brake_worst_ns = age_ns
            self.brake.see((self._brake_ns - age_ns) / NS_PER_S, now_ns)
        if truth.drive_n > PULL_N:
            margin_s = (self._traction_ns - (now_ns - spoken.traction_ns)) / NS_PER_S
            if margin_s < self.traction.least:
                self.traction.see(margin_s, now_ns)
        if truth.speed_mps > COASTING_MPS:
            oldest_ns = min(
                spoken.tacho_ns, spoken.brake_status_ns, spoken.traction_status_ns, spoken.desk_ns
            )
            age_ns = now_ns - oldest_ns
            if age_ns > self._inputs_worst_ns:
                self._inputs_worst_ns = age_ns
                self.inputs.see((self._inputs_ns - age_ns) / NS_PER_S, now_ns)

    def open(self, now_ns: int, spoken: Spoken) -> None:
        """Take a step in which a door is not locked."""
        margin_s = (self._doors_ns - (now_ns - spoken.doors_ns)) / NS_PER_S
        if margin_s < self.doors.least:
            self.doors.see(margin_s, now_ns)


class DepartureWatch:
    """Judges that a train departs with its doors and those of the platform locked.

    The state when it began to move counts; a lock that is lost later violates other invariants.
    """

    __slots__ = ("_locked", "_place", "_platform_locked", "_standing", "locked", "platform")

    def __init__(self, place: LinePlaces, *, locked: Gauge, platform: Gauge) -> None:
        self._place = place
        self.locked, self.platform = locked, platform
        self._standing = True
        self._locked: bool | None = None
        """State when the train began to move; None at standstill and after the departure."""
        self._platform_locked: bool | None = None
        """None if the platform has no doors."""

    def sample(self, truth: Truth, now_ns: int, spoken: Spoken) -> None:
        """Take a step in which the train moves, or the first one at rest."""
        speed_mps = truth.speed_mps
        if speed_mps == 0.0:
            self._standing = True
            return
        if self._standing:
            self._standing = False
            bypassed = spoken.door_bypassed > 0.0
            self._locked = truth.doors_locked > 0.0 or bypassed
            self._platform_locked = None
            if self._place.platform_doors(truth.front_m):
                self._platform_locked = truth.platform_doors_locked > 0.0 or bypassed
        if self._locked is not None and speed_mps > LEFT_MPS:
            self.locked.said(self._locked, now_ns)
            if self._platform_locked is not None:
                self.platform.said(self._platform_locked, now_ns)
            self._locked = None
