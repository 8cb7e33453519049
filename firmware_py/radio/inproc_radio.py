"""A radio in virtual time, in one process: delay, jitter, loss, duplication and cuts between ports.

What is drawn does not depend on what is configured: every message costs the same four draws for
each receiver, so that another loss ratio leaves the delays of all other messages as they were.
"""

import heapq
from collections.abc import Collection, Sequence
from typing import Final, Protocol

from firmware_py.ports import LinkCounters, RadioMessage
from zenoh_config import keys

INBOX_MESSAGES: Final = 256
DELAY_S: Final = 0.020
_NS_PER_S: Final = 1e9


class UniformGenerator(Protocol):
    """A generator of uniform numbers in [0, 1), such as numpy's."""

    def random(self) -> float: ...


class InprocRadio:
    """The air between ports. Settings may be changed while it runs; they act on what is sent."""

    def __init__(
        self,
        delay_s: float = DELAY_S,
        *,
        jitter_s: float = 0.0,
        loss_ratio: float = 0.0,
        duplication_ratio: float = 0.0,
        generator: UniformGenerator | None = None,
    ) -> None:
        """Args:
        delay_s: from sending to being heard; the least of it where there is jitter.
        jitter_s: up to this much is added, evenly spread; it may change the order of messages.
        loss_ratio: share of messages that do not arrive, for each receiver.
        duplication_ratio: share of those that arrive twice, each time with its own jitter.
        generator: needed by everything but the delay.
        """
        self.delay_s = delay_s
        self.jitter_s = jitter_s
        self.loss_ratio = loss_ratio
        self.duplication_ratio = duplication_ratio
        self.lost = 0
        self.cut_off = 0
        self.duplicated = 0
        self._generator = generator
        self._ports: dict[str, InprocRadioPort] = {}
        self._cuts: set[tuple[str, str]] = set()
        self._number = 0

    def port(self, name: str, subscriptions: Collection[str]) -> "InprocRadioPort":
        """A station that hears what others send under the keys that it subscribes to."""
        assert name not in self._ports, f"radio port {name} exists"
        self._ports[name] = InprocRadioPort(self, name, tuple(subscriptions))
        return self._ports[name]

    def cut(self, sender: str, receiver: str, *, both_ways: bool = True) -> None:
        """From now on the receiver hears no more of the sender; what is in the air arrives."""
        self._cuts.add((sender, receiver))
        if both_ways:
            self._cuts.add((receiver, sender))

    def heal(self) -> None:
        """End all cuts."""
        self._cuts.clear()

    def carry(self, now_ns: int, sender: "InprocRadioPort", key: str, payload: bytes) -> None:
        for receiver in self._ports.values():
            if receiver is sender or not receiver.is_subscribed_to(key):
                continue
            loss, jitter, duplication, second_jitter = self._draw()
            if (sender.name, receiver.name) in self._cuts:
                self.cut_off += 1
            elif loss < self.loss_ratio:
                self.lost += 1
            else:
                self._deliver(now_ns, receiver, key, payload, jitter)
                if duplication < self.duplication_ratio:
                    self.duplicated += 1
                    self._deliver(now_ns, receiver, key, payload, second_jitter)

    def _draw(self) -> tuple[float, float, float, float]:
        generator = self._generator
        if generator is None:
            assert self.jitter_s == self.loss_ratio == self.duplication_ratio == 0.0
            return 0.0, 0.0, 0.0, 0.0
        return generator.random(), generator.random(), generator.random(), generator.random()

    def _deliver(
        self, now_ns: int, receiver: "InprocRadioPort", key: str, payload: bytes, jitter: float
    ) -> None:
        due_ns = now_ns + round((self.delay_s + jitter * self.jitter_s) * _NS_PER_S)
        self._number += 1
        receiver.hear(due_ns, self._number, key, payload)


class InprocRadioPort:
    def __init__(self, radio: InprocRadio, name: str, subscriptions: tuple[str, ...]) -> None:
        self.counters = LinkCounters()
        self.name = name
        self._radio = radio
        self._subscriptions = subscriptions
        self._hears: dict[str, bool] = {}
        """By key; a line has few, and says all of them again and again."""
        self._inbox: list[tuple[int, int, str, bytes]] = []
        """Heap by instant, then by the order of sending: the same order in every run."""
        self._closed = False

    def listen(self, subscriptions: Collection[str]) -> None:
        self._subscriptions = tuple(subscriptions)
        self._hears.clear()

    def is_subscribed_to(self, key: str) -> bool:
        hears = self._hears.get(key)
        if hears is None:
            hears = any(keys.matches(wanted, key) for wanted in self._subscriptions)
            self._hears[key] = hears
        return hears and not self._closed

    def hear(self, due_ns: int, number: int, key: str, payload: bytes) -> None:
        heapq.heappush(self._inbox, (due_ns, number, key, payload))
        if len(self._inbox) > INBOX_MESSAGES:
            heapq.heappop(self._inbox)
            self.counters.dropped_in += 1

    def send(self, now_ns: int, key: str, payload: bytes) -> None:
        if self._closed:
            self.counters.dropped_out += 1
            return
        self.counters.sent += 1
        self._radio.carry(now_ns, self, key, payload)

    def receive(self, now_ns: int) -> Sequence[RadioMessage]:
        inbox = self._inbox
        if not inbox or inbox[0][0] > now_ns:
            return ()
        heard: list[RadioMessage] = []
        while inbox and inbox[0][0] <= now_ns:
            due_ns, _, key, payload = heapq.heappop(inbox)
            heard.append(RadioMessage(due_ns, key, payload))
        self.counters.received += len(heard)
        return heard

    def close(self) -> None:
        self._closed = True
        self._inbox.clear()
