"""First check of every received message: destination, permitted sender, and order."""

from collections import Counter
from collections.abc import Mapping
from typing import Final

from zenoh_config.messages import WAYSIDE, RefusedReason
from zenoh_config.t2t import (
    BROADCAST,
    FIRST_ARBITER,
    LAST_ARBITER,
    LAST_TRAIN,
    SUPERVISION,
    Admission,
    AreaAuthority,
    Heartbeat,
    LeaseAnswer,
    LineOrder,
    ObjectClaim,
    ObjectStatus,
    RosterAck,
    StandbySync,
    SwitchStep,
    SyncAck,
    T2tMessage,
    TrackStatus,
    TrainReport,
)
from zenoh_config.t2t_supervision import Removal

SOURCES_MAX: Final = 16_384
"""Number of message streams whose order is tracked. More are refused, so that memory stays bounded.

All trains of a line may pass the areas that concern this train, and each sends four kinds of
message there.
"""
TRAINS: Final = range(WAYSIDE + 1, LAST_TRAIN + 1)
ARBITERS: Final = range(FIRST_ARBITER, LAST_ARBITER + 1)
THE_WAYSIDE: Final = range(WAYSIDE, WAYSIDE + 1)
THE_SUPERVISION: Final = range(SUPERVISION, SUPERVISION + 1)
NO_SENDER: Final = range(0)
SENDERS: Final[Mapping[type[T2tMessage], range]] = {
    Heartbeat: TRAINS,
    TrainReport: TRAINS,
    AreaAuthority: TRAINS,
    StandbySync: TRAINS,
    SyncAck: TRAINS,
    SwitchStep: TRAINS,
    Admission: TRAINS,
    ObjectClaim: TRAINS,
    LeaseAnswer: ARBITERS,
    RosterAck: ARBITERS,
    ObjectStatus: THE_WAYSIDE,
    TrackStatus: THE_WAYSIDE,
    LineOrder: THE_SUPERVISION,
    Removal: THE_SUPERVISION,
}
"""Addresses that may send a message of each type to a train."""

Stream = tuple[type[T2tMessage], int, int, int]
"""Message type, source, area and object number (0 if the message has none)."""


class Reception:
    """Checks received messages and counts refusals by reason. A refused message has no other
    effect.
    """

    def __init__(self, address: int, boot: int) -> None:
        self.refusals: Counter[RefusedReason] = Counter()
        self.doubled = False
        """Another device sends under this train's address."""
        self._address, self._boot = address, boot
        self._newest: dict[Stream, tuple[int, int]] = {}

    def admits(self, message: T2tMessage, own_sequence: int) -> bool:
        reason = self._objection(message, own_sequence)
        if reason is None:
            return True
        self.refusals[reason] += 1
        return False

    def forget(self, area: int) -> None:
        """Stop tracking the order of train messages of this area.

        Messages of the wayside and of supervision stay tracked, because those streams are few.
        """
        self._newest = {
            stream: newest
            for stream, newest in self._newest.items()
            if stream[2] != area or not WAYSIDE < stream[1] <= LAST_TRAIN
        }

    def _objection(self, message: T2tMessage, own_sequence: int) -> RefusedReason | None:
        source = message.source
        if source == self._address:
            spoken = (self._boot, own_sequence)
            self.doubled |= (message.boot, message.sequence) > spoken
            return RefusedReason.WRONG_SOURCE
        if message.destination not in (self._address, BROADCAST):
            return RefusedReason.WRONG_DESTINATION
        if not _may_say(source, message):
            return RefusedReason.WRONG_SOURCE
        if isinstance(message, AreaAuthority):
            if message.destination != self._address:
                return RefusedReason.WRONG_DESTINATION
            # The member's own guard keeps authorities in order, by term and across masters.
            return None
        number = message.number if isinstance(message, ObjectStatus) else 0
        stream = (type(message), source, message.area, number)
        newest = self._newest.get(stream)
        if newest is None and len(self._newest) >= SOURCES_MAX:
            return RefusedReason.WRONG_SOURCE
        if newest is not None and (message.boot, message.sequence) <= newest:
            return RefusedReason.WRONG_BOOT if message.boot < newest[0] else RefusedReason.NOT_NEWER
        self._newest[stream] = (message.boot, message.sequence)
        return None


def _may_say(source: int, message: T2tMessage) -> bool:
    return source in SENDERS.get(type(message), NO_SENDER)
