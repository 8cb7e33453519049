"""Random sequences of inputs and motion; protection must keep its invariants throughout."""

import math
from dataclasses import replace
from typing import Any

from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, precondition, rule

from can_dbc.alarms import TrainAlarms
from can_dbc.cab import CabMode
from can_dbc.doors import DoorStatus
from can_dbc.vobc import AtoPhase, Cause, OperatingMode, Supervision
from hil_tests.unit.vobc.atp.heard_rig import DESK
from hil_tests.unit.vobc.atp.protection_rig import (
    CONFIG,
    KMH,
    LOCKED,
    STOP_M,
    UNLOCKED,
    WHOLE,
    Train,
)
from vobc.arbitration import arbitrate
from vobc.vocabulary import AtoDemand, Authority, CycleOutput, Motion

MOVING_STATES = (Supervision.NOMINAL, Supervision.WARNING, Supervision.SERVICE)
FULL_LEVER = AtoDemand(5.0, False, True, AtoPhase.RUNNING, 20.0, 100.0)
BAD = st.sampled_from([math.nan, math.inf, -math.inf])
ORDERS_AGED_S = CONFIG.authority_service_ratio * CONFIG.restrictions_age_max_s
AGED_S = CONFIG.authority_service_ratio * CONFIG.authority_age_max_s


class Life(RuleBasedStateMachine):
    """The rules operate every input of a train, while operation always demands the maximum."""

    def __init__(self) -> None:
        super().__init__()
        self.train = Train()
        self.releases = 0
        self.verdict = self.train.step()
        self.output = self.arbitrated(self.train.motion())
        self.before = self.verdict
        self.reset_now = False
        """Desk or centre has just reset the present emergency of a train that could receive it."""

    def arbitrated(self, motion: Motion) -> CycleOutput:
        return arbitrate(
            self.verdict,
            FULL_LEVER,
            motion,
            self.train.image.desk,
            train=WHOLE.train,
            load_kg=10_000.0,
        )

    def go(self, cycles: int = 1) -> None:
        for _ in range(cycles):
            self.before = self.verdict
            self.verdict = self.train.step()
            self.output = self.arbitrated(self.train.motion())
            self.check()

    @property
    def centre_silent(self) -> bool:
        return not self.train.image.orders_age_s <= CONFIG.orders_age_max_s

    def check(self) -> None:
        verdict, before, output, train = self.verdict, self.before, self.output, self.train
        if verdict.supervision not in MOVING_STATES:
            assert output.force_n == 0.0
            assert not output.traction_permitted
            assert not output.emergency_released
            assert output.service_decel_mps2 > 0.0
        if verdict.mode in (OperatingMode.ASLEEP, OperatingMode.STANDBY):
            assert verdict.supervision not in MOVING_STATES
        if before.supervision is Supervision.EMERGENCY is not verdict.supervision:
            assert train.stood_s >= 2.0
            assert self.reset_now
            assert verdict.supervision is Supervision.NO_AUTHORITY
            assert verdict.emergency_cause is Cause.NONE
        assert (verdict.supervision is Supervision.EMERGENCY) is (
            verdict.emergency_cause is not Cause.NONE
        )
        if verdict.reverse_permitted:
            assert verdict.mode is OperatingMode.JOG
            assert train.image.authority is not None
            assert train.image.authority.rear_m is not None
        self.check_mode()

    def check_mode(self) -> None:
        verdict, before, train = self.verdict, self.before, self.train
        assert verdict.ceiling is not None
        assert before.ceiling is not None
        flat = {
            OperatingMode.RESTRICTED: 25.0 * KMH,
            OperatingMode.CREEP: 15.0 * KMH,
            OperatingMode.JOG: 5.0 * KMH,
        }.get(verdict.mode, math.inf)
        assert verdict.ceiling.permitted_mps <= flat + 1e-9
        raised = verdict.ceiling.permitted_mps > before.ceiling.permitted_mps
        # A train that is held may also change its mode while it is pushed away from the end of
        # its authority, which raises the ceiling.
        may_move = verdict.supervision in MOVING_STATES
        if may_move and verdict.mode is not before.mode and raised and train.speed_mps != 0.0:
            assert train.localised
            assert train.image.authority is not None
            assert train.image.authority_age_s < AGED_S
            assert train.image.orders_age_s < ORDERS_AGED_S

    @rule(speed_mps=st.floats(-1.0, 25.0), cycles=st.integers(1, 30))
    def drive(self, speed_mps: float, cycles: int) -> None:
        self.train.speed_mps = speed_mps
        self.go(cycles)

    @rule(cycles=st.integers(1, 60))
    def stand(self, cycles: int) -> None:
        self.train.speed_mps = 0.0
        self.go(cycles)

    @rule(age_s=st.floats(0.0, 6.0), ahead_m=st.one_of(st.none(), st.floats(-50.0, 1500.0)))
    def authority(self, age_s: float, ahead_m: float | None) -> None:
        train = self.train
        end_m = None if ahead_m is None else train.front_m + ahead_m
        rear_m = train.front_m - 100.0
        train.change(
            authority=None if end_m is None else Authority(end_m, 1, 1, rear_m),
            authority_age_s=age_s,
        )
        self.go()

    @rule(name=st.sampled_from(["awake", "hold", "emergency", "creep", "restricted"]))
    def order(self, name: str) -> None:
        orders = self.train.image.orders
        assert orders is not None
        changed: dict[str, Any] = {name: not getattr(orders, name)}
        self.train.change(orders=replace(orders, **changed))
        self.go()

    @rule(age_s=st.floats(0.0, 8.0) | st.floats(0.0, 80.0))
    def silent_centre(self, age_s: float) -> None:
        self.train.change(orders_age_s=age_s)
        self.go()

    @rule(
        mode=st.sampled_from(list(CabMode)),
        button=st.booleans(),
        alarm=st.booleans(),
        restricted=st.booleans(),
        bypass=st.booleans(),
    )
    def desk(
        self, mode: CabMode, button: bool, alarm: bool, restricted: bool, bypass: bool
    ) -> None:
        self.train.change(
            desk=replace(
                DESK,
                mode=mode,
                emergency_released=not button,
                no_passenger_alarm=not alarm,
                restricted_requested=restricted,
                door_bypass_requested=bypass,
            )
        )
        self.go()

    @rule(name=st.sampled_from(["brake", "traction", "doors", "desk", "tag_reader", "alarms"]))
    def silence(self, name: str) -> None:
        age = f"{name}_age_s"
        self.train.change(**{age: 9.0 if getattr(self.train.image, age) == 0.0 else 0.0})
        self.go()

    @rule()
    def place(self) -> None:
        self.train.localised = not self.train.localised
        self.go()

    @rule(doors=st.sampled_from([LOCKED, UNLOCKED]))
    def lock(self, doors: DoorStatus) -> None:
        self.train.change(doors=doors)
        self.go()

    @rule()
    def obstacle(self) -> None:
        self.train.change(alarms=TrainAlarms(False, True))
        self.go()
        self.train.change(alarms=TrainAlarms(True, True))
        self.go()

    @rule()
    def at_a_stop(self) -> None:
        """Place the front a little off a stopping point that operation heads for."""
        self.train.front_m, self.train.stopping_at_m = STOP_M + 0.7, STOP_M
        self.train.speed_mps = 0.0
        self.go(3)

    @rule(desk=st.booleans(), centre=st.booleans(), names_it=st.booleans())
    def reset(self, desk: bool, centre: bool, names_it: bool) -> None:
        train = self.train
        assert train.image.orders is not None
        assert train.image.desk is not None
        self.releases += centre
        number = self.verdict.emergency_number
        self.reset_now = desk or (centre and names_it and not self.centre_silent)
        train.change(
            desk=replace(train.image.desk, reset_requested=desk),
            orders=replace(
                train.image.orders,
                releases=self.releases,
                released_emergency=number if names_it else number + 1,
            ),
        )
        self.go()
        train.change(desk=replace(train.image.desk, reset_requested=False))
        self.go()
        self.reset_now = False

    @rule(bad=BAD, part=st.sampled_from(["front", "speed", "travel", "accel"]))
    def no_number(self, bad: float, part: str) -> None:
        good = self.train.motion()
        motion = {
            "front": replace(good, front_m=replace(good.front_m, high=bad)),
            "speed": replace(good, speed_mps=replace(good.speed_mps, low=bad)),
            "travel": replace(good, travel_m=bad),
            "accel": replace(good, accel_mps2=bad),
        }[part]
        self.verdict = self.train.protection.step(
            self.train.image, motion, odometer_usable=True, not_finite=False
        )
        output = self.arbitrated(motion)
        assert not output.emergency_released
        assert not output.traction_permitted
        assert output.force_n == 0.0
        assert output.motion is None
        self.verdict = self.train.protection.step(
            self.train.image, good, odometer_usable=True, not_finite=True
        )
        assert self.verdict.supervision is Supervision.EMERGENCY

    @precondition(lambda self: self.verdict.supervision is Supervision.EMERGENCY)
    @rule(cycles=st.integers(1, 100))
    def waiting_alone_releases_nothing(self, cycles: int) -> None:
        self.train.speed_mps = 0.0
        self.go(cycles)
        assert self.verdict.supervision is Supervision.EMERGENCY

    @invariant()
    def doors_stay_shut_in_an_emergency(self) -> None:
        if self.verdict.supervision is Supervision.EMERGENCY:
            assert not any(self.verdict.doors)


TestLife = Life.TestCase
TestLife.settings = settings(max_examples=40, stateful_step_count=30, deadline=None)
