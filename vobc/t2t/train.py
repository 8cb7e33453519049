"""One train among trains that command themselves: the state machine that its process runs."""

from firmware_py.trackdb.areas import AreaMap
from vobc.t2t.vocabulary import OwnTrain, Stepped, T2tConfig, TrainMemory
from zenoh_config.t2t import T2tMessage


class TrainCore:
    """Not for reuse over a restart: a new incarnation is a new object with the stored memory."""

    def __init__(
        self,
        config: T2tConfig,
        line: AreaMap,
        *,
        address: int,
        memory: TrainMemory,
        start_ns: int,
        seed: int = 0,
    ) -> None:
        """`memory` as it was stored; the first step hands out the one of this incarnation."""
        raise NotImplementedError

    def next_due_ns(self) -> int:
        """When the next step is needed although nothing is heard."""
        raise NotImplementedError

    def step(self, now_ns: int, heard: tuple[T2tMessage, ...], own: OwnTrain) -> Stepped:
        """Read all, decide once, say all."""
        raise NotImplementedError
