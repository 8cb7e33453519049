"""Bus faults on the lockstep bench: some between controller and bus, some on the bus itself."""

from collections import Counter
from collections.abc import Sequence
from typing import Any, Final

from firmware_py.buses.confinement import CRC_BITS, ErrorCounters
from firmware_py.buses.disturbed import DisturbedWire
from firmware_py.buses.inproc import InprocBus, InprocPort
from firmware_py.ports import CanFrame, CanPort, LinkCounters
from metro_hil.faults.frames import FrameFaults
from metro_hil.model.frame_names import concerns, known_messages
from plant_emulator.faults.acting import Acting, ActingFaults, hits
from plant_emulator.faults.declared_bus import (
    BabblingIdiot,
    BusOff,
    DamagePlace,
    FrameCorrupt,
    FrameDirection,
    LinkCut,
    Masquerade,
)
from plant_emulator.faults.kinds import FaultPlace
from plant_emulator.faults.plan import FaultPlan

CONTROLLER: Final = "VOBC"
STRANGER: Final = "STRANGER"
BABBLER: Final = "BABBLER"
"""Name of the port that says what no node of the train says."""
BABBLE: Final = b"\xaa" * 8
"""Nothing is stuffed into it."""
COMMANDED: Final = {
    can_id: known.acting for can_id, known in known_messages().items() if known.sender == CONTROLLER
}
"""Which unit acts on which command: the plant takes all of them in at one node."""


class FaultyPort:
    """The controller's CanPort with faults between it and the bus."""

    def __init__(self, port: CanPort, faults: FrameFaults) -> None:
        self.faults = faults
        self.stranger: CanPort | None = None
        """Where a masquerade speaks; without it it does so where genuine frames pass."""
        self._port = port
        self._uncommon: list[CanFrame] = []
        """Error, remote and 29-bit frames: no fault speaks of them."""

    @property
    def counters(self) -> LinkCounters:
        return self._port.counters

    def send(self, now_ns: int, can_id: int, data: bytes) -> None:
        self.faults.offer(now_ns, FrameDirection.TO_TRAIN, can_id, data)
        self.poll(now_ns)

    def poll(self, now_ns: int) -> None:
        """Send what has become due. Without a call in between it goes with the next `send`."""
        for _, can_id, data in self.faults.take(now_ns, FrameDirection.TO_TRAIN):
            self._port.send(now_ns, can_id, data)
        if self.stranger is not None:
            for _, can_id, data in self.faults.take_strangers(now_ns):
                self.stranger.send(now_ns, can_id, data)

    def settle(self, now_ns: int) -> None:
        """Take in what was said up to now, so that a fault from now on does not touch it."""
        for frame in self._port.receive(now_ns):
            if frame.extended or frame.remote or frame.error:
                self._uncommon.append(frame)
                continue
            self.faults.offer(frame.stamp_ns, FrameDirection.TO_VOBC, frame.can_id, frame.data)

    def receive(self, now_ns: int) -> Sequence[CanFrame]:
        """Frames carry the instant at which they get through."""
        self.settle(now_ns)
        taken = self.faults.take(now_ns, FrameDirection.TO_VOBC)
        frames = [CanFrame(due_ns, can_id, data) for due_ns, can_id, data in taken]
        if self._uncommon:
            frames = sorted([*frames, *self._uncommon], key=lambda frame: frame.stamp_ns)
            self._uncommon.clear()
        return frames

    def close(self) -> None:
        self._port.close()


class BusFaults:
    """Sends each bus fault to where it acts. The bus is taken over when the first needs it."""

    def __init__(self, bus: InprocBus, vobc: FaultyPort, seed: int) -> None:
        self.vobc = vobc
        self._bus = bus
        self._acting = ActingFaults(FaultPlace.BUS, seed)
        self._wire: DisturbedWire | None = None
        self._babblers: dict[int, InprocPort] = {}
        self._frames_before: dict[int, int] = {}
        """By index of a cut or a babbling node that acts: frames on the bus when it began."""
        self._kept_off: list[str] = []
        """Nodes that stay off the bus for good."""

    def reseed(self, seed: int) -> None:
        """What begins from now on draws from another seed."""
        self._acting.reseed(seed)
        self.vobc.faults.reseed(seed)

    def change(self, plan: FaultPlan, active: bool, now_ns: int) -> None:
        """A listener of the schedule; faults of other places are none of its business."""
        if plan.kind.place is not FaultPlace.BUS:
            return
        parameters = plan.parameters
        if not _acts_on_wire(parameters):
            self.vobc.settle(now_ns)
            if isinstance(parameters, Masquerade) and self.vobc.stranger is None:
                self.vobc.faults.strangers_apart = True
                self.vobc.stranger = self._bus.port(STRANGER, ())
            self.vobc.faults.change(plan, active, now_ns)
            return
        # Frames that start before now have met what acted until now.
        self._bus.advance(now_ns)
        self._acting.change(plan, active, now_ns)
        wire = self._taken_over()
        if isinstance(parameters, BabblingIdiot | LinkCut):
            self._count_frames(plan, active)
        if isinstance(parameters, BabblingIdiot):
            self._babble(wire, plan, active, now_ns)
        elif isinstance(parameters, LinkCut):
            self._cut(wire, parameters, now_ns)
        elif not active:
            self._restart(wire, parameters, now_ns)

    def struck_bit(self, start_ns: int, can_id: int, data: bytes, sender: str) -> int | None:
        """A Disturber: what the faults on the wire make of a frame that is about to start."""
        way = FrameDirection.TO_TRAIN if sender == CONTROLLER else FrameDirection.TO_VOBC
        for acting in self._acting:
            parameters = acting.plan.parameters
            if isinstance(parameters, BusOff):
                struck = parameters.node.name == sender
            elif isinstance(parameters, FrameCorrupt):
                struck = concerns(parameters.frames, parameters.way, can_id, way) and hits(
                    acting.draws, parameters.share_ratio
                )
            else:
                continue
            if struck:
                self.vobc.faults.note(start_ns, acting.name, can_id)
                self._acting.touched[acting.plan.index] += 1
                return _some_bit(acting, data)
        return None

    def errors_of(self, node: str, now_ns: int) -> ErrorCounters:
        """Of a node by its name."""
        return self._taken_over().errors_of(node, now_ns)

    def _count_frames(self, plan: FaultPlan, active: bool) -> None:
        """A cut node misses what passes on the bus; all of it waits for a node that babbles."""
        if active:
            self._frames_before[plan.index] = self._bus.statistics().frames
        else:
            before = self._frames_before.pop(plan.index, None)
            if before is not None:
                self._acting.touched[plan.index] += self._bus.statistics().frames - before

    @property
    def touched(self) -> Counter[int]:
        """By index of the fault: how many frames it changed, kept away or added."""
        found = Counter(self._acting.touched)
        found.update(self.vobc.faults.touched)
        frames = self._bus.statistics().frames
        found.update({index: frames - before for index, before in self._frames_before.items()})
        return found

    @property
    def done(self) -> Counter[tuple[str, str]]:
        """How often a kind of fault struck a message."""
        return self.vobc.faults.done

    @property
    def error_frames(self) -> Counter[str]:
        """By the sender of the frame that was destroyed."""
        return Counter() if self._wire is None else self._wire.error_frames

    def story(self) -> list[tuple[int, str]]:
        """What happened, by instant: the first thousand of frames and of nodes' states each."""
        told = [(each.at_ns, f"{each.kind}: {each.message}") for each in self.vobc.faults.events]
        if self._wire is not None:
            told += [
                (each.at_ns, f"{each.node} is {each.state.value}") for each in self._wire.events
            ]
        return sorted(told, key=lambda each: each[0])

    def _taken_over(self) -> DisturbedWire:
        if self._wire is None:
            self._wire = DisturbedWire(self._bus, self, acting=COMMANDED)
        return self._wire

    def _babble(self, wire: DisturbedWire, plan: FaultPlan, active: bool, now_ns: int) -> None:
        port = self._babblers.get(plan.index)
        if port is None:
            port = self._babblers[plan.index] = self._bus.port(f"{BABBLER}{plan.index}", ())
        if active:
            idiot: BabblingIdiot = plan.parameters
            wire.babble(port, idiot.can_id, BABBLE, idiot.load_ratio, now_ns)
        else:
            wire.hush(port, now_ns)

    def _cut(self, wire: DisturbedWire, cut: LinkCut, now_ns: int) -> None:
        """Mended when the last of the faults that cut it is over."""
        if any(other.node is cut.node for _, other in self._acting.of(LinkCut)):
            wire.cut(cut.node.name, now_ns)
        else:
            wire.mend(cut.node.name, now_ns)

    def _restart(self, wire: DisturbedWire, ended: Any, now_ns: int) -> None:
        """Nodes that were driven off the bus come back, but for those that must not."""
        if isinstance(ended, BusOff) and not ended.recovers:
            self._kept_off.append(ended.node.name)
        held = [other.node.name for _, other in self._acting.of(BusOff)]
        for name in wire.nodes_off():
            if name not in (*held, *self._kept_off):
                wire.restart(name, now_ns)


def _acts_on_wire(parameters: Any) -> bool:
    if isinstance(parameters, FrameCorrupt):
        return parameters.damage is DamagePlace.ON_WIRE
    return isinstance(parameters, BabblingIdiot | BusOff | LinkCut)


def _some_bit(acting: Acting, data: bytes) -> int:
    return int(acting.draws.integers(8 * len(data) + CRC_BITS))
