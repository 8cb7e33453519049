"""Invariants of emergency brake, traction and silent wires (5, 6, 7, 33, 34)."""

from can_dbc.vobc import Cause, Supervision
from metro_hil.monitors.context import Context
from metro_hil.monitors.description import NEVER_NS, Spoken
from metro_hil.monitors.gauge import Gauge
from metro_hil.monitors.place import LinePlaces
from plant_emulator.truth import Truth

NS_PER_S = 1_000_000_000
PULL_N = 1.0
"""Less than this is no tractive effort."""
LEFT_MPS = 0.1
"""A train that is faster has departed; couplers that ease do not make it so."""
COASTING_MPS = 0.5
"""A train that is slower may be taken to stand by who watches its wheels."""
EMERGENCY = float(Supervision.EMERGENCY)
RESTART_NS = NS_PER_S // 4
"""So long no controller is silent between two VOBC_STATUS without missing a cycle."""
OVERSHOT = float(Cause.OVERSHOT)
"""The only emergency that may release itself, at standstill: a jog is to mend it."""


class EmergencyWatch:
    """What an emergency brake must and what must not end it."""

    __slots__ = (
        "_applied_moving",
        "_cause",
        "_commanded",
        "_cut_ns",
        "_latched",
        "_let_go_ns",
        "_pulled",
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
        self._pulled = False
        """Traction acted when the emergency brake was asked for, and has not been seen off."""
        self._commanded = False
        """By the frames: what was commanded before the first of them is not known."""
        self._start_ns = context.start_ns
        self._applied_moving = False
        self._latched = False
        self._reset_ns = -1
        self._reset_was_pressed = True
        self._releases = 0.0
        self._cause = 0.0
        """Of the latched emergency, as last said."""
        # The report and the answer may both be held up on the bus.
        self._takeover_ns = round((context.takeover_s + context.input_age_s) * NS_PER_S)
        self._let_go_ns = -1
        """The brake unit stopped wanting it then, and the train has moved since."""
        self._releasable_ns = round(context.brake_unit_s * NS_PER_S)
        self._released_ns = NEVER_NS
        """The controller let go of it last."""
        self._status_ns = context.start_ns
        self._slips = 0.0
        """As the last VOBC_STATUS had it."""

    def sample(self, truth: Truth, now_ns: int, spoken: Spoken) -> None:
        """To be told of every step while the brake unit wants the emergency brake."""
        self._let_go_ns = -1
        if self._since_ns < 0:
            self._since_ns = now_ns
            self._pulled = truth.drive_n > PULL_N
        since_ns = now_ns - self._since_ns
        pulls = truth.drive_n > PULL_N
        if self._pulled or pulls:
            # Also in the first step without: traction ended somewhere within it.
            self._pulled = pulls
            self.traction_off.see((self._cut_ns - since_ns) / NS_PER_S, now_ns)
        if (
            since_ns > self._cut_ns
            and spoken.force_commanded_n > PULL_N
            and spoken.traction_permitted > 0.0
        ):
            self.ignored.said(not pulls, now_ns)
        if self._applied_moving and truth.speed_mps == 0.0 and spoken.emergency_commanded > 0.0:
            # Held down to standstill; that it stays until its reset is seen at its release.
            self._applied_moving = False
            self.held.said(True, now_ns)

    def ended(self, truth: Truth, now_ns: int) -> None:
        """The brake unit does not want it any more.

        One that it applied before it reported the last one off, nobody can tell from that.
        """
        self._since_ns = -1
        told = now_ns - self._released_ns > self._releasable_ns
        if told and abs(truth.speed_mps) > LEFT_MPS:
            self._let_go_ns = now_ns

    def without(self, truth: Truth, now_ns: int) -> None:
        """To be told of every step without it in which the train moves."""
        if self._let_go_ns < 0:
            return
        if truth.speed_mps == 0.0:
            self._let_go_ns = -1
        elif now_ns - self._let_go_ns > self._takeover_ns:
            self._let_go_ns = -1
            self.held.said(False, now_ns)

    def news(self, truth: Truth, now_ns: int, spoken: Spoken) -> None:
        """To be told whenever the controller or the desk has said something."""
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
        if self._began_anew(spoken):
            # It knows nothing of what was latched before; that it brakes and knows no place is new.
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

    def _began_anew(self, spoken: Spoken) -> bool:
        """A controller that was silent and counts no missed cycles for it was started again."""
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
    """What happens when vital frames stay away."""

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
        # Each obstacle opens the doors once more.
        closing_s = config.close_s + config.obstructed_closings * (config.reopen_s + config.close_s)
        self._doors_ns = round((doors_timeout_s + slack_s + closing_s) * NS_PER_S)
        self._inputs_ns = round(
            (context.input_silence_s + 2.0 * context.cycle_s + slack_s) * NS_PER_S
        )
        self._brake_worst_ns = self._inputs_worst_ns = -1

    def released(self, truth: Truth, now_ns: int, spoken: Spoken) -> None:
        """To be told of every step in which the brake unit wants no emergency brake."""
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
        """To be told of every step in which a door is not locked."""
        margin_s = (self._doors_ns - (now_ns - spoken.doors_ns)) / NS_PER_S
        if margin_s < self.doors.least:
            self.doors.see(margin_s, now_ns)


class DepartureWatch:
    """A train leaves its standstill with its doors and those of the platform locked.

    What counts is how they were when it began to move; a lock lost later breaks other rules.
    """

    __slots__ = ("_locked", "_place", "_platform_locked", "_standing", "locked", "platform")

    def __init__(self, place: LinePlaces, *, locked: Gauge, platform: Gauge) -> None:
        self._place = place
        self.locked, self.platform = locked, platform
        self._standing = True
        self._locked: bool | None = None
        """As it was when the train began to move; None while it stands and once it has left."""
        self._platform_locked: bool | None = None
        """None: there are none."""

    def sample(self, truth: Truth, now_ns: int, spoken: Spoken) -> None:
        """To be told of every step in which the train moves, and of the first at rest."""
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
