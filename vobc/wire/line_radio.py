"""A train among trains that command themselves, on the radio: bytes in, bytes out, stored first."""

from collections import Counter
from collections.abc import Callable, Iterable
from typing import Final

from firmware_py.ports import RadioMessage, TunableRadioPort
from vobc.train_to_train.train import TrainCore
from vobc.train_to_train.vocabulary import HeldAuthority, OwnTrain, Role, TrainMemory, TrainState
from zenoh_config import t2t_keys
from zenoh_config.codec import BENCH_KEY, pack, unpack
from zenoh_config.messages import Refused
from zenoh_config.t2t import AreaAuthority, T2tMessage

Store = Callable[[TrainMemory], bool]
"""Whether the memory is safe on the disk."""
WAITING_MAX: Final = 1000
"""Messages kept between two steps; more are refused and counted."""


class LineRadio:
    """Carries out what the core decides, in its order: store, apply, send.

    Authorities wait until the control cycle asks for them with `apply`, so that what the next
    report acknowledges is what the brake loop has.
    """

    def __init__(
        self, core: TrainCore, line_name: str, store: Store, *, key: bytes = BENCH_KEY
    ) -> None:
        self.authority: HeldAuthority | None = None
        """To be handed to the protection in the control cycle that asked for it."""
        self.state = TrainState.LOST
        self.roles: dict[int, Role] = {}
        self.refusals: Counter[str] = Counter()
        """By reason: of the envelope and the key; the core counts its own."""
        self.subscriptions = t2t_keys.of_train(line_name, core.address)
        """Key expressions that its port listens to, at first and as `tune` has left it."""
        self._listens = core.listens
        self._core, self._line_name, self._store, self.key = core, line_name, store, key
        self._heard: list[T2tMessage] = []
        self._authorities: list[T2tMessage] = []
        self._unstored: TrainMemory | None = None

    def takes(self, messages: Iterable[RadioMessage]) -> list[RadioMessage]:
        """Keep what is of this protocol for the next step; the rest comes back."""
        others = []
        for message in messages:
            heard = unpack(message.payload, self.key)
            if isinstance(heard, Refused):
                self.refusals[heard.reason.value] += 1
            elif not isinstance(heard, T2tMessage):
                others.append(message)
            elif message.key != t2t_keys.key_of(self._line_name, heard):
                # What one says under the key of another was not said by that other.
                self.refusals["wrong source"] += 1
            elif len(self._heard) + len(self._authorities) >= WAITING_MAX:
                self.refusals["flood"] += 1
            elif isinstance(heard, AreaAuthority):
                self._authorities.append(heard)
            else:
                self._heard.append(heard)
        return others

    def refused(self) -> Counter[str]:
        """Messages that were not acted on, by reason: all of them so far."""
        return self.refusals + self._core.refusals

    def is_due(self, now_ns: int) -> bool:
        """A step would have something to do."""
        return bool(self._heard) or now_ns >= self._core.next_due_ns()

    def tune(self, port: TunableRadioPort) -> None:
        """Have the port, which listens to `subscriptions`, listen where the train is now."""
        if self._core.listens is not self._listens:
            self._listens = self._core.listens
            areas = sorted(self._listens)
            self.subscriptions = t2t_keys.of_train(self._line_name, self._core.address, areas)
            port.listen(self.subscriptions)

    def step(self, now_ns: int, own: OwnTrain, *, apply: bool) -> list[tuple[str, bytes]]:
        """Key and payload of everything to send, after what was to be applied is applied.

        Nothing is applied or sent for as long as the disk does not take what must be stored.
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
        return [
            (t2t_keys.key_of(self._line_name, message), pack(message, self.key))
            for message in stepped.out
        ]
