"""Radio of a train in train-to-train control: bytes in, bytes out, memory stored first."""

from collections import Counter
from collections.abc import Callable, Iterable
from typing import Final

from firmware_py.ports import RadioMessage, TunableRadioPort
from vobc.train_to_train.train import TrainCore
from vobc.train_to_train.vocabulary import HeldAuthority, OwnTrain, Role, TrainMemory, TrainState
from zenoh_config import t2t_keys
from zenoh_config.codec import BENCH_KEY, SafetyKey, pack, unpack
from zenoh_config.messages import Refused
from zenoh_config.t2t import AreaAuthority, T2tMessage

Store = Callable[[TrainMemory], bool]
"""Stores the memory. The result says whether it is safe on the disk."""
WAITING_MAX: Final = 1000
"""Greatest number of messages stored between two steps. More are refused and counted."""


class LineRadio:
    """Carries out the decisions of the core in its order: store, apply, send.

    Authorities wait until the control cycle requests them with `apply`. The next report then
    acknowledges exactly what ATP uses.
    """

    def __init__(
        self,
        core: TrainCore,
        line_name: str,
        store: Store,
        *,
        key: SafetyKey = BENCH_KEY,
        database: int | None = None,
    ) -> None:
        """`database` is the version of the track database; messages of another one are refused."""
        self.authority: HeldAuthority | None = None
        """Authority for ATP in the control cycle that requested it."""
        self.state = TrainState.LOST
        self.roles: dict[int, Role] = {}
        self.refusals: Counter[str] = Counter()
        """Refused messages by reason, for envelope and key. The core counts its own."""
        self.subscriptions = t2t_keys.of_train(line_name, core.address)
        """Key expressions of the port's subscriptions: the initial ones, or those that `tune` has
        set."""
        self._listens = core.listens
        self._core, self._line_name, self._store, self.key = core, line_name, store, key
        self._database = database
        self._heard: list[T2tMessage] = []
        self._authorities: list[T2tMessage] = []
        self._unstored: TrainMemory | None = None

    def takes(self, messages: Iterable[RadioMessage]) -> list[RadioMessage]:
        """Store messages of this protocol for the next step. The result is the other messages."""
        others = []
        for message in messages:
            heard = unpack(message.payload, self.key, database=self._database)
            if isinstance(heard, Refused):
                self.refusals[heard.reason.value] += 1
            elif not isinstance(heard, T2tMessage):
                others.append(message)
            elif message.key != t2t_keys.key_of(self._line_name, heard):
                # A message under the key of another sender does not come from that sender.
                self.refusals["wrong source"] += 1
            elif len(self._heard) + len(self._authorities) >= WAITING_MAX:
                self.refusals["flood"] += 1
            elif isinstance(heard, AreaAuthority):
                self._authorities.append(heard)
            else:
                self._heard.append(heard)
        return others

    def refused(self) -> Counter[str]:
        """Total number of messages not acted on, by reason."""
        return self.refusals + self._core.refusals

    @property
    def round_trip_ms(self) -> tuple[float, int]:
        """Time that the arbiters take to answer, and the longest one that the timers allow."""
        return self._core.round_trip_ms, self._core.round_trip_max_ms

    def is_due(self, now_ns: int) -> bool:
        """Whether a step has something to do."""
        return bool(self._heard) or now_ns >= self._core.next_due_ns()

    def tune(self, port: TunableRadioPort) -> None:
        """Subscribe the port to the areas where the train is now."""
        if self._core.listens is not self._listens:
            self._listens = self._core.listens
            areas = sorted(self._listens)
            self.subscriptions = t2t_keys.of_train(self._line_name, self._core.address, areas)
            port.listen(self.subscriptions)

    def step(self, now_ns: int, own: OwnTrain, *, apply: bool) -> list[tuple[str, bytes]]:
        """Run one step. The result is key and payload of each message to send.

        While the disk does not accept the memory, nothing is applied or sent.
        """
        heard, self._heard = self._heard, []
        if apply:
            heard, self._authorities = [*heard, *self._authorities], []
        stepped = self._core.step(now_ns, tuple(heard), own)
        self._unstored = stepped.memory or self._unstored
        if self._unstored is not None:
            if not self._store(self._unstored):
                self.authority = None
                return []
            self._unstored = None
        self.authority, self.state = stepped.authority, stepped.state
        self.roles = dict(stepped.roles)
        return self._packed(stepped.out)

    def _packed(self, messages: Iterable[T2tMessage]) -> list[tuple[str, bytes]]:
        """Leave out what does not fit into its field. A value that another train sent led to it."""
        packed = []
        for message in messages:
            try:
                payload = pack(message, self.key, database=self._database)
            except ValueError:
                self.refusals["not sendable"] += 1
                continue
            packed.append((t2t_keys.key_of(self._line_name, message), payload))
        return packed
