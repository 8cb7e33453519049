"""The trains of one area in line order. Arbiters commit the order before the master acts on it."""

from collections.abc import Sequence

from vobc.train_to_train.guards import Commitment, MasterGuards
from vobc.train_to_train.lease import Kept
from zenoh_config.t2t import RosterAck, RosterEntry

Order = tuple[RosterEntry, ...]


class Roster:
    """Roster of one master under one term, foremost train first.

    It is never sorted by position again.
    """

    def __init__(self, term: int, adopted: Kept, majority: int, guards: MasterGuards) -> None:
        self.term = term
        self.version = 1
        self.proposed: Order = adopted.roster
        """The newest order, committed or not. A train on it is an obstacle to those behind."""
        self.kept: Order | None = None
        """Order that a majority committed under this term. None: nothing is committed yet."""
        self._majority, self._guards = majority, guards
        self._acks: set[int] = set()
        self._judge()

    @property
    def pending(self) -> bool:
        return self.kept is not self.proposed

    def propose(self, order: Sequence[RosterEntry]) -> None:
        """Propose a new order, with the rears brought up to date. Only one proposal is open at a
        time.
        """
        assert not self.pending
        self.proposed = tuple(order)
        self.version += 1
        self._acks = set()
        self._judge()

    def on_message(self, ack: RosterAck) -> None:
        if (ack.term, ack.version) == (self.term, self.version):
            self._acks.add(ack.source)
            self._judge()

    def missing(self, arbiters: Sequence[int]) -> list[int]:
        """Arbiters that have not yet acknowledged the newest order."""
        return [each for each in arbiters if each not in self._acks]

    def _judge(self) -> None:
        if self._guards.roster_kept(Commitment(len(self._acks), self._majority)):
            self.kept = self.proposed

    def may_be_commanded(self) -> set[int]:
        """Trains that the next master will certainly know, in this incarnation."""
        boots = self.boots()
        return {e.train for e in self.kept or () if boots.get(e.train) == e.boot}

    def boots(self) -> dict[int, int]:
        """Incarnation of each train of the newest order."""
        return {entry.train: entry.boot for entry in self.proposed}


def placed(order: Sequence[RosterEntry], entry: RosterEntry, at: int) -> Order:
    return (*order[:at], entry, *order[at:])
