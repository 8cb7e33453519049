"""One step of odometry: pulses, radar, accelerometer and tags of a cycle give the train's motion.

Theory
------
Odometry answers two questions with different means. *Where can the train be?* takes intervals
that hold for every error within the declared bounds; ATP uses only their ends. *Where is it most
likely?* takes a Kalman filter; ATO uses it, and it never moves an interval.

States:

- interval W of the front by the wheels, interval G over ground (`localisation`);
- interval of the distance per pulse (`scale`), best estimate and covariance of position and
  distance per pulse (`localisation`);
- window of the newest tacho samples (`tracking`), speed interval over ground (`ground`);
- flags: `slip` (wheels contradict each other or the ground), `wheels_out` (a jump of the wheel
  speed proves that the wheels slip), `lost_cause` of the references (the place is not known).

Equations, with a_max as greatest acceleration of any train and e as declared ratio of error:

    distance per pulse    s = pi * d / p / (1 + e),   e in [e_low, e_high]
    n pulses              W += [n * s_low, n * s_high]
    speed of a wheel      [r_low * s_low - c, r_high * s_high + c],  c = a_max * (T / 2 + j + age)
                          from the mean pulse rate r over a window T with stamp jitter j, and the
                          age of the newest sample
    speed over ground     v += [f - g_high - b, f - g_low + b] * dt
                          from the felt acceleration f, gravity along the gradients that the front
                          may be on, and the error b of the accelerometer; cut with the radar's
                          [u - e_u, u + e_u] where both agree
    distance over ground  G += (v_before + v) / 2 * dt, each end for itself
    tag at chainage c     W, G := c + antenna offset + distance since, +- bound of the tag, each if
                          that is narrower

Invariants:

1. W holds the true front while tacho A rolls without slip. G holds it while radar and
   accelerometer keep their declared errors. The reported interval is the hull of both, so it holds
   the true front if any one sensor is wrong (INV-13).
2. An interval becomes narrower only by an accepted tag (INV-14). A tag outside its window is
   refused and narrows nothing (INV-15). A tag is accepted only if wheels and ground both expect it.
   One that they contradict widens both intervals to its place.
3. The reported speed interval is the hull of wheels and ground while both may be right. Wheels that
   are proven to slip do not count.
4. Zero speed is proven only after its upper bound stayed below the limit for `zero_speed_s`
   without slip and with fresh samples (INV-17).
5. A sample is as old as its sensor's stamp says. A late frame is an old sample, never a slow train.

References: [IEEE 1474.1] for position uncertainty and zero speed, [Allotta 2013] for the tags
before a stopping point and the error range of the wheels.
"""

import math
from typing import Final

from can_dbc.odometer import Tacho
from firmware_py.trackdb import LineMap
from vobc.odometry.config import OdometryConfig
from vobc.odometry.contacts import Travelled
from vobc.odometry.ground import Gradients, GroundSpeed, believable_mps
from vobc.odometry.localisation import Localisation
from vobc.odometry.pulses import LeadBounds, PulseCounter
from vobc.odometry.references import LocatedTag, References
from vobc.odometry.sampling import OwnTime
from vobc.odometry.scale import Waypoint
from vobc.odometry.tracking import HALF_PULSE, SpeedTrack
from vobc.vocabulary import (
    CycleInput,
    Interval,
    Motion,
    OdometryRecord,
    PlaceProof,
    RefusedTag,
    TagReading,
    TagRefusal,
    TrainBelief,
)

SPACING_S: Final = 0.008
"""Least spacing of usable samples. Closer ones arrived in a burst; only the last has a reliable
age, and it covers them all."""
REST_MPS: Final = 0.02
"""Upper bound of the speed of a wheel with 256 pulses per turn that gave none for half a second."""
UNSURE_MPS: Final = 0.3
"""Uncertainty of the ground speed above which the wheels narrow its bounds again."""
KIN_S: Final = 0.6
"""Greatest time between a jump of the wheel speed and a contradiction to the ground that count as
one slip. A jump this soon after the axles differed does not count."""


class Odometry:
    """State of odometry from cycle to cycle."""

    def __init__(
        self, config: OdometryConfig, train: TrainBelief, line: LineMap, start: OdometryRecord
    ) -> None:
        self._config = config
        self._train = train
        self._where = Localisation(config, train, start)
        where = self._where
        self._refer = References(config, line, start.proof)
        self._antenna_m = train.antenna_offset_m
        self._refer.begin(where.high_m - self._antenna_m + config.tag_bound_m)
        self._gradients = Gradients(line)
        self._ground = GroundSpeed(config)
        self._pulses = PulseCounter(config.max_speed_mps / where.scale.low_m)
        self._jump_pulses_per_s2 = config.max_accel_mps2 / where.scale.low_m
        self._track = SpeedTrack(bandwidth_rad_s=config.tracking_rad_s, window_s=config.window_s)
        self._time = OwnTime()
        self._travel_m = self._pulses_m = 0.0
        self._over_m = self._over_blur_m = 0.0
        """Distance over ground since the start, and half the width of its bounds."""
        self._slip_until_s = 0.0
        self._slip = False
        self._sampled_s = self._jumped_s = -math.inf
        """Last instant at which the wheel speed changed faster than any train can."""
        self._wheels_out = False
        """The wheels are proven to slip or slide. Their interval then follows the ground."""
        self._fast_s = 0.0
        """Last instant at which zero speed was not certain."""
        self._axles_differ = False
        """In this cycle one axle fell behind the other. One tacho may be broken."""
        self._adhesion_lost = False
        """In this cycle the axles moved further apart than couplers stretch, or the wheels
        contradict the ground."""
        self._differed_s = -math.inf
        self._against_s = -math.inf
        """Last instant at which the wheels contradicted the ground, or their direction."""
        self._lead = LeadBounds()
        self._led_s = -math.inf
        """Last instant at which one axle turned further than the other."""
        self._usable = False
        self._slow = False
        self._rejected = 0

    @property
    def usable(self) -> bool:
        """The last tacho sample was plausible."""
        return self._usable

    @property
    def rejected_tags(self) -> int:
        return self._rejected

    def record(self) -> OdometryRecord:
        """Place to store over a power cycle. It is valid only at standstill."""
        where = self._where
        low_m, high_m = min(where.low_m, where.ground_low_m), max(where.high_m, where.ground_high_m)
        half_m = max(high_m - where.at_m, where.at_m - low_m, 0.0)
        known = not self._refer.lost_cause
        proof = PlaceProof.REMEMBERED if known else PlaceProof.UNKNOWN
        return OdometryRecord(where.at_m, half_m, where.m_per_pulse, proof)

    def step(self, inputs: CycleInput) -> Motion | None:
        """Motion at `inputs.now_ns`. None: the samples do not cover `learn_s` yet."""
        if not self._time.begun:
            self._time.expect(inputs.dt_s)
        now_s = self._time.tell(inputs.now_ns)
        samples = inputs.tacho_samples
        last = len(samples) - 1
        self._axles_differ = self._adhesion_lost = False
        for index, sample in enumerate(samples):
            if index == last or sample.age_s - samples[index + 1].age_s >= SPACING_S:
                self._take(sample.frame, now_s - max(0.0, sample.age_s))
        if not self._track.begun:
            return None
        wheels = self._wheel_speed(now_s)
        self._follow_ground(inputs, now_s, wheels)
        self._watch_slip(now_s, wheels)
        if self._refer.waiting and inputs.cold is not None:
            moved_m = self._refer.check_cold(inputs.cold, self._where.pulses)
            if moved_m is not None:
                self._where.widen(moved_m)
        way = Travelled(self._where.pulses, self._over_m, self._over_blur_m)
        least_m = self._where.scale.declared_m[0]
        self._refer.follow(way, least_m, now_s, gap=inputs.tag_gap, slip=self._slip)
        accepted: tuple[int, ...] = ()
        refused: tuple[RefusedTag, ...] = ()
        for tag in inputs.tags:
            is_accepted, refusal = self._offer(tag)
            if is_accepted:
                accepted = (*accepted, tag.tag_id)
            elif refusal is not None:
                refused = (*refused, refusal)
                self._rejected += 1
        speed = self._speed(wheels)
        standstill = self._standstill(now_s, inputs.tacho_age_s)
        motion = self._motion(now_s, speed, accepted, refused, standstill=standstill)
        return motion if self._track.heard_s >= self._config.learn_s else None

    def _take(self, tacho: Tacho, stamp_s: float) -> None:
        """Process one tacho sample: count it, track the speed, move the position."""
        track, where, pulses = self._track, self._where, self._pulses
        dt_s = stamp_s - self._sampled_s
        if dt_s <= 0.0:
            return
        self._sampled_s = stamp_s
        was_on_b, lead = pulses.on_b, pulses.lead
        step = pulses.step(tacho, dt_s)
        self._usable = step is not None and not pulses.contradicted
        if step is None:
            if track.begun:
                where.widen(self._config.max_speed_mps * dt_s)
            return
        if not track.begun:
            self._fast_s = stamp_s
        if pulses.on_b != was_on_b:
            where.forget_scale()
        track.add(stamp_s, pulses.count)
        if pulses.lead != lead:
            self._led_s = stamp_s
        if pulses.axles_differ:
            self._axles_differ = True
            where.scale.forget_anchor()
        self._adhesion_lost = self._adhesion_lost or pulses.adhesion_lost
        if step == 0:
            return
        where.advance(step)
        self._pulses_m += step * where.m_per_pulse
        self._refer.turned(where.pulses)
        if pulses.contradicted:
            # The direction is uncertain, so the same distance the other way is equally possible.
            both_m = 2.0 * step * where.scale.declared_m[1]
            where.stretch(max(0.0, both_m), max(0.0, -both_m))
        if not self._slip:
            where.follow_wheels(step)
            self._travel_m += step * where.m_per_pulse

    def _wheel_speed(self, now_s: float) -> Interval:
        """Present speed of a wheel that rolls without slip."""
        config, where, track = self._config, self._where, self._track
        low_rate, high_rate, window_s = track.mean_rate(config.stamp_jitter_s)
        # The mean is valid for the middle of the window. Since then the speed may have changed this
        # much.
        change_mps = config.max_accel_mps2 * (0.5 * window_s + config.stamp_jitter_s)
        scale = where.scale
        low = low_rate * (scale.low_m if low_rate > 0.0 else scale.high_m) - change_mps
        high = high_rate * (scale.high_m if high_rate > 0.0 else scale.low_m) + change_mps
        self._slow = -config.zero_speed_mps < low and high < config.zero_speed_mps
        aged_mps = config.max_accel_mps2 * max(0.0, now_s - track.stamp_s)
        # A single sample, or several at one instant, bounds the speed only by the train's maximum.
        low = max(low - aged_mps, -config.max_speed_mps)
        high = min(high + aged_mps, config.max_speed_mps)
        if self._pulses.contradicted:
            low, high = min(low, -high), max(high, -low)
        if track.still_s >= config.standing_s:
            track.settle()
            return Interval(low, 0.0, high)
        return Interval(low, track.limited_rate_pulses_per_s(now_s) * where.m_per_pulse, high)

    def _follow_ground(self, inputs: CycleInput, now_s: float, wheels: Interval) -> None:
        """Update speed and distance over ground since the cycle before."""
        config, where, ground = self._config, self._where, self._ground
        dt_s, steady = self._time.dt_s, self._time.steady
        radar_mps = believable_mps(inputs, config)
        if not ground.begun and not self._begin_ground(radar_mps, now_s, wheels):
            return
        self._gradients.look(
            min(where.low_m, where.ground_low_m), max(where.high_m, where.ground_high_m)
        )
        # After a gap between cycles the accelerometer shows only the end of the gap.
        imu = inputs.imu if steady and inputs.imu_age_s <= config.imu_age_s else None
        felt_mps2 = imu.accel_mps2 if imu is not None and imu.healthy else None
        ground.feel(felt_mps2, self._gradients)
        ground.step(dt_s, radar_mps, inputs.doppler_age_s, wheels.low, wheels.high)
        if ground.seen:
            self._lead.begin(self._pulses.lead)
        least_m, most_m = ground.moved_low_m, ground.moved_high_m
        if self._wheels_bear_witness(inputs, wheels):
            least_m, most_m = self._by_gripping_wheels(least_m, most_m, wheels)
        if not steady:
            least_m, most_m = min(0.0, least_m), max(0.0, most_m)
        where.move_over_ground(least_m, most_m, dt_s, steady=steady)
        self._over_m += 0.5 * (least_m + most_m)
        self._over_blur_m += 0.5 * (most_m - least_m)
        if self._slip:
            likely_m = 0.5 * (least_m + most_m)
            where.follow_ground(likely_m, most_m - least_m)
            self._travel_m += likely_m

    def _begin_ground(self, radar_mps: float | None, now_s: float, wheels: Interval) -> bool:
        """Start the ground speed from the wheels. False while it cannot be told from them."""
        config, where, ground, track = self._config, self._where, self._ground, self._track
        learns = track.heard_s < config.learn_s
        waits = learns or (radar_mps is None and track.still_s < config.standing_s)
        if not waits or (track.window_full and not learns):
            ground.begin(wheels.low, wheels.high)
        if waits:
            where.begin_ground(wheels, max(0.0, now_s - track.stamp_s))
        return not waits

    def _wheels_bear_witness(self, inputs: CycleInput, wheels: Interval) -> bool:
        """Whether the wheels tell the speed over ground, which no radar sees now.

        Wheels that may be slipping say nothing about the ground, except if only one of two axles
        does: then the other one tells it.
        """
        gripping = not self._slip and not self._axles_differ
        fresh = inputs.tacho_age_s <= self._config.silence_s and self._usable
        return (
            (gripping or self._one_axle_slips())
            and not self._ground.seen
            and self._wheels_agree(wheels)
            and fresh
            and not self._sets_off(inputs)
        )

    def _one_axle_slips(self) -> bool:
        """Whether slip shows only as a difference between two axles that both count pulses, of a
        train that stands, brakes or hardly accelerates.
        """
        agrees = self._time.now_s - self._against_s >= self._config.slip_hold_s
        accel_mps2 = self._track.accel_pulses_per_s2 * self._where.m_per_pulse
        pulls = accel_mps2 > self._config.gentle_mps2
        return agrees and not pulls and self._pulses.paired and not self._wheels_out

    def _by_gripping_wheels(
        self, least_m: float, most_m: float, wheels: Interval
    ) -> tuple[float, float]:
        """Distance over ground in this cycle, narrowed by wheels that grip.

        If the axles differ, one of them grips. The distance then covers both.
        """
        config, ground, track = self._config, self._ground, self._track
        gentle = abs(track.accel_pulses_per_s2) * self._where.m_per_pulse <= config.gentle_mps2
        slip_ratio = config.gentle_slip_ratio if gentle else config.unseen_slip_ratio
        slack_mps = slip_ratio * abs(wheels.best)
        apart = self._slip or self._axles_differ
        # The count follows one axle. While that one stands, the lead shows whether the other turns.
        still_s = min(track.still_s, track.stamp_s - self._led_s if apart else math.inf)
        if still_s >= config.standing_s:
            least_m = most_m = 0.0
            ground.begin(-REST_MPS, REST_MPS)
        elif abs(wheels.best) <= config.doppler_blind_mps:
            dt_s = self._time.dt_s
            least_m = (wheels.best - slack_mps) * dt_s
            most_m = (wheels.best + slack_mps) * dt_s
        elif apart:
            return least_m, most_m
        if apart:
            back, ahead = self._lead.widen(self._pulses.lead)
            most_m_per_pulse = (1.0 + slip_ratio) * self._where.scale.declared_m[1]
            return least_m - back * most_m_per_pulse, most_m + ahead * most_m_per_pulse
        if ground.high_mps - ground.low_mps > 2.0 * (UNSURE_MPS + slack_mps):
            ground.begin(
                max(ground.low_mps, wheels.low - slack_mps),
                min(ground.high_mps, wheels.high + slack_mps),
            )
        return least_m, most_m

    def _sets_off(self, inputs: CycleInput) -> bool:
        """No wheel turns, but the holding brake is not proven and the accelerometer shows motion.

        Couplers stretch, so the first car moves before the axle of the second one turns. Other
        brakes prove nothing, because a train pulls while they still release.
        """
        if self._track.still_s < self._config.standing_s or self._ground.may_rest:
            return False
        brake, heard = inputs.brake, inputs.brake_age_s <= self._config.silence_s
        return brake is None or not (heard and brake.holding_applied)

    def _wheels_agree(self, wheels: Interval) -> bool:
        ground = self._ground
        return wheels.low <= ground.high_mps and ground.low_mps <= wheels.high

    def _watch_slip(self, now_s: float, wheels: Interval) -> None:
        """Detect slip: the wheels contradict each other or the ground beyond tolerance, now or
        recently.
        """
        config, where, ground = self._config, self._where, self._ground
        if not ground.begun:
            return
        if self._axles_differ:
            self._differed_s = now_s
        jumped = self._track.jumped(self._jump_pulses_per_s2, config.stamp_jitter_s)
        if jumped and now_s - self._differed_s > KIN_S:
            self._jumped_s = now_s
        against = self._pulses.contradicted or not self._wheels_agree(wheels)
        if against:
            self._against_s = now_s
            self._adhesion_lost = True
        if against or self._axles_differ:
            if not self._slip:
                where.at_m += self._ahead_m(now_s, wheels.best)
            self._slip = True
            self._slip_until_s = now_s + config.slip_hold_s
        elif self._slip and now_s >= self._slip_until_s:
            self._slip = False
            where.at_m -= self._ahead_m(now_s, wheels.best)
            over = Interval(ground.low_mps, ground.best_mps, ground.high_mps)
            where.reconcile(wheels, over, max(0.0, now_s - self._track.stamp_s))
        if self._slip and now_s - self._jumped_s <= KIN_S:
            self._wheels_out = True
        if self._wheels_out:
            age_s = max(0.0, now_s - self._track.stamp_s) + config.stamp_jitter_s
            where.trust_ground(ground.low_mps, ground.high_mps, age_s)
            self._wheels_out = self._slip

    def _offer(self, tag: TagReading) -> tuple[bool, RefusedTag | None]:
        """Use a tag for the place. The result says whether it was accepted, or why it was
        refused.
        """
        where, refer, config, track = self._where, self._refer, self._config, self._track
        site = refer.sites.get(tag.tag_id)
        if site is None:
            return False, RefusedTag(tag.tag_id, TagRefusal.UNKNOWN, 0.0)
        age_s = tag.age_s
        grow_mps = config.max_accel_mps2 * age_s
        ground = self._ground
        over_m = ((ground.low_mps - grow_mps) * age_s, (ground.high_mps + grow_mps) * age_s)
        rate = track.rate_pulses_per_s
        speed_mps = max(abs(rate) * where.m_per_pulse, abs(ground.best_mps))
        latch_m = config.tag_stamp_s * speed_mps
        since = self._pulses.since_latched(tag.pulses)
        honest = since is not None and not self._slip
        if since is not None and not self._wheels_out:
            ends_m = (since * where.scale.low_m, since * where.scale.high_m)
            since_m = (min(ends_m), since * where.m_per_pulse, max(ends_m))
        else:
            since_m = (over_m[0], 0.5 * (over_m[0] + over_m[1]), over_m[1])
        counted = round(rate * age_s) if since is None else since
        rough_m = 0.0 if honest else 0.5 * (over_m[1] - over_m[0])
        front_m = site.position_m + self._antenna_m
        read_at = where.pulses - counted
        most_m = where.scale.declared_m[1] if honest else math.inf
        read_s = self._time.now_s - age_s - config.tag_stamp_s
        off_m = refer.off_centre_m(site, read_at, most_m, read_s)
        bound_m = config.tag_bound_m + off_m + latch_m + where.scale.declared_m[1]
        reading = LocatedTag(
            site,
            front_m,
            front_m + since_m[1],
            bound_m + rough_m + 0.5 * (since_m[2] - since_m[0]),
            read_at,
            self._over_m - 0.5 * (over_m[0] + over_m[1]),
            self._over_blur_m,
        )
        refer.read(reading, honest=honest)
        ground_m = where.lately_m(age_s) or over_m
        since_s = max(0.0, self._time.now_s - track.stamp_s)
        windows = where.windows(ground.low_mps, ground.high_mps, since_s)
        restarts = bool(refer.lost_cause)
        if restarts:
            refusal = refer.find_again(reading, *where.scale.declared_m)
            if refer.lost_cause:
                return False, refusal
        else:
            refusal = refer.judge(reading, windows, disputed=self._slip)
            if refusal is not None:
                widens = refer.widens(refusal, reading.bound_m)
                restarts = widens and refer.pairs(reading, *where.scale.declared_m)
                if widens and not restarts:
                    where.embrace(front_m, since_m, ground_m, bound_m)
                if not restarts:
                    return False, refusal
        if restarts:
            where.restart(reading.claim_m, reading.bound_m)
        refer.accept(reading, None if restarts else windows)
        refer.turned(where.pulses)
        where.refer(front_m, since_m, ground_m, bound_m, restarts=restarts)
        where.correct(front_m, since_m[1] / where.m_per_pulse, latch_m + rough_m + off_m)
        if honest and not off_m:
            over = (reading.ground_m, reading.ground_bound_m)
            where.measure(Waypoint(site.position_m, bound_m, reading.pulses, *over))
        return True, None

    def _ahead_m(self, now_s: float, speed_mps: float) -> float:
        """Likely distance from the last sample, in whole pulses, to the front's present place."""
        ahead = self._track.at_pulses - (self._pulses.count + HALF_PULSE)
        return ahead * self._where.m_per_pulse + speed_mps * (now_s - self._track.stamp_s)

    def _speed(self, wheels: Interval) -> Interval:
        """Combine wheels and ground while both may be right. Wheels proven to slip do not count."""
        ground = self._ground
        if not ground.begun:
            return _ordered(wheels.low, wheels.best, wheels.high)
        best = wheels.best
        if self._slip:
            # If a second axle turns almost alike, the wheels of a train that slows show changes
            # sooner than the ground.
            nearest_mps = min(max(best, ground.low_mps), ground.high_mps)
            slows = self._track.accel_pulses_per_s2 <= 0.0
            best = nearest_mps if slows and self._one_axle_slips() else ground.best_mps
        if self._wheels_out:
            return _ordered(ground.low_mps, best, ground.high_mps)
        return _ordered(min(wheels.low, ground.low_mps), best, max(wheels.high, ground.high_mps))

    def _standstill(self, now_s: float, tacho_age_s: float) -> bool:
        """Zero speed is proven once its bounds at the samples were below the limit long enough."""
        silent = tacho_age_s > self._config.silence_s
        if not self._slow or self._slip or silent or not self._usable:
            self._fast_s = now_s
        return now_s - self._fast_s >= self._config.zero_speed_s

    def _motion(
        self,
        now_s: float,
        speed: Interval,
        accepted: tuple[int, ...],
        refused: tuple[RefusedTag, ...],
        *,
        standstill: bool,
    ) -> Motion:
        """Motion at this instant: the last sample extrapolated with the speed since."""
        config, where, track, refer = self._config, self._where, self._track, self._refer
        low_m, high_m = where.by_wheels(speed, max(0.0, now_s - track.stamp_s))
        low_m, high_m = min(low_m, where.ground_low_m), max(high_m, where.ground_high_m)
        standing = track.still_s >= config.standing_s and not self._slip
        best_m = where.at_m
        if not self._slip:
            best_m += self._ahead_m(now_s, speed.best)
        best_m = min(max(best_m, low_m), high_m)
        if self._ground.begun:
            front_m = where.never_narrower(low_m, best_m, high_m)
        else:
            front_m = Interval(low_m, best_m, high_m)
        refer.watch(front_m.low - self._antenna_m, speed.best, front_m.high - front_m.low)
        return Motion(
            front_m=front_m,
            speed_mps=speed,
            accel_mps2=0.0 if standing else track.accel_pulses_per_s2 * where.m_per_pulse,
            travel_m=self._travel_m,
            standing=standing,
            standstill=standstill,
            localised=not refer.lost_cause,
            slip=self._slip,
            adhesion_lost=self._adhesion_lost,
            accepted_tag_ids=accepted,
            refused_tags=refused,
            missed_tags=refer.missed,
            lost_cause=refer.lost_cause,
            wheel_diameter_m=where.m_per_pulse * self._train.pulses_per_turn / math.pi,
            pulses_m=self._pulses_m,
            next_tag_m=refer.next_tag_m + self._antenna_m,
        )


def _ordered(low: float, best: float, high: float) -> Interval:
    return Interval(low, min(max(best, low), high), high)
