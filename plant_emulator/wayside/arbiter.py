"""The third party: grants each area's lease to one train at a time, under terms that only grow."""

from plant_emulator.wayside.t2t_vocabulary import ArbiterMemory, WaysideStepped
from zenoh_config.t2t import T2tMessage
from zenoh_config.timers import LineTimers


class Arbiter:
    def __init__(
        self, timers: LineTimers, *, address: int, memory: ArbiterMemory | None, start_ns: int
    ) -> None:
        """`memory` as stored; None when it cannot be read: then it never grants anything."""
        raise NotImplementedError

    def step(self, now_ns: int, heard: tuple[T2tMessage, ...]) -> WaysideStepped[ArbiterMemory]:
        raise NotImplementedError
