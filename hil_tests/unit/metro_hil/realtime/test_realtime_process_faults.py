"""Effects of process faults: signals in the right order."""

import pytest

from metro_hil.realtime.process_faults import SETTLE_NS, ProcessFaults, refuse_impossible
from metro_hil.realtime.wires import Blocked
from plant_emulator.faults.plan import FaultPlan, read_faults

S = 1_000_000_000


class Recorder:
    """A controller that records the signals it gets."""

    def __init__(self) -> None:
        self.done: list[str] = []
        self.there = True

    def start(self) -> None:
        self.there = True
        self.done.append("start")

    def kill(self) -> None:
        self.there = False
        self.done.append("kill")

    def pause(self) -> None:
        self.done.append("pause")

    def resume(self) -> None:
        self.done.append("resume")


def plan_of(kind: str, **keys: object) -> FaultPlan:
    return read_faults([{"kind": kind, **keys}], "case")[0]


def test_a_killed_controller_is_started_again_when_the_fault_ends() -> None:
    controller = Recorder()
    faults, plan = ProcessFaults(controller), plan_of("controller_killed", duration_s=3.0)

    faults.change(plan, True, 10 * S)
    faults.change(plan, False, 13 * S)

    assert controller.done == ["kill", "start"]
    assert faults.started_ns == 13 * S
    assert not faults.for_good


def test_a_kill_without_an_end_is_for_good() -> None:
    faults = ProcessFaults(Recorder())

    faults.change(plan_of("controller_killed", start_s=4.0), True, 4 * S)

    assert faults.for_good
    assert faults.acting(100 * S)


def test_a_paused_controller_goes_on_when_the_fault_ends() -> None:
    controller = Recorder()
    faults, plan = ProcessFaults(controller), plan_of("controller_paused", duration_s=1.0)

    faults.change(plan, True, S)
    faults.change(plan, False, 2 * S)

    assert controller.done == ["pause", "resume"]
    assert faults.acting(2 * S + SETTLE_NS)
    assert not faults.acting(2 * S + SETTLE_NS + 1)


def test_a_slow_controller_is_paused_after_each_cycle() -> None:
    controller = Recorder()
    faults, plan = ProcessFaults(controller), plan_of("slow_cycle", extra_s=0.08)
    faults.change(plan, True, S)

    faults.cycle_heard(S)
    faults.cycle_heard(S + 1_000_000)
    faults.poll(S + 79_000_000)
    assert controller.done == ["pause"]
    faults.poll(S + 80_000_000)
    assert controller.done == ["pause", "resume"]
    faults.cycle_heard(S + 81_000_000)

    assert controller.done == ["pause", "resume", "pause"]
    assert faults.next_ns == S + 161_000_000


def test_without_the_fault_a_cycle_causes_no_pause() -> None:
    controller = Recorder()

    ProcessFaults(controller).cycle_heard(S)

    assert controller.done == []


def test_faults_of_the_train_do_not_affect_the_process() -> None:
    controller = Recorder()
    faults = ProcessFaults(controller)

    faults.change(plan_of("tacho_stuck"), True, S)

    assert controller.done == []
    assert not faults.acting(S)


def test_a_step_of_the_clock_is_refused_with_the_reason() -> None:
    with pytest.raises(Blocked, match="CLOCK_MONOTONIC"):
        refuse_impossible([plan_of("clock_step")], controller_ours=True)


def test_a_foreign_process_is_not_signalled() -> None:
    with pytest.raises(Blocked, match="did not start the controller"):
        refuse_impossible([plan_of("controller_paused")], controller_ours=False)


def test_a_memory_that_is_a_file_of_the_process_cannot_be_lost() -> None:
    with pytest.raises(Blocked, match="memory_lost: the file of its memory is its own"):
        refuse_impossible([plan_of("controller_killed", memory_lost=True)], controller_ours=True)
