"""A schedule of faults from a seed: which kinds it has, how often, on which nodes and for how long.

Each seed takes some kinds and leaves out others. A run with all kinds at once can hide what a run
with one kind shows.
"""

import random
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final

from metro_hil.simulation.event_queue import SimulatedNetwork
from metro_hil.simulation.links import CLEAR, Weather
from metro_hil.simulation.node import Doom

NS_PER_S: Final = 1_000_000_000
NS_PER_MS: Final = 1_000_000


@dataclass(frozen=True, slots=True)
class FaultScale:
    """Severity of the faults. The mean time between two faults is sampled from the given range."""

    between_s_min: float = 2.0
    between_s_max: float = 30.0
    drift_ppm: int = 200
    """Maximum clock drift that the protocol assumes; a run stays within it."""
    steps: bool = True
    """Whether clocks may jump forwards, which their node cannot notice, or back, which it can."""
    disks: bool = True
    """Whether disks may be lost."""
    quiet: bool = False
    """Whether the run has its usual weather and no other fault."""
    foul_share: float = 0.0
    """Severity of the disturbance that affects changing links all the time; 0 for none."""


class NetworkFaults:
    """Begins and ends faults on a network; `calm` ends all of them and begins no new one."""

    def __init__(
        self,
        net: SimulatedNetwork,
        *,
        seed: int,
        victims: Sequence[int],
        revive: Callable[[int], None],
        scale: FaultScale,
    ) -> None:
        """`revive` starts a dead node."""
        self.net, self.victims, self.revive, self.scale = net, victims, revive, scale
        self.counts: dict[str, int] = {}
        self._rng = random.Random(seed ^ 0x5EED)
        self._over = False
        self._cuts: dict[int, list[tuple[int, int]]] = {}
        self._cut_number = 0
        self._void: set[int] = set()
        """Nodes whose clocks went back and that have not been restarted since."""
        self._usual = CLEAR
        rng = self._rng
        kinds: list[tuple[str, Callable[[], None], int]] = [
            ("pause", self._pause, 4),
            ("pause before sending", self._freeze, 3),
            ("crash", self._crash, 4),
            ("crash in a step", self._crash_in_step, 4),
            ("cut off", self._isolate, 3),
            ("cut one way", self._one_way, 3),
            ("partition", self._partition, 2),
            ("weather", self._storm, 3),
            ("slow", self._slow, 2),
            ("drift", self._drift, 2),
            ("stampede", self._stampede, 1),
        ]
        if scale.steps:
            kinds.append(("clock step", self._clock_step, 1))
            kinds.append(("clock back", self._clock_back, 1))
        if scale.disks:
            kinds.append(("crash with its disk", self._crash_disk, 1))
        chosen = [each for each in kinds if rng.random() < 0.6] or [rng.choice(kinds)]
        self.kinds = tuple(name for name, _, _ in chosen)
        self._choices = [(name, call) for name, call, weight in chosen for _ in range(weight)]
        spread_s = scale.between_s_max - scale.between_s_min
        self._between_ns = int((scale.between_s_min + rng.random() ** 2 * spread_s) * NS_PER_S)

    def begin(self) -> None:
        self._ambient()
        if not self.scale.quiet:
            self._next()

    def calm(self) -> None:
        """End all faults of links, clocks and nodes; no new fault begins."""
        self._over = True
        for pairs in self._cuts.values():
            self.net.heal(pairs)
        self._cuts.clear()
        self.net.weather(self.net.links(), CLEAR)
        for address in self.victims:
            self.net.nodes[address].slow_ns = 0
            self.net.nodes[address].doom = None
            self.net.nodes[address].freeze_ns = 0
            if address in self._void:
                self.net.kill(address, why="is ended, as its clock went back")
            self.revive(address)
        self.net.say("faults", "all over")

    # -- schedule
    # -----------------------------------------------------------------------------------

    def _next(self) -> None:
        wait_ns = int(self._rng.expovariate(1.0) * self._between_ns)
        self.net.at(self.net.now_ns + wait_ns, self._strike)

    def _strike(self, _: object) -> None:
        if self._over:
            return
        name, call = self._rng.choice(self._choices)
        self.counts[name] = self.counts.get(name, 0) + 1
        call()
        self._next()

    def _later(self, for_ns: int, call: Callable[[object], None]) -> None:
        """Queue the end of a fault; it is skipped if all faults have ended meanwhile."""
        self.net.at(self.net.now_ns + for_ns, lambda _: None if self._over else call(_))

    def _victim(self) -> int:
        return self._rng.choice(self.victims)

    def _span_ns(self, least_ms: float, most_ms: float) -> int:
        """Return a random duration; short ones are as frequent as long ones."""
        ratio = most_ms / least_ms
        return int(least_ms * ratio ** self._rng.random() * NS_PER_MS)

    # -- the faults --------------------------------------------------------------------------------

    def _ambient(self) -> None:
        """Set the link quality of the whole run before the first fault."""
        if not self.scale.quiet:
            self._usual = self._weather(0.03 * self._rng.random())
        self.net.weather(self.net.links(), self._usual)
        if self.scale.foul_share:
            self._foul(None)

    def _foul(self, _: object) -> None:
        """Degrade half of the links, and others after a while; the end of a storm clears some."""
        weather = self._weather(self.scale.foul_share)
        self.net.weather([each for each in self.net.links() if self._rng.random() < 0.5], weather)
        self._later(self._span_ns(1000.0, 8000.0), self._foul)

    def _weather(self, badness_share: float) -> Weather:
        rng = self._rng
        return Weather(
            delay_ns=self._span_ns(0.2, 10.0),
            spread_ns=self._span_ns(0.5, 40.0),
            loss_share=badness_share * rng.random(),
            double_share=badness_share * rng.random() * (rng.random() < 0.5),
            damage_share=badness_share * rng.random() * (rng.random() < 0.3),
            late_share=badness_share * rng.random() * (rng.random() < 0.5),
            late_ns=self._span_ns(50.0, 3000.0),
        )

    def _storm(self) -> None:
        links = list(self.net.links())
        if self._rng.random() < 0.7:
            address = self._victim()
            links = [each for each in links if address in (each.source, each.target)]
        weather = self._weather(0.5)
        self.net.say("faults", f"weather on {len(links)} links: {weather}")
        self.net.weather(links, weather)

        def back(_: object) -> None:
            self.net.weather(links, self._usual)

        self._later(self._span_ns(100.0, 8000.0), back)

    def _pause(self) -> None:
        self.net.stop(self._victim(), self._span_ns(20.0, 8000.0))

    def _freeze(self) -> None:
        self.net.nodes[self._victim()].freeze_ns = self._span_ns(20.0, 4000.0)

    def _crash(self) -> None:
        self._kill(self._victim())

    def _kill(self, address: int, *, disk_lost: bool = False) -> None:
        self.net.kill(address, disk_lost=disk_lost)
        self._restart_later(address)

    def _restart_later(self, address: int) -> None:
        self._later(self._span_ns(5.0, 20000.0), lambda _: self.revive(address))

    def _crash_in_step(self) -> None:
        address = self._victim()
        node = self.net.nodes[address]
        node.doom = self._rng.choice((Doom.BEFORE_STORING, Doom.BEFORE_SENDING, Doom.WHILE_SENDING))
        self._restart_later(address)

    def _crash_disk(self) -> None:
        self._kill(self._victim(), disk_lost=True)

    def _stampede(self) -> None:
        """Kill several nodes at once, as a power failure does."""
        for address in self._rng.sample(list(self.victims), k=max(1, len(self.victims) // 2)):
            self._kill(address)

    def _isolate(self) -> None:
        address = self._victim()
        others = [other for other in self.net.nodes if other != address]
        self._cut([(address, other) for other in others] + [(other, address) for other in others])

    def _one_way(self) -> None:
        address = self._victim()
        others = [other for other in self.net.nodes if other != address]
        if self._rng.random() < 0.3:
            others = [self._rng.choice(others)]
        out = self._rng.random() < 0.5
        self._cut([(address, other) if out else (other, address) for other in others])

    def _partition(self) -> None:
        addresses = list(self.net.nodes)
        self._rng.shuffle(addresses)
        size = self._rng.randint(1, len(addresses) - 1)
        one, two = addresses[:size], addresses[size:]
        there = [(a, b) for a in one for b in two]
        back = [(b, a) for a in one for b in two]
        self._cut(there + back if self._rng.random() < 0.7 else there)

    def _cut(self, pairs: list[tuple[int, int]]) -> None:
        keeps = self._rng.random() < 0.3
        self._cut_number += 1
        number = self._cut_number
        self._cuts[number] = pairs
        self.net.say("faults", f"cut {number}{', kept' if keeps else ''}: {_ways(pairs)}")
        self.net.cut(pairs, keeps=keeps)

        def heal(_: object) -> None:
            self.net.say("faults", f"cut {number} heals")
            self.net.heal(self._cuts.pop(number))

        self._later(self._span_ns(50.0, 12000.0), heal)

    def _slow(self) -> None:
        node = self.net.nodes[self._victim()]
        node.slow_ns = self._span_ns(1.0, 150.0)
        self.net.say(node.name, f"is slow by {node.slow_ns / 1e6:.1f} ms")

        def quick(_: object) -> None:
            node.slow_ns = 0

        self._later(self._span_ns(100.0, 10000.0), quick)

    def _drift(self) -> None:
        ppm = self._rng.randint(-self.scale.drift_ppm, self.scale.drift_ppm)
        self.net.drift_clock(self._victim(), ppm)

    def _clock_step(self) -> None:
        self.net.step_clock(self._victim(), self._span_ns(1.0, 5000.0))

    def _clock_back(self) -> None:
        """Set a clock back, as no sound monotonic clock does; restart the node after a while."""
        address = self._victim()
        self.net.step_clock(address, -self._span_ns(1.0, 5000.0))
        self._void.add(address)

        def restart(_: object) -> None:
            self._void.discard(address)
            self._kill(address)

        self._later(self._span_ns(500.0, 10000.0), restart)


def _ways(pairs: Sequence[tuple[int, int]]) -> str:
    return " ".join(f"{source}>{target}" for source, target in pairs)
