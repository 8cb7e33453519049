"""Faults of frames between controller and train: frames go in, and come out when they are due.

The module reads no clock and knows no bus. So the same core works between the controller and a bus
in virtual time (`metro_hil.faults.bus`) and between two real segments (`metro_hil.faults.gateway`).
Faults that act at once are applied in the order of the scenario.
"""

from collections import Counter, deque
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, Final, NamedTuple

from firmware_py.buses import confinement
from firmware_py.buses.confinement import wire_frame
from metro_hil.faults.corruption import Forger, alive_counter, masked, spoiled
from metro_hil.model.frame_names import (
    check_bus_fault,
    concerns,
    known_messages,
    known_names,
    name_of,
)
from plant_emulator.faults.acting import NS_PER_S, Acting, ActingFaults, DelayQueue, after_ns, hits
from plant_emulator.faults.declared_bus import (
    DamagePlace,
    FrameCorrupt,
    FrameDelay,
    FrameDirection,
    FrameDrop,
    FrameDuplicate,
    FrameReorder,
    FrameReplay,
    Masquerade,
)
from plant_emulator.faults.kinds import FaultPlace
from plant_emulator.faults.plan import FaultPlan

__all__ = ["FrameFaults", "FrameEvent", "Due", "check_bus_fault"]

EVENTS_MAX: Final = 1000
MEMORY_S: Final = 60.0
"""Longest memory of a replay."""
ATTEMPTS_MAX: Final = 32
"""Number of failed attempts after which a sender is off the bus."""
BIT_NS: Final = 4_000
"""Duration of a bit at 250 kbit/s."""

Due = tuple[int, int, bytes]
"""Instant, identifier and data."""
_Item = tuple[int, bytes]


class FrameEvent(NamedTuple):
    """An effect of a fault on a frame."""

    at_ns: int
    kind: str
    message: str


@dataclass(slots=True)
class _Memory:
    """State of one active fault."""

    floors_ns: dict[FrameDirection, int] = field(default_factory=dict)
    """For a delay: earliest instant of the next frame of each direction, so that order is kept."""
    forger: Forger | None = None
    past: list[tuple[int, FrameDirection, int, bytes]] = field(default_factory=list)
    """For a replay: offset from its start at which each frame is first sent again."""
    next_index: int = 0
    next_ns: int = 0
    counter: int | None = None
    """Alive counter of a masquerade."""


class FrameFaults:
    """Takes every frame in order of time, and returns those that are due. Time must not go back."""

    def __init__(
        self, seed: int, *, memory_s: float = MEMORY_S, strangers_apart: bool = False
    ) -> None:
        """Prepare the faults.

        Args:
            memory_s: how much of the past is kept for a frame_replay: the longest planned.
            strangers_apart: `take_strangers` returns the frames of a masquerade; otherwise they
                come with the genuine frames of their direction.
        """
        self.done: Counter[tuple[str, str]] = Counter()
        """Number of times that each kind of fault struck each message."""
        self.events: list[FrameEvent] = []
        """The first EVENTS_MAX events."""
        self.events_left_out = 0
        self._acting = ActingFaults(FaultPlace.BUS, seed)
        self.strangers_apart = strangers_apart
        self._memory: dict[int, _Memory] = {}
        self._fading: list[tuple[FrameDelay, _Memory]] = []
        """Delays that have ended; later frames still queue behind those that they hold."""
        self._held: dict[FrameDirection, DelayQueue[tuple[int, bytes]]] = {
            FrameDirection.TO_TRAIN: DelayQueue(),
            FrameDirection.TO_VOBC: DelayQueue(),
            FrameDirection.BOTH: DelayQueue(),
        }
        """Held frames by direction; BOTH holds those of masquerades."""
        self._past: deque[tuple[int, FrameDirection, int, bytes]] = deque()
        self._past_ns = round(memory_s * NS_PER_S)
        self._genuine: dict[int, bytes] = {}

    def reseed(self, seed: int) -> None:
        """Let faults that begin from now on use another seed."""
        self._acting.reseed(seed)

    def change(self, plan: FaultPlan, active: bool, now_ns: int) -> None:
        """Take a change of a fault from the schedule; faults of other places are ignored."""
        self._produce(now_ns)
        if not self._acting.change(plan, active, now_ns):
            return
        if active:
            self._memory[plan.index] = self._begin(plan, now_ns)
        else:
            memory = self._memory.pop(plan.index, None)
            if memory is not None and isinstance(plan.parameters, FrameDelay):
                self._fading.append((plan.parameters, memory))

    def offer(self, now_ns: int, way: FrameDirection, can_id: int, data: bytes) -> None:
        """Take one frame of this direction at the instant at which it would arrive."""
        self._remember(now_ns, way, can_id, data)
        items: list[_Item] = [(now_ns, data)]
        for acting in self._acting:
            items = self._struck(acting, now_ns, way, can_id, items)
        if self._fading:
            items = self._queued(now_ns, way, can_id, items)
        held = self._held[way]
        for due_ns, each in items:
            held.hold(due_ns, (can_id, each))

    def take(self, now_ns: int, way: FrameDirection) -> list[Due]:
        """Return the frames that are due by now, in order."""
        held = self._held[way]
        if not self._memory and not held:
            # The fast path: this is called every millisecond, and mostly nothing is due.
            return []
        self._produce(now_ns)
        return [(due_ns, can_id, data) for due_ns, (can_id, data) in held.due(now_ns)]

    def take_strangers(self, now_ns: int) -> list[Due]:
        """Return the frames of masquerades that are due, if they are kept apart."""
        return self.take(now_ns, FrameDirection.BOTH)

    def next_due_ns(self) -> int | None:
        """Return the earliest instant of a frame to take; None if none will come."""
        waiting = [each.next_ns for each in self._held.values()]
        sources = [self._memory[acting.plan.index].next_ns for acting in self._sources()]
        return min((at_ns for at_ns in (*waiting, *sources) if at_ns is not None), default=None)

    @property
    def held(self) -> int:
        """Number of frames that are still to come."""
        return sum(len(each) for each in self._held.values())

    @property
    def touched(self) -> Counter[int]:
        """Number of frames that each fault changed, delayed or added, by index of the fault."""
        return self._acting.touched

    def strike(self, acting: Acting, at_ns: int, can_id: int, *, changed: bool = True) -> None:
        """Count a frame that a fault met, and whether the fault changed anything."""
        self.note(at_ns, acting.name, can_id)
        self._acting.touched[acting.plan.index] += changed

    def note(self, at_ns: int, kind: str, can_id: int) -> None:
        """Count an effect on a frame."""
        message = name_of(can_id)
        self.done[kind, message] += 1
        if len(self.events) < EVENTS_MAX:
            self.events.append(FrameEvent(at_ns, kind, message))
        else:
            self.events_left_out += 1

    # Effects on a passing frame.

    def _struck(
        self, acting: Acting, now_ns: int, way: FrameDirection, can_id: int, items: list[_Item]
    ) -> list[_Item]:
        parameters: Any = acting.plan.parameters
        if isinstance(parameters, FrameCorrupt) and parameters.damage is DamagePlace.BEFORE_CRC:
            return self._forged(acting, parameters, way, can_id, items)
        if not isinstance(
            parameters, FrameDrop | FrameDelay | FrameDuplicate | FrameReorder | FrameCorrupt
        ) or not concerns(parameters.frames, parameters.way, can_id, way):
            return items
        if isinstance(parameters, FrameDelay):
            late_ns = self._late_ns(acting, parameters, now_ns, way)
            for due_ns, _ in items:
                self.strike(acting, due_ns, can_id, changed=late_ns > 0)
            return [(due_ns + late_ns, data) for due_ns, data in items]
        floors_ns = self._memory[acting.plan.index].floors_ns
        found: list[_Item] = []
        for due_ns, data in items:
            if isinstance(parameters, FrameCorrupt) and parameters.damage is DamagePlace.ON_WIRE:
                # The sender repeats a frame before it sends the next one.
                due_ns = max(due_ns, floors_ns.get(way, 0))
                struck = _sent_again(acting, parameters, due_ns, can_id, data)
                floors_ns[way] = max([due_ns, *(at_ns for at_ns, _ in struck)])
            else:
                struck = _fate(acting, parameters, due_ns, can_id, data)
            if struck != [(due_ns, data)]:
                self.strike(acting, due_ns, can_id)
            found += struck
        return found

    def _late_ns(self, acting: Acting, late: FrameDelay, now_ns: int, way: FrameDirection) -> int:
        floors_ns = self._memory[acting.plan.index].floors_ns
        due_ns = after_ns(now_ns, late.delay_s + acting.draws.random() * late.jitter_s)
        due_ns = floors_ns[way] = max(due_ns, floors_ns.get(way, 0))
        return due_ns - now_ns

    def _queued(
        self, now_ns: int, way: FrameDirection, can_id: int, items: list[_Item]
    ) -> list[_Item]:
        """Queue frames behind those that an ended delay still holds."""
        self._fading = [
            (late, memory)
            for late, memory in self._fading
            if max(memory.floors_ns.values(), default=0) > now_ns
        ]
        for late, memory in self._fading:
            floor_ns = memory.floors_ns.get(way, 0)
            if concerns(late.frames, late.way, can_id, way) and floor_ns > now_ns:
                items = [(due_ns + floor_ns - now_ns, data) for due_ns, data in items]
        return items

    def _forged(
        self,
        acting: Acting,
        parameters: FrameCorrupt,
        way: FrameDirection,
        can_id: int,
        items: list[_Item],
    ) -> list[_Item]:
        forger = self._memory[acting.plan.index].forger
        assert forger is not None
        known = known_messages().get(can_id)
        names = {can_id} if known is None else {each.frame_id for each in known.bound.messages}
        if not any(concerns(parameters.frames, parameters.way, each, way) for each in names):
            return items
        found: list[_Item] = []
        for due_ns, data in items:
            second = known is not None and known.is_twin
            strike = not second and hits(acting.draws, parameters.share_ratio)
            forged = forger.forged(can_id, data, strike=strike)
            if forged is not None:
                self.strike(acting, due_ns, can_id)
            found.append((due_ns, data if forged is None else forged))
        return found

    # Additional frames.

    def _begin(self, plan: FaultPlan, now_ns: int) -> _Memory:
        memory, parameters = _Memory(next_ns=now_ns), plan.parameters
        if isinstance(parameters, FrameCorrupt):
            memory.forger = Forger(parameters.bits, self._acting.draws_of(plan))
        elif isinstance(parameters, FrameReplay):
            from_ns = now_ns - round(parameters.memory_s * NS_PER_S)
            memory.past = [
                (at_ns - from_ns, way, can_id, data)
                for at_ns, way, can_id, data in self._past
                if from_ns < at_ns <= now_ns
                and concerns(parameters.frames, parameters.way, can_id, way)
            ]
            if memory.past:
                memory.next_ns = now_ns + memory.past[0][0]
        return memory

    def _remember(self, now_ns: int, way: FrameDirection, can_id: int, data: bytes) -> None:
        self._genuine[can_id] = data
        past = self._past
        past.append((now_ns, way, can_id, data))
        while past[0][0] <= now_ns - self._past_ns:
            past.popleft()

    def _sources(self) -> Sequence[Acting]:
        return [
            acting
            for acting in self._acting
            if isinstance(acting.plan.parameters, Masquerade)
            or self._memory[acting.plan.index].past
        ]

    def _produce(self, now_ns: int) -> None:
        """Let replays and masquerades send what is due up to now."""
        if not self._memory:
            return
        for acting in self._sources():
            memory = self._memory[acting.plan.index]
            while memory.next_ns <= now_ns:
                if isinstance(acting.plan.parameters, Masquerade):
                    self._masquerade(acting, acting.plan.parameters, memory)
                else:
                    self._replay(acting, acting.plan.parameters, memory)

    def _replay(self, acting: Acting, replay: FrameReplay, memory: _Memory) -> None:
        offset_ns, way, can_id, data = memory.past[memory.next_index]
        self.strike(acting, memory.next_ns, can_id)
        self._held[way].hold(memory.next_ns, (can_id, data))
        memory.next_index += 1
        again_ns = 0
        if memory.next_index == len(memory.past):
            memory.next_index, again_ns = 0, round(replay.memory_s * NS_PER_S)
        memory.next_ns += memory.past[memory.next_index][0] - offset_ns + again_ns

    def _masquerade(self, acting: Acting, mask: Masquerade, memory: _Memory) -> None:
        at_ns = memory.next_ns
        memory.next_ns = after_ns(at_ns, mask.period_s)
        known = known_names()[mask.frame]
        genuine = self._genuine.get(known.can_id)
        if genuine is None:
            return
        bound = known.bound
        if memory.counter is None:
            memory.counter = alive_counter(bound, genuine)
        memory.counter = memory.counter + 1 & 0xFF
        lane = FrameDirection.BOTH if self.strangers_apart else known.way
        for can_id, data in masked(bound, genuine, mask.values or {}, memory.counter, mask.twins):
            self.strike(acting, at_ns, can_id)
            self._held[lane].hold(at_ns, (can_id, data))


def _fate(acting: Acting, parameters: Any, due_ns: int, can_id: int, data: bytes) -> list[_Item]:
    """Apply a fault without a memory to one frame."""
    draws = acting.draws
    if isinstance(parameters, FrameDrop):
        return [] if hits(draws, parameters.loss_ratio) else [(due_ns, data)]
    if not hits(draws, parameters.share_ratio):
        return [(due_ns, data)]
    if isinstance(parameters, FrameDuplicate):
        copies = range(parameters.copies + 1)
        return [(after_ns(due_ns, copy * parameters.gap_s), data) for copy in copies]
    if isinstance(parameters, FrameReorder):
        return [(after_ns(due_ns, parameters.hold_s), data)]
    return [(due_ns, spoiled(can_id, data, parameters.bits, draws))]


def _sent_again(
    acting: Acting, corrupt: FrameCorrupt, due_ns: int, can_id: int, data: bytes
) -> list[_Item]:
    """Delay a frame by the error frames of all failed attempts, for a bench without a bus model."""
    frame = wire_frame(can_id, data)
    for _ in range(ATTEMPTS_MAX):
        if not hits(acting.draws, corrupt.share_ratio):
            return [(due_ns, data)]
        bit = int(acting.draws.integers(frame.first, frame.last + 1))
        bits = confinement.destroyed_bits(frame, bit, sender_passive=False, hearers_active=True)
        due_ns += bits * BIT_NS
    return []
