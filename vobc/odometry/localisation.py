"""Where the front of the train is: an interval that holds the truth, and the best guess in it."""

from collections.abc import Sequence

from firmware_py.trackdb import LineMap, TagSite
from vobc.odometry.config import OdometryConfig
from vobc.vocabulary import OdometryRecord, TrainBelief


class Localisation:
    """Dead reckoning from tag to tag.

    The interval moves by the pulses times the least and the largest distance a pulse may stand for
    and shrinks only at accepted tags. The best estimate is a Kalman filter over (position, metres
    per pulse): every tag corrects both, weighed by what came before.
    """

    __slots__ = (
        "_anchor",
        "_antenna_m",
        "_config",
        "_declared_m",
        "_next_tag",
        "_pulse_m",
        "_sites",
        "_tags",
        "_var_pp",
        "_var_ps",
        "_var_ss",
        "at_m",
        "high_m",
        "low_m",
        "m_per_pulse",
        "m_per_pulse_high",
        "m_per_pulse_low",
        "missed",
        "pulses",
        "rejected",
    )

    def __init__(
        self, config: OdometryConfig, train: TrainBelief, line: LineMap, start: OdometryRecord
    ) -> None:
        self._config = config
        self._antenna_m = train.antenna_offset_m
        self._sites = {tag.tag_id: tag for tag in line.tags}
        self._tags: Sequence[TagSite] = line.tags
        nominal_m = train.nominal_m_per_pulse
        self._declared_m = (
            nominal_m / (1.0 + config.scale_error_high_ratio),
            nominal_m / (1.0 + config.scale_error_low_ratio),
        )
        self.m_per_pulse_low, self.m_per_pulse_high = self._declared_m
        self.m_per_pulse = min(max(start.m_per_pulse, self.m_per_pulse_low), self.m_per_pulse_high)
        self._pulse_m = self.m_per_pulse_high
        self.at_m = start.front_m
        """Best estimate of the front at the last sample."""
        # From any instant on, pulses tell the way within one pulse, so once is enough to add it.
        self.low_m = start.front_m - start.bound_m - self._pulse_m
        self.high_m = start.front_m + start.bound_m + self._pulse_m
        self._var_pp = (start.bound_m / 2.0) ** 2
        self._var_ps = 0.0
        self._var_ss = (nominal_m * config.scale_sigma_ratio) ** 2
        self.pulses = 0
        """Pulses since start, the base of all distances between tags."""
        self._anchor: tuple[float, int, float] | None = (
            start.front_m - self._antenna_m,
            0,
            start.bound_m + self._pulse_m,
        )
        """Where the antenna was, pulses then and bound, from where the scale is being measured."""
        self.rejected = 0
        self.missed = 0
        """Tags in a row that should have been read."""
        reach_m = self.high_m - self._antenna_m + config.tag_bound_m
        self._next_tag = sum(1 for tag in self._tags if tag.position_m <= reach_m)

    def advance(self, pulses: int) -> None:
        """The wheels turned."""
        if pulses == 0:
            return
        self.pulses += pulses
        if pulses > 0:
            self.low_m += pulses * self.m_per_pulse_low
            self.high_m += pulses * self.m_per_pulse_high
        else:
            self.low_m += pulses * self.m_per_pulse_high
            self.high_m += pulses * self.m_per_pulse_low
        self._predict(pulses, pulses * self.m_per_pulse)

    def advance_slipping(
        self, pulses: int, *, least_m: float, likely_m: float, most_m: float
    ) -> None:
        """The wheels turned, but not as the train moved: believe neither alone."""
        self.pulses += pulses
        by_wheels = (pulses * self.m_per_pulse_low, pulses * self.m_per_pulse_high)
        self.low_m += min(least_m, *by_wheels)
        self.high_m += max(most_m, *by_wheels)
        self._predict(0, likely_m)
        self._var_pp += (most_m - least_m) ** 2
        self._anchor = None

    def widen(self, by_m: float) -> None:
        self.low_m -= by_m
        self.high_m += by_m
        self._var_pp += by_m * by_m
        self._anchor = None

    def _predict(self, pulses: int, moved_m: float) -> None:
        creep_m2 = self._config.creep_sigma_m_per_sqrt_m**2 * abs(moved_m)
        self.at_m += moved_m
        self._var_pp += pulses * (2.0 * self._var_ps + pulses * self._var_ss) + creep_m2
        self._var_ps += pulses * self._var_ss

    def forget_scale(self) -> None:
        """Another wheel counts from now on; what was measured of the first says nothing of it."""
        self.m_per_pulse_low, self.m_per_pulse_high = self._declared_m
        self._var_ss += (self._pulse_m * self._config.scale_sigma_ratio) ** 2
        self._anchor = None

    def offer_tag(
        self,
        tag_id: int,
        pulses_since: float,
        *,
        speed_mps: float,
        rough_m: float = 0.0,
    ) -> bool:
        """A tag was read `pulses_since` before the last sample; false when it cannot be true.

        Believed only if the place it claims and the interval have a point in common: a tag that
        lies elsewhere, or was read by cross-talk, changes nothing.

        Args:
            rough_m: by how much `pulses_since` may be wrong; nothing is calibrated then.
        """
        site = self._sites.get(tag_id)
        if site is None:
            self.rejected += 1
            return False
        front_m = site.position_m + self._antenna_m
        ends_m = (pulses_since * self.m_per_pulse_low, pulses_since * self.m_per_pulse_high)
        latch_m = self._config.tag_stamp_s * abs(speed_mps) + rough_m
        bound_m = self._config.tag_bound_m + latch_m + self._pulse_m
        low_m = max(self.low_m, front_m + min(ends_m) - bound_m)
        high_m = min(self.high_m, front_m + max(ends_m) + bound_m)
        if low_m > high_m:
            self.rejected += 1
            return False
        self.low_m, self.high_m = low_m, high_m
        self._correct(front_m, pulses_since, latch_m)
        if rough_m == 0.0:
            self._measure_scale(site.position_m, self.pulses - round(pulses_since), bound_m)
        self.missed = 0
        return True

    def _correct(self, front_m: float, pulses_since: float, latch_m: float) -> None:
        """Kalman update with the measurement front_m = position - m_per_pulse * pulses_since."""
        noise = self._config.tag_sigma_m**2 + self._pulse_m**2 / 12.0 + latch_m**2 / 3.0
        gain_p = self._var_pp - pulses_since * self._var_ps
        gain_s = self._var_ps - pulses_since * self._var_ss
        spread = gain_p - pulses_since * gain_s + noise
        miss_m = front_m - (self.at_m - self.m_per_pulse * pulses_since)
        self.at_m += gain_p / spread * miss_m
        self.m_per_pulse += gain_s / spread * miss_m
        self._var_pp -= gain_p * gain_p / spread
        self._var_ps -= gain_p * gain_s / spread
        self._var_ss -= gain_s * gain_s / spread
        self.at_m = min(max(self.at_m, self.low_m), self.high_m)
        self.m_per_pulse = min(max(self.m_per_pulse, self.m_per_pulse_low), self.m_per_pulse_high)

    def _measure_scale(self, position_m: float, pulses: int, bound_m: float) -> None:
        """Two known places and the pulses between them bound the distance behind one pulse."""
        if self._anchor is None:
            self._anchor = (position_m, pulses, bound_m)
            return
        base_m, counted = position_m - self._anchor[0], pulses - self._anchor[1]
        if base_m < self._config.scale_base_m or counted <= 1:
            return
        slack_m = bound_m + self._anchor[2]
        margin_ratio = self._config.scale_margin_ratio
        low = (base_m - slack_m) / (counted + 1) * (1.0 - margin_ratio)
        high = (base_m + slack_m) / (counted - 1) * (1.0 + margin_ratio)
        low, high = max(low, self.m_per_pulse_low), min(high, self.m_per_pulse_high)
        if low <= high:
            self.m_per_pulse_low, self.m_per_pulse_high = low, high
            self.m_per_pulse = min(max(self.m_per_pulse, low), high)
        self._anchor = (position_m, pulses, bound_m)

    def watch_missed(self, speed_mps: float, read_ids: Sequence[int]) -> None:
        """Count the tags that the antenna has certainly passed without a telegram."""
        for tag_id in read_ids:
            passed = self._sites[tag_id].position_m
            while self._next_tag < len(self._tags) and self._tags[self._next_tag].position_m <= (
                passed
            ):
                self._next_tag += 1
        late_m = max(0.0, speed_mps) * self._config.tag_silence_s + self._config.tag_bound_m
        certain_m = self.low_m - self._antenna_m - late_m
        while (
            self._next_tag < len(self._tags) and self._tags[self._next_tag].position_m < certain_m
        ):
            self._next_tag += 1
            self.missed += 1
