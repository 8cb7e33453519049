"""When a sensor was read, by this board's clock: from its own counting, not from the arrival.

A frame may be held up on its way: by a bus that others keep busy, in a mailbox, by a host that has
other things to do. Taken for fresh it would show a train that suddenly slows down. A sensor counts
its frames and sends them in step with its own clock; of all samples the one that came through
fastest shows how far the two clocks are apart.
"""

from typing import Final

from can_dbc.odometer import Doppler, Imu, Tacho

COUNTER_PERIOD: Final = 256
STAMP_PERIOD_MS: Final = 256
TACHO_PERIOD_MS: Final = 20
OTHER_PERIOD_MS: Final = 50
"""Of radar and accelerometer."""
STAMP_PLAY_MS: Final = 5
"""A sensor whose stamp leaves the step of its counter by more was started anew."""
DRIFT_RATIO: Final = 2.0e-4
"""Two crystals of 100 ppm; so much later the fastest frame of today may be tomorrow."""
LATE_NS: Final = 100_000_000
"""Held up for longer, a sample is refused."""
FASTER_NS: Final = 1_000_000_000
"""The frame that set the clocks may itself have been so late; one that comes through faster by no
more sets them closer."""
PACED_FRAMES: Final = 5
"""After a silence that the counter cannot measure so many frames have to come in step."""
PACE_NS: Final = 10_000_000
"""What comes faster than it was sent by more than this comes out of a queue."""
READER_PLAY_NS: Final = 5_000_000
"""Telegrams differ in length, and a stamp is not known better."""
READER_LATE_NS: Final = 1_000_000_000
"""By no more a telegram of the tag reader is held up; beyond, its clock is another one."""
NS_PER_MS: Final = 1_000_000
S_PER_NS: Final = 1e-9
STEADY_S: Final = 0.1
"""Cycles further apart are not to be told from a clock that was set: the train may have stood."""
CYCLES_STEADY: Final = 1.5
"""The same for slow controllers, as a multiple of their cycle."""


class OwnTime:
    """The time of odometry: this board's clock, but it never goes back."""

    __slots__ = ("_ahead_s", "_longest_s", "begun", "dt_s", "now_s", "steady")

    def __init__(self) -> None:
        self.begun = False
        self.now_s = 0.0
        self.dt_s = 0.0
        """Since the cycle before, and 0 in the first one."""
        self.steady = True
        """Nothing can have happened between the cycle before and this one."""
        self._ahead_s = 0.0
        """Of the board's clock, by as much as that was ever set back."""
        self._longest_s = STEADY_S

    def expect(self, cycle_s: float) -> None:
        """How long a cycle is; one that is late by half is still no gap."""
        self._longest_s = max(STEADY_S, CYCLES_STEADY * cycle_s)

    def tell(self, now_ns: int) -> float:
        """The instant of a new cycle in s; where the clock was set back, the longest step goes on.

        How long that step took nobody knows, but more would not have been a cycle.
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
    """Follows a sensor that sends in step with its counter.

    The counter tells how old a frame is as long as that is less than its period; after a longer
    silence frames are refused until they come as they were sent, and not out of a queue.
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
        """Frames that were too old when they came."""

    def sampled_ns(self, heard_ns: int, counter: int) -> int | None:
        """The instant of a frame that was heard now, never after it; None when it is too old."""
        if self._anew(heard_ns):
            self._begin(heard_ns, counter)
            return heard_ns
        steps = (counter - self._counter) % COUNTER_PERIOD
        return self._follow(heard_ns, counter, steps * self._period_ns)

    def _anew(self, heard_ns: int) -> bool:
        """No frame yet, or this board's clock was set back: what was learnt of it is void."""
        return not self._begun or heard_ns < self._heard_ns

    def _begin(self, heard_ns: int, counter: int) -> None:
        """The sensor's time counts from here."""
        self._begun = True
        self._counter = counter
        self._heard_ns = heard_ns
        self._sensor_ns = 0
        self._offset_ns = heard_ns

    def _follow(self, heard_ns: int, counter: int, ahead_ns: int) -> int | None:
        """The youngest sample that fits is taken, but none from the future.

        Args:
            ahead_ns: how far the sensor went on, less whole turns of its counter.
        """
        elapsed_ns = heard_ns - self._heard_ns
        offset_ns = self._offset_ns + int(DRIFT_RATIO * elapsed_ns)
        sensor_ns = self._sensor_ns + ahead_ns
        turns = (heard_ns - sensor_ns - offset_ns + FASTER_NS) // self._turn_ns
        sensor_ns += turns * self._turn_ns
        gone_ns = sensor_ns - self._sensor_ns
        self._heard_ns, self._sensor_ns, self._counter = heard_ns, sensor_ns, counter
        apart_ns = heard_ns - sensor_ns
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
    """The tacho's: its stamp is finer than its counter, and shows when the sensor started anew."""

    __slots__ = ("_stamp_ms", "restarts")

    def __init__(self) -> None:
        super().__init__(TACHO_PERIOD_MS)
        self._stamp_ms = 0
        self.restarts = 0
        """How often the sensor started anew."""

    def sampled_ns(self, heard_ns: int, counter: int, stamp_ms: float = 0.0) -> int | None:
        """As of `FrameClock`.

        Args:
            stamp_ms: of the sensor, modulo STAMP_PERIOD_MS.
        """
        stamp = int(stamp_ms)
        before, self._stamp_ms = self._stamp_ms, stamp
        if self._anew(heard_ns):
            self._begin(heard_ns, counter)
            return heard_ns
        counted_ms = (counter - self._counter) % COUNTER_PERIOD * TACHO_PERIOD_MS
        half_ms = STAMP_PERIOD_MS // 2
        play_ms = (stamp - before - counted_ms + half_ms) % STAMP_PERIOD_MS - half_ms
        if abs(play_ms) > STAMP_PLAY_MS:
            self.restarts += 1
            self._begin(heard_ns, counter)
            return heard_ns
        return self._follow(heard_ns, counter, (counted_ms + play_ms) * NS_PER_MS)


class ReaderClock:
    """Follows the tag reader's clock, which every telegram tells.

    A serial line says only when it was asked, and bytes wait there for the next cycle, or for a
    process that is held up. Of all telegrams the one that came through fastest shows how far the
    two clocks are apart; every other one was sent as much earlier as it came later.
    """

    __slots__ = ("_fastest", "_period_ns", "_reader_ns", "_sent_ns")

    def __init__(self, period_ms: float) -> None:
        """Args: period_ms: after so long the reader's clock begins at 0 again."""
        self._period_ns = round(period_ms * NS_PER_MS)
        self._reader_ns = self._sent_ns = 0
        self._fastest: tuple[int, int] | None = None
        """When the last telegram was heard, and how far the clocks are apart by the fastest."""

    def late_ns(self, heard_ns: int, sent_ms: float) -> int:
        """How much later than the fastest one a telegram came; 0 within what is not told apart.

        One that seems to have come through faster than any, be it for a clock that was set, is what
        the next are compared with; so is one that is too late to be of the same clock.
        """
        sent_ns = round(sent_ms * NS_PER_MS)
        self._reader_ns += (sent_ns - self._sent_ns) % self._period_ns
        self._sent_ns = sent_ns
        apart_ns = offset_ns = heard_ns - self._reader_ns
        if self._fastest is not None:
            before_ns, fastest_ns = self._fastest
            drifted_ns = fastest_ns + int(DRIFT_RATIO * (heard_ns - before_ns))
            if apart_ns <= drifted_ns + READER_LATE_NS:
                offset_ns = min(apart_ns, drifted_ns)
        self._fastest = heard_ns, offset_ns
        late_ns = apart_ns - offset_ns
        return late_ns if late_ns > READER_PLAY_NS else 0


class OdometerClocks:
    """All that one odometer sends; when its tachos start anew, so did radar and accelerometer."""

    __slots__ = ("_inertial", "_radar", "_tacho")

    def __init__(self) -> None:
        self._tacho = SampleClock()
        self._radar = FrameClock(OTHER_PERIOD_MS)
        self._inertial = FrameClock(OTHER_PERIOD_MS)

    @property
    def refused(self) -> int:
        """Frames that were too old when they came."""
        return self._tacho.refused + self._radar.refused + self._inertial.refused

    def sampled_ns(self, heard: Tacho | Doppler | Imu, heard_ns: int, counter: int) -> int | None:
        """When a frame that was heard now was taken; None when it is too old.

        Args:
            counter: its alive counter.
        """
        if isinstance(heard, Tacho):
            restarts = self._tacho.restarts
            sampled_ns = self._tacho.sampled_ns(heard_ns, counter, heard.stamp_ms)
            if self._tacho.restarts != restarts:
                self._radar = FrameClock(OTHER_PERIOD_MS)
                self._inertial = FrameClock(OTHER_PERIOD_MS)
            return sampled_ns
        clock = self._radar if isinstance(heard, Doppler) else self._inertial
        return clock.sampled_ns(heard_ns, counter)
