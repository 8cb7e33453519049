"""A controller process that is killed, paused, slowed or given a wrong time."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import pytest

from firmware_py.clock.clock import LockstepClock
from firmware_py.clock.executive import Executive, Task, run
from firmware_py.ports import CanFrame, LinkCounters, RadioMessage, SerialChunk
from metro_hil.faults.process import ControllerProcess, ProcessCan, ProcessRadio, ProcessSerial
from plant_emulator.faults.plan import read_faults
from vobc.vocabulary import SAFE_OUTPUT, CycleOutput

NS_PER_MS = 1_000_000
CYCLE_MS = 50


@dataclass
class Wire:
    """A CAN port that receives a frame every 10 ms and records what is sent, and when."""

    sent: list[tuple[int, int]] = field(default_factory=list)
    read_ns: int = -1
    counters: LinkCounters = field(default_factory=LinkCounters)

    def send(self, now_ns: int, can_id: int, data: bytes) -> None:
        self.sent.append((now_ns // NS_PER_MS, can_id))

    def receive(self, now_ns: int) -> Sequence[CanFrame]:
        step_ns = 10 * NS_PER_MS
        first = self.read_ns // step_ns + 1
        self.read_ns = now_ns
        return [
            CanFrame(number * step_ns, 1, b"") for number in range(first, now_ns // step_ns + 1)
        ]

    def close(self) -> None: ...


class Nothing:
    """A serial line and a radio that receive nothing."""

    counters = LinkCounters()

    def send(self, now_ns: int, *what: object) -> None: ...

    def receive(self, now_ns: int) -> Sequence[SerialChunk | RadioMessage]:
        return ()

    def close(self) -> None: ...


class Beacon:
    """A controller that sends one frame per cycle and records received frames and missed cycles."""

    def __init__(self, can: ProcessCan, start_ns: int, again: bool, cycle_ms: float) -> None:
        self.can, self.again = can, again
        self.output: CycleOutput = SAFE_OUTPUT
        self.cycles: list[tuple[int, int, list[int]]] = []
        """Instant in ms, cycles missed before, ages in ms of the received frames."""
        self.instants_ns: list[int] = []
        self.executive = Executive([Task("control", cycle_ms, self.control)], start_ns)

    def control(self, now_ns: int) -> None:
        self.instants_ns.append(now_ns)
        heard = [(now_ns - frame.stamp_ns) // NS_PER_MS for frame in self.can.receive(now_ns)]
        self.cycles.append((now_ns // NS_PER_MS, self.executive.slips_before("control"), heard))
        self.can.send(now_ns, 0x100, b"")

    def stop(self, now_ns: int) -> None:
        self.can.send(now_ns, 0x1FF, b"")


class Bench:
    def __init__(self, cycle_ms: float = CYCLE_MS) -> None:
        self.cycle_ms = cycle_ms
        self.wire = Wire()
        self.devices: list[Beacon] = []
        self.clock = LockstepClock()
        nothing = Nothing()
        self.ended = self.forgotten = 0
        self.process = ControllerProcess(
            self.start,
            self.end,
            can=self.wire,
            tags=nothing,  # type: ignore[arg-type]
            radio=nothing,  # type: ignore[arg-type]
            start_ns=0,
            forget=self.forget,
        )

    def forget(self) -> None:
        self.forgotten += 1

    def start(
        self, can: ProcessCan, _: ProcessSerial, __: ProcessRadio, now_ns: int, again: bool
    ) -> Beacon:
        self.devices.append(Beacon(can, now_ns, again, self.cycle_ms))
        return self.devices[-1]

    def end(self) -> None:
        self.ended += 1

    def run_to(self, ms: int) -> None:
        run([self.process.executive], self.clock, lambda now_ns: now_ns >= ms * NS_PER_MS)

    def change(self, active: bool, kind: str, **parameters: object) -> None:
        (plan,) = read_faults([{"kind": kind, **parameters}], "test")
        self.process.change(plan, active, self.clock.now_ns())

    @property
    def sent_ms(self) -> list[int]:
        return [ms for ms, _ in self.wire.sent]


@pytest.mark.parametrize("memory_lost", [False, True])
def test_a_killed_process_loses_its_memory_once_and_only_if_the_fault_requests_it(
    memory_lost: bool,
) -> None:
    bench = Bench()
    bench.run_to(60)
    bench.change(True, "controller_killed", memory_lost=memory_lost)
    bench.run_to(120)
    bench.change(False, "controller_killed", memory_lost=memory_lost)

    bench.run_to(200)

    assert bench.forgotten == (1 if memory_lost else 0)
    assert [device.again for device in bench.devices] == [False, True]


def test_without_a_fault_the_process_keeps_its_schedule() -> None:
    bench = Bench()

    bench.run_to(201)

    assert bench.sent_ms == [0, 50, 100, 150, 200]


def test_a_process_whose_cycle_falls_between_two_milliseconds_runs_at_its_instants() -> None:
    bench = Bench(cycle_ms=31.25)

    bench.run_to(100)

    assert bench.devices[0].instants_ns == [0, 31_250_000, 62_500_000, 93_750_000]


def test_a_paused_process_finds_old_frames_and_missed_cycles() -> None:
    bench = Bench()
    bench.run_to(60)
    bench.change(True, "controller_paused")
    bench.run_to(230)
    bench.change(False, "controller_paused")

    bench.run_to(260)

    assert bench.sent_ms == [0, 50, 230, 250]
    at_ms, slips, ages_ms = bench.devices[0].cycles[2]
    # Of the releases at 100, 150 and 200, two are skipped and the last one runs late.
    assert (at_ms, slips) == (230, 2)
    assert ages_ms == [
        170,
        160,
        150,
        140,
        130,
        120,
        110,
        100,
        90,
        80,
        70,
        60,
        50,
        40,
        30,
        20,
        10,
        0,
    ]


def test_a_killed_process_is_silent_and_returns_as_a_new_one() -> None:
    bench = Bench()
    bench.run_to(60)
    bench.change(True, "controller_killed")
    bench.run_to(230)
    assert bench.process.output is SAFE_OUTPUT
    bench.change(False, "controller_killed")

    bench.run_to(331)

    assert bench.sent_ms == [0, 50, 230, 280, 330]
    assert [device.again for device in bench.devices] == [False, True]
    assert bench.ended == 1
    # No process received the frames that came while none was running.
    assert bench.devices[1].cycles[0][2] == []


def test_a_slow_process_sends_late_and_misses_releases() -> None:
    bench = Bench()
    bench.run_to(60)
    bench.change(True, "slow_cycle", extra_s=0.08)

    bench.run_to(300)

    assert [ms for ms, _, _ in bench.devices[0].cycles] == [0, 50, 100, 180, 260]
    # The release at 150 runs at 180; that at 200 runs at 260, when the one at 250 has passed, too.
    assert [slips for _, slips, _ in bench.devices[0].cycles] == [0, 0, 0, 0, 1]
    assert bench.sent_ms == [0, 50, 180, 260]


def test_a_stepped_clock_ages_earlier_inputs_and_skips_cycles() -> None:
    bench = Bench()
    bench.run_to(60)
    bench.change(True, "clock_step", step_s=1.0)

    bench.run_to(101)

    # By its clock it is 1060 ms; the releases from 100 on have passed.
    assert [cycle[:2] for cycle in bench.devices[0].cycles][2:] == [(1060, 19), (1100, 0)]
    # The stepped clock stamps the frames that come after the step.
    assert bench.devices[0].cycles[3][2] == [30, 20, 10, 0]
    assert bench.sent_ms == [0, 50, 60, 100]


def test_only_a_running_process_sends_last_frames() -> None:
    for kind, words in ((None, 1), ("controller_paused", 0), ("controller_killed", 0)):
        bench = Bench()
        bench.run_to(60)
        if kind:
            bench.change(True, kind)

        bench.process.stop(70 * NS_PER_MS)

        assert sum(can_id == 0x1FF for _, can_id in bench.wire.sent) == words
