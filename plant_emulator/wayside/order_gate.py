"""First check of messages that the wayside receives: destination and order."""

from collections import Counter
from typing import Final

from zenoh_config.messages import RefusedReason
from zenoh_config.t2t import BROADCAST, T2tMessage

STREAMS_MAX: Final = 32_768
"""Maximum number of message streams whose order is tracked; further ones are refused, so memory is
bounded. Each of 500 trains may command each of ten areas, and an arbiter receives two kinds of
messages from each."""


class OrderGate:
    """Refuses repeated and outdated messages, by kind, sender and area."""

    def __init__(self, address: int) -> None:
        self.refusals: Counter[RefusedReason] = Counter()
        self.sources: dict[RefusedReason, int] = {}
        """Sender of the last refused message, by reason."""
        self._address = address
        self._newest: dict[tuple[type[T2tMessage], int, int], tuple[int, int]] = {}

    def admits(self, message: T2tMessage) -> bool:
        reason = self._objection(message)
        if reason is not None:
            self.refuse(reason, message)
        return reason is None

    def refuse(self, reason: RefusedReason, message: T2tMessage) -> None:
        """Count a message that is not accepted."""
        self.refusals[reason] += 1
        self.sources[reason] = message.source

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
