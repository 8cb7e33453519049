"""Faults of wheels, tachos, radar and accelerometer, and of the rail under them."""

import math
from collections.abc import Callable, Sequence
from typing import Final

from plant_emulator.faults.declared_train import (
    Axle,
    DopplerOutage,
    DopplerWrong,
    ImuBias,
    LoadCell,
    LowAdhesion,
    SensorRestart,
    TachoDrift,
    TachoInterference,
    TachoStuck,
    TachoUnhealthy,
    TrainLonger,
    WheelSlide,
    WheelSlip,
    WheelWear,
)
from plant_emulator.faults.effects import Effect, SettingFault, SharedSetting
from plant_emulator.faults.plan import FaultPlan
from plant_emulator.world import World

NS_PER_S: Final = 1_000_000_000
AXLES: Final = {Axle.A: (0,), Axle.B: (1,), Axle.BOTH: (0, 1)}


class SensorEffects:
    """Combines concurrent faults of sensors.

    Slips, biases and offsets add, scales multiply, and the lowest adhesion counts.
    """

    def __init__(self, world: World) -> None:
        self._slip_ratios = [SharedSetting[float](_slip_of(world, axle)) for axle in (0, 1)]
        self._scales = [SharedSetting[float](_scale_of(world, axle)) for axle in (0, 1)]
        self._failed = [SharedSetting[bool](_failure_of(world, axle)) for axle in (0, 1)]
        own_ratio = world.adhesion_ratio

        def slicken(found: Sequence[float]) -> None:
            world.adhesion_ratio = min(own_ratio, *found) if found else own_ratio

        def blind(found: Sequence[bool]) -> None:
            world.doppler.blind = any(found)

        def mislead(found: Sequence[float]) -> None:
            world.doppler.wrong_ratio = math.prod(found, start=1.0)

        def misweigh(found: Sequence[float]) -> None:
            world.load_cell_ratio = math.prod(found, start=1.0)

        def lengthen(found: Sequence[float]) -> None:
            world.length_m = world.train.length_m + sum(found, 0.0)

        self._added = [SharedSetting[float](_added_of(world, axle)) for axle in (0, 1)]
        self._load = SharedSetting[float](misweigh)
        self._length = SharedSetting[float](lengthen)
        self._adhesion = SharedSetting[float](slicken)
        self._blind = SharedSetting[bool](blind)
        self._wrong = SharedSetting[float](mislead)
        self._bias = SharedSetting[float](lambda found: world.imu.shift(sum(found, 0.0)))

    def of(self, plan: FaultPlan) -> Effect | None:
        """Return the effect of a sensor fault; None for a fault of another place."""
        index = plan.index
        match plan.parameters:
            case WheelSlip(slip_ratio=ratio, axle=axle, ramp_s=ramp_s):
                return Ramped(index, self._on(axle, self._slip_ratios), ratio, ramp_s)
            case WheelSlide(slide_ratio=ratio, axle=axle, ramp_s=ramp_s):
                return Ramped(index, self._on(axle, self._slip_ratios), -ratio, ramp_s)
            case TachoDrift(ratio_per_s=ratio_per_s, axle=axle):
                return Drifting(index, self._on(axle, self._scales), ratio_per_s)
            case TachoStuck(axle=axle):
                return SettingFault(index, *((knob, 0.0) for knob in self._on(axle, self._scales)))
            case TachoUnhealthy(axle=axle):
                stuck = ((knob, 0.0) for knob in self._on(axle, self._scales))
                return SettingFault(
                    index, *stuck, *((k, True) for k in self._on(axle, self._failed))
                )
            case WheelWear(diameter_ratio=ratio, axle=axle):
                return SettingFault(
                    index, *((k, 1.0 / ratio) for k in self._on(axle, self._scales))
                )
            case TachoInterference(pulses_per_s=pulses_per_s, axle=axle):
                added = ((knob, pulses_per_s) for knob in self._on(axle, self._added))
                return SettingFault(index, *added)
            case SensorRestart():
                return SettingFault(index)  # the plant silences and restarts the node
            case LoadCell(share_ratio=ratio):
                return SettingFault(index, (self._load, ratio))
            case TrainLonger(extra_m=extra_m):
                return SettingFault(index, (self._length, extra_m))
            case LowAdhesion(adhesion_ratio=ratio):
                return SettingFault(index, (self._adhesion, ratio))
            case DopplerOutage():
                return SettingFault(index, (self._blind, True))
            case DopplerWrong(error_ratio=ratio):
                return SettingFault(index, (self._wrong, 1.0 + ratio))
            case ImuBias(bias_mps2=bias_mps2):
                return SettingFault(index, (self._bias, bias_mps2))
        return None

    @staticmethod
    def _on(axle: Axle, knobs: Sequence[SharedSetting]) -> list[SharedSetting]:  # type: ignore[type-arg]
        return [knobs[place] for place in AXLES[axle]]


class Ramped:
    """A share that grows from 0 to its full value, and returns to 0 after the end."""

    def __init__(
        self, index: int, knobs: Sequence[SharedSetting[float]], ratio: float, ramp_s: float
    ) -> None:
        self._index, self._knobs, self._ratio = index, knobs, ratio
        self._ramp_ns = ramp_s * NS_PER_S
        self._active = False
        self._since_ns = 0
        self._from_level = self._level = 0.0

    def begin(self, now_ns: int) -> None:
        self._turn(now_ns, active=True)

    def end(self, now_ns: int) -> None:
        self._turn(now_ns, active=False)

    def _turn(self, now_ns: int, *, active: bool) -> None:
        self._active, self._since_ns, self._from_level = active, now_ns, self._level

    def step(self, now_ns: int) -> bool:
        gone_ns = now_ns - self._since_ns
        change = gone_ns / self._ramp_ns if gone_ns < self._ramp_ns else 1.0
        level = self._from_level + (change if self._active else -change)
        self._level = max(0.0, min(1.0, level))
        for knob in self._knobs:
            if self._level > 0.0 or self._active:
                knob.set(self._index, self._ratio * self._level)
            else:
                knob.clear(self._index)
        return self._active or self._level > 0.0


class Drifting:
    """A scale that deviates more with every second of the fault, and returns to normal at its
    end.
    """

    def __init__(
        self, index: int, knobs: Sequence[SharedSetting[float]], ratio_per_s: float
    ) -> None:
        self._index, self._knobs, self._ratio_per_s = index, knobs, ratio_per_s
        self._since_ns: int | None = None

    def begin(self, now_ns: int) -> None:
        self._since_ns = now_ns

    def end(self, now_ns: int) -> None:
        self._since_ns = None
        for knob in self._knobs:
            knob.clear(self._index)

    def step(self, now_ns: int) -> bool:
        if self._since_ns is None:
            return False
        gone_s = (now_ns - self._since_ns) / NS_PER_S
        for knob in self._knobs:
            knob.set(self._index, 1.0 + self._ratio_per_s * gone_s)
        return True


def _slip_of(world: World, place: int) -> Callable[[Sequence[float]], None]:
    axle = world.tachos.axles[place]

    def turn(found: Sequence[float]) -> None:
        axle.forced_slip_ratio = sum(found, 0.0)

    return turn


def _scale_of(world: World, place: int) -> Callable[[Sequence[float]], None]:
    axle = world.tachos.axles[place]
    return lambda found: axle.rescale(math.prod((max(0.0, ratio) for ratio in found), start=1.0))


def _added_of(world: World, place: int) -> Callable[[Sequence[float]], None]:
    axle = world.tachos.axles[place]

    def turn(found: Sequence[float]) -> None:
        axle.added_pulses_per_s = sum(found, 0.0)

    return turn


def _failure_of(world: World, place: int) -> Callable[[Sequence[bool]], None]:
    def turn(found: Sequence[bool]) -> None:
        world.tachos.healthy[place] = not any(found)

    return turn
