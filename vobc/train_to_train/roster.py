"""The trains of one area in line order, kept at the arbiters before anything rests on it."""

from collections.abc import Sequence

from vobc.train_to_train.guards import Commitment, MasterGuards
from vobc.train_to_train.lease import Kept
from zenoh_config.t2t import RosterAck, RosterEntry

Order = tuple[RosterEntry, ...]


class Roster:
    """Of one master, under one term. Foremost train first; never sorted by position again."""

    def __init__(self, term: int, adopted: Kept, majority: int, guards: MasterGuards) -> None:
        self.term = term
        self.version = 1
        self.proposed: Order = adopted.roster
        """The newest order, kept or not: a train on it is an obstacle to those behind."""
        self.kept: Order | None = None
        """As kept under this very term; None before the first time."""
        self._majority, self._guards = majority, guards
        self._acks: set[int] = set()
        self._judge()

    @property
    def pending(self) -> bool:
        return self.kept is not self.proposed

    def propose(self, order: Sequence[RosterEntry]) -> None:
        """One change at a time. The rears are brought up to date on the way."""
        assert not self.pending
        self.proposed = tuple(order)
        self.version += 1
        self._acks = set()
        self._judge()

    def hears(self, ack: RosterAck) -> None:
        if (ack.term, ack.version) == (self.term, self.version):
            self._acks.add(ack.source)
            self._judge()

    def missing(self, arbiters: Sequence[int]) -> list[int]:
        """Who has yet to keep the newest order."""
        return [each for each in arbiters if each not in self._acks]

    def _judge(self) -> None:
        if self._guards.roster_kept(Commitment(len(self._acks), self._majority)):
            self.kept = self.proposed

    def may_be_commanded(self) -> set[int]:
        """Trains that whoever commands next will know of, in this very incarnation."""
        boots = self.boots()
        return {e.train for e in self.kept or () if boots.get(e.train) == e.boot}

    def boots(self) -> dict[int, int]:
        """By train of the newest order, the incarnation that it is about."""
        return {entry.train: entry.boot for entry in self.proposed}


def placed(order: Sequence[RosterEntry], entry: RosterEntry, at: int) -> Order:
    return (*order[:at], entry, *order[at:])
