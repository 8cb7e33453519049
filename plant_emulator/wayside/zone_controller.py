"""A zone controller for one train: answers every position report with a movement authority.

The authority ends at an overlap behind the destination, at the end of the line, at a signal at
stop, or behind another train, whichever comes first. A few metres of track behind the train stay
reserved for it. The module is pure: messages in, messages out.
"""

from collections import Counter
from collections.abc import Collection, Iterable
from math import inf
from typing import Final

from firmware_py.ports import RadioMessage
from firmware_py.trackdb import LineMap, Station
from firmware_py.trackdb.version import database_version
from zenoh_config import keys
from zenoh_config.codec import pack, unpack
from zenoh_config.messages import (
    WAYSIDE,
    MovementAuthority,
    PositionReport,
    Refused,
    RefusedReason,
)
from zenoh_config.sequencing import ReportGate

OVERLAP_M: Final = 60.0
BUFFER_M: Final = 10.0
"""Distance that authorities keep from the end of the line."""
REAR_M: Final = 10.0
"""Length of track reserved behind the train."""
TERM: Final = 1
"""Term of all authorities. The issuer is the same for the whole run, so the term never changes."""


class ZoneController:
    """Answers sound reports only, and counts all refused messages by reason."""

    def __init__(self, line: LineMap, destination: Station) -> None:
        self.end_m = min(destination.stop_m + OVERLAP_M, line.end_m - BUFFER_M)
        """Farthest end of any authority."""
        self.limit_m = inf
        """Limit behind a train ahead; authorities do not extend beyond it."""
        self.shift_m = 0.0
        """A fault: its map is another one, and all ends of authority lie this much further."""
        self.refusals: Counter[RefusedReason] = Counter()
        self.answered = 0
        self.farthest_end_m: float | None = None
        """Farthest end of all authorities sent so far."""
        self.latest: MovementAuthority | None = None
        """The newest authority."""
        self.latest_rear_m = 0.0
        """Rear limit of the newest authority. Without such a limit it is the place that the rear
        has surely passed."""
        self.rear_protected = True
        """A fault sets this to False: authorities then contain no rear limit."""
        self._line_name, self._start_m = line.name, line.start_m
        self.database = database_version(line)
        """Version of the track database; reports of another one are refused."""
        self._gate = ReportGate()
        self._sequence = 0
        self._stops_m: tuple[float, ...] = ()
        self._concerned: dict[tuple[int, float], bool] = {}
        """By train and signal, whether the train was in front of the signal when it was first
        checked."""
        self.departs_ns = 0
        """Until then, the authority of every train ends at its front."""
        self._withdrawn = False
        self._withdrawn_m: dict[int, float] = {}
        """By train, the farthest place of its front when its authority was withdrawn."""
        self._rears_m: dict[int, tuple[int, float]] = {}
        """By train, its incarnation and the protected rear, which never moves back within one
        incarnation."""

    def show_stop(self, stops_m: Collection[float]) -> None:
        """Set the places of all signals that show stop from now on."""
        self._stops_m = tuple(sorted(stops_m))
        self._concerned = {
            key: concerned for key, concerned in self._concerned.items() if key[1] in stops_m
        }

    def withdraw(self, withdrawn: bool) -> None:
        """Withdraw every authority to the train's front in its next report."""
        self._withdrawn = withdrawn
        self._withdrawn_m = {}

    def answers(self, heard: Iterable[RadioMessage], now_ns: int) -> list[tuple[str, bytes]]:
        """Return key and payload of all answers to the received messages."""
        return [answer for message in heard if (answer := self.answer(message, now_ns))]

    def answer(self, message: RadioMessage, now_ns: int) -> tuple[str, bytes] | None:
        report = self._believed(message)
        if isinstance(report, RefusedReason):
            self.refusals[report] += 1
            return None
        self.answered += 1
        self._sequence += 1
        end_m = self._end_m(report, now_ns) + self.shift_m
        rear_m = self._rear_m(report, end_m)
        farthest_m = self.farthest_end_m
        self.farthest_end_m = end_m if farthest_m is None else max(farthest_m, end_m)
        authority = MovementAuthority(
            train=report.train,
            boot=report.boot,
            term=TERM,
            sequence=self._sequence,
            echo_stamp_ns=report.stamp_ns,
            end_m=end_m,
            source=WAYSIDE,
            stamp_ns=now_ns,
            rear_m=rear_m,
            parameters=report.parameters,
        )
        self.latest = authority
        self.latest_rear_m = report.rear_min_m if rear_m is None else rear_m
        key = keys.authority(self._line_name, WAYSIDE, report.train)
        return key, pack(authority, database=self.database)

    def _end_m(self, report: PositionReport, now_ns: int) -> float:
        """Return the end of authority.

        A signal does not affect a train that passed it before it showed stop.
        """
        end_m = min(self.end_m, self.limit_m)
        for stop_m in self._stops_m:
            if self._concerned.setdefault((report.train, stop_m), report.front_min_m < stop_m):
                end_m = min(end_m, stop_m)
                break
        if self._withdrawn or now_ns < self.departs_ns:
            end_m = min(end_m, self._withdrawn_m.setdefault(report.train, report.front_max_m))
        return end_m

    def _rear_m(self, report: PositionReport, end_m: float) -> float | None:
        boot, rear_m = self._rears_m.get(report.train, (report.boot, self._start_m))
        if boot != report.boot:
            rear_m = self._start_m
        rear_m = max(rear_m, report.rear_min_m - REAR_M)
        self._rears_m[report.train] = (report.boot, rear_m)
        return min(rear_m, end_m) if self.rear_protected else None

    def _believed(self, message: RadioMessage) -> PositionReport | RefusedReason:
        report = unpack(message.payload, database=self.database)
        if isinstance(report, Refused):
            return report.reason
        if not isinstance(report, PositionReport):
            return RefusedReason.UNKNOWN_TYPE
        if message.key != keys.report(self._line_name, report.train):
            # A report under the key of another train does not come from that train.
            return RefusedReason.WRONG_SOURCE
        refused = self._gate.check(report)
        return report if refused is None else refused.reason
