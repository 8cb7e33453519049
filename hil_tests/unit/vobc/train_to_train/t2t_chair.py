"""One master alone; the tests make every message that it receives."""

from collections.abc import Sequence
from typing import Any

from firmware_py.trackdb.areas import Area, AreaMap, ObjectSite, TrackSection
from vobc.train_to_train.guards import LeaseGuards, MasterGuards
from vobc.train_to_train.lease import Lease
from vobc.train_to_train.master import Master
from vobc.train_to_train.message_heads import MessageHeads
from vobc.train_to_train.occupancy import TrainTable
from vobc.train_to_train.vocabulary import T2tConfig
from zenoh_config.t2t import (
    BROADCAST,
    AreaAuthority,
    LeaseAnswer,
    LineOrder,
    OrderKind,
    RosterAck,
    RosterEntry,
    SectionState,
    T2tMessage,
    TrackStatus,
    TrainReport,
)
from zenoh_config.t2t_supervision import Removal

MS = 1_000_000
OWN = 7
TERM = 5
ARBITERS = (65_001, 65_002, 65_003)
AREAS = (Area(1, 0.0, 2000.0), Area(2, 2000.0, 4000.0))
SECTIONS = tuple(TrackSection(n, 500.0 * (n - 1), 500.0 * n) for n in range(1, 9))
LENGTH_M = 80.0


def entry(train: int, front_m: float, *, sieved: bool = True, boot: int = 1) -> RosterEntry:
    return RosterEntry(train, front_m - LENGTH_M, sieved, boot)


TWO = (entry(1, 900.0), entry(2, 500.0))


class Chair:
    """A master under term 5 in the first of two areas, its arbiters, and the messages that it
    sends."""

    def __init__(
        self,
        roster: Sequence[RosterEntry] = TWO,
        *,
        area: int = 1,
        sections: bool = False,
        objects: tuple[ObjectSite, ...] = (),
        kept: bool = True,
        now_ms: int = 0,
    ) -> None:
        config = T2tConfig(arbiters=ARBITERS)
        self.lease = Lease(config, LeaseGuards())
        request = self.lease.ask(0, seen_term=TERM - 1, tried_term=0)
        for arbiter in ARBITERS[:2]:
            head = (arbiter, OWN, area, TERM, 1, 1, 0)
            answer = LeaseAnswer(*head, True, request.nonce, 0, OWN, 0, 4, 1, tuple(roster))
            self.lease.on_message(answer, 0)
        self.lease.until_ns = 10**15
        self.now_ns = now_ms * MS
        self.sequence = 0
        self.area = area
        self.speaker = MessageHeads(OWN, 9)
        line = AreaMap("test", AREAS, SECTIONS if sections else (), objects)
        self.master = Master(
            config,
            MasterGuards(),
            line,
            area,
            speaker=self.speaker,
            lease=self.lease,
            table=TrainTable(),
            now_ns=self.now_ns,
        )
        if kept:
            self.keeps()

    def head(self, source: int, *, term: int = TERM) -> tuple[int, int, int, int, int, int, int]:
        self.sequence += 1
        return (source, OWN, self.area, term, 1, self.sequence, 0)

    def on_message(self, message: T2tMessage) -> None:
        self.master.on_message(message, self.now_ns)

    def keeps(self, version: int | None = None, *, term: int = TERM, arbiters: int = 2) -> None:
        asked = self.master.roster.version if version is None else version
        for arbiter in ARBITERS[:arbiters]:
            self.on_message(RosterAck(*self.head(arbiter, term=term), asked))

    def reports(self, train: int, front_m: float, **told: Any) -> TrainReport:
        self.sequence += 1
        fields: dict[str, Any] = {
            "source": train,
            "destination": BROADCAST,
            "area": self.area,
            "term": TERM,
            "boot": 1,
            "sequence": self.sequence,
            "stamp_ns": self.now_ns + train,
            "localised": True,
            "front_min_m": front_m,
            "front_max_m": front_m,
            "rear_min_m": front_m - LENGTH_M,
            "protected_m": front_m - LENGTH_M,
            "speed_mps": 0.0,
            "standstill": True,
            "latent_m": front_m,
            "held_end_m": front_m,
            "easy_m": front_m,
            "held_term": 0,
            "held_sequence": 0,
            "member": False,
            "behind": 0,
            "comes_from": 0,
            "axles": 16,
            "out_of_service": False,
            "ready_nonce": 0,
            # 0 means that no heartbeat was received.
            "echo_ns": self.now_ns or -1,
        }
        report = TrainReport(**{**fields, **told})
        self.on_message(report)
        return report

    def orders(self, kind: OrderKind, train: int) -> None:
        self.on_message(LineOrder(*self.head(65_100, term=0), kind, train))

    def removes(self, train: int, *, echo_ms: int | None = None, term: int = TERM) -> None:
        echo_ns = self.now_ns if echo_ms is None else echo_ms * MS
        self.on_message(Removal(*self.head(65_100, term=term), echo_ns, train))

    def track(self, *, seen_ms: int | None = None, term: int = TERM, **told: Any) -> None:
        """Report the track status: all sections are clear except those with a number in `axles`."""
        axles: dict[int, int] = told.get("axles", {})
        states = [
            SectionState(s.number, s.number in axles, axles.get(s.number, 0)) for s in SECTIONS
        ]
        echo_ns = self.now_ns if seen_ms is None else seen_ms * MS
        head = (0, OWN, self.area, term, 1, self.sequence, 0)
        self.on_message(
            TrackStatus(
                *head, echo_ns, tuple(states), told.get("restrictions", ()), told.get("closed", ())
            )
        )

    def step(self, ms: int = 100, *, away: bool = False) -> list[T2tMessage]:
        self.now_ns += ms * MS
        return self.master.step(self.now_ns, away=away)

    def order(self) -> list[int]:
        return [each.train for each in self.master.roster.proposed]


def of(kind: type[Any], said: Sequence[T2tMessage]) -> list[Any]:
    return [each for each in said if isinstance(each, kind)]


def authorities(said: Sequence[T2tMessage]) -> dict[int, AreaAuthority]:
    return {each.destination: each for each in of(AreaAuthority, said)}
