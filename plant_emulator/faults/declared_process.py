"""Faults of the controller's process."""

from dataclasses import dataclass

from plant_emulator.faults.kinds import FaultPlace, Hazard, check_range, fault


@fault("controller_killed", FaultPlace.PROCESS, Hazard.OVERRUN, Hazard.UNWANTED_MOTION)
@dataclass(frozen=True, slots=True)
class ControllerKilled:
    """The process ends at once, as by kill -9, without a last word on the bus.

    When the fault ends it is started again, with what its memory kept; a fault without an end
    leaves it dead.
    """

    memory_lost: bool = False
    """Its memory is empty when it is started again."""


@fault("controller_paused", FaultPlace.PROCESS, Hazard.OVERRUN, Hazard.MISLOCATED)
@dataclass(frozen=True, slots=True)
class ControllerPaused:
    """The process stands still, as by SIGSTOP, and goes on when the fault ends."""


@fault("slow_cycle", FaultPlace.PROCESS, Hazard.OVERRUN, Hazard.NO_BRAKE)
@dataclass(frozen=True, slots=True)
class SlowCycle:
    """Every control cycle takes so much longer; cycles that fall due meanwhile are slipped."""

    extra_s: float = 0.08

    def __post_init__(self) -> None:
        check_range(self, "extra_s", 0.0, 10.0)


@fault("clock_step", FaultPlace.PROCESS, Hazard.MISLOCATED, Hazard.OVERRUN)
@dataclass(frozen=True, slots=True)
class ClockStep:
    """The controller's clock jumps once, forwards, when the fault begins.

    Its clock never runs backwards (CLOCK_MONOTONIC), so only forward steps exist.
    """

    step_s: float = 1.0

    def __post_init__(self) -> None:
        check_range(self, "step_s", 0.0, 3600.0)
