"""The controller's process in virtual time, which faults can kill, pause, slow and mislead.

The effects are those of a real kernel. A paused process later finds all messages in its inboxes,
and its missed cycles have slipped. A killed process sends nothing more, and messages for it are
lost; when it starts again, it knows what its memory kept. A slow process sends its decision only
when it has finished, and cycles that fall due meanwhile slip. A stepped clock makes earlier
messages old. Only commands on the bus leave the process, so nothing else is modelled.
"""

from collections import Counter, deque
from collections.abc import Callable, Sequence
from typing import Final, Protocol

from firmware_py.clock.executive import Executive
from firmware_py.ports import (
    CanFrame,
    CanPort,
    LinkCounters,
    RadioMessage,
    RadioPort,
    SerialChunk,
    SerialPort,
)
from plant_emulator.faults.declared_process import (
    ClockStep,
    ControllerKilled,
    ControllerPaused,
    SlowCycle,
)
from plant_emulator.faults.plan import FaultPlan
from vobc.vocabulary import SAFE_OUTPUT, CycleOutput

POLL_NS: Final = 1_000_000
CYCLE_TASKS: Final = frozenset({"control", "grant"})
"""Tasks that a slow process delays. An external controller has only `grant`."""
NS_PER_S: Final = 1_000_000_000


class BenchDevice(Protocol):
    """A controller as the bench runs it."""

    executive: Executive

    @property
    def output(self) -> CycleOutput:
        """Output of the last cycle."""
        ...

    def stop(self, now_ns: int) -> None: ...


class ProcessClock:
    """Lead of the process's clock over true time, and the delay of its output."""

    def __init__(self) -> None:
        self.ahead_ns = 0
        self.held_ns = 0
        """Delay of each output; 0 while the process is not slow."""


class ProcessCan:
    """The controller's CAN port as its process sees it."""

    def __init__(self, port: CanPort, clock: ProcessClock) -> None:
        self._port, self._clock = port, clock
        self._held: deque[tuple[int, int, bytes]] = deque()

    @property
    def counters(self) -> LinkCounters:
        return self._port.counters

    def send(self, now_ns: int, can_id: int, data: bytes) -> None:
        clock = self._clock
        self._held.append((now_ns - clock.ahead_ns + clock.held_ns, can_id, data))
        self.poll(now_ns - clock.ahead_ns)

    def poll(self, true_ns: int) -> None:
        """Send what is due."""
        held = self._held
        while held and held[0][0] <= true_ns:
            due_ns, can_id, data = held.popleft()
            self._port.send(due_ns, can_id, data)

    @property
    def due_ns(self) -> int | None:
        """True instant at which the next held frame is due."""
        return self._held[0][0] if self._held else None

    def forget(self) -> None:
        """Drop the held frames of a process that has been killed."""
        self._held.clear()

    def receive(self, now_ns: int) -> Sequence[CanFrame]:
        ahead_ns = self._clock.ahead_ns
        frames = self._port.receive(now_ns - ahead_ns)
        if not ahead_ns:
            return frames
        return [frame._replace(stamp_ns=frame.stamp_ns + ahead_ns) for frame in frames]

    def close(self) -> None:
        self._port.close()


class ProcessSerial:
    """The tag reader's line as the process sees it; the controller sends nothing on it."""

    def __init__(self, port: SerialPort, clock: ProcessClock) -> None:
        self._port, self._clock = port, clock

    @property
    def counters(self) -> LinkCounters:
        return self._port.counters

    def send(self, now_ns: int, data: bytes) -> None:
        self._port.send(now_ns - self._clock.ahead_ns, data)

    def receive(self, now_ns: int) -> Sequence[SerialChunk]:
        ahead_ns = self._clock.ahead_ns
        chunks = self._port.receive(now_ns - ahead_ns)
        return [chunk._replace(stamp_ns=chunk.stamp_ns + ahead_ns) for chunk in chunks]

    def close(self) -> None:
        self._port.close()


class ProcessRadio:
    """The radio as the process sees it."""

    def __init__(self, port: RadioPort, clock: ProcessClock) -> None:
        self._port, self._clock = port, clock

    @property
    def counters(self) -> LinkCounters:
        return self._port.counters

    def send(self, now_ns: int, key: str, payload: bytes) -> None:
        self._port.send(now_ns - self._clock.ahead_ns, key, payload)

    def receive(self, now_ns: int) -> Sequence[RadioMessage]:
        ahead_ns = self._clock.ahead_ns
        heard = self._port.receive(now_ns - ahead_ns)
        return [message._replace(stamp_ns=message.stamp_ns + ahead_ns) for message in heard]

    def close(self) -> None:
        self._port.close()


StartDevice = Callable[[ProcessCan, ProcessSerial, ProcessRadio, int, bool], BenchDevice]
"""Starts a controller on these ports at this instant of its clock; True for a restart."""


class ControllerProcess:
    """Runs a controller under the process faults of a case; runs like a controller itself."""

    def __init__(
        self,
        start: StartDevice,
        end: Callable[[], None],
        *,
        can: CanPort,
        tags: SerialPort,
        radio: RadioPort,
        start_ns: int,
        forget: Callable[[], None] | None = None,
    ) -> None:
        """Start the controller.

        Args:
            end: removes a controller that was killed.
            forget: erases its memory; None if it has none.
        """
        self._start, self._end, self._forget = start, end, forget
        self._clock = ProcessClock()
        self._can = ProcessCan(can, self._clock)
        self._tags = ProcessSerial(tags, self._clock)
        self._radio = ProcessRadio(radio, self._clock)
        self._device: BenchDevice | None = start(
            self._can, self._tags, self._radio, start_ns, False
        )
        self._killers: set[int] = set()
        self._pausers: set[int] = set()
        self._slowers: dict[int, float] = {}
        self._busy_until_ns = 0
        self._missed_ns = -1
        """Due instant of the last cycle that a pause made it miss."""
        self.touched: Counter[int] = Counter()
        """Number of kills, clock steps or delayed cycles, by index of the fault."""
        self.executive = Executive.woken("process", self._wake, start_ns)

    @property
    def output(self) -> CycleOutput:
        """Output of the last cycle; the safe output while there is no controller."""
        return SAFE_OUTPUT if self._device is None else self._device.output

    def change(self, plan: FaultPlan, active: bool, now_ns: int) -> None:
        """Begin or end a process fault."""
        parameters = plan.parameters
        self.touched.setdefault(plan.index, 0)
        if isinstance(parameters, ControllerKilled):
            _mark(self._killers, plan.index, active)
            self.touched[plan.index] += active and self._device is not None
            self._kill()
            if active and parameters.memory_lost and self._forget is not None:
                self._forget()
        elif isinstance(parameters, ControllerPaused):
            _mark(self._pausers, plan.index, active)
        elif isinstance(parameters, SlowCycle):
            if active:
                self._slowers[plan.index] = parameters.extra_s
            else:
                self._slowers.pop(plan.index, None)
        elif isinstance(parameters, ClockStep) and active:
            self._clock.ahead_ns += round(parameters.step_s * NS_PER_S)
            self.touched[plan.index] += parameters.step_s > 0.0

    def _kill(self) -> None:
        if self._killers and self._device is not None:
            self._device = None
            self._can.forget()
            self._end()

    def _start_again(self, now_ns: int) -> BenchDevice:
        there_ns = now_ns + self._clock.ahead_ns
        for port in (self._can, self._tags, self._radio):
            # Messages for a process that did not run are lost.
            port.receive(there_ns)
        self._busy_until_ns = now_ns
        return self._start(self._can, self._tags, self._radio, there_ns, True)

    def _wake(self, now_ns: int) -> int:
        """Wake at each poll, and at the exact instant of a task or held frame in between."""
        self._poll(now_ns)
        poll_ns = now_ns - now_ns % POLL_NS + POLL_NS
        held_ns = self._can.due_ns
        if held_ns is not None and now_ns < held_ns < poll_ns:
            # At the poll, other frames may have been sent that must come after this one.
            poll_ns = held_ns
        if self._device is None:
            return poll_ns
        due_ns = self._device.executive.next_due_ns() - self._clock.ahead_ns
        return min(poll_ns, due_ns) if due_ns > now_ns else poll_ns

    def _poll(self, now_ns: int) -> None:
        self._can.poll(now_ns)
        if self._device is None and not self._killers:
            self._device = self._start_again(now_ns)
        device, clock = self._device, self._clock
        if device is None or now_ns < self._busy_until_ns:
            return
        there_ns = now_ns + clock.ahead_ns
        if self._pausers:
            self._count_missed(device.executive.next_due_ns(), there_ns)
            return
        if device.executive.next_due_ns() > there_ns:
            return
        clock.held_ns = 0
        if self._slowers and _in_cycle(device.executive, there_ns):
            clock.held_ns = round(sum(self._slowers.values()) * NS_PER_S)
            self.touched.update(index for index, extra_s in self._slowers.items() if extra_s > 0.0)
            self._busy_until_ns = now_ns + clock.held_ns
        while device.executive.run_next(there_ns):
            pass
        clock.held_ns = 0

    def _count_missed(self, due_ns: int, now_ns: int) -> None:
        """Count each cycle that a paused process misses once."""
        if self._missed_ns != due_ns <= now_ns:
            self._missed_ns = due_ns
            self.touched.update(self._pausers)

    def stop(self, now_ns: int) -> None:
        """Send the safe output, unless the process is dead or paused."""
        if self._device is not None and not self._pausers:
            self._device.stop(now_ns + self._clock.ahead_ns)


def _in_cycle(executive: Executive, now_ns: int) -> bool:
    return any(task.name in CYCLE_TASKS for task in executive.due(now_ns))


def _mark(marks: set[int], index: int, active: bool) -> None:
    if active:
        marks.add(index)
    else:
        marks.discard(index)
