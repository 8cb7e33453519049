"""Checks all messages: who issues authorities, under which lease, and what a train obeys.

It uses messages only and no state of the nodes: it computes leases itself from requests and
answers.
"""

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final, NamedTuple

from metro_hil.simulation.checker import ViolationError
from metro_hil.simulation.node import QueuedMessage
from metro_hil.simulation.true_train import BrakeLoopGrant
from zenoh_config.t2t import (
    FIRST_ARBITER,
    NO_TRAIN,
    AreaAuthority,
    LeaseAnswer,
    LeaseKind,
    LeaseRequest,
    RosterAck,
    RosterCommit,
    SwitchKind,
    SwitchStep,
    TrainReport,
)

NS_PER_MS: Final = 1_000_000
TOLD_MAX: Final = 256
LESS_MAX: Final = 1000
ANSWERS_MAX: Final = 1000
LET_IN_MAX: Final = 1000
FROM_ARBITERS: Final = (LeaseAnswer, RosterAck)
HEARD_NS: Final = 200 * NS_PER_MS
"""A train whose report is at most this old counts as received, whatever the timers are."""
TOLERANCE_NS: Final = 2 * NS_PER_MS
"""Tolerance for the effect of clock drift on a lease."""


@dataclass(frozen=True, slots=True)
class LeaseRules:
    """Parameters of the leases."""

    lease_ns: int
    drift_ratio: float
    margin_ns: int
    majority: int
    age_max_ns: int
    hostile: int = NO_TRAIN
    """A train whose authorities are not judged: it may issue anything while it commands."""


class Readiness(NamedTuple):
    """State of a train as its master last received it while a switch is prepared."""

    nonce: int
    at_ns: int
    rear_m: float
    """Position behind which the train's rear is not, by its own knowledge."""


class Switch(NamedTuple):
    """A planned switch that a master prepares."""

    term: int
    nonce: int
    heard: dict[int, Readiness]


class HeldLease(NamedTuple):
    """A lease that a train holds."""

    until_ns: int
    """End of the lease, by the true clock."""
    arbiters: frozenset[int]
    """The majority of arbiters that granted the lease."""


class AuthorityChecks:
    """Checks the messages of all nodes; raises ViolationError."""

    def __init__(
        self, rules: LeaseRules, looked: Counter[str], ends_m: Mapping[int, float] | None = None
    ) -> None:
        """`ends_m` gives the ends of the areas; an area that is missing has no known end."""
        self.rules, self.looked, self._ends_m = rules, looked, ends_m or {}
        self._issuers: dict[tuple[int, int], int] = {}
        """Issuing train, by area and term."""
        self._until_ns: dict[tuple[int, int], tuple[int, int]] = {}
        """Term of a train's lease and its end by the train's clock, by train and area."""
        self._answers: dict[tuple[int, int, int, int], dict[int, int]] = {}
        """Stamp of the request that each arbiter granted, by train, area, term and nonce."""
        self._less_ns: dict[tuple[int, int, int, int], int] = {}
        """Difference between a whole lease and the lease requested, by train, area, term and nonce.
        Only requests of the current incarnation are kept."""
        self._received_ends_m: dict[tuple[int, int], dict[tuple[int, int], float]] = {}
        """Ends of the received authorities by term and sequence, for each train and area."""
        self._won: set[tuple[int, int, int]] = set()
        """Train, area and term of every lease ever granted."""
        self._stale: set[tuple[int, int, int, int]] = set()
        """Train, area, term and sequence of authorities that were too old on arrival."""
        self._leases: dict[int, dict[int, HeldLease]] = {}
        """Leases, by area and train."""
        self._named: dict[tuple[int, int], dict[int, tuple[int, int, int]]] = {}
        """Boot, sequence and successor of each train's newest request, by arbiter and area."""
        self._named_by: dict[tuple[int, int, int, int], frozenset[int]] = {}
        """Trains that had named the new holder as successor, by arbiter, train, area and term."""
        self._rosters: dict[tuple[int, int, int, int], tuple[frozenset[int], set[int]]] = {}
        """Trains on a roster and the arbiters that store it, by train, area, term and version."""
        self._proposed: dict[tuple[int, int, int], frozenset[int]] = {}
        """Trains on the newest roster that a master sent, by train, area and term."""
        self._kept: dict[tuple[int, int], tuple[int, frozenset[int]]] = {}
        """Version and trains of the newest committed roster, by area and term."""
        self._given_back: set[tuple[int, int, int]] = set()
        """Train, area and term of leases that their holders gave back."""
        self.clocks_sound = True
        """No clock was stepped, so that leases of different holders can be compared."""
        self._switches: dict[tuple[int, int], Switch] = {}
        """The planned switch that a master prepares, by master and area."""
        self._newest: dict[tuple[int, int, int], tuple[int, int]] = {}
        """Boot and sequence of the newest report, by receiver, area and sender."""
        self._ready: set[tuple[int, int, int, int]] = set()
        """Successor, master, area and nonce of each readiness that a successor reported."""

    def stepped(
        self,
        address: int,
        now_ns: int,
        true_ns: int,
        heard: Sequence[Any],
        letters: Sequence[QueuedMessage],
    ) -> None:
        """Check what a train received and sent in one step, at this instant of its own clock."""
        for message in heard:
            kind = type(message)
            if kind is AreaAuthority:
                self._note_authority(address, message, now_ns)
            elif kind in FROM_ARBITERS and message.source < FIRST_ARBITER:
                # Forged: every receiver must refuse it.
                continue
            elif kind is LeaseAnswer:
                self._note_answer(address, message, now_ns, true_ns - now_ns)
            elif kind is RosterAck:
                self._note_ack(address, message)
            elif kind is TrainReport:
                self._note_readiness(address, message, now_ns)
        for letter in letters:
            message = letter.message
            kind = type(message)
            if kind is AreaAuthority:
                if address != self.rules.hostile:
                    self._check_issue(message, now_ns)
            elif kind is LeaseRequest:
                self._note_request(message)
            elif kind is RosterCommit:
                key = (address, message.area, message.term, message.version)
                names = frozenset(entry.train for entry in message.roster)
                self._rosters.setdefault(key, (names, set()))
                self._proposed[key[:3]] = names
            elif kind is TrainReport:
                self._check_report(message)
            elif kind is SwitchStep:
                self._switch(message, now_ns)

    def answered(
        self, arbiter: int, heard: Sequence[Any], letters: Sequence[QueuedMessage]
    ) -> None:
        """Note what an arbiter received and granted, and which trains had named the new holder."""
        asked: dict[tuple[int, int, int], frozenset[int]] = {}
        for message in heard:
            if type(message) is not LeaseRequest:
                continue
            named = self._named.setdefault((arbiter, message.area), {})
            if message.kind is LeaseKind.ACQUIRE:
                by = frozenset([each for each in named if named[each][2] == message.source])
                asked[message.source, message.area, message.nonce] = by
            number = message.boot, message.sequence
            if number > named.get(message.source, (0, 0, 0))[:2]:
                named[message.source] = (*number, message.successor)
        for letter in letters if asked else ():
            answer = letter.message
            if type(answer) is LeaseAnswer and answer.granted:
                by_whom = asked.get((answer.destination, answer.area, answer.nonce))
                if by_whom is not None:
                    key = arbiter, answer.destination, answer.area, answer.term
                    self._named_by.setdefault(key, by_whom)
                    if len(self._named_by) > LET_IN_MAX:
                        del self._named_by[next(iter(self._named_by))]

    def booted(self, address: int) -> None:
        """Forget what the previous incarnation of a train received and asked for."""
        memories: tuple[dict[Any, Any], ...] = (
            self._received_ends_m,
            self._until_ns,
            self._newest,
            self._answers,
            self._less_ns,
        )
        for memory in memories:
            for key in [key for key in memory if key[0] == address]:
                del memory[key]

    def _note_authority(self, address: int, message: AreaAuthority, now_ns: int) -> None:
        if message.destination == address:
            told = self._received_ends_m.setdefault((address, message.area), {})
            number = message.term, message.sequence
            # A second copy may come too late; the train accepted the first one.
            if number not in told and now_ns - message.echo_ns > self.rules.age_max_ns:
                self._stale.add((address, message.area, *number))
            told[number] = message.end_m
            if len(told) > TOLD_MAX:
                del told[next(iter(told))]

    def _note_request(self, message: LeaseRequest) -> None:
        asked = (message.source, message.area, message.term, message.nonce)
        self._less_ns[asked] = message.less_ns
        if len(self._less_ns) > LESS_MAX:
            del self._less_ns[next(iter(self._less_ns))]
        if message.kind is LeaseKind.RELEASE:
            self._given_back.add((message.source, message.area, message.term))
            self._until_ns.pop((message.source, message.area), None)
            self._leases.get(message.area, {}).pop(message.source, None)

    def _note_ack(self, address: int, message: RosterAck) -> None:
        names, keepers = self._rosters.get(
            (address, message.area, message.term, message.version), (frozenset(), set())
        )
        keepers.add(message.source)
        if len(keepers) >= self.rules.majority:
            key = message.area, message.term
            if message.version >= self._kept.get(key, (0, names))[0]:
                self._kept[key] = message.version, names

    def keeps(self, train: int, area: int) -> bool:
        """Tell whether the newest committed roster holds the train, in any incarnation."""
        term = max([term for each, term in self._kept if each == area], default=0)
        return train in self._kept.get((area, term), (0, frozenset()))[1]

    def _check_single_lease(
        self, address: int, area: int, term: int, true_ns: int, arbiters: frozenset[int]
    ) -> None:
        """Check invariant 19: no other lease of the area runs.

        Exempt is a lease whose holder had named this train as successor, if every arbiter that
        granted both leases knew that.
        """
        self.looked["19 lease"] += 1
        for other, lease in self._leases.get(area, {}).items():
            if other == address or lease.until_ns <= true_ns + TOLERANCE_NS:
                continue
            both = lease.arbiters & arbiters
            named = [other in self._named_by.get((e, address, area, term), ()) for e in both]
            if not (named and all(named)) and self.clocks_sound:
                raise ViolationError(
                    "19",
                    f"train {address} gets the lease of area {area}, and that of train {other} "
                    f"runs for another {(lease.until_ns - true_ns) / NS_PER_MS:.1f} ms",
                )

    def _note_answer(self, address: int, message: LeaseAnswer, now_ns: int, ahead_ns: int) -> None:
        """`ahead_ns` is the difference of the true clock to the train's clock."""
        if not message.granted or message.destination != address:
            return
        asked = (address, message.area, message.term, message.nonce)
        # An answer may come after the train that asked has restarted.
        if asked not in self._less_ns or asked[:3] in self._given_back:
            return
        answers = self._answers.setdefault(asked, {})
        answers[message.source] = message.echo_ns
        if len(answers) < self.rules.majority:
            return
        newest_ns = sorted(answers.values(), reverse=True)[self.rules.majority - 1]
        until_ns = newest_ns + round(self.rules.lease_ns * (1.0 - self.rules.drift_ratio))
        until_ns -= self._less_ns[asked]
        key = address, message.area
        term, before_ns = self._until_ns.get(key, (0, 0))
        if message.term > term or until_ns > before_ns:
            arbiters = frozenset([each for each in answers if answers[each] >= newest_ns])
            if message.term > term and until_ns > now_ns:
                self._check_single_lease(
                    address, message.area, message.term, now_ns + ahead_ns, arbiters
                )
            self._leases.setdefault(message.area, {})[address] = HeldLease(
                until_ns + ahead_ns, arbiters
            )
            self._until_ns[key] = message.term, until_ns
            self._won.add((address, message.area, message.term))
        if len(self._answers) > ANSWERS_MAX:
            del self._answers[next(iter(self._answers))]

    def _check_issue(self, message: AreaAuthority, now_ns: int) -> None:
        self.looked["19"] += 1
        self.looked["25"] += 1
        issuer = self._issuers.setdefault((message.area, message.term), message.source)
        if issuer != message.source:
            raise ViolationError(
                "19",
                f"train {message.source} issues in area {message.area}, term {message.term}, "
                f"which belongs to train {issuer}",
            )
        _, kept = self._kept.get((message.area, message.term), (0, frozenset()))
        if message.destination not in kept:
            raise ViolationError(
                "roster",
                f"train {message.source} issues to train {message.destination} in area "
                f"{message.area}, which is not on a committed roster",
            )
        term, until_ns = self._until_ns.get((message.source, message.area), (0, 0))
        late_ns = now_ns - (until_ns - self.rules.margin_ns)
        if term != message.term or late_ns >= 0:
            raise ViolationError(
                "25",
                f"train {message.source} issues in area {message.area}, term {message.term}, "
                f"{late_ns / NS_PER_MS:.1f} ms after it had to stop, with a lease of term {term}",
            )

    def _check_report(self, report: TrainReport) -> None:
        """Check invariants 24 and 29: an authority that a train reports was fresh on arrival."""
        self.looked["24"] += 1
        number = report.held_term, report.held_sequence
        if self._stale and (report.source, report.area, *number) in self._stale:
            raise ViolationError(
                "24",
                f"train {report.source} accepted {number} in area {report.area}, late on arrival",
            )

    def made_of(self, address: int, grant: BrakeLoopGrant) -> None:
        """Check invariant 27: this incarnation of the train received what its brake loop obeys."""
        self.looked["27"] += 1
        if (address, grant.area, grant.term) in self._won:
            return
        key, number = (address, grant.area), (grant.term, grant.sequence)
        end_m = self._received_ends_m.get(key, {}).get(number)
        if end_m is None or grant.end_m > end_m:
            raise ViolationError(
                "27",
                f"train {address} obeys {grant.end_m:.2f} m of area {grant.area}, term "
                f"{grant.term}, number {grant.sequence}; it received {end_m}",
            )

    def _switch(self, step: SwitchStep, now_ns: int) -> None:
        """Note a message of a master or a successor about a planned switch."""
        key = step.source, step.area
        if step.kind is SwitchKind.READY:
            self._ready.add((step.source, step.destination, step.area, step.nonce))
        elif step.kind is SwitchKind.PREPARE:
            known = self._switches.get(key)
            if known is None or (known.term, known.nonce) != (step.term, step.nonce):
                self._switches[key] = Switch(step.term, step.nonce, {})
        else:
            switch = self._switches.pop(key, None)
            if switch is not None and step.kind is SwitchKind.COMMIT:
                self._commit(step, switch, now_ns)

    def _note_readiness(self, address: int, report: TrainReport, now_ns: int) -> None:
        """Note a report while a switch is prepared; a late copy of an older report is ignored."""
        stream, number = (address, report.area, report.source), (report.boot, report.sequence)
        if number <= self._newest.get(stream, (0, 0)):
            return
        self._newest[stream] = number
        switch = self._switches.get((address, report.area)) if self._switches else None
        if switch is not None:
            rear_m = report.rear_min_m if report.localised else -math.inf
            switch.heard[report.source] = Readiness(report.ready_nonce, now_ns, rear_m)

    def _commit(self, step: SwitchStep, switch: "Switch", now_ns: int) -> None:
        """Check invariant 26: all trains are ready when a master commits a switch.

        The successor must be ready, and so must every train on the committed roster that the master
        receives. The way of a non-communicating train is reserved. A train that has left the area,
        or that is missing on the roster proposed since, is about to leave the roster.
        """
        self.looked["26"] += 1
        text = f"train {step.source} commits switch {step.nonce} of area {step.area}"
        if (step.successor, step.source, step.area, step.nonce) not in self._ready:
            raise ViolationError("26", f"{text}; its successor {step.successor} is not ready")
        _, kept = self._kept.get((step.area, switch.term), (0, frozenset()))
        proposed = self._proposed.get((step.source, step.area, switch.term), kept)
        for train in sorted((kept & proposed) - {step.source}):
            heard = switch.heard.get(train)
            if heard is None or now_ns - heard.at_ns > HEARD_NS or heard.nonce == step.nonce:
                continue
            if heard.rear_m >= self._ends_m.get(step.area, math.inf):
                continue
            raise ViolationError("26", f"{text}; train {train} is ready for {heard.nonce}")
