"""A switch, crossing or platform track: locked for passing, or free to move or open."""

from firmware_py.trackdb.areas import ObjectSite
from plant_emulator.wayside.t2t_vocabulary import ObjectMemory, WaysideStepped
from zenoh_config.t2t import T2tMessage
from zenoh_config.timers import LineTimers


class LineObject:
    """Says its status at every change and every heartbeat period, as WAYSIDE, to BROADCAST."""

    def __init__(
        self,
        timers: LineTimers,
        site: ObjectSite,
        area: int,
        *,
        memory: ObjectMemory | None,
        start_ns: int,
    ) -> None:
        """`memory` as stored; None when it cannot be read: then it stays FAILED."""
        raise NotImplementedError

    def next_due_ns(self) -> int:
        raise NotImplementedError

    def step(
        self,
        now_ns: int,
        heard: tuple[T2tMessage, ...],
        *,
        release_wanted: bool,
        occupied: bool,
    ) -> WaysideStepped[ObjectMemory]:
        """`release_wanted`: it is asked to move or open; `occupied`: a train stands in it."""
        raise NotImplementedError
