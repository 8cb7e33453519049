"""Records the controller's reports of a late or weak brake, from the frames on the bus."""

from typing import Final, NamedTuple

from can_dbc.binding import can_id
from can_dbc.codec import Decoder
from can_dbc.vobc import EventKind, VobcEvent

EVENT_ID: Final = can_id(VobcEvent)
TEXTS: Final = {
    EventKind.BRAKE_LATE: "the controller reports a late brake: dead time {} ms or more",
    EventKind.BRAKE_WEAK: "the controller reports a weak brake: {} % of the demand",
}
NS_PER_S: Final = 1e9


class BrakeReport(NamedTuple):
    at_s: float
    text: str


class BrakeReports:
    """Receives every frame of a run."""

    __slots__ = ("_decode", "found")

    def __init__(self) -> None:
        self._decode = Decoder([VobcEvent]).decode
        self.found: list[BrakeReport] = []
        """Reports in order of time."""

    def frame(self, stamp_ns: int, can_id: int, data: bytes) -> None:
        if can_id != EVENT_ID:
            return
        heard = self._decode(can_id, data, stamp_ns)
        if isinstance(heard, VobcEvent) and heard.event in TEXTS:
            text = TEXTS[heard.event].format(heard.cause)
            self.found.append(BrakeReport(stamp_ns / NS_PER_S, text))
