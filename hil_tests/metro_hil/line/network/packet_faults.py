"""What becomes of packets between trains and their wayside: lost, late, doubled, cut off one way.

Pure: it is told the time and handed packets. The fate of the nth packet from one to the other
follows from the seed, these two and n alone, whatever the weather is and whatever others send.
"""

import random
from collections.abc import Iterable
from dataclasses import asdict, dataclass
from heapq import heappop, heappush

from metro_hil.simulation.links import Weather

Way = tuple[str, str]
"""From whom to whom."""


@dataclass(slots=True)
class WayCounts:
    """Packets of one direction."""

    sent: int = 0
    lost: int = 0
    """By the weather."""
    cut: int = 0
    """Sent while nothing came through."""
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
        """Nothing that is sent from now on comes through; what is on its way does."""
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
        """Delays of its copies; none: lost. As many draws for every packet."""
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
        """When the next packet arrives."""
        return self._heap[0][0] if self._heap else None

    def take(self, now_ns: int) -> list[tuple[str, bytes]]:
        """What has arrived by now, and at whom, in the order of arrival."""
        arrived = []
        while self._heap and self._heap[0][0] <= now_ns:
            _, _, target, packet = heappop(self._heap)
            arrived.append((target, packet))
        return arrived

    def told(self) -> dict[str, dict[str, int]]:
        """Counts, for JSON."""
        return {f"{a} > {b}": asdict(each) for (a, b), each in sorted(self.counts.items())}
