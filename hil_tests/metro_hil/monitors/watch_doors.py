"""Invariants of the doors (17, 30, 31, 32)."""

import itertools

from metro_hil.monitors.context import Context
from metro_hil.monitors.description import Spoken
from metro_hil.monitors.gauge import Gauge
from metro_hil.monitors.place import LinePlaces
from metro_hil.monitors.watch_brake import PULL_N
from plant_emulator.truth import Truth

NS_PER_S = 1_000_000_000


class DoorWatch:
    """Judges steps in which a door is not locked or may be opened."""

    __slots__ = (
        "_car_ends_m",
        "_cut_ns",
        "_left_enabled_ns",
        "_left_open",
        "_place",
        "_right_enabled_ns",
        "_right_open",
        "_slack_ns",
        "_unlocked_ns",
        "_window_m",
        "_zero_speed_mps",
        "enable",
        "enabled_speed",
        "holding",
        "place",
        "platform",
        "side",
        "speed",
        "traction",
    )

    def __init__(
        self,
        context: Context,
        where: LinePlaces,
        *,
        enabled_speed: Gauge,
        speed: Gauge,
        place: Gauge,
        platform: Gauge,
        side: Gauge,
        enable: Gauge,
        traction: Gauge,
        holding: Gauge,
    ) -> None:
        self._place = where
        self.enabled_speed, self.speed, self.place, self.side = enabled_speed, speed, place, side
        self.platform = platform
        self.enable, self.traction, self.holding = enable, traction, holding
        self._zero_speed_mps = context.zero_speed_mps
        self._window_m = context.door_window_m
        lengths_m = [car.length_m for car in context.train.cars]
        self._car_ends_m = list(itertools.accumulate(lengths_m, initial=0.0))
        self._cut_ns = round(context.traction_cut_s * NS_PER_S)
        self._slack_ns = round(context.slack_s * NS_PER_S)
        self._left_open = self._right_open = False
        # The initial instants are too old to count.
        self._left_enabled_ns = self._right_enabled_ns = -NS_PER_S
        self._unlocked_ns = -1

    def enabled(self, truth: Truth, now_ns: int, spoken: Spoken) -> None:
        """Take a step in which the controller enables a side, which requires zero speed."""
        if spoken.enable_left > 0.0:
            self._left_enabled_ns = now_ns
        if spoken.enable_right > 0.0:
            self._right_enabled_ns = now_ns
        margin_mps = self._zero_speed_mps - abs(truth.speed_mps)
        if margin_mps < self.enabled_speed.least:
            self.enabled_speed.see(margin_mps, now_ns)

    def sample(self, truth: Truth, now_ns: int, spoken: Spoken) -> None:
        left, right = truth.left_open > 0.0, truth.right_open > 0.0
        if left and not self._left_open:
            self.enable.said(now_ns - self._left_enabled_ns <= self._slack_ns, now_ns)
        if right and not self._right_open:
            self.enable.said(now_ns - self._right_enabled_ns <= self._slack_ns, now_ns)
        self._left_open, self._right_open = left, right
        # A bypass needs both the person at the desk and the controller's event.
        bypassed = spoken.door_bypassed > 0.0 and spoken.door_bypass_pressed > 0.0
        if truth.doors_locked > 0.0 or bypassed:
            self._unlocked_ns = -1
        else:
            self._check_traction(truth, now_ns)
        if left or right:
            self._check_open(truth, now_ns, left=left, right=right)

    def _check_traction(self, truth: Truth, now_ns: int) -> None:
        if self._unlocked_ns < 0:
            self._unlocked_ns = now_ns
            self.traction.see(self._cut_ns / NS_PER_S, now_ns)
        elif truth.drive_n > PULL_N:
            self.traction.see((self._cut_ns - (now_ns - self._unlocked_ns)) / NS_PER_S, now_ns)

    def _check_open(self, truth: Truth, now_ns: int, *, left: bool, right: bool) -> None:
        margin_mps = self._zero_speed_mps - abs(truth.speed_mps)
        if margin_mps < self.speed.least:
            self.speed.see(margin_mps, now_ns)
        margin_m = self._window_m - abs(self._place.stop_error_m(truth.front_m))
        if margin_m < self.place.least:
            self.place.see(margin_m, now_ns)
        room_m = self._room_m(truth)
        if room_m < self.platform.least:
            self.platform.see(room_m, now_ns)
        platform = self._place.side(truth.front_m)
        wrong = (left and not platform >= 0.0) or (right and not platform <= 0.0)
        self.side.said(not wrong, now_ns)
        self.holding.said(truth.holding > 0.0 or truth.emergency > 0.0, now_ns)

    def _room_m(self, truth: Truth) -> float:
        """Return how far all open doors lie within the platform; negative by the part beyond it.

        The outer ends of the first and the last car with an open door decide.
        """
        ends_m, front_m = self._car_ends_m, truth.front_m
        first, end = 0, len(ends_m) - 1
        cars = int(truth.left_cars) | int(truth.right_cars)
        if cars:
            first, end = (cars & -cars).bit_length() - 1, cars.bit_length()
        return self._place.room_m(front_m, front_m - ends_m[end], front_m - ends_m[first])
