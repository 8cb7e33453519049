"""Planned switch of the master, on the side that hands over: prepare, ready, commit."""

import enum
from collections.abc import Callable, Mapping
from typing import Final, NamedTuple

from zenoh_config.t2t import NO_TRAIN


class SwitchState(enum.Enum):
    IDLE = "idle"
    PREPARING = "preparing"
    """The master asks all trains whether they are ready. Nothing has changed yet."""
    COMMITTED = "committed"
    """The successor may acquire the lease. Until it has, the old term stays in force."""


class SwitchGuardInputs(NamedTuple):
    """Inputs of the guards that decide on a switch."""

    wanted: int
    """The train that should become master. 0: no switch is wanted."""
    successor_fit: bool
    successor_ready: bool
    all_ready: bool
    """Every train of the roster that reports is ready. Silent trains keep their reservation."""
    timed_out: bool


def asked_for(look: SwitchGuardInputs) -> bool:
    return look.wanted != NO_TRAIN and look.successor_fit


def all_said_ready(look: SwitchGuardInputs) -> bool:
    return look.successor_ready and look.all_ready


def given_up(look: SwitchGuardInputs) -> bool:
    return look.timed_out or not look.successor_fit


Guard = Callable[[SwitchGuardInputs], bool]

TRANSITIONS: Final[Mapping[SwitchState, tuple[tuple[Guard, SwitchState], ...]]] = {
    SwitchState.IDLE: ((asked_for, SwitchState.PREPARING),),
    SwitchState.PREPARING: (
        (given_up, SwitchState.IDLE),
        (all_said_ready, SwitchState.COMMITTED),
    ),
    SwitchState.COMMITTED: ((given_up, SwitchState.IDLE),),
}
"""COMMITTED has no transition for success. The old master ends when it receives the new term."""


class PlannedSwitch:
    def __init__(self, limit_ns: int) -> None:
        self.state = SwitchState.IDLE
        self.successor = NO_TRAIN
        self.nonce = 0
        self.aborted = 0
        """Nonce of the last switch that was given up."""
        self.successor_ready = False
        self._limit_ns = limit_ns
        self._began_ns = 0

    def step(
        self, now_ns: int, *, wanted: int, fit: Callable[[int], bool], all_ready: Callable[[], bool]
    ) -> None:
        """Make at most one transition."""
        target = wanted if self.state is SwitchState.IDLE else self.successor
        running = self.state is not SwitchState.IDLE
        look = SwitchGuardInputs(
            wanted=wanted,
            successor_fit=target != NO_TRAIN and fit(target),
            successor_ready=self.successor_ready,
            all_ready=running and all_ready(),
            timed_out=now_ns - self._began_ns >= self._limit_ns,
        )
        for guard, state in TRANSITIONS[self.state]:
            if guard(look):
                self._enter(state, now_ns, wanted)
                return

    def _enter(self, state: SwitchState, now_ns: int, wanted: int) -> None:
        self.state = state
        if state is SwitchState.PREPARING:
            self.nonce += 1
            self.successor, self.successor_ready = wanted, False
            self._began_ns = now_ns
        elif state is SwitchState.IDLE:
            self.aborted, self.successor = self.nonce, NO_TRAIN

    def is_ready(self, train: int, nonce: int) -> None:
        if self.state is SwitchState.PREPARING and (train, nonce) == (self.successor, self.nonce):
            self.successor_ready = True
