"""Forwards frames between two segments through the bus faults that are active.

The gateway stands between the controller on segment A and the train on segment B. Frames of one
side leave on the other in the order of their arrival, unless a fault changes that.
"""

from collections.abc import Mapping, Sequence
from typing import Final, Protocol

from firmware_py.histogram import Histogram
from firmware_py.ports import CanFrame, CanPort
from plant_emulator.faults.declared_bus import FrameDirection

NS_PER_US: Final = 1_000


class Faults(Protocol):
    """The bus faults, without a bus: frames go in, and come out when they are due."""

    def offer(self, now_ns: int, way: FrameDirection, can_id: int, data: bytes) -> None: ...

    def take(self, now_ns: int, way: FrameDirection) -> Sequence[tuple[int, int, bytes]]:
        """Return due instant, identifier and data of each frame."""
        ...

    def next_due_ns(self) -> int | None: ...


class Forwarding:
    """Forwards the frames that have arrived; never waits."""

    def __init__(self, a: CanPort, b: CanPort, faults: Faults) -> None:
        """Join the two segments.

        Args:
            a: the controller's segment.
            b: the train's segment.
        """
        self._sources: Mapping[FrameDirection, CanPort] = {
            FrameDirection.TO_TRAIN: a,
            FrameDirection.TO_VOBC: b,
        }
        self._targets: Mapping[FrameDirection, CanPort] = {
            FrameDirection.TO_TRAIN: b,
            FrameDirection.TO_VOBC: a,
        }
        self._faults = faults
        self.came = {FrameDirection.TO_TRAIN: 0, FrameDirection.TO_VOBC: 0}
        self.sent = {FrameDirection.TO_TRAIN: 0, FrameDirection.TO_VOBC: 0}
        """Frames sent; a difference to the frames received comes from faults."""
        self.uncommon = 0
        """Extended, remote and error frames, which no node of a train sends; they are not
        forwarded."""
        self.wait_us = Histogram()
        """Time from the instant at which a frame is due on the other side until it is sent. Without
        a delaying fault a frame is due on its arrival."""
        self._longest_ns = 0
        self._offered_ns = 0

    def step(self, now_ns: int) -> None:
        """Receive frames on both sides, and send those that are due."""
        for way, frame in self._arrivals(now_ns):
            # Stamps of two segments may not rise together; the time of the faults never goes back.
            self._offered_ns = max(self._offered_ns, min(frame.stamp_ns, now_ns))
            self._faults.offer(self._offered_ns, way, frame.can_id, frame.data)
        self._offered_ns = max(self._offered_ns, now_ns)
        for way, target in self._targets.items():
            for due_ns, can_id, data in self._faults.take(now_ns, way):
                target.send(now_ns, can_id, data)
                self.sent[way] += 1
                self._count_wait(now_ns - due_ns)

    def _arrivals(self, now_ns: int) -> list[tuple[FrameDirection, CanFrame]]:
        found = []
        for way, source in self._sources.items():
            for frame in source.receive(now_ns):
                if frame.extended or frame.remote or frame.error:
                    self.uncommon += 1
                    continue
                self.came[way] += 1
                found.append((way, frame))
        found.sort(key=lambda each: each[1].stamp_ns)
        return found

    def _count_wait(self, wait_ns: int) -> None:
        self.wait_us.add(max(0, wait_ns) // NS_PER_US)
        self._longest_ns = max(self._longest_ns, wait_ns)

    def longest_wait_us(self) -> float:
        """Return the longest wait since the last call."""
        longest_ns, self._longest_ns = self._longest_ns, 0
        return longest_ns / NS_PER_US

    @property
    def next_due_ns(self) -> int | None:
        return self._faults.next_due_ns()

    @property
    def alive(self) -> bool:
        """Whether both segments are there."""
        return all(getattr(port, "alive", True) for port in self._sources.values())

    def summary(self) -> dict[str, int]:
        """Return frame counts, and how long frames waited beyond any delay by a fault."""
        ports = self._sources.values()
        return {
            **{f"came_{way.value}": count for way, count in self.came.items()},
            **{f"sent_{way.value}": count for way, count in self.sent.items()},
            "uncommon": self.uncommon,
            "dropped_in": sum(port.counters.dropped_in for port in ports),
            "dropped_out": sum(port.counters.dropped_out for port in ports),
            "wait_p50_us": self.wait_us.percentile(50.0),
            "wait_p99_us": self.wait_us.percentile(99.0),
            "wait_max_us": self.wait_us.max,
        }
