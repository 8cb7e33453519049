"""A train of plain numbers and a controller that sends what a test sets, without plant and VOBC."""

from dataclasses import replace
from typing import Any

import pytest

from can_dbc.binding import Frame
from can_dbc.brake import BrakeCommand, BrakeStatus
from can_dbc.cab import CabMode
from can_dbc.codec import Encoder
from can_dbc.doors import DoorCommand
from can_dbc.nodes import Direction
from can_dbc.odometer import Tacho
from can_dbc.traction import TractionCommand, TractionStatus
from can_dbc.vobc import (
    AtoPhase,
    Missing,
    Supervision,
    VobcMotion,
    VobcPosition,
    VobcStatus,
    VobcTarget,
)
from firmware_py.trackdb import LineZone
from metro_hil.model.case import MonitorResult
from metro_hil.monitors import Context, MonitorSet, read_monitors
from plant_emulator.truth import Truth
from plant_emulator.world import plan_scenario, unattended

STEP_NS = 10_000_000
STEPS_PER_CYCLE = 5
FRAME_NS = 500_000
"""Time between two frames of a burst, ns."""
SCENARIO = plan_scenario()


class Rig:
    """A train at rest at 1000 m with everything in order; each step advances by 10 ms.

    Frames of controller and units are sent every cycle of 50 ms, speed and position every other
    cycle. They follow the step that begins the cycle by a millisecond. Tests can change them
    between two steps.
    """

    def __init__(
        self,
        tables: list[dict[str, Any]],
        invariants: object,
        *,
        settling_s: float = 0.0,
        lateness_s: float = 0.0,
        **zones: Any,
    ) -> None:
        self.context = Context(
            line=replace(SCENARIO.line, **zones),
            train=SCENARIO.train,
            settling_s=settling_s,
            lateness_s=lateness_s,
        )
        self.monitors = MonitorSet(read_monitors(tables, "test", invariants), self.context)
        self.truth = truth = Truth()
        truth.front_m, truth.rear_m = 1000.0, 931.41
        truth.authority_end_m = 4560.0
        truth.adhesion_ratio = 0.28
        truth.civil_limit_mps = 70.0 / 3.6
        truth.holding = 1.0
        self.said: dict[type[Frame], Frame] = {type(frame): frame for frame in _in_order()}
        self.silent: set[type[Frame]] = set()
        self.now_ns = 0
        self._steps = 0
        self._tracks = True
        self._encoder = Encoder()

    def say(self, kind: type[Frame], **changes: Any) -> None:
        """Change a frame from the next cycle on. A changed position no longer follows the true
        one."""
        self._tracks = self._tracks and kind is not VobcPosition
        self.said[kind] = replace(self.said[kind], **changes)

    def send_now(self, kind: type[Frame], **changes: Any) -> None:
        self.say(kind, **changes)
        self._send([self.said[kind]])

    def tell(self, frame: Frame) -> None:
        """Send a frame once, now; `said` holds the frames of every cycle."""
        self._send([frame])

    def step(self, count: int = 1, **changes: float) -> None:
        """Set the truth, then advance while the train moves at its speed."""
        for name, value in changes.items():
            setattr(self.truth, name, value)
        for _ in range(count):
            if self._steps % STEPS_PER_CYCLE == 0:
                if self._tracks:
                    place = VobcPosition(front_m=self.truth.front_m, uncertainty_m=1.0)
                    self.said[VobcPosition] = place
                self._send([f for kind, f in self.said.items() if self._is_due(kind)])
            self._steps += 1
            self.now_ns += STEP_NS
            truth = self.truth
            truth.t_s = self.now_ns / 1e9
            truth.front_m += truth.speed_mps * 0.01
            truth.rear_m = truth.front_m - SCENARIO.train.length_m
            truth.to_stop_m = 1500.0 - truth.front_m
            self.monitors.sample(truth, self.now_ns)

    def _is_due(self, kind: type[Frame]) -> bool:
        slow = kind in (VobcMotion, VobcPosition) and self._steps // STEPS_PER_CYCLE % 2
        return kind not in self.silent and not slow

    def _send(self, frames: list[Frame]) -> None:
        stamp_ns = self.now_ns + 2 * FRAME_NS
        for frame in frames:
            for can_id, data in self._encoder.encode(frame):
                self.monitors.frame(stamp_ns, can_id, data)
                stamp_ns += FRAME_NS // 2

    def emergency(self, commanded: bool) -> None:
        """Command the emergency brake and let the brake unit request it, at once."""
        self.say(BrakeCommand, emergency_released=not commanded)
        self.truth.emergency = 1.0 if commanded else 0.0

    def result(self, name: str) -> MonitorResult:
        self.monitors.finish()
        return next(each for each in self.monitors.results({}) if each.name == name)

    def margin(self, name: str) -> float:
        margin = self.result(name).margin
        assert margin is not None, f"{name} saw nothing"
        return margin


def _in_order() -> list[Frame]:
    """The frames of a running train without faults, brake first."""
    return [
        BrakeCommand(service_decel_mps2=0.0, emergency_released=True, holding_released=True),
        TractionCommand(force_n=0.0, direction=Direction.FORWARD, traction_permitted=True),
        DoorCommand(enable_left=False, enable_right=False, open_left=False, open_right=False),
        VobcStatus(
            supervision=Supervision.NOMINAL,
            ato_phase=AtoPhase.RUNNING,
            missing=Missing.NOTHING,
            localised=True,
            slip_detected=False,
            work_us=0.0,
            cycle_slips=0,
        ),
        VobcMotion(speed_mps=0.0, ceiling_mps=19.0, emergency_mps=21.0),
        VobcPosition(front_m=1000.0, uncertainty_m=1.0),
        VobcTarget(distance_to_stop_m=500.0, distance_to_authority_m=3500.0),
        Tacho(
            pulses_a=0,
            pulses_b=0,
            direction=Direction.NEUTRAL,
            healthy_a=True,
            healthy_b=True,
            stamp_ms=0.0,
        ),
        BrakeStatus(
            applied_decel_mps2=0.0,
            cylinder_pressure_kpa=0.0,
            emergency_applied=False,
            holding_applied=False,
            released=True,
            ready=True,
        ),
        TractionStatus(force_n=0.0, effort_available_ratio=1.0, traction_cut=False, ready=True),
        unattended(CabMode.AUTO),
    ]


@pytest.fixture
def rig() -> Rig:
    """A rig with all invariants, none of them requested by name."""
    return Rig([], "all")


@pytest.fixture
def settling_rig() -> Rig:
    """A rig whose train and controller do not begin at the same instant and get 2 s to settle."""
    return Rig([], "all", settling_s=2.0)


@pytest.fixture
def zone_rig() -> Rig:
    """A rig on a line with a neutral section from 1050 m to 1080 m."""
    return Rig([], "all", neutral_sections=(LineZone(1050.0, 1080.0),))


@pytest.fixture
def exit_rig() -> Rig:
    """A rig on a line with an evacuation stop from 1230 m to 1300 m."""
    return Rig([], "all", evacuation_stops=(LineZone(1230.0, 1300.0, "exit"),))


@pytest.fixture
def late_rig() -> Rig:
    """A rig in which cycles may be late by 50 ms."""
    return Rig([], "all", lateness_s=0.05)


@pytest.fixture
def rig_at_platform_doors() -> Rig:
    """A rig whose train stands at a platform with platform doors."""
    rig = Rig([], "all")
    station = next(each for each in SCENARIO.line.stations if each.platform_doors)
    rig.truth.front_m = station.stop_m
    return rig


@pytest.fixture
def rig_for() -> type[Rig]:
    """A rig with monitors of the test."""
    return Rig
