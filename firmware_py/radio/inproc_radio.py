"""A radio in virtual time, in one process: delay, jitter, loss, duplication and cuts between ports.

Every message takes the same four random numbers for each receiver, whatever the settings are. So
another loss ratio does not change the delays of all other messages.
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
    """The radio channel between ports.

    Settings may be changed while it runs; they affect messages sent later.
    """

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
        delay_s: time from sending to reception; the minimum if there is jitter.
        jitter_s: additional delay, uniformly distributed from 0; it may change the order of
            messages.
        loss_ratio: share of messages that do not arrive, for each receiver.
        duplication_ratio: share of messages that arrive twice, each time with its own jitter.
        generator: needed by all settings except the delay.
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
        """Create a port that receives messages of others under the subscribed keys."""
        assert name not in self._ports, f"radio port {name} exists"
        self._ports[name] = InprocRadioPort(self, name, tuple(subscriptions))
        return self._ports[name]

    def cut(self, sender: str, receiver: str, *, both_ways: bool = True) -> None:
        """Drop all messages from this sender to this receiver from now on; those already sent
        arrive.
        """
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
        self._receives: dict[str, bool] = {}
        """Whether the port receives a key, by key; a line has few keys and repeats them."""
        self._inbox: list[tuple[int, int, str, bytes]] = []
        """Heap by instant, then by order of sending, so that every run has the same order."""
        self._closed = False

    def listen(self, subscriptions: Collection[str]) -> None:
        self._subscriptions = tuple(subscriptions)
        self._receives.clear()

    def is_subscribed_to(self, key: str) -> bool:
        is_wanted = self._receives.get(key)
        if is_wanted is None:
            is_wanted = any(keys.matches(wanted, key) for wanted in self._subscriptions)
            self._receives[key] = is_wanted
        return is_wanted and not self._closed

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
