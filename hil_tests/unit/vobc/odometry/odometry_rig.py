"""A train for tests of odometry: true motion, and sensors with every permitted error."""

import math
import random
from bisect import bisect_right
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from can_dbc.nodes import Direction
from can_dbc.odometer import ColdMovement, Doppler, Imu, Tacho
from firmware_py.trackdb import GradientSection, LineMap, SpeedSection, Station, TagSite
from vobc.config import load_config
from vobc.odometry import Odometry
from vobc.odometry.sampling import OdometerClocks
from vobc.vocabulary import (
    NEVER_S,
    CycleInput,
    Motion,
    OdometryRecord,
    PlaceProof,
    TachoSample,
    TagReading,
)

CONFIG = load_config("florence4")
NOMINAL_M = math.pi * CONFIG.train.wheel_diameter_m / CONFIG.train.pulses_per_turn
ANTENNA_M = CONFIG.train.antenna_offset_m
STEP_S = 0.005
HEALTH_STEPS = 100
"""Steps between two health frames of the tag reader; it sends one every half a second."""
NS = 1_000_000_000
TAGS = tuple(TagSite(100 + index, 60.0 + 110.0 * index) for index in range(24))
LINE = LineMap(
    "rig", -200.0, 4000.0, (Station("A", 0.0, -80.0, 5.0),), (SpeedSection(-200.0, 4000.0, 20.0),),
    gradients=(GradientSection(150.0, 300.0, 30.0), GradientSection(300.0, 420.0, -25.0)),
    tags=TAGS,
)  # fmt: skip
CLIMBS = ((150.0, 300.0, 30.0), (300.0, 420.0, -25.0))
"""The same gradients in the form that the rig uses."""
Slip = tuple[float, float, float, int]
"""Slip from and to (s), relative excess of the wheel speed, and the axles (1 A, 2 B, 3 both)."""


@dataclass
class Errors:
    """Errors of the sensors; the defaults are perfect except for noise."""

    seed: int = 1
    scale_ratio: float = 0.0
    """Counted distance = true distance * (1 + ratio)."""
    start_off_m: float = 0.0
    radar_ratio: float = 0.0
    imu_bias_mps2: float = 0.0
    slips: tuple[Slip, ...] = ()
    lost_share: float = 0.0
    """Share of the tacho frames that are lost."""
    late_share: float = 0.0
    late_s: float = 0.06
    """Delay of a late frame, s; other frames overtake it."""
    twice_share: float = 0.0
    silent: tuple[float, float] = (math.inf, math.inf)
    """Interval in which no frame arrives; all of them arrive from a queue at its end."""
    missed: frozenset[int] = frozenset()
    false_tags: dict[float, int] = field(default_factory=dict)
    """False tags: time of the reading to tag id, wherever the train is."""
    repeat_tags: bool = False
    """The reader reads each tag again half a second later."""
    again_m: dict[int, float] = field(default_factory=dict)
    """Greatest distance behind a tag at which the reader reads it a second time, by tag."""
    untold: frozenset[int] = frozenset()
    """Tags whose first telegram is lost on the reader's line."""
    radar: Callable[[float, float], float | None] = lambda time_s, speed_mps: speed_mps
    """Radar reading without its own errors; None for no reading."""


@dataclass(frozen=True)
class Moment:
    time_s: float
    front_m: float
    speed_mps: float
    motion: Motion


class Rig:
    """Moves the train, emulates the sensors and runs odometry every 50 ms."""

    def __init__(
        self,
        errors: Errors,
        *,
        front_m: float = 0.0,
        bound_m: float = 0.5,
        believed_m: float = 0.0,
        proof: PlaceProof = PlaceProof.SET_UP,
    ) -> None:
        self.errors = errors
        self.rng = random.Random(errors.seed)
        self.front_m = front_m + errors.start_off_m
        self.speed_mps = self.accel_mps2 = self.time_s = 0.0
        self.step_number = 0
        self.rolled_m = [0.0, 0.0]
        self.phase = [self.rng.random(), self.rng.random()]
        self.before_mps = 0.0
        self.wait: list[tuple[float, int, object, int]] = []
        """Frames in transit: arrival time, order, frame and counter."""
        self.sent = 0
        self.back_ns = 0
        """Total time by which the board's clock was set back, ns."""
        self.latest: dict[type, tuple[object, int]] = {}
        self.samples: list[tuple[Tacho, int]] = []
        self.tags: list[tuple[float, float, int, int]] = []
        self.second_m: dict[int, float] = {}
        """Position of the front at which a tag is read again, by tag."""
        self.telegram_lost = True
        """A telegram was lost since the last health frame; initially none has been received."""
        self.clocks = OdometerClocks()
        self.cold: ColdMovement | None = None
        self.felt_m = {t.tag_id: t.position_m + self.rng.uniform(-0.05, 0.05) for t in TAGS}
        self.readings = sorted((at_m + ANTENNA_M, tag) for tag, at_m in self.felt_m.items())
        """Position of the front at which each tag is read, and the tag."""
        self.pulse_m = NOMINAL_M / (1.0 + errors.scale_ratio)
        record = OdometryRecord(believed_m, bound_m, NOMINAL_M, proof)
        self.odometry = Odometry(CONFIG.odometry, CONFIG.train, LINE, record)

    def run(self, duration_s: float, accel: Callable[[float, float], float]) -> list[Moment]:
        """Args: accel: demanded acceleration at a time and speed; the train follows with a jerk
        of 4 m/s³."""
        history = []
        for _ in range(round(duration_s / STEP_S)):
            self._move(accel(self.time_s, self.speed_mps))
            number = self.step_number
            if number % 4 == 0:
                self._send(self._tacho(), number // 4)
            if number % 10 == 0:
                self._send(self._radar(), number // 10)
                self._send(self._imu(), number // 10)
                self._deliver()
                motion = self.odometry.step(self._seen())
                if motion is not None:
                    history.append(Moment(self.time_s, self.front_m, self.speed_mps, motion))
        return history

    def set_back(self, by_s: float) -> None:
        """Set the board's clock back between two cycles; received frames keep their age."""
        by_ns = round(by_s * NS)
        self.back_ns += by_ns
        self.latest = {kind: (frame, at - by_ns) for kind, (frame, at) in self.latest.items()}

    def _move(self, wanted_mps2: float) -> None:
        change = max(-4.0 * STEP_S, min(4.0 * STEP_S, wanted_mps2 - self.accel_mps2))
        self.accel_mps2 += change
        after_mps = self.speed_mps + self.accel_mps2 * STEP_S
        if self.speed_mps > 0.0 >= after_mps:
            after_mps, self.accel_mps2 = 0.0, 0.0
        moved_m = 0.5 * (self.speed_mps + after_mps) * STEP_S
        before_m, before_rolled_m = self.front_m, self.rolled_m[0]
        self.speed_mps = after_mps
        self.front_m += moved_m
        for axle in (0, 1):
            self.rolled_m[axle] += moved_m * (1.0 + self._slip(axle))
        self.step_number += 1
        self.time_s = self.step_number * STEP_S
        self._read_tags(before_m, before_rolled_m)

    def _slip(self, axle: int) -> float:
        if not self.errors.slips:
            return 0.0
        return sum(
            share for from_s, to_s, share, axles in self.errors.slips
            if from_s <= self.time_s < to_s and axles & (1 << axle)
        )  # fmt: skip

    def _count(self, axle: int) -> int:
        return self._count_after(self.rolled_m[axle], axle)

    def _count_after(self, rolled_m: float, axle: int) -> int:
        return math.floor(rolled_m / self.pulse_m + self.phase[axle])

    def _tacho(self) -> Tacho:
        stamp_ms = float(round(self.time_s * 1000.0) % 256)
        way = Direction.FORWARD if self.speed_mps >= 0.0 else Direction.REVERSE
        return Tacho(self._count(0) % 65536, self._count(1) % 1024, way, True, True, stamp_ms)

    def _radar(self) -> Doppler:
        shown = self.errors.radar(self.time_s, self.speed_mps)
        noise = max(-0.12, min(0.12, self.rng.gauss(0.0, 0.03)))
        if shown is None or abs(self.speed_mps) < 0.5:
            return Doppler(0.0, 0.0, True)
        return Doppler(shown * (1.0 + self.errors.radar_ratio) + noise, 95.0, True)

    def _imu(self) -> Imu:
        mean = (self.speed_mps - self.before_mps) / (10 * STEP_S)
        self.before_mps = self.speed_mps
        under = next((c for a, b, c in CLIMBS if a <= self.front_m - 8.0 < b), 0.0)
        noise = max(-0.08, min(0.08, self.rng.gauss(0.0, 0.02)))
        return Imu(mean + 9.81 * under / 1000.0 + self.errors.imu_bias_mps2 + noise, True)

    def _send(self, frame: object, counter: int) -> None:
        errors, draw = self.errors, self.rng.random()
        due_s = self.time_s
        if errors.silent[0] <= self.time_s < errors.silent[1]:
            due_s = errors.silent[1]
        elif isinstance(frame, Tacho):
            if draw < errors.lost_share:
                return
            if draw > 1.0 - errors.late_share:
                due_s += errors.late_s
            if draw > 1.0 - errors.twice_share:
                self.wait.append((due_s + 0.03, self.sent, frame, counter))
        self.wait.append((due_s, self.sent, frame, counter))
        self.sent += 1

    def _deliver(self) -> None:
        """Deliver frames like the inbox of the wire; frames of one instant arrive 0.2 ms apart."""
        now_ns = round(self.time_s * NS) - self.back_ns
        due = sorted(entry for entry in self.wait if entry[0] <= self.time_s)
        self.wait = [entry for entry in self.wait if entry[0] > self.time_s]
        for due_s, _, frame, counter in due:
            assert isinstance(frame, Tacho | Doppler | Imu)
            at_ns = self.clocks.sampled_ns(
                frame, min(now_ns, round(due_s * NS) - self.back_ns), counter % 256
            )
            if at_ns is None:
                continue
            if isinstance(frame, Tacho):
                self.samples.append((frame, at_ns))
            self.latest[type(frame)] = (frame, at_ns)

    def _read_tags(self, before_m: float, before_rolled_m: float) -> None:
        errors = self.errors

        def count_at(place_m: float) -> float:
            part = (place_m + ANTENNA_M - before_m) / (self.front_m - before_m)
            before = self._count_after(before_rolled_m, 0)
            return before + (self._count(0) - before) * part

        first, last = (
            bisect_right(self.readings, (at_m, math.inf)) for at_m in (before_m, self.front_m)
        )
        for _, tag_id in self.readings[first:last]:
            place_m = self.felt_m[tag_id]
            if tag_id not in errors.missed:
                late_s = self.rng.uniform(-0.005, 0.005)
                pulses = count_at(place_m) + late_s * self.speed_mps / self.pulse_m
                if tag_id in errors.untold:
                    self.telegram_lost = True
                else:
                    self._tell_tag(tag_id, math.floor(pulses))
                if tag_id in errors.again_m:
                    self.second_m[tag_id] = place_m + errors.again_m[tag_id]
                if errors.repeat_tags:
                    errors.false_tags[self.time_s + 0.5] = tag_id
        for tag_id, again_m in list(self.second_m.items()):
            if again_m + ANTENNA_M <= self.front_m:
                del self.second_m[tag_id]
                self._tell_tag(tag_id, math.floor(count_at(again_m)))
        for at_s in [at_s for at_s in errors.false_tags if at_s <= self.time_s]:
            self._tell_tag(errors.false_tags.pop(at_s), self._count(0))

    def _tell_tag(self, tag_id: int, pulses: int) -> None:
        """Queue a telegram; a reader reports tags in the order in which it read them."""
        due_s = self.time_s + self.rng.uniform(0.005, 0.05)
        due_s = max([due_s, *(tag[0] for tag in self.tags)])
        self.tags.append((due_s, self.time_s, tag_id, pulses % 65536))

    def _heard(self, kind: type) -> tuple[Any, float]:
        if kind not in self.latest:
            return None, NEVER_S
        frame, at_ns = self.latest[kind]
        return frame, (round(self.time_s * NS) - self.back_ns - at_ns) / NS

    def _seen(self) -> CycleInput:
        now_ns = round(self.time_s * NS) - self.back_ns
        tacho, radar, imu = (self._heard(kind) for kind in (Tacho, Doppler, Imu))
        samples = tuple(TachoSample(frame, (now_ns - at) / NS) for frame, at in self.samples)
        self.samples = []
        tags = tuple(
            TagReading(i, pulses, self.time_s - at_s)
            for due_s, at_s, i, pulses in self.tags
            if due_s <= self.time_s
        )
        self.tags = [tag for tag in self.tags if tag[0] > self.time_s]
        tag_gap = self.telegram_lost and bool(tags or self.step_number % HEALTH_STEPS == 0)
        self.telegram_lost = self.telegram_lost and not tag_gap
        return CycleInput(
            now_ns=now_ns,
            dt_s=0.05,
            tacho=tacho[0],
            tacho_age_s=tacho[1],
            tacho_samples=samples,
            doppler=radar[0],
            doppler_age_s=radar[1],
            imu=imu[0],
            imu_age_s=imu[1],
            tags=tags,
            cold=self.cold,
            cold_age_s=0.1 if self.cold else NEVER_S,
            tag_gap=tag_gap,
        )
