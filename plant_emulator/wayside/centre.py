"""The operations centre: answers every status of a train with its orders.

Every answer repeats the full set of orders, so a lost message loses none. The centre relies on a
train's position only while the train reports itself localised. The module is pure.
"""

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Final

from firmware_py.ports import RadioMessage
from firmware_py.trackdb import LineMap, Station
from firmware_py.trackdb.version import database_version
from plant_emulator.wayside.platform_doors import PlatformDoors
from zenoh_config import keys
from zenoh_config.codec import BENCH_KEY, SafetyKey, pack, unpack
from zenoh_config.messages import (
    RESTRICTIONS_MAX,
    Refused,
    RefusedReason,
    SpeedRestriction,
    TrainOrders,
    TrainStatus,
)
from zenoh_config.sequencing import ReportGate

PLATFORM_REACH_M: Final = 10.0
"""Distance beyond the end of a platform up to which a stopped train still counts as standing at
it."""
ALIGNED_M: Final = 1.0
"""Largest distance from its stopping point at which platform doors open for a train."""


@dataclass(frozen=True, slots=True)
class StandingOrders:
    """Orders of the centre to the train, independent of the train's status."""

    awake: bool = True
    hold: bool = False
    skip_next: bool = False
    stop_next: bool = False
    emergency: bool = False
    creep: bool = False
    restricted: bool = False
    withheld_left: bool = False
    """Do not authorise doors on the left even if the platform is there."""
    withheld_right: bool = False
    wrong_side: bool = False
    """Authorise doors on the side without a platform, and only there."""
    restrictions: tuple[SpeedRestriction, ...] = ()


NORMAL: Final = StandingOrders()


class Centre:
    """Answers sound statuses only, and counts all refused messages by reason."""

    def __init__(
        self,
        line: LineMap,
        doors: PlatformDoors,
        *,
        first_sequence: int = 0,
        key: SafetyKey = BENCH_KEY,
    ) -> None:
        """`first_sequence`: first sequence number of its orders; it must exceed those of all
        earlier centres.
        """
        self.refusals: Counter[RefusedReason] = Counter()
        self.answered = 0
        self.unanswered = 0
        """Number of sound statuses that the centre did not answer."""
        self.withheld = 0
        """Number of answers that withheld a door which the platform would permit."""
        self.standing = NORMAL
        self.releases = 0
        """Number of emergency resets so far."""
        self.released_emergency = 0
        """Number of the emergency that the last reset is for."""
        self.silent = False
        """A fault: the centre receives statuses but answers none."""
        self.latest: TrainOrders | None = None
        """The orders that were sent last."""
        self.database = database_version(line)
        """Version of the track database; places that a train of another one reports are ignored."""
        self._line, self._doors = line, doors
        self._gate = ReportGate()
        self._sequence, self._key = first_sequence, key
        self._emergency_number = 0
        """Number of the train's emergency, by its latest status."""

    def release(self) -> None:
        """Reset the emergency that the train's latest status reports, and no other."""
        self.releases += 1
        self.released_emergency = self._emergency_number

    def answers(self, heard: Iterable[RadioMessage], now_ns: int) -> list[tuple[str, bytes]]:
        """Return key and payload of all answers to the received messages."""
        return [answer for message in heard if (answer := self.answer(message, now_ns))]

    def answer(self, message: RadioMessage, now_ns: int) -> tuple[str, bytes] | None:
        status = self._believed(message)
        if isinstance(status, RefusedReason):
            self.refusals[status] += 1
            return None
        self._emergency_number = status.emergency_number
        self._move_platform_doors(status, now_ns)
        if self.silent:
            self.unanswered += 1
            return None
        self.answered += 1
        orders = self._orders(status, now_ns)
        self.latest = orders
        key = keys.order(self._line.name, orders.source, status.train)
        return key, pack(orders, self._key, database=self.database)

    def _orders(self, status: TrainStatus, now_ns: int) -> TrainOrders:
        self._sequence += 1
        standing, station = self.standing, self._station(status)
        left, right = _sides(station, wrong=standing.wrong_side)
        self.withheld += (left and standing.withheld_left) or (right and standing.withheld_right)
        # A train without position may be standing at any platform.
        near = self._line.stations if not status.localised else () if not station else (station,)
        return TrainOrders(
            train=status.train,
            boot=status.boot,
            sequence=self._sequence,
            echo_stamp_ns=status.stamp_ns,
            awake=standing.awake,
            hold=standing.hold,
            skip_next=standing.skip_next,
            stop_next=standing.stop_next,
            emergency=standing.emergency,
            releases=self.releases,
            creep=standing.creep,
            restricted=standing.restricted,
            doors_left=left and not standing.withheld_left,
            doors_right=right and not standing.withheld_right,
            platform_doors_locked=self._doors.locked(near),
            restrictions=joined(standing.restrictions),
            stamp_ns=now_ns,
            released_emergency=self.released_emergency,
        )

    def _station(self, status: TrainStatus) -> Station | None:
        """Return the station at whose platform the train's front is, of several the one with the
        nearest stopping point. None if there is none or the position is unknown.
        """
        if not status.localised:
            return None
        front_m = status.front_m
        here = (
            station
            for station in self._line.stations
            if station.platform_start_m <= front_m <= station.platform_end_m + PLATFORM_REACH_M
        )
        return min(here, key=lambda station: _off_stop_m(station, front_m), default=None)

    def _move_platform_doors(self, status: TrainStatus, now_ns: int) -> None:
        station = self._station(status)
        wanted = False
        if station is not None and status.standstill:
            side = station.side
            wanted = (side.left and status.open_left) or (side.right and status.open_right)
            wanted = wanted and _off_stop_m(station, status.front_m) <= ALIGNED_M
        self._doors.ask(station, wanted=wanted, now_ns=now_ns)

    def _believed(self, message: RadioMessage) -> TrainStatus | RefusedReason:
        status = unpack(message.payload, self._key, database=self.database)
        if isinstance(status, Refused) and status.reason is RefusedReason.OTHER_DATABASE:
            # The answer lets the train report why it gets no authority.
            self.refusals[status.reason] += 1
            status = unpack(message.payload, self._key)
            if isinstance(status, TrainStatus):
                status = replace(status, localised=False)
        if isinstance(status, Refused):
            return status.reason
        if not isinstance(status, TrainStatus):
            return RefusedReason.UNKNOWN_TYPE
        if message.key != keys.status(self._line.name, status.train):
            return RefusedReason.WRONG_SOURCE
        refused = self._gate.check(status)
        return status if refused is None else refused.reason


def _off_stop_m(station: Station, front_m: float) -> float:
    """Return the distance to the nearest of the station's stopping points."""
    return min(abs(stop_m - front_m) for stop_m in station.stops_m)


def _sides(station: Station | None, *, wrong: bool) -> tuple[bool, bool]:
    """Return for left and right whether the centre would authorise doors."""
    if station is None:
        return False, False
    return station.side.left is not wrong, station.side.right is not wrong


def joined(restrictions: Sequence[SpeedRestriction]) -> tuple[SpeedRestriction, ...]:
    """Return restrictions that fit into one message.

    The surplus is replaced by one restriction that covers it all.
    """
    fit, rest = restrictions[: RESTRICTIONS_MAX - 1], restrictions[RESTRICTIONS_MAX - 1 :]
    if len(rest) <= 1:
        return tuple(restrictions)
    return (
        *fit,
        SpeedRestriction(
            start_m=min(each.start_m for each in rest),
            end_m=max(each.end_m for each in rest),
            limit_mps=min(each.limit_mps for each in rest),
        ),
    )
