"""A small emulated train with sensors and wayside that closes the control loop around ATO alone.

The rig shares no code with the controller's predictor. The train is a point mass; the actuators are
queues of timed demands; the odometer counts pulses and the localisation is corrected at tags. The
rig runs in steps of 10 ms, the controller in cycles of 50 ms.
"""

import math
import random
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

from can_dbc.vobc import AtoPhase
from firmware_py.trackdb import LineMap, Station, load_line
from vobc.ato import Ato, AtoConfig
from vobc.odometry.tracking import SpeedTrack
from vobc.vocabulary import AtoDemand, AtoInput

LINE = load_line("florence")
STEP_S = 0.01
TRAIN_LENGTH_M = 68.59
ANTENNA_M = 2.0
PULSE_M = math.pi * 0.860 / 256.0
ROTATING_RATIO = 0.08
FILTER_RAD_S = 8.0
FINE_M = 1e-4
"""Position noise given to the odometry's speed filter, m. The pulse noise is in
`speed_sigma_mps`."""


@dataclass
class RigSettings:
    seed: int = 1
    brake_delay_s: float | None = 1.0
    """Dead time of the brake; None samples one from `brake_delays_s` for each brake application."""
    brake_delays_s: tuple[float, float] = (0.4, 1.0)
    brake_lag_s: float | None = None
    """First-order lag of the brake; None samples one from 0.25 s to 0.5 s."""
    brake_gain: float | None = None
    traction_gain: float | None = None
    odometer_error: float | None = 0.0
    """Relative error of the odometer; None samples one from -1 % to +5 %."""
    load_ratio: float = 0.5
    tag_sigma_m: float = 0.02
    speed_sigma_mps: float = 0.01
    cycle_s: float = 0.05
    link_s: float = 0.015
    """Delay from the measurement to the actuator, in addition to the dead times of the
    actuators."""
    missed_tags: frozenset[int] = frozenset()
    start_scale_known: bool = False
    ceiling_margin_mps: float = 0.0


class Delayed:
    """First-order lag behind a pure transport delay."""

    def __init__(self, delay_s: float, lag_s: float) -> None:
        self.delay_s = delay_s
        self.lag_s = lag_s
        self.queue: deque[tuple[float, float]] = deque()
        self.input = 0.0
        self.output = 0.0

    def ask(self, now_s: float, value: float) -> None:
        self.queue.append((now_s + self.delay_s, value))

    def step(self, now_s: float) -> float:
        while self.queue and self.queue[0][0] <= now_s + 1e-9:
            self.input = self.queue.popleft()[1]
        self.output += (self.input - self.output) * (1.0 - math.exp(-STEP_S / self.lag_s))
        return self.output


@dataclass
class Stop:
    station: str
    error_m: float
    at_s: float
    leg_s: float
    last_50_m_s: float


@dataclass
class Trace:
    demands: list[AtoDemand] = field(default_factory=list)
    times_s: list[float] = field(default_factory=list)
    fronts_m: list[float] = field(default_factory=list)
    speeds_mps: list[float] = field(default_factory=list)
    accels_mps2: list[float] = field(default_factory=list)


class Rig:
    """The world around one `Ato`. `step` runs one control cycle; tests set attributes between
    cycles."""

    def __init__(self, ato: Ato, line: LineMap, settings: RigSettings, start_m: float) -> None:
        self.ato, self.line, self.settings = ato, line, settings
        draw = random.Random(settings.seed)
        self.draw = draw
        self.cycle_s = settings.cycle_s
        lag_s = (
            settings.brake_lag_s if settings.brake_lag_s is not None else draw.uniform(0.25, 0.5)
        )
        self.brake = Delayed(settings.brake_delay_s or 1.0, lag_s)
        self.traction = Delayed(0.1, 0.3)
        gain = settings.brake_gain
        self.brake_gain = gain if gain is not None else draw.uniform(0.95, 1.05)
        gain = settings.traction_gain
        # The load is known within 5 %. The error scales traction and brake alike.
        load_error = draw.uniform(-0.05, 0.05) * settings.load_ratio * 54.4
        believed_t, true_t = (
            130.0 + settings.load_ratio * 54.4 + load_error,
            130.0 + (settings.load_ratio * 54.4),
        )
        self.traction_gain = gain if gain is not None else believed_t / true_t
        self.brake_gain *= believed_t / true_t
        self.load_kg = (settings.load_ratio * 54.4 + load_error) * 1000.0
        self.davis_ratio = draw.uniform(0.8, 1.2)
        error = settings.odometer_error
        self.odometer_error = error if error is not None else draw.uniform(-0.01, 0.05)
        self.now_s = 0.0
        self.front_m = start_m
        self.start_m = start_m
        self.speed_mps = 0.0
        self.accel_mps2 = 0.0
        self.counted_m = 0.0
        self._track = SpeedTrack(bandwidth_rad_s=FILTER_RAD_S, window_s=0.2)
        self.still_s = 10.0
        self.enabled = True
        self.emergency = False
        self.authority_end_m = line.end_m
        self.ceiling_mps = 100.0
        self.traction_ratio = 1.0
        self.traction_most_mps2 = 2.0
        self.holding_s = 10.0
        self.held = True
        self.hold_asked = True
        self.doors_position = 0.0
        self.doors_asked = False
        self.doors_stuck_open = False
        self.door_permission = True
        self.braked_to_rest = False
        self.orders: dict[str, bool] = {}
        """Further fields of the ATO input, such as `skip_next=True`."""
        self.jog_permitted = True
        self.jog_to_tag = False
        self.jog_back_m = 0.0
        self.ahead_m = 0.0
        # Localisation: position = anchor + counted * scale. Each has its own standard deviation.
        self.anchor_m, self.anchor_count_m = start_m, 0.0
        self.anchor_sigma_m = 0.02
        self.scale = 1.0 / (1.0 + self.odometer_error) if settings.start_scale_known else 1.0
        self.scale_sigma = 1e-4 if settings.start_scale_known else 0.03
        self.pending_tags: deque[tuple[int, float, float]] = deque()
        self.tag_index = 0
        self._skip_tags()
        self.trace = Trace()
        self.stops: list[Stop] = []
        self.leg_start_s = 0.0
        self.zone_s = 0.0
        self.shift_m = 0.0
        self.told_late_s = 0.0
        """Time by which the clock stepped: the reported cycle time exceeds the true one by this."""

    def _skip_tags(self) -> None:
        tags = self.line.tags
        while self.tag_index < len(tags) and tags[self.tag_index].position_m + ANTENNA_M <= (
            self.front_m + 0.01
        ):
            self.tag_index += 1

    # The physics run every 10 ms.

    def physics(self) -> None:
        self.now_s += STEP_S
        drive = self.traction.step(self.now_s) * self.traction_gain * self.traction_ratio
        brake = self.brake.step(self.now_s) * self.brake_gain
        if self.emergency:
            brake, drive = max(brake, 1.2), 0.0
        if self.held:
            brake += 1.0
        grade = (
            9.81
            * self.line.mean_gradient_permille(self.front_m - TRAIN_LENGTH_M, self.front_m)
            / 1000.0
            / (1.0 + ROTATING_RATIO)
        )
        speed = self.speed_mps
        davis = self.davis_ratio * (0.012 + 0.0004 * abs(speed) + 0.00008 * speed * speed)
        radius = self.line.radius_m(self.front_m - TRAIN_LENGTH_M / 2.0)
        davis += 0.0 if radius is None else 9.81 * 0.5 / (radius - 30.0)
        free = drive - grade
        friction = brake + davis
        if speed == 0.0:
            self.accel_mps2 = 0.0 if abs(free) <= friction else free - math.copysign(friction, free)
        else:
            self.accel_mps2 = free - math.copysign(friction, speed)
        new = speed + self.accel_mps2 * STEP_S
        if speed != 0.0 and new * speed < 0.0:
            new = 0.0
        self.front_m += (speed + new) / 2.0 * STEP_S
        self.counted_m += (speed + new) / 2.0 * STEP_S * (1.0 + self.odometer_error)
        self.speed_mps = new
        self.still_s = self.still_s + STEP_S if abs(new) < 0.25 else 0.0
        self._hold_and_doors()
        self._meet_tags()

    def _hold_and_doors(self) -> None:
        self.holding_s = self.holding_s + STEP_S if self.hold_asked != self.held else 0.0
        if self.holding_s > 0.2:
            self.held = self.hold_asked
        wish = 1.0 if self.doors_asked or self.doors_stuck_open else 0.0
        change = STEP_S / 2.5
        self.doors_position += min(change, max(-change, wish - self.doors_position))
        assert self.doors_position == 0.0 or abs(self.speed_mps) < 0.01, "moved with open doors"

    def _meet_tags(self) -> None:
        tags = self.line.tags
        if self.tag_index >= len(tags):
            return
        tag = tags[self.tag_index]
        if self.front_m - ANTENNA_M < tag.position_m:
            return
        self.tag_index += 1
        if tag.tag_id in self.settings.missed_tags:
            return
        sigma = self.settings.tag_sigma_m
        noise = min(0.05, max(-0.05, self.draw.gauss(0.0, sigma))) if sigma > 0.0 else 0.0
        # Travelled distance at the instant at which the centre of the antenna was over the tag.
        past_m = self.front_m - ANTENNA_M - tag.position_m
        at_count_m = self.counted_m - past_m * (1.0 + self.odometer_error) + noise
        self.pending_tags.append((tag.tag_id, tag.position_m + ANTENNA_M, at_count_m))

    # The localisation runs every cycle.

    def _count(self) -> float:
        return (math.floor(self.counted_m / PULSE_M) + 0.5) * PULSE_M

    def _localise(self) -> tuple[int, ...]:
        accepted = []
        while self.pending_tags:
            tag_id, front_m, count_m = self.pending_tags.popleft()
            run_m = count_m - self.anchor_count_m
            guess_m = self.anchor_m + run_m * self.scale
            # Variance of two independent errors: the offset at the anchor and the scale since then.
            p_offset, p_scale = self.anchor_sigma_m**2, self.scale_sigma**2
            spread = p_offset + run_m**2 * p_scale + 0.022**2
            surprise_m = front_m - guess_m
            gain = (p_offset + run_m**2 * p_scale) / spread
            if abs(run_m) > 1.0:
                scale_gain = run_m * p_scale / spread
                self.scale += scale_gain * surprise_m
                self.scale_sigma = math.sqrt(max(1e-8, p_scale * (1.0 - scale_gain * run_m)))
            self.anchor_m = guess_m + gain * surprise_m
            self.anchor_count_m = count_m
            self.anchor_sigma_m = math.sqrt((1.0 - gain) * (p_offset + run_m**2 * p_scale))
            accepted.append(tag_id)
        return tuple(accepted)

    @property
    def located_m(self) -> float:
        return self.anchor_m + (self._count() - self.anchor_count_m) * self.scale + self.shift_m

    def step(self) -> AtoDemand:
        accepted = self._localise()
        noise = self.draw.gauss(0.0, self.settings.speed_sigma_mps)
        moving = abs(self.speed_mps) > 1e-3
        self._track.add(self.now_s, round(self.counted_m / FINE_M))
        if not moving:
            self._track.settle()
        filtered = self._track.rate_pulses_per_s * FINE_M
        speed = filtered * self.scale + noise if moving else 0.0
        standstill = self.still_s >= 2.0
        train = (self.front_m - TRAIN_LENGTH_M, self.front_m)
        limit = self.line.least_limit_mps(*train)
        seen = AtoInput(
            now_ns=round(self.now_s * 1e9),
            dt_s=self.cycle_s + self.told_late_s,
            enabled=self.enabled and not self.emergency,
            front_m=self.located_m,
            speed_mps=speed,
            accel_mps2=self.accel_mps2,
            standstill=standstill,
            accepted_tag_ids=accepted,
            gradient_permille=self.line.mean_gradient_permille(*train),
            ceiling_mps=min(limit, self.ceiling_mps),
            authority_end_m=self.authority_end_m,
            load_kg=self.load_kg,
            traction_ratio=self.traction_ratio,
            traction_mps2=self.traction_ratio * self.traction_most_mps2,
            doors_locked=self.doors_position == 0.0,
            doors_open=self.doors_position == 1.0,
            door_enabled=self.door_permission and standstill and self.held,
            holding_applied=self.held,
            jog_permitted=self.jog_permitted,
            jog_to_tag=self.jog_to_tag,
            jog_back_m=self.jog_back_m,
            ahead_m=self.ahead_m,
            **self.orders,
        )
        demand = self.ato.step(seen)
        self._act(demand)
        self._note(demand)
        for _ in range(round(self.cycle_s / STEP_S)):
            self.physics()
        return demand

    def _act(self, demand: AtoDemand) -> None:
        at_s = self.now_s + self.settings.link_s
        brake = max(0.0, -demand.accel_mps2)
        last = self.brake.queue[-1][1] if self.brake.queue else self.brake.input
        if brake > 0.0 and last == 0.0 and self.settings.brake_delay_s is None:
            self.brake.delay_s = self.draw.uniform(*self.settings.brake_delays_s)
        self.brake.ask(at_s, brake)
        push = max(0.0, demand.accel_mps2)
        self.traction.ask(at_s, -push if demand.reverse else push)
        self.hold_asked = demand.hold
        self.doors_asked = demand.open_doors and self.door_permission

    def _note(self, demand: AtoDemand) -> None:
        trace = self.trace
        before = trace.demands[-1].phase if trace.demands else AtoPhase.OFF
        trace.demands.append(demand)
        trace.times_s.append(self.now_s)
        trace.fronts_m.append(self.front_m)
        trace.speeds_mps.append(self.speed_mps)
        trace.accels_mps2.append(self.accel_mps2)
        if demand.phase is AtoPhase.DEPARTING and before is not AtoPhase.DEPARTING:
            self.leg_start_s = self.now_s
        if demand.distance_to_stop_m > 50.0:
            self.zone_s = self.now_s
        if demand.phase is AtoPhase.STOPPED and before is not AtoPhase.STOPPED:
            stop = self.ato.next_stop
            assert stop is not None
            if stop.dwell_s == 0.0:
                return
            rest_s = self.now_s - self.still_s
            self.stops.append(
                Stop(
                    stop.name,
                    self.front_m - stop.stop_m,
                    rest_s,
                    rest_s - self.leg_start_s,
                    rest_s - self.zone_s,
                )
            )

    def run(self, until: Callable[["Rig"], bool], limit_s: float = 900.0) -> None:
        end_s = self.now_s + limit_s
        while not until(self):
            assert self.now_s < end_s, f"still {self.ato.phase.name} at {self.front_m:.2f} m"
            self.step()


def served(count: int) -> Callable[[Rig], bool]:
    """Condition for `Rig.run`: the train has made this many stops."""
    return lambda rig: len(rig.stops) >= count


def line_with(**run_s: float) -> LineMap:
    """The Florence line with these running times to stations, and none to the other stations."""
    stations = [replace(each, run_s=run_s.get(each.name, 0.0)) for each in LINE.stations]
    return replace(LINE, stations=tuple(stations))


def quick_stops() -> list[Station]:
    """All stations of Florence with a scheduled stop, with short dwell times."""
    return [replace(each, dwell_s=1.0) for each in LINE.stations if each.dwell_s > 0.0]


def run_line(config: AtoConfig | None = None, **settings: Any) -> Rig:
    """Run from chainage zero over all stations of Florence."""
    stops = quick_stops()
    ato = Ato(config or AtoConfig(), LINE, 0.0, stops)
    rig = Rig(ato, LINE, RigSettings(**settings), 0.0)
    rig.run(served(len(stops)))
    return rig
