"""Sampling time of each sensor frame by this controller's clock, from the sensor's own counter.

A busy bus, a mailbox or a busy host may delay a frame. Treated as fresh, a delayed frame would show
a train that suddenly slows down. A sensor counts its frames and sends them in step with its own
clock. The frame with the shortest delay shows the offset between the two clocks.
"""

from typing import Final

from can_dbc.odometer import Doppler, Imu, Tacho

COUNTER_PERIOD: Final = 256
STAMP_PERIOD_MS: Final = 256
TACHO_PERIOD_MS: Final = 20
OTHER_PERIOD_MS: Final = 50
"""Period of radar and accelerometer frames."""
STAMP_PLAY_MS: Final = 5
"""Difference between stamp and counter beyond which the sensor has restarted."""
DRIFT_RATIO: Final = 2.0e-4
"""Greatest drift between two crystals of 100 ppm each."""
LATE_NS: Final = 100_000_000
"""Delay beyond which a sample is refused."""
FASTER_NS: Final = 1_000_000_000
"""Bound of the delay of the frame that first set the clock offset. A faster frame corrects the
offset by at most this."""
PACED_FRAMES: Final = 5
"""Number of frames that must arrive in step after a silence that the counter cannot measure."""
PACE_NS: Final = 10_000_000
"""A frame that arrives this much faster than it was sent comes out of a queue."""
READER_PLAY_NS: Final = 5_000_000
"""Tolerance for the different length of telegrams and the resolution of their stamps."""
READER_LATE_NS: Final = 1_000_000_000
"""Greatest delay of a telegram of the tag reader. Beyond, the reader's clock was set."""
NS_PER_MS: Final = 1_000_000
S_PER_NS: Final = 1e-9
STEADY_S: Final = 0.1
"""Longest interval between cycles that counts as continuous. A longer one may be a clock that was
set, and the train may have stood meanwhile."""
CYCLES_STEADY: Final = 1.5
"""The same limit for slow controllers, as a multiple of their cycle."""


class OwnTime:
    """Time base of odometry: the controller's clock, but never backwards."""

    __slots__ = ("_ahead_s", "_longest_s", "begun", "dt_s", "now_s", "steady")

    def __init__(self) -> None:
        self.begun = False
        self.now_s = 0.0
        self.dt_s = 0.0
        """Time since the cycle before. 0 in the first cycle."""
        self.steady = True
        """The interval to the cycle before is short enough to exclude an interruption."""
        self._ahead_s = 0.0
        """Lead over the controller's clock: the sum of all backward steps of that clock."""
        self._longest_s = STEADY_S

    def expect(self, cycle_s: float) -> None:
        """Set the length of a cycle. A cycle that is late by half its length is no gap."""
        self._longest_s = max(STEADY_S, CYCLES_STEADY * cycle_s)

    def tell(self, now_ns: int) -> float:
        """Instant of a new cycle in s. If the clock was set back, time advances by the longest
        step.

        The true length of that step is unknown, but a longer one would not have been a cycle.
        """
        now_s = now_ns * S_PER_NS + self._ahead_s
        dt_s = now_s - self.now_s if self.begun else 0.0
        self.steady = 0.0 <= dt_s <= self._longest_s
        if dt_s < 0.0:
            dt_s = self._longest_s
            self._ahead_s += self.now_s + dt_s - now_s
            now_s = self.now_s + dt_s
        self.begun, self.now_s, self.dt_s = True, now_s, dt_s
        return now_s


class FrameClock:
    """Follows the clock of a sensor that sends in step with its counter.

    The counter shows the age of a frame as long as the age is shorter than the counter's period.
    After a longer silence, frames are refused until they arrive at their sending rate and not out
    of a queue.
    """

    __slots__ = (
        "_begun",
        "_counter",
        "_heard_ns",
        "_late_ns",
        "_offset_ns",
        "_period_ns",
        "_sensor_ns",
        "_turn_ns",
        "_unpaced",
        "refused",
    )

    def __init__(self, period_ms: int, late_ns: int = LATE_NS) -> None:
        self._period_ns = period_ms * NS_PER_MS
        self._turn_ns = self._period_ns * COUNTER_PERIOD
        self._late_ns = late_ns
        self._begun = False
        self._counter = 0
        self._heard_ns = 0
        self._sensor_ns = 0
        self._offset_ns = 0
        self._unpaced = 0
        self.refused = 0
        """Number of frames that were too old on arrival."""

    def sampled_ns(self, received_at_ns: int, counter: int) -> int | None:
        """Sampling instant of a frame received now. None: the frame is too old.

        The instant is never in the future.
        """
        if self._restarted(received_at_ns):
            self._begin(received_at_ns, counter)
            return received_at_ns
        steps = (counter - self._counter) % COUNTER_PERIOD
        return self._follow(received_at_ns, counter, steps * self._period_ns)

    def _restarted(self, received_at_ns: int) -> bool:
        """There is no frame yet, or the controller's clock was set back, so the offset is void."""
        return not self._begun or received_at_ns < self._heard_ns

    def _begin(self, received_at_ns: int, counter: int) -> None:
        """Start the sensor's time here."""
        self._begun = True
        self._counter = counter
        self._heard_ns = received_at_ns
        self._sensor_ns = 0
        self._offset_ns = received_at_ns

    def _follow(self, received_at_ns: int, counter: int, ahead_ns: int) -> int | None:
        """Take the latest sampling instant that fits and is not in the future.

        Args:
            ahead_ns: progress of the sensor's time, modulo its counter period.
        """
        elapsed_ns = received_at_ns - self._heard_ns
        offset_ns = self._offset_ns + int(DRIFT_RATIO * elapsed_ns)
        sensor_ns = self._sensor_ns + ahead_ns
        turns = (received_at_ns - sensor_ns - offset_ns + FASTER_NS) // self._turn_ns
        sensor_ns += turns * self._turn_ns
        gone_ns = sensor_ns - self._sensor_ns
        self._heard_ns, self._sensor_ns, self._counter = received_at_ns, sensor_ns, counter
        apart_ns = received_at_ns - sensor_ns
        self._offset_ns = min(apart_ns, offset_ns)
        if elapsed_ns > self._turn_ns - FASTER_NS:
            self._unpaced = PACED_FRAMES
        elif self._unpaced:
            in_step = gone_ns - elapsed_ns <= PACE_NS
            self._unpaced = self._unpaced - 1 if in_step else PACED_FRAMES
        if self._unpaced or apart_ns - self._offset_ns > self._late_ns:
            self.refused += 1
            return None
        return sensor_ns + self._offset_ns


class SampleClock(FrameClock):
    """Clock of the tacho. Its stamp is finer than its counter and shows a restart of the sensor."""

    __slots__ = ("_stamp_ms", "restarts")

    def __init__(self) -> None:
        super().__init__(TACHO_PERIOD_MS)
        self._stamp_ms = 0
        self.restarts = 0
        """Number of restarts of the sensor."""

    def sampled_ns(self, received_at_ns: int, counter: int, stamp_ms: float = 0.0) -> int | None:
        """Sampling instant as in `FrameClock`.

        Args:
            stamp_ms: stamp of the sensor, modulo STAMP_PERIOD_MS.
        """
        stamp = int(stamp_ms)
        before, self._stamp_ms = self._stamp_ms, stamp
        if self._restarted(received_at_ns):
            self._begin(received_at_ns, counter)
            return received_at_ns
        counted_ms = (counter - self._counter) % COUNTER_PERIOD * TACHO_PERIOD_MS
        half_ms = STAMP_PERIOD_MS // 2
        play_ms = (stamp - before - counted_ms + half_ms) % STAMP_PERIOD_MS - half_ms
        if abs(play_ms) > STAMP_PLAY_MS:
            self.restarts += 1
            self._begin(received_at_ns, counter)
            return received_at_ns
        return self._follow(received_at_ns, counter, (counted_ms + play_ms) * NS_PER_MS)


class ReaderClock:
    """Follows the clock of the tag reader, which every telegram carries.

    A serial line shows only when it was read. Bytes wait there for the next cycle, or for a delayed
    process. The telegram with the shortest delay shows the offset between the two clocks. The delay
    of every other telegram follows from it.
    """

    __slots__ = ("_fastest", "_period_ns", "_reader_ns", "_sent_ns")

    def __init__(self, period_ms: float) -> None:
        """Start to follow the clock.

        Args:
            period_ms: period after which the reader's clock wraps to 0.
        """
        self._period_ns = round(period_ms * NS_PER_MS)
        self._reader_ns = self._sent_ns = 0
        self._fastest: tuple[int, int] | None = None
        """Arrival of the last telegram, and the smallest clock offset so far."""

    def late_ns(self, received_at_ns: int, sent_ms: float) -> int:
        """Delay of a telegram relative to the fastest one. 0: within the tolerance.

        A telegram that seems faster than any before becomes the new reference, even if a clock was
        set. So does one that is too late to be of the same clock.
        """
        sent_ns = round(sent_ms * NS_PER_MS)
        self._reader_ns += (sent_ns - self._sent_ns) % self._period_ns
        self._sent_ns = sent_ns
        apart_ns = offset_ns = received_at_ns - self._reader_ns
        if self._fastest is not None:
            before_ns, fastest_ns = self._fastest
            drifted_ns = fastest_ns + int(DRIFT_RATIO * (received_at_ns - before_ns))
            if apart_ns <= drifted_ns + READER_LATE_NS:
                offset_ns = min(apart_ns, drifted_ns)
        self._fastest = received_at_ns, offset_ns
        late_ns = apart_ns - offset_ns
        return late_ns if late_ns > READER_PLAY_NS else 0


class OdometerClocks:
    """Clocks of one odometer unit. When its tachos restart, its radar and accelerometer have
    restarted, too.
    """

    __slots__ = ("_inertial", "_radar", "_tacho")

    def __init__(self) -> None:
        self._tacho = SampleClock()
        self._radar = FrameClock(OTHER_PERIOD_MS)
        self._inertial = FrameClock(OTHER_PERIOD_MS)

    @property
    def refused(self) -> int:
        """Number of frames that were too old on arrival."""
        return self._tacho.refused + self._radar.refused + self._inertial.refused

    def sampled_ns(
        self, heard: Tacho | Doppler | Imu, received_at_ns: int, counter: int
    ) -> int | None:
        """Sampling instant of a frame received now. None: the frame is too old.

        Args:
            counter: alive counter of the frame.
        """
        if isinstance(heard, Tacho):
            restarts = self._tacho.restarts
            sampled_ns = self._tacho.sampled_ns(received_at_ns, counter, heard.stamp_ms)
            if self._tacho.restarts != restarts:
                self._radar = FrameClock(OTHER_PERIOD_MS)
                self._inertial = FrameClock(OTHER_PERIOD_MS)
            return sampled_ns
        clock = self._radar if isinstance(heard, Doppler) else self._inertial
        return clock.sampled_ns(received_at_ns, counter)
