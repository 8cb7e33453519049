"""One step of odometry: pulses, radar and tags of a cycle to the motion of the train."""

import math
from typing import Final

from can_dbc.odometer import Tacho
from firmware_py.trackdb import LineMap
from vobc.odometry.config import OdometryConfig
from vobc.odometry.localisation import Localisation
from vobc.odometry.pulses import PulseCounter
from vobc.odometry.tracking import HALF_PULSE, SpeedTrack
from vobc.vocabulary import (
    CycleInput,
    Interval,
    Motion,
    OdometryRecord,
    TagReading,
    TrainBelief,
)

S_PER_NS: Final = 1e-9
SPACING_S: Final = 0.008
"""Samples closer than this were held up somewhere and came in a bunch; only the last of a bunch was
taken near the instant at which it was heard, and it counts the pulses of all."""


class Odometry:
    """Holds what odometry remembers from cycle to cycle."""

    def __init__(
        self, config: OdometryConfig, train: TrainBelief, line: LineMap, start: OdometryRecord
    ) -> None:
        self._config = config
        self._where = Localisation(config, train, line, start)
        self._pulses = PulseCounter(config.max_speed_mps / self._where.m_per_pulse_low)
        self._track = SpeedTrack(bandwidth_rad_s=config.tracking_rad_s, window_s=config.window_s)
        self._travel_m = 0.0
        self._slip_until_s = 0.0
        self._slip = False
        self._sampled_s = -math.inf
        self._fast_s = 0.0
        """Last instant at which zero speed was not certain."""
        self._usable = False
        self._slow = False

    @property
    def usable(self) -> bool:
        """The last tacho sample made sense."""
        return self._usable

    @property
    def rejected_tags(self) -> int:
        return self._where.rejected

    def record(self) -> OdometryRecord:
        """What to keep over a power cycle; sensible only at standstill."""
        where = self._where
        half_m = max(where.high_m - where.at_m, where.at_m - where.low_m)
        return OdometryRecord(where.at_m, half_m, where.m_per_pulse)

    def step(self, seen: CycleInput) -> Motion | None:
        """The motion at `seen.now_ns`; None before the first tacho sample."""
        now_s = seen.now_ns * S_PER_NS
        radar_mps = self._radar_mps(seen)
        self._watch_slip(now_s, radar_mps)
        samples = seen.tacho_samples
        last = len(samples) - 1
        for index, sample in enumerate(samples):
            if index == last or sample.age_s - samples[index + 1].age_s >= SPACING_S:
                self._take(sample.frame, now_s - sample.age_s, radar_mps)
        if not self._track.begun:
            return None
        accepted: tuple[int, ...] = ()
        if seen.tags:
            accepted = tuple([tag.tag_id for tag in seen.tags if self._offer(tag)])
        speed = self._speed(now_s, radar_mps)
        self._where.watch_missed(speed.best, accepted)
        standstill = self._standstill(now_s, seen.tacho_age_s)
        return self._motion(now_s, speed, accepted, standstill=standstill)

    def _take(self, tacho: Tacho, stamp_s: float, radar_mps: float | None) -> None:
        """One tacho sample: count, track, move."""
        track, where = self._track, self._where
        dt_s = stamp_s - self._sampled_s
        if dt_s <= 0.0:
            return
        self._sampled_s = stamp_s
        was_on_b = self._pulses.on_b
        step = self._pulses.step(tacho, dt_s)
        self._usable = step is not None
        if step is None:
            if track.begun:
                where.widen(self._config.max_speed_mps * dt_s)
            return
        if not track.begun:
            self._fast_s = stamp_s
        if self._pulses.on_b != was_on_b:
            where.forget_scale()
        track.add(stamp_s, self._pulses.count)
        if self._slip and radar_mps is not None:
            error_mps = self._radar_error_mps(radar_mps)
            where.advance_slipping(
                step,
                least_m=(radar_mps - error_mps) * dt_s,
                likely_m=radar_mps * dt_s,
                most_m=(radar_mps + error_mps) * dt_s,
            )
            self._travel_m += radar_mps * dt_s
        elif step:
            where.advance(step)
            self._travel_m += step * where.m_per_pulse

    def _radar_mps(self, seen: CycleInput) -> float | None:
        """What the Doppler radar says, if it is to be believed."""
        radar = seen.doppler
        if (
            radar is None
            or not radar.healthy
            or radar.quality_percent < self._config.doppler_quality_percent
            or seen.doppler_age_s > self._config.doppler_age_s
        ):
            return None
        return radar.speed_mps

    def _radar_error_mps(self, radar_mps: float) -> float:
        return self._config.doppler_error_mps + self._config.doppler_error_ratio * abs(radar_mps)

    def _watch_slip(self, now_s: float, radar_mps: float | None) -> None:
        """Wheels and radar contradict each other by more than both may be wrong, or did so lately.

        The wheels are as the cycle before left them, as old as what the radar says.
        """
        if now_s >= self._slip_until_s:
            self._slip = False
        if radar_mps is None or not self._track.begun:
            return
        rate = self._track.rate_pulses_per_s
        ends_mps = (rate * self._where.m_per_pulse_low, rate * self._where.m_per_pulse_high)
        apart_mps = max(min(ends_mps) - radar_mps, radar_mps - max(ends_mps))
        may_mps = self._config.slip_threshold_mps + self._radar_error_mps(radar_mps)
        if apart_mps > may_mps:
            if not self._slip:
                self._where.widen(self._config.slip_onset_m)
            self._slip = True
            self._slip_until_s = now_s + self._config.slip_hold_s

    def _offer(self, tag: TagReading) -> bool:
        """Where the wheels counted falsely the way since the tag is only known roughly."""
        where, rate = self._where, self._track.rate_pulses_per_s
        speed_mps = rate * where.m_per_pulse
        since = self._pulses.since_latched(tag.pulses)
        if since is not None and not self._slip:
            return where.offer_tag(tag.tag_id, since, speed_mps=speed_mps)
        rough_m = abs(speed_mps) * tag.age_s + self._config.tag_bound_m
        return where.offer_tag(tag.tag_id, rate * tag.age_s, speed_mps=speed_mps, rough_m=rough_m)

    def _speed(self, now_s: float, radar_mps: float | None) -> Interval:
        config, where, track = self._config, self._where, self._track
        low_rate, high_rate, window_s = track.mean_rate(config.stamp_jitter_s)
        # The mean held in the middle of the window; since then the speed may have changed so much.
        change_mps = config.max_accel_mps2 * (0.5 * window_s + config.stamp_jitter_s)
        high_m = where.m_per_pulse_high if high_rate > 0.0 else where.m_per_pulse_low
        low_m = where.m_per_pulse_low if low_rate > 0.0 else where.m_per_pulse_high
        low = low_rate * low_m - change_mps
        high = high_rate * high_m + change_mps
        self._slow = -config.zero_speed_mps < low and high < config.zero_speed_mps
        aged_mps = config.max_accel_mps2 * max(0.0, now_s - track.stamp_s)
        # A single sample, or several at one instant, says nothing but that the train is a train.
        low = max(low - aged_mps, -config.max_speed_mps)
        high = min(high + aged_mps, config.max_speed_mps)
        if track.still_s >= config.standing_s:
            track.settle()
            best = 0.0
        else:
            best = track.limited_rate_pulses_per_s(now_s) * where.m_per_pulse
        if self._slip and radar_mps is not None:
            error_mps = self._radar_error_mps(radar_mps)
            low, high = min(low, radar_mps - error_mps), max(high, radar_mps + error_mps)
            best = radar_mps
        return Interval(min(low, best), best, max(high, best))

    def _standstill(self, now_s: float, tacho_age_s: float) -> bool:
        """Zero speed is proven once both ends stayed under the limit for long enough.

        What counts is the speed at the samples, as long as these come: the bounds of now breathe
        with the age of the last one.
        """
        silent = tacho_age_s > self._config.silence_s
        if not self._slow or self._slip or silent or not self._usable:
            self._fast_s = now_s
        return now_s - self._fast_s >= self._config.zero_speed_s

    def _motion(
        self, now_s: float, speed: Interval, accepted: tuple[int, ...], *, standstill: bool
    ) -> Motion:
        """The position at this instant: the last sample carried on by the speed since."""
        config, where, track = self._config, self._where, self._track
        age_s = max(0.0, now_s - track.stamp_s) + config.stamp_jitter_s
        low_m = where.low_m + min(0.0, speed.low) * age_s
        high_m = where.high_m + max(0.0, speed.high) * age_s
        standing = track.still_s >= config.standing_s and not self._slip
        best_m = where.at_m
        if not self._slip:
            ahead = track.at_pulses - (self._pulses.count + HALF_PULSE)
            best_m += ahead * where.m_per_pulse + speed.best * (now_s - track.stamp_s)
        width_m = high_m - low_m
        return Motion(
            front_m=Interval(low_m, min(max(best_m, low_m), high_m), high_m),
            speed_mps=speed,
            accel_mps2=0.0 if standing else track.accel_pulses_per_s2 * where.m_per_pulse,
            travel_m=self._travel_m,
            standing=standing,
            standstill=standstill,
            localised=(
                width_m <= config.localisation_limit_m and where.missed < config.missed_tags_max
            ),
            slip=self._slip,
            accepted_tag_ids=accepted,
        )
