"""The operations centre: every status of a train is answered with its orders.

Orders are a state that is said anew in every answer, so that one lost message loses none of them.
Where a train is, the centre believes only while the train itself says that it knows. It is pure.
"""

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Final

from firmware_py.ports import RadioMessage
from firmware_py.trackdb import LineMap, PlatformSide, Station
from plant_emulator.wayside.platform_doors import PlatformDoors
from zenoh_config import keys
from zenoh_config.codec import BENCH_KEY, pack, unpack
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
"""A train that stopped so far beyond the end of a platform still counts as standing at it."""
ALIGNED_M: Final = 1.0
"""Platform doors open only for a train that stands so near to its stopping point."""


@dataclass(frozen=True, slots=True)
class StandingOrders:
    """What the centre wants of the train, whatever the train says."""

    awake: bool = True
    hold: bool = False
    skip_next: bool = False
    stop_next: bool = False
    emergency: bool = False
    creep: bool = False
    restricted: bool = False
    withheld_left: bool = False
    """Doors on the left are not authorised although the platform lies there."""
    withheld_right: bool = False
    wrong_side: bool = False
    """Doors are authorised on the side where there is no platform, and only there."""
    restrictions: tuple[SpeedRestriction, ...] = ()


NORMAL: Final = StandingOrders()


class Centre:
    """Counts what it refuses by reason; it never answers anything else than a sound status."""

    def __init__(
        self,
        line: LineMap,
        doors: PlatformDoors,
        *,
        first_sequence: int = 0,
        key: bytes = BENCH_KEY,
    ) -> None:
        """`first_sequence`: of its orders; above everything that an earlier one said."""
        self.refusals: Counter[RefusedReason] = Counter()
        self.answered = 0
        self.unanswered = 0
        """Sound statuses that the centre passed over in silence."""
        self.withheld = 0
        """Answers that withheld a door which the platform would allow."""
        self.standing = NORMAL
        self.releases = 0
        """Resets of an emergency so far."""
        self.silent = False
        """A fault: statuses are heard and nothing is answered."""
        self.latest: TrainOrders | None = None
        """What was said last."""
        self._line, self._doors = line, doors
        self._gate = ReportGate()
        self._sequence, self._key = first_sequence, key

    def answers(self, heard: Iterable[RadioMessage], now_ns: int) -> list[tuple[str, bytes]]:
        """Key and payload of everything that is to be said to what was heard."""
        return [answer for message in heard if (answer := self.answer(message, now_ns))]

    def answer(self, message: RadioMessage, now_ns: int) -> tuple[str, bytes] | None:
        status = self._believed(message)
        if isinstance(status, RefusedReason):
            self.refusals[status] += 1
            return None
        self._move_platform_doors(status, now_ns)
        if self.silent:
            self.unanswered += 1
            return None
        self.answered += 1
        orders = self._orders(status, now_ns)
        self.latest = orders
        return keys.order(self._line.name, orders.source, status.train), pack(orders, self._key)

    def _orders(self, status: TrainStatus, now_ns: int) -> TrainOrders:
        self._sequence += 1
        standing, station = self.standing, self._station(status)
        left, right = _sides(station, wrong=standing.wrong_side)
        self.withheld += (left and standing.withheld_left) or (right and standing.withheld_right)
        # Of a train that does not know where it is, any platform may be the one it stands at.
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
        )

    def _station(self, status: TrainStatus) -> Station | None:
        """At whose platform the train's front is; None where it is at none or does not know."""
        if not status.localised:
            return None
        for station in self._line.stations:
            reach_m = station.platform_end_m + PLATFORM_REACH_M
            if station.platform_start_m <= status.front_m <= reach_m:
                return station
        return None

    def _move_platform_doors(self, status: TrainStatus, now_ns: int) -> None:
        station = self._station(status)
        wanted = False
        if station is not None and status.standstill:
            at_left = station.side is PlatformSide.LEFT
            wanted = status.open_left if at_left else status.open_right
            wanted = wanted and abs(status.front_m - station.stop_m) <= ALIGNED_M
        self._doors.ask(station, wanted=wanted, now_ns=now_ns)

    def _believed(self, message: RadioMessage) -> TrainStatus | RefusedReason:
        status = unpack(message.payload, self._key)
        if isinstance(status, Refused):
            return status.reason
        if not isinstance(status, TrainStatus):
            return RefusedReason.UNKNOWN_TYPE
        if message.key != keys.status(self._line.name, status.train):
            return RefusedReason.WRONG_SOURCE
        refused = self._gate.check(status)
        return status if refused is None else refused.reason


def _sides(station: Station | None, *, wrong: bool) -> tuple[bool, bool]:
    """Left and right: where the centre would let doors open."""
    if station is None:
        return False, False
    at_left = station.side is PlatformSide.LEFT
    return at_left is not wrong, at_left is wrong


def joined(restrictions: Sequence[SpeedRestriction]) -> tuple[SpeedRestriction, ...]:
    """No more than one message holds; what is over that is joined into one that covers it all."""
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
