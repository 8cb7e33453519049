"""When a tacho was read, by this board's clock: from the stamp of the sensor, not from the arrival.

A frame may be held up on its way, by the bus or by a host that has other things to do. Taken for
fresh it would show a train that suddenly slows down. The sensor stamps each sample with its own
clock; of all samples the one that came through fastest shows how far the two clocks are apart.
"""

from typing import Final

STAMP_PERIOD_MS: Final = 256
DRIFT_RATIO: Final = 2.0e-4
"""Two crystals of 100 ppm; so much later the fastest frame of today may be tomorrow."""
LATE_NS: Final = 100_000_000
"""Held up for longer, a sample is refused. Under half the stamp's period, so that it is noticed."""
NS_PER_MS: Final = 1_000_000
STAMP_PERIOD_NS: Final = STAMP_PERIOD_MS * NS_PER_MS


class SampleClock:
    """Follows the clock of one sensor.

    A sensor's clock only goes forwards. One that started anew therefore looks as if it had gone
    ahead, which makes its first sample the fastest there was and sets the clocks together again.
    """

    __slots__ = ("_begun", "_heard_ns", "_offset_ns", "_sensor_ns", "refused")

    def __init__(self) -> None:
        self._begun = False
        self._heard_ns = 0
        self._sensor_ns = 0
        self._offset_ns = 0
        self.refused = 0
        """Samples that were too old when they came."""

    def sampled_ns(self, heard_ns: int, stamp_ms: float) -> int | None:
        """The instant of a sample that was heard now, never after it; None when it is too old.

        Args:
            stamp_ms: of the sensor, modulo STAMP_PERIOD_MS.
        """
        if not self._begun:
            return self._begin(heard_ns, stamp_ms)
        stamp_ns = int(stamp_ms) * NS_PER_MS
        elapsed_ns = heard_ns - self._heard_ns
        ahead_ns = (stamp_ns - self._sensor_ns) % STAMP_PERIOD_NS
        # As many whole periods as bring the sensor's progress nearest to that of our own clock.
        turns = max(0, (elapsed_ns - ahead_ns + STAMP_PERIOD_NS // 2) // STAMP_PERIOD_NS)
        self._heard_ns = heard_ns
        self._sensor_ns += ahead_ns + turns * STAMP_PERIOD_NS
        apart_ns = heard_ns - self._sensor_ns
        self._offset_ns = min(apart_ns, self._offset_ns + int(DRIFT_RATIO * max(0, elapsed_ns)))
        if apart_ns - self._offset_ns > LATE_NS:
            self.refused += 1
            return None
        return self._sensor_ns + self._offset_ns

    def _begin(self, heard_ns: int, stamp_ms: float) -> int:
        self._begun = True
        self._heard_ns = heard_ns
        self._sensor_ns = int(stamp_ms) * NS_PER_MS
        self._offset_ns = heard_ns - self._sensor_ns
        return heard_ns
