"""Faults of the controller's process."""

from dataclasses import dataclass

from plant_emulator.faults.kinds import FaultPlace, Hazard, check_range, fault


@fault("controller_killed", FaultPlace.PROCESS, Hazard.OVERRUN, Hazard.UNWANTED_MOTION)
@dataclass(frozen=True, slots=True)
class ControllerKilled:
    """The process ends at once, as by kill -9, and sends no final frame.

    When the fault ends, the process restarts with its stored memory. A fault without an end leaves
    it dead.
    """

    memory_lost: bool = False
    """The stored memory is empty at the restart."""


@fault("controller_paused", FaultPlace.PROCESS, Hazard.OVERRUN, Hazard.MISLOCATED)
@dataclass(frozen=True, slots=True)
class ControllerPaused:
    """The process is suspended, as by SIGSTOP, and continues when the fault ends."""


@fault("slow_cycle", FaultPlace.PROCESS, Hazard.OVERRUN, Hazard.NO_BRAKE)
@dataclass(frozen=True, slots=True)
class SlowCycle:
    """Every control cycle takes this much longer; cycles that fall due meanwhile are skipped."""

    extra_s: float = 0.08

    def __post_init__(self) -> None:
        check_range(self, "extra_s", 0.0, 10.0)


@fault("clock_step", FaultPlace.PROCESS, Hazard.MISLOCATED, Hazard.OVERRUN)
@dataclass(frozen=True, slots=True)
class ClockStep:
    """The controller's clock jumps forwards once, when the fault begins.

    The clock (CLOCK_MONOTONIC) never runs backwards, so only forward steps exist.
    """

    step_s: float = 1.0

    def __post_init__(self) -> None:
        check_range(self, "step_s", 0.0, 3600.0)
