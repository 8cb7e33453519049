"""Which trains must be ready before a master hands over, and for which switch a train reports
readiness."""

import dataclasses

import pytest

from hil_tests.unit.vobc.train_to_train.test_t2t_regressions import Command, own, reports, train
from vobc.train_to_train.planned_switch import SwitchState
from zenoh_config.t2t import (
    BROADCAST,
    Heartbeat,
    LineOrder,
    OrderKind,
    Phase,
    SwitchKind,
    SwitchStep,
    TrainReport,
)

MS = 1_000_000
SUCCESSOR, OTHER = 1, 2


class HandOver(Command):
    """A master that was ordered to hand over to train 1; train 2 is on the roster, too."""

    def __init__(self) -> None:
        super().__init__()
        self.on_message(SUCCESSOR, 900.0)
        self.on_message(OTHER, 500.0)
        self.step()
        self.on_message(SUCCESSOR, 900.0)
        self.step()
        head = (65_100, 7, 1, 0, 1, 1, 0)
        self.master.on_message(LineOrder(*head, OrderKind.SWITCH_MASTER, SUCCESSOR), self.now_ns)

    def says(self, source: int, *, ready_nonce: int, localised: bool = True) -> None:
        """A report with a constant position."""
        heard: list[TrainReport] = []
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(self.master, "on_message", lambda report, now_ns: heard.append(report))
            self.on_message(source, 900.0 if source == SUCCESSOR else 500.0)
        report = dataclasses.replace(heard[0], localised=localised, ready_nonce=ready_nonce)
        self.master.on_message(report, self.now_ns)

    def successor_is_ready(self) -> None:
        nonce = self.master.succession.switch.nonce
        self.says(SUCCESSOR, ready_nonce=nonce)
        step = SwitchStep(SUCCESSOR, 7, 1, 1, 1, 99, 0, SwitchKind.READY, nonce, SUCCESSOR)
        self.master.on_message(step, self.now_ns)

    @property
    def state(self) -> SwitchState:
        return self.master.succession.switch.state


def test_a_switch_waits_for_a_lost_train_that_reports() -> None:
    """A master that never received its position once committed without asking it (simulation
    seed 1206)."""
    over = HandOver()
    over.master._known.records[OTHER].report = None
    over.says(OTHER, ready_nonce=0, localised=False)
    over.says(SUCCESSOR, ready_nonce=0)
    over.step()
    assert over.state is SwitchState.PREPARING

    over.says(OTHER, ready_nonce=0, localised=False)
    over.successor_is_ready()
    over.step()
    assert over.state is SwitchState.PREPARING

    over.says(OTHER, ready_nonce=1, localised=False)
    over.says(SUCCESSOR, ready_nonce=1)
    over.step()
    assert over.state is SwitchState.COMMITTED


def test_the_readiness_report_of_a_lost_train_counts() -> None:
    """Otherwise its last report from before would delay every switch until it is aborted."""
    over = HandOver()
    over.says(OTHER, ready_nonce=0)
    over.says(SUCCESSOR, ready_nonce=0)
    over.step()

    over.says(OTHER, ready_nonce=1, localised=False)
    over.successor_is_ready()
    over.step()

    assert over.state is SwitchState.COMMITTED


def test_a_train_that_never_reported_does_not_delay_a_switch() -> None:
    over = HandOver()
    over.master._known.records[OTHER].ready_nonce = None
    over.says(SUCCESSOR, ready_nonce=0)
    over.step()
    over.successor_is_ready()
    over.step()

    assert over.state is SwitchState.COMMITTED


def test_readiness_for_one_masters_switch_does_not_count_for_the_next_master() -> None:
    """Each master counts its switches from one."""
    core = train()

    def nonce_after(now_ms: int, *heard: Heartbeat | SwitchStep) -> int:
        (report,) = reports(core.step(now_ms * MS, heard, own()).out)
        return report.ready_nonce

    def beat(source: int, term: int, sequence: int) -> Heartbeat:
        return Heartbeat(source, BROADCAST, 1, term, 1, sequence, 0, Phase.ISSUING, 0, 1)

    def prepare(source: int, term: int, sequence: int) -> SwitchStep:
        head = (source, BROADCAST, 1, term, 1, sequence, 0)
        return SwitchStep(*head, SwitchKind.PREPARE, 1, 3)

    core.step(0, (), own())
    assert nonce_after(100, beat(9, 4, 1)) == 0
    assert nonce_after(110, prepare(9, 4, 2)) == 1
    assert nonce_after(210, beat(9, 4, 3)) == 1
    assert nonce_after(220, beat(8, 5, 1)) == 0
    assert nonce_after(230, prepare(8, 5, 2)) == 1
