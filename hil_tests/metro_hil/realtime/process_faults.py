"""Applies faults of the controller's process with the signals of the kernel.

A slow cycle stops the process for some time after the commands of every cycle arrived on the bus.
The next cycle then begins late, and the cycles due meanwhile slip, as with a program that takes too
long. Only the decision itself is fresher than it would be. The clock of a process cannot be set
from outside: a time namespace is fixed before its first process. So a clock step is refused.
"""

from collections import Counter
from collections.abc import Sequence
from typing import Final, Protocol

from metro_hil.realtime.wires import Blocked
from plant_emulator.faults.declared_process import (
    ClockStep,
    ControllerKilled,
    ControllerPaused,
    SlowCycle,
)
from plant_emulator.faults.kinds import FaultPlace
from plant_emulator.faults.plan import FaultPlan

NS_PER_S: Final = 1_000_000_000
SETTLE_NS: Final = 2_000_000_000
"""Time after a fault of the process in which its effects are attributed to the fault."""


class ControllerHandle(Protocol):
    """What faults can do to the process."""

    def start(self) -> None: ...

    def kill(self) -> None: ...

    def pause(self) -> None: ...

    def resume(self) -> None: ...

    @property
    def there(self) -> bool: ...


def refuse_impossible(faults: Sequence[FaultPlan], *, controller_ours: bool) -> None:
    """Raise Blocked for faults of the process that the bench cannot apply."""
    for plan in faults:
        if isinstance(plan.parameters, ClockStep):
            raise Blocked(
                "clock_step: no program can step another's CLOCK_MONOTONIC; run it in lockstep"
            )
        if isinstance(plan.parameters, ControllerKilled) and plan.parameters.memory_lost:
            raise Blocked(
                "controller_killed: memory_lost: the file of its memory is its own; run it in "
                "lockstep"
            )
        if plan.kind.place is FaultPlace.PROCESS and not controller_ours:
            raise Blocked(
                f"{plan.kind.name}: the bench did not start the controller, so its process "
                "cannot be touched"
            )


class ProcessFaults:
    """The faults of the process that are active, and their effects on it."""

    def __init__(self, controller: ControllerHandle) -> None:
        self._controller = controller
        self._killers: set[int] = set()
        self._pausers: set[int] = set()
        self._slowers: dict[int, float] = {}
        self._resume_ns: int | None = None
        self._touched_ns: int | None = None
        self.started_ns: int | None = None
        """Instant of its last restart."""
        self.touched: Counter[int] = Counter()
        """How often each fault ended or delayed the process, by index of the fault."""
        self.for_good = False
        """Whether a fault without an end killed the process."""

    @property
    def slow(self) -> bool:
        """Whether `cycle_heard` has to be called soon after each cycle."""
        return bool(self._slowers)

    @property
    def next_ns(self) -> int | None:
        return self._resume_ns

    def acting(self, now_ns: int) -> bool:
        """Tell whether a fault of the process acts, or did a moment ago."""
        if self._killers or self._pausers or self._slowers:
            return True
        return self._touched_ns is not None and now_ns - self._touched_ns <= SETTLE_NS

    @property
    def killed(self) -> bool:
        return bool(self._killers)

    def change(self, plan: FaultPlan, active: bool, now_ns: int) -> None:
        """Begin or end a fault; faults of other places are ignored."""
        parameters, index = plan.parameters, plan.index
        if plan.kind.place is not FaultPlace.PROCESS:
            return
        self._touched_ns = now_ns
        if active and isinstance(parameters, ControllerKilled | ControllerPaused):
            self.touched[index] += self._controller.there
        if isinstance(parameters, ControllerKilled):
            _mark(self._killers, index, active)
            self.for_good = self.for_good or (active and _endless(plan))
            self._kill_or_start(now_ns)
        elif isinstance(parameters, ControllerPaused):
            _mark(self._pausers, index, active)
            self._pause_or_resume()
        elif isinstance(parameters, SlowCycle):
            if active:
                self._slowers[index] = parameters.extra_s
            else:
                self._slowers.pop(index, None)

    def cycle_heard(self, now_ns: int) -> None:
        """Note that the controller has just sent the commands of a cycle."""
        if self._slowers and self._resume_ns is None and not self._killers:
            self._controller.pause()
            self.touched.update(index for index, extra_s in self._slowers.items() if extra_s > 0.0)
            self._resume_ns = now_ns + round(sum(self._slowers.values()) * NS_PER_S)

    def poll(self, now_ns: int) -> None:
        if self._resume_ns is not None and now_ns >= self._resume_ns:
            self._resume_ns = None
            self._touched_ns = now_ns
            self._pause_or_resume()

    def _kill_or_start(self, now_ns: int) -> None:
        if self._killers:
            self._controller.kill()
            self._resume_ns = None
        elif not self._controller.there:
            self._controller.start()
            self.started_ns = now_ns

    def _pause_or_resume(self) -> None:
        if self._pausers or self._resume_ns is not None:
            self._controller.pause()
        else:
            self._controller.resume()


def _endless(plan: FaultPlan) -> bool:
    window = plan.window
    return window.end_s is None and window.duration_s is None and not window.until


def _mark(marks: set[int], index: int, active: bool) -> None:
    if active:
        marks.add(index)
    else:
        marks.discard(index)
