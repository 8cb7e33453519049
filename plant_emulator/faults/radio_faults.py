"""Faults of the radio, applied at the wayside's end for both directions.

A sent message that is due between two polls leaves at the later poll. A received message carries
its exact instant.
"""

from collections import Counter
from collections.abc import Sequence

from firmware_py.ports import LinkCounters, RadioMessage, RadioPort
from plant_emulator.faults.acting import Acting, ActingFaults, DelayQueue, after_ns, hits
from plant_emulator.faults.declared_wires import (
    RadioDelay,
    RadioDuplicate,
    RadioLoss,
    RadioPartition,
    RadioReorder,
)
from plant_emulator.faults.kinds import FaultPlace
from plant_emulator.faults.plan import FaultPlan

_Message = tuple[str, bytes]


class RadioFaults:
    """A RadioPort that applies faults to the wayside's port."""

    def __init__(self, port: RadioPort, seed: int) -> None:
        self._port = port
        self._acting = ActingFaults(FaultPlace.RADIO, seed)
        self._to_train: DelayQueue[_Message] = DelayQueue()
        self._to_wayside: DelayQueue[_Message] = DelayQueue()
        self.done: Counter[str] = Counter()
        """Number of messages that each kind affected, in both directions together."""

    @property
    def counters(self) -> LinkCounters:
        return self._port.counters

    def change(self, plan: FaultPlan, active: bool, now_ns: int) -> None:
        """Start or end a fault of the schedule; faults of other places are ignored."""
        if plan.kind.place is FaultPlace.RADIO:
            # Messages sent before this instant are subject to the faults active before it.
            self.poll(now_ns)
            self._take_in(now_ns)
            self._acting.change(plan, active, now_ns)

    def poll(self, now_ns: int) -> None:
        """Send the messages that are due; call it in every step."""
        for _, (key, payload) in self._to_train.due(now_ns):
            if not self._cut():
                self._port.send(now_ns, key, payload)

    def send(self, now_ns: int, key: str, payload: bytes) -> None:
        if not self._acting and not self._to_train:
            self._port.send(now_ns, key, payload)
            return
        self._pass(self._to_train, now_ns, (key, payload))
        self.poll(now_ns)

    def receive(self, now_ns: int) -> Sequence[RadioMessage]:
        if not self._acting and not self._to_wayside:
            return self._port.receive(now_ns)
        self._take_in(now_ns)
        return [
            RadioMessage(due_ns, key, payload)
            for due_ns, (key, payload) in self._to_wayside.due(now_ns)
            if not self._cut()
        ]

    def close(self) -> None:
        self._port.close()

    @property
    def touched(self) -> Counter[int]:
        """Number of messages that each fault changed, by the fault's index."""
        return self._acting.touched

    @property
    def held(self) -> int:
        """Number of delayed messages in both directions."""
        return len(self._to_train) + len(self._to_wayside)

    def _take_in(self, now_ns: int) -> None:
        for stamp_ns, key, payload in self._port.receive(now_ns):
            self._pass(self._to_wayside, stamp_ns, (key, payload))

    def _pass(self, held: DelayQueue[_Message], now_ns: int, message: _Message) -> None:
        """Decide when and how often the message arrives; a lost one never does."""
        if self._cut():
            return
        due_ns = now_ns
        for acting in self._acting:
            parameters, draws = acting.plan.parameters, acting.draws
            if isinstance(parameters, RadioLoss):
                if hits(draws, parameters.loss_ratio):
                    self._count(acting)
                    return
            elif isinstance(parameters, RadioDelay):
                wait_s = parameters.delay_s + draws.random() * parameters.jitter_s
                self._count(acting, wait_s > 0.0)
                due_ns = after_ns(due_ns, wait_s)
            elif isinstance(parameters, RadioReorder) and hits(draws, parameters.share_ratio):
                self._count(acting, parameters.hold_s > 0.0)
                due_ns = after_ns(due_ns, parameters.hold_s)
        held.hold(due_ns, message)
        for acting, again in self._acting.of(RadioDuplicate):
            if hits(acting.draws, again.share_ratio):
                self._count(acting)
                held.hold(after_ns(due_ns, again.gap_s), message)

    def _cut(self) -> bool:
        """Return whether a partition drops a message now, and count it."""
        for acting, _ in self._acting.of(RadioPartition):
            self._count(acting)
            return True
        return False

    def _count(self, acting: Acting, changed: bool = True) -> None:
        """Count a message that a fault affected, and whether the fault changed anything."""
        self.done[acting.name] += 1
        self._acting.touched[acting.plan.index] += changed
