"""Bus faults on the lockstep bench: some between controller and bus, some on the bus itself."""

from collections import Counter
from collections.abc import Sequence
from typing import Any, Final

from firmware_py.buses.confinement import CRC_BITS, ErrorCounters
from firmware_py.buses.disturbed import DisturbedWire, Disturber
from firmware_py.buses.inproc import VirtualBus, VirtualPort
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
"""Name of the port of a babbling node, which is no node of the train."""
BABBLE: Final = b"\xaa" * 8
"""Data of the babbling node; it needs no stuff bits."""
COMMANDED: Final = {
    can_id: known.acting for can_id, known in known_messages().items() if known.sender == CONTROLLER
}
"""Unit that acts on each command; the plant receives all commands at one node."""


class FaultyPort:
    """The controller's CanPort with faults between it and the bus."""

    def __init__(self, port: CanPort, faults: FrameFaults) -> None:
        self.faults = faults
        self.stranger: CanPort | None = None
        """Port of a masquerading node; without it its frames go where genuine ones pass."""
        self._port = port
        self._uncommon: list[CanFrame] = []
        """Received error, remote and 29-bit frames; no fault acts on them."""

    @property
    def counters(self) -> LinkCounters:
        return self._port.counters

    def send(self, now_ns: int, can_id: int, data: bytes) -> None:
        self.faults.offer(now_ns, FrameDirection.TO_TRAIN, can_id, data)
        self.poll(now_ns)

    def poll(self, now_ns: int) -> None:
        """Send the frames that are due. Without this call they go with the next `send`."""
        for _, can_id, data in self.faults.take(now_ns, FrameDirection.TO_TRAIN):
            self._port.send(now_ns, can_id, data)
        if self.stranger is not None:
            for _, can_id, data in self.faults.take_strangers(now_ns):
                self.stranger.send(now_ns, can_id, data)

    def settle(self, now_ns: int) -> None:
        """Take in all frames up to now, so that a fault that begins now does not affect them."""
        for frame in self._port.receive(now_ns):
            if frame.extended or frame.remote or frame.error:
                self._uncommon.append(frame)
                continue
            self.faults.offer(frame.stamp_ns, FrameDirection.TO_VOBC, frame.can_id, frame.data)

    def receive(self, now_ns: int) -> Sequence[CanFrame]:
        """Return the received frames, stamped with the instant at which they get through."""
        self.settle(now_ns)
        taken = self.faults.take(now_ns, FrameDirection.TO_VOBC)
        frames = [CanFrame(due_ns, can_id, data) for due_ns, can_id, data in taken]
        if self._uncommon:
            frames = sorted([*frames, *self._uncommon], key=lambda frame: frame.stamp_ns)
            self._uncommon.clear()
        return frames

    def close(self) -> None:
        self._port.close()


class SharedWire(DisturbedWire):
    """A wire that destroys frames of its own choice, and others as `next_disturber` says."""

    next_disturber: Disturber | None = None

    def disturb(self, disturber: Disturber) -> None:
        """Let this one decide about the frames that this wire spares."""
        self.disturber, self.next_disturber = self, disturber

    def struck_bit(self, start_ns: int, can_id: int, data: bytes, sender: str) -> int | None:
        """Return the bit that is destroyed in a starting frame; see `Disturber`."""
        if self.next_disturber is None:
            return None
        return self.next_disturber.struck_bit(start_ns, can_id, data, sender)


class BusFaults:
    """Applies each bus fault where it acts; takes over the bus when the first fault needs it."""

    def __init__(
        self, bus: VirtualBus, vobc: FaultyPort, seed: int, wire: SharedWire | None = None
    ) -> None:
        """Args:
        wire: what already carries the frames of the bus.
        """
        self.vobc = vobc
        self._bus = bus
        self._acting = ActingFaults(FaultPlace.BUS, seed)
        self._wire: DisturbedWire | None = wire
        if wire is not None:
            wire.disturb(self)
        self._babblers: dict[int, VirtualPort] = {}
        self._frames_before: dict[int, int] = {}
        """Frames on the bus at the start of an active cut or babbling node, by index of the
        fault."""
        self._kept_off: list[str] = []
        """Nodes that stay off the bus for good."""

    def reseed(self, seed: int) -> None:
        """Let faults that begin from now on use another seed."""
        self._acting.reseed(seed)
        self.vobc.faults.reseed(seed)

    def change(self, plan: FaultPlan, active: bool, now_ns: int) -> None:
        """Take a change of a fault from the schedule; faults of other places are ignored."""
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
        # Frames that started before now met only the earlier faults.
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
        """Return the bit that faults on the wire destroy in a frame that is about to start."""
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
        """Return the error counters of a node."""
        return self._taken_over().errors_of(node, now_ns)

    def _count_frames(self, plan: FaultPlan, active: bool) -> None:
        """Count frames that a cut node misses, or that wait for a babbling node: all of them."""
        if active:
            self._frames_before[plan.index] = self._bus.statistics().frames
        else:
            before = self._frames_before.pop(plan.index, None)
            if before is not None:
                self._acting.touched[plan.index] += self._bus.statistics().frames - before

    @property
    def touched(self) -> Counter[int]:
        """Number of frames that each fault changed, kept away or added, by index of the fault."""
        found = Counter(self._acting.touched)
        found.update(self.vobc.faults.touched)
        frames = self._bus.statistics().frames
        found.update({index: frames - before for index, before in self._frames_before.items()})
        return found

    @property
    def done(self) -> Counter[tuple[str, str]]:
        """Number of times that each kind of fault struck each message."""
        return self.vobc.faults.done

    @property
    def error_frames(self) -> Counter[str]:
        """Number of destroyed frames, by sender."""
        return Counter() if self._wire is None else self._wire.error_frames

    def story(self) -> list[tuple[int, str]]:
        """Return the events by instant: the first thousand of frames and of node states each."""
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
        """Cut a node, or mend the link when the last fault that cut it is over."""
        if any(other.node is cut.node for _, other in self._acting.of(LinkCut)):
            wire.cut(cut.node.name, now_ns)
        else:
            wire.mend(cut.node.name, now_ns)

    def _restart(self, wire: DisturbedWire, ended: Any, now_ns: int) -> None:
        """Restart nodes that were off the bus, except those that must stay off."""
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
