"""What the wayside tells each area's master: occupied sections, restrictions, closed stretches."""

from collections.abc import Collection, Mapping

from firmware_py.trackdb.areas import AreaMap
from zenoh_config.messages import SpeedRestriction
from zenoh_config.t2t import T2tMessage
from zenoh_config.timers import LineTimers


class Track:
    def __init__(self, timers: LineTimers, line: AreaMap, *, boot: int, start_ns: int) -> None:
        self.restrictions: tuple[SpeedRestriction, ...] = ()
        self.closed: tuple[SpeedRestriction, ...] = ()
        raise NotImplementedError

    def step(
        self,
        now_ns: int,
        heard: tuple[T2tMessage, ...],
        *,
        axles: Mapping[int, int],
        disturbed: Collection[int] = (),
    ) -> tuple[T2tMessage, ...]:
        """A status for each master heard of, every heartbeat period and at every change.

        Args:
            axles: in each section, by its number; none where it is not named.
            disturbed: sections whose count is not to be trusted; they are told as occupied.
        """
        raise NotImplementedError
