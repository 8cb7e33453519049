"""Bus faults between two segments, controller here and train there, where no bus can be modelled.

The frames that pass are spoiled by `FrameFaults`. What would happen on the bus is made of what a
gateway can do: a node that is off or cut is one whose frames do not pass, frames destroyed on the
wire are late by their error frames, and an idiot babbles on both segments at its rate.
"""

from collections import Counter
from dataclasses import dataclass
from typing import Final

from can_dbc.nodes import Node
from firmware_py.buses.confinement import RECOVERY_BITS
from firmware_py.buses.timing import frame_bits
from metro_hil.frame_faults import BIT_NS, Due, FrameEvent, FrameFaults
from metro_hil.frame_names import known_messages
from plant_emulator.faults.declared_bus import BabblingIdiot, BusOff, LinkCut, Way
from plant_emulator.faults.kinds import Place
from plant_emulator.faults.plan import FaultPlan

RECOVERY_NS: Final = RECOVERY_BITS * BIT_NS
FOREVER_NS: Final = 1 << 62
BABBLE: Final = b"\xaa" * 8
BABBLE_FRAMES_MAX: Final = 64
"""At once, after the gateway was held up; the rest is left out and counted."""


@dataclass(slots=True)
class _Babble:
    can_id: int
    period_ns: int
    next_ns: dict[Way, int]


class GatewayFaults:
    """Takes the place of FrameFaults: offer every frame, take what is due."""

    def __init__(self, seed: int) -> None:
        self.frames = FrameFaults(seed)
        self.babble_left_out = 0
        self._blocked: dict[int, tuple[str, Node, int]] = {}
        """By number of the fault: its kind, the node, and until when."""
        self._babbles: dict[int, _Babble] = {}

    @property
    def done(self) -> Counter[tuple[str, str]]:
        return self.frames.done

    @property
    def events(self) -> list[FrameEvent]:
        return self.frames.events

    def change(self, plan: FaultPlan, active: bool, now_ns: int) -> None:
        """A listener of the schedule; faults of other places are none of its business."""
        if plan.kind.place is not Place.BUS:
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
                ways = {Way.TO_TRAIN: now_ns, Way.TO_VOBC: now_ns}
                self._babbles[plan.index] = _Babble(parameters.can_id, period_ns, ways)
        else:
            self.frames.change(plan, active, now_ns)

    def offer(self, now_ns: int, way: Way, can_id: int, data: bytes) -> None:
        if self._blocked:
            kind = self._blocked_by(now_ns, way, can_id)
            if kind:
                self.frames.note(now_ns, kind, can_id)
                return
        self.frames.offer(now_ns, way, can_id, data)

    def take(self, now_ns: int, way: Way) -> list[Due]:
        """What is due by now, in the order in which it is due."""
        due = self.frames.take(now_ns, way)
        if not self._babbles:
            return due
        for babble in self._babbles.values():
            due += self._babbled(babble, now_ns, way)
        return sorted(due, key=lambda each: each[0])

    def next_due_ns(self) -> int | None:
        """When there is something to take at the earliest; None when nothing is to come."""
        found = self.frames.next_due_ns()
        known = [] if found is None else [found]
        known += [at_ns for each in self._babbles.values() for at_ns in each.next_ns.values()]
        return min(known, default=None)

    def _babbled(self, babble: _Babble, now_ns: int, way: Way) -> list[Due]:
        next_ns = babble.next_ns[way]
        count = max(0, (now_ns - next_ns) // babble.period_ns + 1)
        left_out = max(0, count - BABBLE_FRAMES_MAX)
        self.babble_left_out += left_out
        babble.next_ns[way] = next_ns + count * babble.period_ns
        due = [
            (next_ns + number * babble.period_ns, babble.can_id, BABBLE)
            for number in range(left_out, count)
        ]
        for at_ns, can_id, _ in due:
            self.frames.note(at_ns, "babbling_idiot", can_id)
        return due

    def _blocked_by(self, now_ns: int, way: Way, can_id: int) -> str:
        """Kind of the fault that keeps this frame from passing; empty when it passes."""
        off = {
            node.name: kind for kind, node, until_ns in self._blocked.values() if now_ns < until_ns
        }
        if not off:
            return ""
        known = known_messages().get(can_id)
        if way is Way.TO_TRAIN:
            ends = (Node.VOBC.name, "" if known is None else known.acting)
        else:
            ends = (Node.VOBC.name, "" if known is None else known.sender)
        return next((off[name] for name in ends if name in off), "")
