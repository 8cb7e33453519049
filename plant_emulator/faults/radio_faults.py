"""Faults of the radio, brought about at the wayside's end of it, for both directions.

Instants between two polls come about at the later one for what is sent; what is heard carries the
exact instant.
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
    """A RadioPort around the wayside's."""

    def __init__(self, port: RadioPort, seed: int) -> None:
        self._port = port
        self._acting = ActingFaults(FaultPlace.RADIO, seed)
        self._to_train: DelayQueue[_Message] = DelayQueue()
        self._to_wayside: DelayQueue[_Message] = DelayQueue()
        self.done: Counter[str] = Counter()
        """How many messages each kind struck, of both directions together."""

    @property
    def counters(self) -> LinkCounters:
        return self._port.counters

    def change(self, plan: FaultPlan, active: bool, now_ns: int) -> None:
        """A listener of the schedule; faults of other places are none of its business."""
        if plan.kind.place is FaultPlace.RADIO:
            # What was said before is met by what acted before.
            self.poll(now_ns)
            self._take_in(now_ns)
            self._acting.change(plan, active, now_ns)

    def poll(self, now_ns: int) -> None:
        """Send what has become due; call it in every step."""
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
        """By index of the fault: how many messages it changed."""
        return self._acting.touched

    @property
    def held(self) -> int:
        """Messages of both directions that are still to come."""
        return len(self._to_train) + len(self._to_wayside)

    def _take_in(self, now_ns: int) -> None:
        for stamp_ns, key, payload in self._port.receive(now_ns):
            self._pass(self._to_wayside, stamp_ns, (key, payload))

    def _pass(self, held: DelayQueue[_Message], now_ns: int, message: _Message) -> None:
        """Decide when the message comes, and how often; never, if it is lost."""
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
        """Whether a partition swallows a message now; counts it."""
        for acting, _ in self._acting.of(RadioPartition):
            self._count(acting)
            return True
        return False

    def _count(self, acting: Acting, changed: bool = True) -> None:
        """One message that a fault met, and whether that changed anything."""
        self.done[acting.name] += 1
        self._acting.touched[acting.plan.index] += changed
