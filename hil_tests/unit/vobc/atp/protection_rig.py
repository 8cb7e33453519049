"""An emulated train for tests of protection: tests set its motion and its inputs."""

from dataclasses import replace
from typing import Any

from can_dbc.alarms import TrainAlarms
from can_dbc.brake import BrakeStatus
from can_dbc.cab import CabMode
from can_dbc.doors import DoorState, DoorStatus
from can_dbc.tags import TagReaderHealth
from can_dbc.traction import TractionStatus
from can_dbc.vobc import Supervision
from firmware_py.trackdb import load_line
from hil_tests.unit.vobc.atp.heard_rig import DESK
from vobc.atp import Protection, ProtectionVerdict
from vobc.config import load_config
from vobc.vocabulary import NEVER_S, Authority, CycleInput, Interval, Motion, Orders

LINE = load_line("florence")
WHOLE = load_config("florence4")
CONFIG = WHOLE.atp
CYCLE_S = 0.05
BETWEEN_M = 3250.0
"""A chainage between stations II and III, m."""
STOP_M = LINE.station("II").stop_m
KMH = 1.0 / 3.6

MANUAL = replace(DESK, mode=CabMode.MANUAL)
ORDERS = Orders(True, False, False, False, False, 0, False, False, True, True, True)
LOCKED = DoorStatus(True, DoorState.LOCKED, DoorState.LOCKED, True)
UNLOCKED = DoorStatus(False, DoorState.LOCKED, DoorState.UNKNOWN, True)
FREE_BRAKE = BrakeStatus(0.0, 0.0, False, False, True, True)
CUT = TractionStatus(0.0, 1.0, True, True)
WELL = CycleInput(
    now_ns=0,
    dt_s=CYCLE_S,
    tacho_age_s=0.0,
    traction=CUT,
    traction_age_s=0.0,
    brake=FREE_BRAKE,
    brake_age_s=0.0,
    doors=LOCKED,
    doors_age_s=0.0,
    desk=DESK,
    desk_age_s=0.0,
    tag_reader=TagReaderHealth(True, 0, 0.0),
    tag_reader_age_s=0.0,
    authority=Authority(BETWEEN_M + 1200.0, 1, 1),
    authority_age_s=0.2,
    alarms=TrainAlarms(True, True),
    alarms_age_s=0.0,
    orders=ORDERS,
    orders_age_s=0.2,
)


class Train:
    """A train whose motion and inputs the test sets."""

    def __init__(self, front_m: float = BETWEEN_M) -> None:
        self.protection = Protection(
            CONFIG, LINE, train_length_m=WHOLE.train.length_m, cycle_s=CYCLE_S
        )
        self.image = WELL
        self.front_m = front_m
        self.travel_m = 0.0
        self.speed_mps = 0.0
        self.half_mps = 0.1
        self.stood_s = 10.0
        self.localised = True
        self.stopping_at_m: float | None = None

    def change(self, **changes: Any) -> None:
        self.image = replace(self.image, **changes)

    def motion(self) -> Motion:
        speed = self.speed_mps
        half = self.half_mps if speed else 0.05
        return Motion(
            Interval(self.front_m - 0.1, self.front_m, self.front_m + 0.1),
            Interval(speed - half, speed, speed + half),
            0.0,
            self.travel_m,
            self.stood_s >= 0.5,
            self.stood_s >= 2.0,
            self.localised,
            False,
            (),
        )

    def step(self, cycles: int = 1) -> ProtectionVerdict:
        for _ in range(cycles):
            moved_m = self.speed_mps * CYCLE_S
            self.front_m += moved_m
            self.travel_m += moved_m
            self.stood_s = 0.0 if self.speed_mps else self.stood_s + CYCLE_S
            verdict = self.protection.step(
                self.image,
                self.motion(),
                odometer_usable=True,
                not_finite=False,
                stopping_at_m=self.stopping_at_m,
            )
        return verdict

    def runs(self, speed_mps: float) -> ProtectionVerdict:
        verdict = self.step(2)
        assert verdict.supervision is Supervision.NOMINAL, verdict.cause
        self.speed_mps = speed_mps
        return self.step()

    def lost(self) -> None:
        """Take away the position and the authority."""
        self.localised = False
        self.change(authority=None, authority_age_s=NEVER_S)
