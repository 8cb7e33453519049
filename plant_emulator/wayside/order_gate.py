"""The first gate of what the wayside hears of trains: for whom it is, and in what order."""

from collections import Counter
from typing import Final

from zenoh_config.messages import RefusedReason
from zenoh_config.t2t import BROADCAST, T2tMessage

STREAMS_MAX: Final = 32_768
"""Kept in order at a time; more are refused, so that memory stays bounded. Of 500 trains on a line
of ten areas each may command each, and an arbiter hears two kinds of message from whoever does.
"""


class OrderGate:
    """Repetitions and what comes out of order, by kind, sender and area, change nothing."""

    def __init__(self, address: int) -> None:
        self.refusals: Counter[RefusedReason] = Counter()
        self._address = address
        self._newest: dict[tuple[type[T2tMessage], int, int], tuple[int, int]] = {}

    def admits(self, message: T2tMessage) -> bool:
        reason = self._objection(message)
        if reason is not None:
            self.refusals[reason] += 1
        return reason is None

    def _objection(self, message: T2tMessage) -> RefusedReason | None:
        if message.destination not in (self._address, BROADCAST):
            return RefusedReason.WRONG_DESTINATION
        stream = (type(message), message.source, message.area)
        newest = self._newest.get(stream)
        if newest is None and len(self._newest) >= STREAMS_MAX:
            return RefusedReason.WRONG_SOURCE
        if newest is not None and message.boot < newest[0]:
            return RefusedReason.WRONG_BOOT
        if newest is not None and (message.boot, message.sequence) <= newest:
            return RefusedReason.NOT_NEWER
        self._newest[stream] = (message.boot, message.sequence)
        return None
