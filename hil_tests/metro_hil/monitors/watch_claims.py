"""Invariants of the controller's reports and demands (3, 9, 13, 14, 16, 36, 39)."""

from collections import deque

from can_dbc.binding import period_s
from can_dbc.vobc import AtoPhase, Missing, Supervision, VobcPosition
from metro_hil.monitors.context import Context
from metro_hil.monitors.description import Spoken
from metro_hil.monitors.gauge import Gauge
from metro_hil.monitors.place import GRAVITY_MPS2
from metro_hil.monitors.watch_modes import JOG
from plant_emulator.truth import Truth

NS_PER_S = 1_000_000_000
SPEED_BIT_MPS = 0.01
REACH_STEP_MPS = 0.05
"""Maximum rounding of the reported bound of the speed."""
CLAIM_PERIOD_S = period_s(VobcPosition)
SETTLING_NS = 2 * NS_PER_S
NARROWED_M = 0.2
"""Decrease of the width that may come from late samples alone."""
CLAIMS = 5
"""Number of earlier claims for comparison. The controller reports missing tacho frames only some
cycles later, and its interval is wider until then."""
TACHO_NS = NS_PER_S // 10
ODOMETER = int(Missing.ODOMETER)
RAMP_CYCLES = 10
UNKNOWN_M = 655.0
"""Largest uncertainty in the frame; it means that the position is unknown."""
TAG_LIFETIME_NS = 2 * NS_PER_S
"""Time that a tag's telegram to the controller and the claim to the bus may take."""
REFUSED_NS = NS_PER_S * 3 // 10
"""Time from the event to the next claim of position and state."""
MISSED_MAX = 2.0
MOVING_MPS = 0.5
SLIPS_MAX = 2.0
SLIPS_PERIOD = 64.0
DRIVEN = (float(AtoPhase.RUNNING), float(AtoPhase.APPROACHING), float(AtoPhase.STOPPING))
FREE = (float(Supervision.NOMINAL), float(Supervision.WARNING))


class ClaimWatch:
    """Judges the frames in which the controller reports its state."""

    __slots__ = (
        "_believed_ns",
        "_claimed",
        "_claimed_slips",
        "_compared_ns",
        "_curve_ns",
        "_cycle_s",
        "_heard_claim_ns",
        "_input_age_s",
        "_least_gap_ns",
        "_limit_m",
        "_mode_ns",
        "_most_gap_ns",
        "_motion_ns",
        "_over_ns",
        "_pair_ns",
        "_position_ns",
        "_refused_m",
        "_refused_ns",
        "_slack_s",
        "_slips",
        "_status_ns",
        "_tag_ns",
        "_tags",
        "_told_lost_ns",
        "_two_claims_m",
        "_widths_m",
        "curve",
        "interval",
        "missed",
        "narrowed",
        "overrun",
        "refused",
        "width",
    )

    def __init__(
        self,
        context: Context,
        *,
        curve: Gauge,
        interval: Gauge,
        narrowed: Gauge,
        width: Gauge,
        overrun: Gauge,
        refused: Gauge,
        missed: Gauge,
    ) -> None:
        self.refused, self.missed = refused, missed
        self._refused_ns = self._told_lost_ns = -1
        self._refused_m = 0.0
        self._two_claims_m = (0.0, 0.0)
        self._heard_claim_ns = -1
        self.curve, self.interval, self.narrowed = curve, interval, narrowed
        self.width, self.overrun = width, overrun
        self._cycle_s, self._slack_s = context.cycle_s, context.slack_s
        self._claimed_slips = 0.0
        self._input_age_s = context.input_age_s
        self._believed_ns = context.start_ns + round(context.settling_s * NS_PER_S)
        self._claimed = False
        rhythm_s = max(CLAIM_PERIOD_S, context.cycle_s)
        self._least_gap_ns = round(0.5 * rhythm_s * NS_PER_S)
        self._most_gap_ns = round((1.5 * rhythm_s + SLIPS_MAX * context.cycle_s) * NS_PER_S)
        self._limit_m = context.localisation_limit_m
        self._mode_ns = context.start_ns
        self._pair_ns = round(0.5 * context.cycle_s * NS_PER_S)
        self._curve_ns = round((context.cycle_s + context.slack_s) * NS_PER_S)
        self._position_ns = self._motion_ns = self._status_ns = context.start_ns
        self._over_ns = -1
        """Instant since which the controller has reported to be over its curve without braking; -1
        if it is not."""
        self._widths_m: deque[float] = deque(maxlen=CLAIMS)
        self._compared_ns = context.start_ns
        """Instant of the last of them."""
        self._tags = 0.0
        self._tag_ns = context.start_ns
        self._slips = -1.0
        """Missed cycles as last reported; negative before the first report."""

    def tag_read(self, tags: float, now_ns: int) -> None:
        """Take a step in which `tags` differs from the step before."""
        self._tags, self._tag_ns = tags, now_ns

    @property
    def tags(self) -> float:
        return self._tags

    def news(self, truth: Truth, now_ns: int, spoken: Spoken) -> None:
        if spoken.position_ns != self._position_ns:
            gap_ns, self._position_ns = spoken.position_ns - self._position_ns, spoken.position_ns
            # A frame that is off its period may have waited for the bus. So may those after it,
            # until the bus has sent all waiting frames.
            in_rhythm = self._least_gap_ns <= gap_ns <= self._most_gap_ns
            if not in_rhythm and self._claimed:
                self._believed_ns = max(self._believed_ns, spoken.position_ns + SETTLING_NS)
            self._claimed = True
            if spoken.position_ns >= self._believed_ns and spoken.uncertainty_m < UNKNOWN_M:
                self._check_interval(truth, now_ns, spoken)
                self._check_width(truth, now_ns, spoken)
        self._check_tags(now_ns, spoken)
        if spoken.motion_ns != self._motion_ns:
            self._motion_ns = spoken.motion_ns
            self._note_over(truth, spoken, 0.0)
        if spoken.mode_ns != self._mode_ns:
            self._mode_ns = spoken.mode_ns
            # VOBC_MODE follows VOBC_MOTION at once; one that waited for the bus may belong to
            # another cycle.
            if 0 <= spoken.mode_ns - spoken.motion_ns < self._pair_ns:
                # A bound that may be above the curve by rounding alone demands no brake; where the
                # brake is commanded, it shows that the brake came in time.
                rounded_mps = 0.0 if spoken.emergency_commanded > 0.0 else REACH_STEP_MPS
                self._note_over(truth, spoken, spoken.speed_reach_mps - rounded_mps)
        if self._over_ns >= 0:
            self._check_curve(now_ns, spoken)
        if spoken.status_ns != self._status_ns:
            self._status_ns = spoken.status_ns
            self._check_overrun(truth, now_ns, spoken)

    def _check_tags(self, now_ns: int, spoken: Spoken) -> None:
        """Check that a rejected tag narrows nothing and two missed tags end localisation."""
        if spoken.refused_ns > self._refused_ns and now_ns >= self._believed_ns:
            self._refused_ns, self._refused_m = spoken.refused_ns, max(self._two_claims_m)
        if self._refused_ns >= 0 and now_ns - self._refused_ns < REFUSED_NS:
            if spoken.accepted_ns >= self._refused_ns - REFUSED_NS:
                self._refused_m = -1.0
            if self._refused_m >= 0.0 and spoken.position_ns > self._refused_ns:
                self.refused.said(spoken.uncertainty_m > self._refused_m - NARROWED_M, now_ns)
        if spoken.position_ns != self._heard_claim_ns:
            # The claim of the same cycle may come before or after the event.
            self._heard_claim_ns = spoken.position_ns
            self._two_claims_m = self._two_claims_m[1], spoken.uncertainty_m
        if spoken.missed_tags < MISSED_MAX:
            self._told_lost_ns = -1
        elif self._told_lost_ns < 0:
            self._told_lost_ns = now_ns
        elif now_ns - self._told_lost_ns > REFUSED_NS:
            self.missed.said(spoken.localised == 0.0, now_ns)

    def _check_interval(self, truth: Truth, now_ns: int, spoken: Spoken) -> None:
        """Compare at the instant of the claim: the start of its cycle or of a missed one."""
        missed = min(SLIPS_MAX, (spoken.cycle_slips - self._claimed_slips) % SLIPS_PERIOD)
        self._claimed_slips = spoken.cycle_slips
        oldest_s = (1.0 + missed) * self._cycle_s + self._slack_s
        later_s = (now_ns - spoken.position_ns) / NS_PER_S
        newest_m = truth.front_m - truth.speed_mps * later_s
        oldest_m = newest_m - truth.speed_mps * oldest_s
        low_m, high_m = min(newest_m, oldest_m), max(newest_m, oldest_m)
        claimed_m = spoken.claimed_front_m
        away_m = max(low_m - claimed_m, claimed_m - high_m, 0.0)
        self.interval.see(spoken.uncertainty_m - away_m, now_ns)

    def _check_width(self, truth: Truth, now_ns: int, spoken: Spoken) -> None:
        width_m = spoken.uncertainty_m
        if spoken.localised > 0.0:
            self.width.see(self._limit_m - width_m, now_ns)
        if now_ns - spoken.tacho_ns > TACHO_NS or int(spoken.missing) & ODOMETER:
            # The extra width for missing tacho frames goes when they return.
            return
        widths_m = self._widths_m
        aged_m = abs(truth.speed_mps) * self._input_age_s
        if widths_m and min(widths_m) - width_m > NARROWED_M + aged_m:
            # Claims may have been ignored since the last one, and a tag read meanwhile.
            by_tag = self._tags > 0.0 and self._tag_ns >= self._compared_ns - TAG_LIFETIME_NS
            self.narrowed.said(by_tag, now_ns)
            widths_m.clear()
        widths_m.append(width_m)
        self._compared_ns = now_ns

    def _note_over(self, truth: Truth, spoken: Spoken, reach_mps: float) -> None:
        """Note an excess; the bound of the speed is at least `reach_mps` above its estimate."""
        bound_mps = abs(spoken.claimed_speed_mps) + max(0.0, reach_mps)
        over = bound_mps - spoken.emergency_limit_mps > SPEED_BIT_MPS
        if over and self._over_ns < 0 and abs(truth.speed_mps) > MOVING_MPS:
            self._over_ns = spoken.motion_ns

    def _check_curve(self, now_ns: int, spoken: Spoken) -> None:
        if spoken.emergency_commanded > 0.0:
            late_ns = max(0, min(now_ns, spoken.brake_ns) - self._over_ns)
            self._over_ns = -1
        else:
            late_ns = now_ns - self._over_ns
        self.curve.see((self._curve_ns - late_ns) / NS_PER_S, now_ns)

    def _check_overrun(self, truth: Truth, now_ns: int, spoken: Spoken) -> None:
        before, self._slips = self._slips, spoken.cycle_slips
        missed = (spoken.cycle_slips - before) % SLIPS_PERIOD
        if before >= 0.0 and missed > SLIPS_MAX and abs(truth.speed_mps) > MOVING_MPS:
            self.overrun.said(spoken.emergency_commanded > 0.0 or truth.emergency > 0.0, now_ns)


class DemandWatch:
    """Judges what the controller demands of traction and brake, as one acceleration."""

    __slots__ = (
        "_accel_mps2",
        "_cycle_ns",
        "_gravity_mps2",
        "_inertia_kg",
        "_judged",
        "_lateness_ns",
        "_limit_mps2",
        "_limit_mps3",
        "_ramp",
        "_reverse_ns",
        "_reverse_since_ns",
        "_traction_ns",
        "accel",
        "direction",
        "jerk",
    )

    def __init__(self, context: Context, *, direction: Gauge, accel: Gauge, jerk: Gauge) -> None:
        self.direction, self.accel, self.jerk = direction, accel, jerk
        train = context.train
        rotating_ratio = train.rotating_mass_percent / 100.0
        self._inertia_kg = train.mass_kg * (1.0 + rotating_ratio)
        self._gravity_mps2 = GRAVITY_MPS2 / (1.0 + rotating_ratio)
        self._limit_mps2 = context.service_accel_mps2
        self._limit_mps3 = context.service_jerk_mps3
        self._cycle_ns = round(context.cycle_s * NS_PER_S)
        self._lateness_ns = round(context.lateness_s * NS_PER_S)
        self._ramp: deque[tuple[int, float]] = deque(maxlen=RAMP_CYCLES)
        self._traction_ns = context.start_ns
        self._reverse_ns = round(context.reverse_s * NS_PER_S)
        self._reverse_since_ns = -1
        """Instant since which effort backwards is demanded without a report of a jog; -1 if it is
        not."""
        self._accel_mps2 = 0.0
        self._judged = False

    def news(self, truth: Truth, now_ns: int, spoken: Spoken) -> None:
        before_ns = self._traction_ns
        if spoken.traction_ns == before_ns:
            return
        self._traction_ns = spoken.traction_ns
        pulls = spoken.force_commanded_n > 0.0 and spoken.traction_permitted > 0.0
        if not pulls or spoken.direction > 0.0 or spoken.mode == JOG:
            self._reverse_since_ns = -1
            if pulls:
                self.direction.said(True, now_ns)
        elif self._reverse_since_ns < 0:
            self._reverse_since_ns = now_ns
        if self._reverse_since_ns >= 0:
            in_doubt = (
                spoken.direction < 0.0 and now_ns - self._reverse_since_ns <= self._reverse_ns
            )
            if not in_doubt:
                self.direction.said(False, now_ns)
        accel_mps2 = (
            spoken.force_commanded_n * spoken.direction / self._inertia_kg
            - spoken.service_decel_mps2
        )
        judged = (
            spoken.ato_phase in DRIVEN
            and spoken.supervision in FREE
            and spoken.traction_permitted > 0.0
            and spoken.emergency_commanded == spoken.holding_commanded == 0.0
        )
        if judged:
            # On falling track and with a weak brake the demand may exceed what the train gives.
            falling_mps2 = -min(0.0, truth.gradient_permille) / 1000.0 * self._gravity_mps2
            braked_mps2 = min(-accel_mps2 - falling_mps2, -truth.accel_mps2)
            margin_mps2 = self._limit_mps2 - max(accel_mps2, braked_mps2)
            if margin_mps2 < self.accel.least:
                self.accel.see(margin_mps2, now_ns)
            if self._judged:
                # Frames wait for the bus; the decisions are a whole number of cycles apart.
                gap_ns = spoken.traction_ns - before_ns
                step_ns = max(1, round(gap_ns / self._cycle_ns)) * self._cycle_ns
                if self._lateness_ns:
                    step_ns = max(step_ns, gap_ns)
                self._check_jerk(accel_mps2 - self._accel_mps2, step_ns, now_ns)
        self._accel_mps2, self._judged = accel_mps2, judged
        if self._lateness_ns:
            self._follow_ramp(accel_mps2, spoken.traction_ns, now_ns)

    def _check_jerk(self, change_mps2: float, step_ns: int, now_ns: int) -> None:
        step_s = (step_ns + self._lateness_ns) / NS_PER_S
        margin_mps3 = self._limit_mps3 - abs(change_mps2) / step_s
        if margin_mps3 < self.jerk.least:
            self.jerk.see(margin_mps3, now_ns)

    def _follow_ramp(self, accel_mps2: float, said_ns: int, now_ns: int) -> None:
        """Compare over several cycles, where the allowance for late cycles weighs less."""
        if not self._judged:
            self._ramp.clear()
            return
        if self._ramp:
            first_ns, first_mps2 = self._ramp[0]
            self._check_jerk(accel_mps2 - first_mps2, said_ns - first_ns, now_ns)
        self._ramp.append((said_ns, accel_mps2))
