"""The controller's process in virtual time, so that it can be killed, paused, slowed and misled.

What happens is what the kernel would do. A paused process finds all that came meanwhile in its
inboxes and its missed cycles slipped. A killed one says nothing more; what came for it is lost, and
when it is started again it knows what its memory kept. A slow one sends what it decided only when
it is done, and its cycles that fall due meanwhile slip. A stepped clock makes old what was heard
before. Commands on the bus are the only thing that leaves, so nothing else has to be modelled.
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
"""What is slowed; the second is all that a program of its own does."""
NS_PER_S: Final = 1_000_000_000


class BenchDevice(Protocol):
    """A controller as the bench runs it."""

    executive: Executive

    @property
    def output(self) -> CycleOutput:
        """Of the last cycle."""
        ...

    def stop(self, now_ns: int) -> None: ...


class ProcessClock:
    """What the process's clock is ahead of true time, and until when what it sends is held back."""

    def __init__(self) -> None:
        self.ahead_ns = 0
        self.held_ns = 0
        """Added to the instant at which something leaves; 0 while the process is not slow."""


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
        """Let go what is due."""
        held = self._held
        while held and held[0][0] <= true_ns:
            due_ns, can_id, data = held.popleft()
            self._port.send(due_ns, can_id, data)

    @property
    def due_ns(self) -> int | None:
        """In true time, when the next thing is to go that is held back."""
        return self._held[0][0] if self._held else None

    def forget(self) -> None:
        """The process is gone, and with it what it was about to say."""
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
    """The tag reader's line as the process sees it. Nothing is sent on it by the controller."""

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
"""Starts a controller on these ports at this instant of its clock; True when it ran before."""


class ControllerProcess:
    """Runs a controller under the process faults of a case; itself run like a controller."""

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
        """Args:
        end: takes away a controller that was killed.
        forget: empties its memory; None where it has none.
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
        """The last cycle that fell due while the process was paused."""
        self.touched: Counter[int] = Counter()
        """By index of the fault: processes ended, clocks moved, cycles held up."""
        self.executive = Executive.woken("process", self._wake, start_ns)

    @property
    def output(self) -> CycleOutput:
        """Of the last cycle; the safe output while there is no controller."""
        return SAFE_OUTPUT if self._device is None else self._device.output

    def change(self, plan: FaultPlan, active: bool, now_ns: int) -> None:
        """A process fault begins or ends."""
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
            # What came while nobody listened reached nobody.
            port.receive(there_ns)
        self._busy_until_ns = now_ns
        return self._start(self._can, self._tags, self._radio, there_ns, True)

    def _wake(self, now_ns: int) -> int:
        """At each poll, and at the very instant of a task or of what is held back between two."""
        self._poll(now_ns)
        poll_ns = now_ns - now_ns % POLL_NS + POLL_NS
        held_ns = self._can.due_ns
        if held_ns is not None and now_ns < held_ns < poll_ns:
            # Nobody may be told at the poll of what was said before others said something.
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
        """A paused process misses what falls due; it counts once."""
        if self._missed_ns != due_ns <= now_ns:
            self._missed_ns = due_ns
            self.touched.update(self._pausers)

    def stop(self, now_ns: int) -> None:
        """The last word, if there is anybody to say it."""
        if self._device is not None and not self._pausers:
            self._device.stop(now_ns + self._clock.ahead_ns)


def _in_cycle(executive: Executive, now_ns: int) -> bool:
    return any(task.name in CYCLE_TASKS for task in executive.due(now_ns))


def _mark(marks: set[int], index: int, active: bool) -> None:
    if active:
        marks.add(index)
    else:
        marks.discard(index)
