"""Event queue of all nodes and links of the simulated network, with the faults that it can apply.

A node is a state machine. It receives the time and its messages, and returns what to store, what to
send and when to wake it. The queue stores before it sends. One generator gives all random numbers,
so a run is a function of its seed.
"""

import random
from collections.abc import Callable, Iterable, Sequence
from heapq import heappop, heappush
from typing import Any, Final, Protocol

from metro_hil.simulation.links import SimulatedLink, Weather
from metro_hil.simulation.node import NEVER, Doom, NodeStep, QueuedMessage, SimulatedNode
from metro_hil.simulation.trace import EventHash, Teller

INBOX_MAX: Final = 256
"""Size of an inbox. A full inbox drops its oldest message."""
TURN_NS: Final = 3_000_000
"""Maximum time from the arrival of a message to the step that reads it. The time is sampled for
each message."""
LEAST_REST_NS: Final = 100_000
"""Delay after which a node that asks to be woken at once is woken."""


Meddler = Callable[[int, int, Any], int | None]
"""Receives source, target and message. It returns None to lose the message, 0 to leave it to the
link, or a delay in nanoseconds."""


class Codec(Protocol):
    """Converts messages to bytes and back, for runs that go through the real codec."""

    def seal(self, message: Any) -> bytes: ...

    def open(self, payload: bytes) -> Any | None:
        """Return None for a payload that must be rejected."""


class SimulatedNetwork:
    """Nodes, the links between them and the event queue."""

    def __init__(self, seed: int, *, codec: Codec | None = None, tell: Teller | None = None):
        self.now_ns = 0
        self.turn_ns = TURN_NS
        self.random = random.Random(seed)
        self.trace = EventHash()
        self.tell = tell
        self.codec = codec
        self.nodes: dict[int, SimulatedNode] = {}
        self.sent = self.delivered = self.lost = self.doubled = self.damaged = 0
        self.steps = self.stored = self.fired = self.disks_lost = 0
        self.clock_steps = 0
        self._heap: list[tuple[int, int, Callable[[Any], None], Any]] = []
        self._number = 0
        self._draw = self.random.random
        self._delivers: Callable[[Any], None] = self._deliver
        self._wakes: Callable[[Any], None] = self._wake
        self._meddler: Meddler | None = None

    @property
    def events(self) -> int:
        """Number of messages sent, messages delivered or lost on the way, and steps of nodes."""
        return self.sent + self.delivered + self.lost + self.damaged + self.steps

    def at(self, at_ns: int, call: Callable[[Any], None], argument: object = None) -> None:
        """Queue a call for a true instant, after all earlier calls for the same instant."""
        self._number += 1
        heappush(self._heap, (at_ns, self._number, call, argument))

    def run(self, until_ns: int) -> None:
        """Run all events up to and including that instant."""
        heap, trace = self._heap, self.trace
        fired = 0
        while heap and heap[0][0] <= until_ns:
            self.now_ns, _, call, argument = heappop(heap)
            call(argument)
            fired += 1
            if not fired & 0x3FF:
                trace.spill()
        self.now_ns = until_ns
        self.fired += fired

    def add(self, node: SimulatedNode) -> None:
        """Link a node to all others; its process does not run yet."""
        assert node.address not in self.nodes
        for other in self.nodes.values():
            other.links[node.address] = SimulatedLink(other.address, node.address)
            node.links[other.address] = SimulatedLink(node.address, other.address)
        self.nodes[node.address] = node

    def links(self) -> Iterable[SimulatedLink]:
        return (link for node in self.nodes.values() for link in node.links.values())

    def boot(self, address: int) -> None:
        """Start the process of a node; a running process is left alone."""
        node = self.nodes[address]
        if node.machine is not None:
            return
        node.boots += 1
        node.inbox = []
        node.doom, node.freeze_ns, node.stopped_until_ns = None, 0, 0
        self.say(node.name, f"starts, with {'what it had stored' if node.disk else 'nothing'}")
        self.trace.note(self.now_ns ^ (node.address << 8) ^ 1)
        node.minds = node.tuned = None
        node.machine = node.start(node, node.clock.local_ns(self.now_ns))
        self._wake_at(node, self.now_ns)

    def kill(self, address: int, *, why: str = "is killed", disk_lost: bool = False) -> None:
        """End the process of a node. Its disk keeps what was stored, unless `disk_lost`."""
        node = self.nodes[address]
        if disk_lost:
            node.disk = None
            self.disks_lost += 1
        if node.machine is None:
            return
        self.say(node.name, f"{why}{', its disk is lost' if disk_lost else ''}")
        self.trace.note(self.now_ns ^ (node.address << 8) ^ 2)
        node.machine = None
        node.inbox = []
        node.wake_ns = NEVER

    def stop(self, address: int, for_ns: int) -> None:
        """Stop a process as SIGSTOP does.

        Later it continues with the messages that have piled up.
        """
        node = self.nodes[address]
        if node.machine is not None and self.now_ns + for_ns > node.stopped_until_ns:
            self.say(node.name, f"is stopped for {for_ns / 1e9:.3f} s")
            self._hold(node, for_ns)

    def _hold(self, node: SimulatedNode, for_ns: int) -> None:
        node.stopped_until_ns = self.now_ns + for_ns
        node.wake_ns = NEVER
        self._wake_at(node, node.stopped_until_ns)

    def runs(self, address: int) -> bool:
        """Tell whether the process of a node runs and is not stopped."""
        node = self.nodes[address]
        return node.machine is not None and node.stopped_until_ns <= self.now_ns

    def step_clock(self, address: int, by_ns: int) -> None:
        node = self.nodes[address]
        self.say(node.name, f"clock steps by {by_ns / 1e9:+.3f} s")
        self.clock_steps += 1
        node.clock.step(self.now_ns, by_ns)
        self._rouse(node)

    def drift_clock(self, address: int, drift_ppm: int) -> None:
        node = self.nodes[address]
        self.say(node.name, f"clock drifts by {drift_ppm:+d} ppm")
        node.clock.drift(self.now_ns, drift_ppm)
        self._rouse(node)

    def _rouse(self, node: SimulatedNode) -> None:
        if node.machine is not None and node.stopped_until_ns <= self.now_ns:
            self._wake_at(node, self.now_ns + LEAST_REST_NS)

    def cut(self, pairs: Iterable[tuple[int, int]], *, keeps: bool = False) -> None:
        """Cut the link from first to second node of each pair; `keeps` holds messages back."""
        for source, target in pairs:
            link = self.nodes[source].links[target]
            link.cut += 1
            link.keeps = keeps

    def heal(self, pairs: Iterable[tuple[int, int]]) -> None:
        """Undo one cut of each pair; messages held back arrive now, in order and all at once."""
        for source, target in pairs:
            link = self.nodes[source].links[target]
            link.cut -= 1
            if link.cut == 0 and link.kept:
                kept, link.kept = link.kept, []
                at_ns = self.now_ns + link.weather.delay_ns
                for payload in kept:
                    self.at(at_ns, self._delivers, (self.nodes[target], payload))

    def deliver(self, target: int, message: Any) -> None:
        """Deliver a message that no node sent, for directed scenarios."""
        self.at(self.now_ns, self._delivers, (self.nodes[target], message))

    def weather(self, links: Iterable[SimulatedLink], weather: Weather) -> None:
        for link in links:
            link.change(weather)

    def meddle(self, meddler: Meddler | None) -> None:
        """Let `meddler` inspect each message and lose or delay it, for directed scenarios."""
        self._meddler = meddler
        for link in self.links():
            link.watch(meddler is not None)

    def say(self, who: str, what: str) -> None:
        if self.tell is not None:
            self.tell(self.now_ns, who, what)

    def _wake_at(self, node: SimulatedNode, at_ns: int) -> None:
        if at_ns < node.wake_ns:
            node.wake_ns = at_ns
            self._number += 1
            heappush(self._heap, (at_ns, self._number, self._wakes, node))

    def _wake(self, node: SimulatedNode) -> None:
        if node.wake_ns != self.now_ns or node.machine is None:
            return
        node.wake_ns = NEVER
        heard, node.inbox = node.inbox, []
        if heard and self.codec is not None:
            heard = self._opened(heard)
        now_ns = self.now_ns
        self.steps += 1
        turn = node.machine.step(node.clock.local_ns(now_ns), heard)
        self.trace.note(now_ns ^ ((node.address & 0x7F) << 56))
        if node.doom is not None:
            self._dying(node, turn)
            return
        if turn.keep is not node.disk:
            self.stored += 1
            node.disk = turn.keep
        if turn.apply is not None:
            turn.apply()
        if turn.letters:
            self._post(node, turn.letters)
        if node.stopped_until_ns <= now_ns:
            due_ns = node.clock.true_ns(turn.due_ns)
            least_ns = now_ns + LEAST_REST_NS
            self._wake_at(node, due_ns if due_ns > least_ns else least_ns)

    def _dying(self, node: SimulatedNode, turn: NodeStep) -> None:
        """Carry out only the part of the step that comes before the node's death."""
        doom = node.doom
        assert doom is not None
        if doom is not Doom.BEFORE_STORING:
            node.disk = turn.keep
        if doom is Doom.WHILE_SENDING:
            if turn.apply is not None:
                turn.apply()
            half = (len(turn.letters) + 1) // 2
            self._send((node, node.boots, turn.letters[:half]))
        self.kill(node.address, why=f"dies {doom.value}")

    def _post(self, node: SimulatedNode, letters: Sequence[QueuedMessage]) -> None:
        if node.freeze_ns:
            self.say(node.name, f"is stopped before it sends, for {node.freeze_ns / 1e9:.3f} s")
            for_ns, node.freeze_ns = node.freeze_ns, 0
            self.at(self.now_ns + for_ns, self._send, (node, node.boots, letters))
            self._hold(node, for_ns)
        elif node.slow_ns:
            self.at(self.now_ns + node.slow_ns, self._send, (node, node.boots, letters))
        else:
            self._send((node, node.boots, letters))

    def _send(self, what: tuple[SimulatedNode, int, Sequence[QueuedMessage]]) -> None:
        node, boots, letters = what
        if node.boots != boots or node.machine is None:
            return
        if node.stopped_until_ns > self.now_ns:
            self.at(node.stopped_until_ns, self._send, what)
            return
        codec, links = self.codec, node.links
        for letter in letters:
            targets, message, topic = letter.targets, letter.message, letter.topic
            if self.tell is not None and targets:
                self.say(node.name, f"sends {message}")
            payload = message if codec is None else codec.seal(message)
            for target in targets:
                receiver = self.nodes[target]
                if topic is not None and receiver.tuned is not None and topic not in receiver.tuned:
                    continue
                link = links[target]
                self.sent += 1
                if link.cut:
                    if link.keeps and len(link.kept) < INBOX_MAX:
                        link.kept.append(payload)
                    else:
                        self.lost += 1
                elif link.fair:
                    weather = link.weather
                    self._number += 1
                    at_ns = self.now_ns + weather.delay_ns + int(self._draw() * weather.spread_ns)
                    heappush(self._heap, (at_ns, self._number, self._delivers, (receiver, payload)))
                else:
                    self._send_foul(link, payload)

    def _send_foul(self, link: SimulatedLink, payload: Any) -> None:
        weather, draw, receiver = link.weather, self._draw, self.nodes[link.target]
        if self._meddler is not None:
            by_ns = self._meddler(link.source, link.target, payload)
            if by_ns is None:
                self.lost += 1
                return
            if by_ns:
                self.at(self.now_ns + by_ns, self._delivers, (receiver, payload))
                return
        if draw() < weather.loss_share:
            self.lost += 1
            return
        copies = 1
        if draw() < weather.double_share:
            self.doubled += 1
            copies = 2
        for _ in range(copies):
            copy = payload
            if draw() < weather.damage_share:
                self.damaged += 1
                if self.codec is None:
                    # A message that was not encoded cannot be damaged; the receiver's codec would
                    # reject it.
                    continue
                copy = self._flipped(payload)
            at_ns = self.now_ns + weather.delay_ns + int(draw() * weather.spread_ns)
            if draw() < weather.late_share:
                at_ns += int(draw() * weather.late_ns)
            self.at(at_ns, self._delivers, (receiver, copy))

    def _flipped(self, payload: bytes) -> bytes:
        damaged = bytearray(payload)
        for _ in range(1 + int(self._draw() * 3)):
            at = int(self._draw() * len(damaged) * 8)
            damaged[at // 8] ^= 1 << (at % 8)
        return bytes(damaged)

    def _opened(self, heard: list[Any]) -> list[Any]:
        assert self.codec is not None
        return [message for each in heard if (message := self.codec.open(each)) is not None]

    def _deliver(self, what: tuple[SimulatedNode, Any]) -> None:
        node, payload = what
        if node.machine is None:
            self.lost += 1
            return
        self.delivered += 1
        inbox = node.inbox
        if len(inbox) >= INBOX_MAX:
            del inbox[0]
        inbox.append(payload)
        if node.minds is not None and not node.minds(payload):
            return
        if node.stopped_until_ns <= self.now_ns:
            at_ns = self.now_ns + int(self._draw() * self.turn_ns)
            if at_ns < node.wake_ns:
                node.wake_ns = at_ns
                self._number += 1
                heappush(self._heap, (at_ns, self._number, self._wakes, node))
