"""Tag antenna and reader: reports with a delay, on a serial line, when which tag passed the
antenna.
"""

from bisect import bisect_left
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from math import inf
from typing import Final

from can_dbc.tags import TagReaderHealth
from firmware_py.tag_reader.telegram import (
    CLOCK_PERIOD_MS,
    HEALTH_PERIOD_S,
    SEQUENCE_PERIOD,
    HealthTelegram,
    TagTelegram,
    encode,
)
from firmware_py.trackdb import TagSite
from plant_emulator.noise import Gaussian, Generators, NoiseSource, Uniform
from plant_emulator.sensors.tacho import Tachos
from plant_emulator.train_config import SensorConfig

NS_PER_S: Final = 1_000_000_000
NS_PER_MS: Final = 1_000_000
SENT_PERIOD: Final = 1 << 16
FAR_NS: Final = 1 << 62


@dataclass(frozen=True, slots=True)
class TagPass:
    """A tag that passed the antenna's centre, as the reader stores it before reporting it."""

    site: TagSite
    true_ns: int
    """Instant at which the tag truly passed."""
    stamp_ns: int
    """Instant that the reader measured, including the error of its stamp."""
    pulses: int
    due_ns: int
    """Earliest instant at which the telegram leaves; it also waits for those before it."""


Judge = Callable[[TagPass], bool]
"""A fault's decision whether the reader detects a tag."""
Witness = Callable[[TagPass], None]
"""A fault's callback for every tag that was read."""


class TagReader:
    """Detects tags in both directions of travel.

    The detected place of each tag has an error that is sampled once a run, because most of it comes
    from how the tag is mounted. A train that passes a tag twice in one run therefore detects it
    twice at the same place.
    """

    def __init__(
        self,
        config: SensorConfig,
        generators: Generators,
        tags: Sequence[TagSite],
        *,
        front_m: float,
        start_ns: int,
    ) -> None:
        draws = generators.of
        place = Gaussian(draws(NoiseSource.TAG_PLACE), config.tag_sigma_m, config.tag_clip_m)
        self._config = config
        self.tags: Final = tuple(tags)
        """Tags of the line at their places in the map."""
        self._own_felt_m = {site.tag_id: site.position_m + place.draw() for site in tags}
        self._offsets_m: Mapping[int, float] = {}
        self._felt_m: list[float] = []
        self._sites: list[TagSite] = []
        self._antenna_m = config.antenna_m
        error, latency = config.tag_stamp_s, config.tag_latency_s
        self._stamp_errors = Uniform(draws(NoiseSource.TAG_TIME), low=error.low, high=error.high)
        self._latencies = Uniform(
            draws(NoiseSource.TAG_LATENCY), low=latency.low, high=latency.high
        )
        self._start_ns = start_ns
        self._at_m = front_m - config.antenna_m
        self._next = 0
        """Index of the first tag at or ahead of the antenna."""
        self._low_m, self._high_m = -inf, inf
        self._lay()
        self._waiting: deque[TagPass] = deque()
        self._health_due_ns = start_ns
        self.due_ns = start_ns
        """Instant of the next telegram, for a tag or for health."""
        self._sequence = 0
        self.tags_read = 0
        self.tags_lost = 0
        """Number of tags that passed under the antenna and were not read."""
        self.displaced_read = 0
        """Number of tags that were read at a place changed by a fault."""
        self.telegrams_sent = 0
        self.last: TagPass | None = None
        """The tag that was read last."""
        self.judges: list[Judge] = []
        """Decisions about every tag under the antenna; the tag is read only if all agree."""
        self.witnesses: list[Witness] = []
        self.antenna_dead = False
        """A fault: the antenna detects no tag."""
        self.fault_hidden = False
        """A fault: the self-test does not find the dead antenna."""
        self._antenna_ok = True
        """Result of the last self-test."""

    def _lay(self) -> None:
        """Compute where each tag is detected.

        A tag that moves past the antenna by this is not read.
        """
        offset_m = self._offsets_m.get
        felt = sorted(
            (self._own_felt_m[site.tag_id] + offset_m(site.tag_id, 0.0), site.tag_id, site)
            for site in self.tags
        )
        self._felt_m = [felt_m for felt_m, _, _ in felt]
        self._sites = [site for _, _, site in felt]
        self._next = bisect_left(self._felt_m, self._at_m)
        self._low_m, self._high_m = self._neighbours()

    def displace(self, offsets_m: Mapping[int, float]) -> None:
        """A fault: move tags, given by number, by these distances along the line; all others return
        to their places.
        """
        self._offsets_m = offsets_m
        self._lay()

    def reseed(self, generators: Generators) -> None:
        """Take further samples from other generators, also for the places of tags that are surely
        ahead.
        """
        config, draws = self._config, generators.of
        self._stamp_errors.reseed(draws(NoiseSource.TAG_TIME))
        self._latencies.reseed(draws(NoiseSource.TAG_LATENCY))
        place = Gaussian(draws(NoiseSource.TAG_PLACE), config.tag_sigma_m, config.tag_clip_m)
        for site in self.tags:
            felt_m = site.position_m + place.draw()
            offset_m = self._offsets_m.get(site.tag_id, 0.0)
            if site.position_m + offset_m - config.tag_clip_m > self._at_m:
                self._own_felt_m[site.tag_id] = felt_m
        self._lay()

    def mount(self, felt_m: Mapping[int, float]) -> None:
        """Detect tags, given by number, at these chainages of the antenna's centre."""
        self._own_felt_m |= {
            tag_id: at_m for tag_id, at_m in felt_m.items() if self.site_of(tag_id)
        }
        self._lay()

    def _neighbours(self) -> tuple[float, float]:
        felt_m, index = self._felt_m, self._next
        return (
            felt_m[index - 1] if index > 0 else -inf,
            felt_m[index] if index < len(felt_m) else inf,
        )

    def step(self, front_m: float, start_ns: int, end_ns: int, tachos: Tachos) -> None:
        """Detect the tags passed when the train's front moved to `front_m` over the step."""
        at_m = front_m - self._antenna_m
        if self._low_m < at_m <= self._high_m:
            self._at_m = at_m
            return
        before_m, felt_m = self._at_m, self._felt_m
        while self._next < len(felt_m) and felt_m[self._next] < at_m:
            self._passed(self._next, before_m, at_m, start_ns, end_ns, tachos)
            self._next += 1
        while self._next > 0 and felt_m[self._next - 1] >= at_m:
            self._next -= 1
            self._passed(self._next, before_m, at_m, start_ns, end_ns, tachos)
        self._at_m = at_m
        self._low_m, self._high_m = self._neighbours()

    def _passed(
        self,
        index: int,
        before_m: float,
        at_m: float,
        start_ns: int,
        end_ns: int,
        tachos: Tachos,
    ) -> None:
        share_ratio = (self._felt_m[index] - before_m) / (at_m - before_m)
        true_ns = start_ns + round(share_ratio * (end_ns - start_ns))
        stamp_ns = true_ns + round(self._stamp_errors.draw() * NS_PER_S)
        due_ns = true_ns + round(self._latencies.draw() * NS_PER_S)
        passed = TagPass(
            self._sites[index], true_ns, stamp_ns, tachos.pulses_a(share_ratio), due_ns
        )
        missed = False
        for judge in self.judges:
            # Call every judge, so that the samples of one fault do not depend on the others.
            missed = not judge(passed) or missed
        if missed or self.antenna_dead:
            self.tags_lost += 1
            return
        self.read(passed)
        self.displaced_read += self._offsets_m.get(passed.site.tag_id, 0.0) != 0.0
        for witness in self.witnesses:
            witness(passed)

    def read(self, passed: TagPass) -> None:
        """Store a tag and report it when it is due. A dead antenna stores no tag."""
        if self.antenna_dead:
            return
        self.last = passed
        self._waiting.append(passed)
        self.due_ns = min(self.due_ns, passed.due_ns)
        self.tags_read += 1

    @property
    def antenna_m(self) -> float:
        """Chainage of the antenna's centre."""
        return self._at_m

    def felt_m(self, tag_id: int) -> float:
        """Chainage of the antenna's centre at which it detects this tag of the line."""
        return self._own_felt_m[tag_id] + self._offsets_m.get(tag_id, 0.0)

    def site_of(self, tag_id: int) -> TagSite | None:
        """The tag with this number on the line; None if the line has none."""
        return next((site for site in self.tags if site.tag_id == tag_id), None)

    def telegrams(self, now_ns: int) -> list[bytes]:
        """Return the encoded telegrams that leave on the serial line now."""
        waiting = self._waiting
        leaving: list[bytes] = []
        while waiting and waiting[0].due_ns <= now_ns:
            leaving.append(self._tag(waiting.popleft(), now_ns))
        if now_ns >= self._health_due_ns:
            leaving.append(self._health(now_ns))
            period_ns = round(HEALTH_PERIOD_S * NS_PER_S)
            self._health_due_ns = max(self._health_due_ns + period_ns, now_ns)
        self.due_ns = min(self._health_due_ns, waiting[0].due_ns if waiting else FAR_NS)
        return leaving

    def _clock_ms(self, instant_ns: int) -> float:
        """Convert an instant to the reader's own clock, which started with the plant."""
        return ((instant_ns - self._start_ns) / NS_PER_MS) % CLOCK_PERIOD_MS

    def _count(self) -> int:
        sequence, self._sequence = self._sequence, (self._sequence + 1) % SEQUENCE_PERIOD
        return sequence

    def _tag(self, passed: TagPass, now_ns: int) -> bytes:
        self.telegrams_sent += 1
        return encode(
            TagTelegram(
                sequence=self._count(),
                tag_id=passed.site.tag_id,
                kind=passed.site.kind,
                stamp_ms=self._clock_ms(min(passed.stamp_ns, now_ns)),
                sent_ms=self._clock_ms(now_ns),
                pulses=passed.pulses,
            )
        )

    def _health(self, now_ns: int) -> bytes:
        self._antenna_ok = not self.antenna_dead or self.fault_hidden
        return encode(
            HealthTelegram(
                sequence=self._count(),
                sent_ms=self._clock_ms(now_ns),
                antenna_ok=self._antenna_ok,
                telegrams_read=self.tags_read,
                crc_errors=0,
                uptime_s=(now_ns - self._start_ns) // NS_PER_S,
            )
        )

    def frame(self, now_ns: int) -> TagReaderHealth:
        """Build the reader's bus frame.

        The reader tests itself with every health telegram on its line.
        """
        tested_ns = self._health_due_ns - round(HEALTH_PERIOD_S * NS_PER_S)
        return TagReaderHealth(
            antenna_ok=self._antenna_ok,
            telegrams_sent=self.telegrams_sent % SENT_PERIOD,
            self_test_age_ms=max(0.0, (now_ns - tested_ns) / NS_PER_MS),
        )
