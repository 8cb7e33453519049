"""A zone controller for one train: every position report is answered with a movement authority.

Nothing else is on the line, so the authority reaches to an overlap behind the destination, or to
the end of the line where that comes first. It is pure: messages in, messages out.
"""

from collections import Counter
from collections.abc import Iterable
from typing import Final

from firmware_py.ports import RadioMessage
from firmware_py.trackdb import LineMap, Station
from zenoh_config import keys
from zenoh_config.codec import pack, unpack
from zenoh_config.messages import (
    WAYSIDE,
    MovementAuthority,
    PositionReport,
    Refused,
    RefusedReason,
    TrainOrders,
    TrainStatus,
)
from zenoh_config.sequencing import ReportGate

OVERLAP_M: Final = 60.0
BUFFER_M: Final = 10.0
"""Kept free before the end of the line."""
TERM: Final = 1
"""There is one issuer for the whole run, so its lease never changes hands."""


class ZoneController:
    """Counts what it refuses by reason; it never answers anything else than a sound report."""

    def __init__(self, line: LineMap, destination: Station) -> None:
        self.end_m = min(destination.stop_m + OVERLAP_M, line.end_m - BUFFER_M)
        """What no authority reaches beyond."""
        self.refusals: Counter[RefusedReason] = Counter()
        self.answered = 0
        self.farthest_end_m: float | None = None
        """Of all authorities given so far."""
        self._line_name = line.name
        self._reports = keys.reports(line.name)
        self._statuses = keys.statuses(line.name)
        self._gate = ReportGate()
        self._status_gate = ReportGate()
        self._orders = 0
        self._sequence = 0

    def answers(self, heard: Iterable[RadioMessage], now_ns: int) -> list[tuple[str, bytes]]:
        """Key and payload of everything that is to be said to what was heard."""
        return [answer for message in heard if (answer := self._answer(message, now_ns))]

    def _answer(self, message: RadioMessage, now_ns: int) -> tuple[str, bytes] | None:
        report = self._believed(message)
        if isinstance(report, TrainStatus):
            return self._order(report, now_ns)
        if isinstance(report, RefusedReason):
            self.refusals[report] += 1
            return None
        self.answered += 1
        self._sequence += 1
        self.farthest_end_m = (
            self.end_m if self.farthest_end_m is None else max(self.farthest_end_m, self.end_m)
        )
        authority = MovementAuthority(
            train=report.train,
            boot=report.boot,
            term=TERM,
            sequence=self._sequence,
            echo_stamp_ns=report.stamp_ns,
            end_m=self.end_m,
            source=WAYSIDE,
            stamp_ns=now_ns,
        )
        return keys.authority(self._line_name, WAYSIDE, report.train), pack(authority)

    def _order(self, status: TrainStatus, now_ns: int) -> tuple[str, bytes]:
        self._orders += 1
        orders = TrainOrders(
            train=status.train,
            boot=status.boot,
            sequence=self._orders,
            echo_stamp_ns=status.stamp_ns,
            awake=True,
            hold=False,
            skip_next=False,
            stop_next=False,
            emergency=False,
            releases=0,
            creep=False,
            restricted=False,
            doors_left=True,
            doors_right=True,
            platform_doors_locked=True,
            stamp_ns=now_ns,
        )
        return keys.order(self._line_name, WAYSIDE, status.train), pack(orders)

    def _believed(self, message: RadioMessage) -> PositionReport | TrainStatus | RefusedReason:
        report = unpack(message.payload)
        if isinstance(report, Refused):
            return report.reason
        if isinstance(report, TrainStatus):
            if message.key != keys.status(self._line_name, report.train):
                return RefusedReason.WRONG_SOURCE
            refused = self._status_gate.check(report)
            return report if refused is None else refused.reason
        if not isinstance(report, PositionReport):
            return RefusedReason.UNKNOWN_TYPE
        if message.key != keys.report(self._line_name, report.train):
            # What a train says under the key of another was not said by that train.
            return RefusedReason.WRONG_SOURCE
        refused = self._gate.check(report)
        return report if refused is None else refused.reason

    @property
    def subscriptions(self) -> tuple[str, ...]:
        """What its radio has to listen to."""
        return (self._reports, self._statuses)
