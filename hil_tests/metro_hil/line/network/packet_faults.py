"""Packet faults between trains and their wayside: loss, delay, duplication, cuts in one direction.

Pure: it takes the time and packets. The fate of the nth packet from one end to the other follows
from the seed, the two ends and n alone. It depends neither on other senders nor on cuts.
"""

import random
from collections.abc import Iterable
from dataclasses import asdict, dataclass
from heapq import heappop, heappush

from metro_hil.simulation.links import Weather

Way = tuple[str, str]
"""Sender and receiver."""


@dataclass(slots=True)
class WayCounts:
    """Packet counts of one direction."""

    sent: int = 0
    lost: int = 0
    """Lost at random."""
    cut: int = 0
    """Sent during a cut."""
    doubled: int = 0


class Ether:
    """All directions at once."""

    def __init__(self, weather: Weather, seed: int) -> None:
        self.counts: dict[Way, WayCounts] = {}
        self._weather, self._seed = weather, seed
        self._draws: dict[Way, random.Random] = {}
        self._cut: set[Way] = set()
        self._heap: list[tuple[int, int, str, bytes]] = []
        self._number = 0

    def cut(self, ways: Iterable[Way]) -> None:
        """Lose everything that is sent from now on; packets that are on their way still arrive."""
        self._cut.update(ways)

    def heal(self, ways: Iterable[Way]) -> None:
        self._cut.difference_update(ways)

    def send(self, now_ns: int, way: Way, packet: bytes) -> None:
        counts = self.counts.setdefault(way, WayCounts())
        counts.sent += 1
        delays_ns = self._fate(way)
        if way in self._cut:
            counts.cut += 1
            return
        counts.lost += not delays_ns
        counts.doubled += len(delays_ns) > 1
        for delay_ns in delays_ns:
            self._number += 1
            heappush(self._heap, (now_ns + delay_ns, self._number, way[1], packet))

    def _fate(self, way: Way) -> tuple[int, ...]:
        """Return the delays of the packet's copies; none: lost.

        Every packet takes equally many samples.
        """
        draw = self._draws.get(way)
        if draw is None:
            draw = self._draws[way] = random.Random(f"{self._seed} {way[0]} {way[1]}")
        weather = self._weather
        lost, doubled, first, second = (draw.random() for _ in range(4))
        if lost < weather.loss_share:
            return ()
        shares = (first, second) if doubled < weather.double_share else (first,)
        return tuple([weather.delay_ns + int(share * weather.spread_ns) for share in shares])

    def due_ns(self) -> int | None:
        """Return when the next packet arrives."""
        return self._heap[0][0] if self._heap else None

    def take(self, now_ns: int) -> list[tuple[str, bytes]]:
        """Return the packets that have arrived by now with their receivers, in order of arrival."""
        arrived = []
        while self._heap and self._heap[0][0] <= now_ns:
            _, _, target, packet = heappop(self._heap)
            arrived.append((target, packet))
        return arrived

    def told(self) -> dict[str, dict[str, int]]:
        """Return the counts, for JSON."""
        return {f"{a} > {b}": asdict(each) for (a, b), each in sorted(self.counts.items())}
