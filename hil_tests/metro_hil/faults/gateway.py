"""Bus faults between a controller segment and a train segment, where no bus model exists.

`FrameFaults` changes the frames that pass. The gateway imitates bus faults with its own means.
Frames of a node that is off or cut do not pass. Frames that are destroyed on the wire are late by
their error frames. A babbling node sends on both segments at its rate. During that time the gateway
arbitrates all frames by identifier, as on one bus of 250 kbit/s. An embedded or virtual segment has
room for all frames, so babbling would otherwise harm no node.
"""

from collections import Counter
from dataclasses import dataclass
from heapq import heappop, heappush
from typing import Final

from can_dbc.nodes import Node
from firmware_py.buses.confinement import RECOVERY_BITS
from firmware_py.buses.inproc import MAILBOX_FRAMES
from firmware_py.buses.timing import frame_bits
from metro_hil.faults.frames import BIT_NS, Due, FrameEvent, FrameFaults
from metro_hil.model.frame_names import known_messages
from plant_emulator.faults.declared_bus import BabblingIdiot, BusOff, FrameDirection, LinkCut
from plant_emulator.faults.kinds import FaultPlace
from plant_emulator.faults.plan import FaultPlan

RECOVERY_NS: Final = RECOVERY_BITS * BIT_NS
FOREVER_NS: Final = 1 << 62
BABBLE: Final = b"\xaa" * 8
BABBLE_FRAMES_MAX: Final = 64
"""Maximum number of babbled frames after a delay of the gateway; the rest is left out and
counted."""


@dataclass(slots=True)
class _Babble:
    index: int
    """Index of the fault."""
    can_id: int
    bits_ns: int
    period_ns: int
    next_ns: int


class GatewayFaults:
    """Replaces FrameFaults: takes every frame and returns those that are due."""

    def __init__(self, seed: int) -> None:
        self.frames = FrameFaults(seed)
        self.babble_left_out = 0
        self._blocked: dict[int, tuple[str, Node, int]] = {}
        """Kind of the fault, node and end, by number of the fault."""
        self._babbles: dict[int, _Babble] = {}
        self._waiting: list[tuple[int, int, FrameDirection, bytes]] = []
        """Heap of frames that wait for the crowded bus: identifier, number, direction, data."""
        self._mailboxes: Counter[str] = Counter()
        """Number of waiting frames of each node; as in virtual time, further ones are dropped."""
        self._passed: dict[FrameDirection, list[Due]] = {
            FrameDirection.TO_TRAIN: [],
            FrameDirection.TO_VOBC: [],
        }
        """Frames that have passed the bus and were not taken yet."""
        self._free_ns = 0
        """Instant at which the bus is free again."""
        self._number = 0
        self._touched: Counter[int] = Counter()

    @property
    def touched(self) -> Counter[int]:
        """Number of frames that each fault changed, kept away or added, by index of the fault."""
        return self._touched + self.frames.touched

    @property
    def done(self) -> Counter[tuple[str, str]]:
        return self.frames.done

    @property
    def events(self) -> list[FrameEvent]:
        return self.frames.events

    def change(self, plan: FaultPlan, active: bool, now_ns: int) -> None:
        """Take a change of a fault from the schedule; faults of other places are ignored."""
        if plan.kind.place is not FaultPlace.BUS:
            return
        parameters = plan.parameters
        if isinstance(parameters, BusOff | LinkCut):
            until_ns = FOREVER_NS
            if not active:
                until_ns = now_ns
                if isinstance(parameters, BusOff):
                    until_ns = now_ns + RECOVERY_NS if parameters.recovers else FOREVER_NS
            self._blocked[plan.index] = (plan.kind.name, parameters.node, until_ns)
        elif isinstance(parameters, BabblingIdiot):
            self._babbles.pop(plan.index, None)
            if active:
                bits_ns = frame_bits(parameters.can_id, BABBLE) * BIT_NS
                period_ns = round(bits_ns / parameters.load_ratio)
                self._babbles[plan.index] = _Babble(
                    plan.index, parameters.can_id, bits_ns, period_ns, next_ns=now_ns
                )
                self._free_ns = max(self._free_ns, now_ns)
        else:
            self.frames.change(plan, active, now_ns)

    def offer(self, now_ns: int, way: FrameDirection, can_id: int, data: bytes) -> None:
        if self._blocked:
            index = self._blocked_by(now_ns, way, can_id)
            if index is not None:
                self._touched[index] += 1
                self.frames.note(now_ns, self._blocked[index][0], can_id)
                return
        self.frames.offer(now_ns, way, can_id, data)

    def take(self, now_ns: int, way: FrameDirection) -> list[Due]:
        """Return the frames that are due by now, in order."""
        if not (self._babbles or self._waiting or self._passed[way]):
            return self.frames.take(now_ns, way)
        self._arbitrate(now_ns)
        passed, self._passed[way] = self._passed[way], []
        return passed

    def next_due_ns(self) -> int | None:
        """Return the earliest instant of a frame to take; None if none will come."""
        found = self.frames.next_due_ns()
        known = [] if found is None else [found]
        known += [max(each.next_ns, self._free_ns) for each in self._babbles.values()]
        if self._waiting:
            known.append(self._free_ns)
        return min(known, default=None)

    def _arbitrate(self, now_ns: int) -> None:
        """Let frames on the bus one after the other, always the lowest identifier that waits.

        Frames that arrive within one call count as having arrived together.
        """
        for way in self._passed:
            for _, can_id, data in self.frames.take(now_ns, way):
                self._line_up(now_ns, way, can_id, data)
        self._leave_out(now_ns)
        while self._free_ns <= now_ns:
            ready = [each for each in self._babbles.values() if each.next_ns <= self._free_ns]
            idiot = min(ready, key=lambda each: each.can_id, default=None)
            if idiot is not None and (not self._waiting or idiot.can_id <= self._waiting[0][0]):
                self._babble(idiot)
            elif self._waiting:
                can_id, _, way, data = heappop(self._waiting)
                self._mailboxes[_sender_of(can_id)] -= 1
                self._passed[way].append((self._free_ns, can_id, data))
                self._free_ns += frame_bits(can_id, data) * BIT_NS
            else:
                later = [each.next_ns for each in self._babbles.values()]
                self._free_ns = min(later, default=now_ns + 1)

    def _line_up(self, now_ns: int, way: FrameDirection, can_id: int, data: bytes) -> None:
        sender = _sender_of(can_id)
        if self._mailboxes[sender] >= MAILBOX_FRAMES:
            self.frames.note(now_ns, "babbling_idiot", can_id)
            return
        self._mailboxes[sender] += 1
        self._number += 1
        heappush(self._waiting, (can_id, self._number, way, data))

    def _babble(self, idiot: _Babble) -> None:
        for passed in self._passed.values():
            passed.append((self._free_ns, idiot.can_id, BABBLE))
        self.frames.note(self._free_ns, "babbling_idiot", idiot.can_id)
        self._touched[idiot.index] += 1
        idiot.next_ns = max(idiot.next_ns + idiot.period_ns, self._free_ns + idiot.bits_ns)
        self._free_ns += idiot.bits_ns

    def _leave_out(self, now_ns: int) -> None:
        """Leave out what a babbling node would have sent during a long delay of the gateway."""
        for idiot in self._babbles.values():
            from_ns = now_ns - BABBLE_FRAMES_MAX * idiot.period_ns
            missed = max(0, from_ns - max(idiot.next_ns, self._free_ns)) // idiot.period_ns
            if missed > 0:
                self.babble_left_out += missed
                idiot.next_ns = max(idiot.next_ns, self._free_ns) + missed * idiot.period_ns
                self._free_ns = idiot.next_ns

    def _blocked_by(self, now_ns: int, way: FrameDirection, can_id: int) -> int | None:
        """Return the index of the fault that blocks this frame; None if it passes."""
        off = {
            node.name: index
            for index, (_, node, until_ns) in self._blocked.items()
            if now_ns < until_ns
        }
        if not off:
            return None
        known = known_messages().get(can_id)
        if way is FrameDirection.TO_TRAIN:
            ends = (Node.VOBC.name, "" if known is None else known.acting)
        else:
            ends = (Node.VOBC.name, "" if known is None else known.sender)
        return next((off[name] for name in ends if name in off), None)


def _sender_of(can_id: int) -> str:
    known = known_messages().get(can_id)
    return "" if known is None else known.sender
