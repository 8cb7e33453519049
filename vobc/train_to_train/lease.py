"""The lease of one area on the train's side: request, renew, name a successor, return."""

import enum
from typing import Final, NamedTuple

from vobc.train_to_train.guards import Attempt, Granted, LeaseClock, LeaseGuards, Terms, Votes
from vobc.train_to_train.vocabulary import T2tConfig
from zenoh_config.t2t import NO_TRAIN, LeaseAnswer, LeaseKind, RosterEntry, SignedGrant
from zenoh_config.timers import NS_PER_MS

ATTEMPT_NS: Final = 100 * NS_PER_MS
"""Least time for which a candidate waits for a majority after the first answer to its request."""
REPEAT_MAX_NS: Final = 500 * NS_PER_MS
"""Longest time after which a candidate without any answer asks again."""
REQUESTS_KEPT: Final = 8
"""Greatest number of open requests."""
TIMES_KEPT: Final = 64
"""Number of requests whose time of sending is remembered. Answers that come later count as lost."""


class LeaseState(enum.Enum):
    NONE = "none"
    ASKED = "asked"
    HELD = "held"


class ArbiterRequest(NamedTuple):
    """Request that the train sends to every arbiter now."""

    kind: LeaseKind
    term: int
    nonce: int
    successor: int
    less_ns: int


class PendingRequest(NamedTuple):
    """A request that is still open."""

    sent_ns: int
    less_ns: int
    voters: set[int]
    """Arbiters that granted it."""


class Kept(NamedTuple):
    """A roster as an arbiter stored it."""

    term: int
    version: int
    roster: tuple[RosterEntry, ...]


NOTHING_KEPT: Final = Kept(0, 0, ())


class Lease:
    """Lease of one area. It builds the requests; the caller sends each to every arbiter."""

    def __init__(self, config: T2tConfig, guards: LeaseGuards) -> None:
        self._config, self._guards = config, guards
        self.state = LeaseState.NONE
        self.term = 0
        self.until_ns = 0
        """End of the lease by this train's clock. It counts from the sending of the newest request
        that a majority granted."""
        self.adopted = NOTHING_KEPT
        """The newest roster among the answers of the majority that granted the lease."""
        self.confirmed_term = 0
        """Highest term that an arbiter has acknowledged to any train."""
        self._records: dict[int, tuple[int, int]] = {}
        """By arbiter, the highest term that it has acknowledged, and the train that holds it."""
        self.successor = NO_TRAIN
        self.wait_until_ns = 0
        """When to ask again, so that the request arrives when the lease that blocks it
        has ended. 0: no lease blocks it."""
        self.beaten = False
        """An arbiter has acknowledged a higher term, so no majority will renew this one."""
        self._grants_by_arbiter: dict[int, SignedGrant] = {}
        """By arbiter, its newest signed grant of this term. Empty on a line without signatures."""
        self._nonce = 0
        self._asked: dict[int, PendingRequest] = {}
        """Open requests by nonce."""
        self._refusers: set[int] = set()
        self._sent_ns: dict[int, int] = {}
        """When the latest requests were sent, by nonce. They include those of earlier attempts."""
        self.round_trip_ns = 0
        """Time that the arbiters take to answer. A slower answer counts at once, and a quicker one
        by an eighth."""
        self._answered = False
        """An arbiter has answered a request of this attempt."""
        self._renewed_ns = 0
        self._asked_ns = 0
        self._confirmed_ns = 0
        """When the train sent the newest request that a majority granted."""
        self._answer_ns = 0
        """Time that this request took until the majority was complete."""

    def ask(self, now_ns: int, *, seen_term: int, tried_term: int) -> ArbiterRequest:
        """Request the lease. The caller must store the term as tried before sending."""
        self.state = LeaseState.ASKED
        self.term = self._guards.unused_term(Terms(seen_term, self.confirmed_term, tried_term))
        self.adopted, self.successor, self.beaten = NOTHING_KEPT, NO_TRAIN, False
        self.wait_until_ns = 0
        self._asked, self._refusers, self._answered = {}, set(), False
        self._grants_by_arbiter = {}
        self._asked_ns = now_ns
        self.until_ns = 0
        self._confirmed_ns = 0
        request = self._request(LeaseKind.ACQUIRE, now_ns)
        self._judge(request.nonce, now_ns)
        return request

    def ask_again(self, now_ns: int) -> ArbiterRequest:
        """Repeat the request of the present attempt, under the same term."""
        return self._request(LeaseKind.ACQUIRE, now_ns)

    def asks_again_ns(self) -> int:
        """When a candidate repeats its request.

        It does so as often as a master renews its lease. The first grant can then come at any time
        within the lease, and a later one extends it soon enough. While no arbiter answers, the time
        between two requests grows by half with each.
        """
        period_ns = self._config.timers.renew_ms * NS_PER_MS
        if not self._answered:
            waited_ns = self._renewed_ns - self._asked_ns
            period_ns = max(period_ns, min(waited_ns // 2, REPEAT_MAX_NS))
        return self._renewed_ns + period_ns

    def renewal_due_ns(self) -> int:
        return self._renewed_ns + self._config.timers.renew_ms * NS_PER_MS

    def renew(self, now_ns: int) -> ArbiterRequest:
        return self._request(LeaseKind.RENEW, now_ns, self._less_ns(now_ns))

    def _less_ns(self, now_ns: int) -> int:
        """Reduction of the next lease: the time without an answer beyond the usual.

        A holder that receives nothing any more still reaches the arbiters. With the reduction its
        lease expires at the arbiters, too.
        """
        timers = self._config.timers
        usual_ns = (timers.renew_ms + timers.margin_ms) * NS_PER_MS + self._answer_ns
        unheard_ns = now_ns - self._confirmed_ns - usual_ns
        return min(max(unheard_ns, 0), timers.holder_lease_ns)

    def give_back(self, now_ns: int) -> ArbiterRequest:
        """Return the lease, or the votes of an incomplete candidacy."""
        request = self._request(LeaseKind.RELEASE, now_ns)
        self.state = LeaseState.NONE
        return request

    def _request(self, kind: LeaseKind, now_ns: int, less_ns: int = 0) -> ArbiterRequest:
        self._nonce += 1
        self._renewed_ns = now_ns
        self._sent_ns[self._nonce] = now_ns
        self._sent_ns.pop(self._nonce - TIMES_KEPT, None)
        if kind is not LeaseKind.RELEASE:
            self._asked[self._nonce] = PendingRequest(now_ns, less_ns, set())
            if len(self._asked) > REQUESTS_KEPT:
                del self._asked[next(iter(self._asked))]
        return ArbiterRequest(kind, self.term, self._nonce, self.successor, less_ns)

    def on_message(self, answer: LeaseAnswer, now_ns: int) -> None:
        """Count the answer as a vote if it answers an open request."""
        if answer.source not in self._config.arbiters:
            return
        self._measure(answer.nonce, now_ns)
        self.confirmed_term = max(self.confirmed_term, answer.term)
        record = answer.term, answer.holder
        self._records[answer.source] = max(record, self._records.get(answer.source, record))
        asked = self._asked.get(answer.nonce)
        self._answered |= asked is not None
        if not answer.granted:
            self._on_refusal(answer, now_ns)
            return
        nonce = None if asked is None else answer.nonce
        attempt = Attempt(answer.term, answer.nonce, self.term, nonce)
        if self.state is LeaseState.NONE or not self._guards.answers_this_attempt(attempt):
            return
        if asked is None:
            asked = self._asked.setdefault(answer.nonce, PendingRequest(answer.echo_ns, 0, set()))
        asked.voters.add(answer.source)
        for grant in answer.grants[:1]:
            self._grants_by_arbiter[answer.source] = max(
                grant, self._grants_by_arbiter.get(answer.source, grant)
            )
        self._refusers.discard(answer.source)
        kept = Kept(answer.roster_term, answer.roster_version, answer.roster)
        newer = (kept.term, kept.version) > (self.adopted.term, self.adopted.version)
        if self.state is LeaseState.ASKED and newer:
            self.adopted = kept
        self._judge(answer.nonce, now_ns)

    def proof(self) -> tuple[SignedGrant, ...]:
        """The signed grants of a majority that end last, by which trains believe the term."""
        latest = sorted(
            self._grants_by_arbiter.values(), key=lambda grant: (-grant.end_ns, grant.arbiter)
        )
        return tuple(latest[: self._config.majority])

    def owner_of(self, term: int) -> int:
        """The train to which a majority granted the term, by their answers. 0: unknown."""
        holders = [holder for granted, holder in self._records.values() if granted == term]
        return next((h for h in holders if holders.count(h) >= self._config.majority), NO_TRAIN)

    def _measure(self, nonce: int, now_ns: int) -> None:
        sent_ns = self._sent_ns.get(nonce)
        if sent_ns is not None:
            less_ns = self.round_trip_ns // 8
            self.round_trip_ns = max(now_ns - sent_ns, self.round_trip_ns - less_ns)

    def _on_refusal(self, answer: LeaseAnswer, now_ns: int) -> None:
        asked = self._asked.get(answer.nonce)
        if asked is not None:
            if answer.wait_ns > 0:
                # The next request takes about as long to the arbiter as this one.
                free_ns = asked.sent_ns + answer.wait_ns + (now_ns - asked.sent_ns) // 8
                self.wait_until_ns = max(self.wait_until_ns, now_ns, free_ns)
            self._refusers.add(answer.source)
            self.beaten |= self.state is LeaseState.HELD and answer.term > self.term

    def _judge(self, nonce: int, now_ns: int) -> None:
        asked = self._asked[nonce]
        votes = Votes(len(asked.voters), self._config.majority)
        if not self._guards.granted_by_majority(votes):
            return
        granted = Granted(asked.sent_ns, self._config.timers.holder_lease_ns, asked.less_ns)
        until_ns = self._guards.granted_until_ns(granted)
        if self.state is LeaseState.ASKED and not self._lasts(now_ns, until_ns):
            # The answer took as long as the lease. A later request may be answered sooner.
            return
        self.until_ns = max(self.until_ns, until_ns)
        if asked.sent_ns > self._confirmed_ns:
            self._confirmed_ns, self._answer_ns = asked.sent_ns, now_ns - asked.sent_ns
        self.state = LeaseState.HELD

    def lost(self, now_ns: int) -> bool:
        """The candidacy has failed: no majority is left, or it has not come in time.

        Without any answer the attempt goes on. Another one would reach the arbiters no sooner, and
        would use up a term.
        """
        refused = len(self._refusers) > len(self._config.arbiters) - self._config.majority
        late = self._answered and self.is_late(now_ns)
        return self.state is LeaseState.ASKED and (refused or late)

    def is_late(self, now_ns: int) -> bool:
        """The answers of a majority should have come by now."""
        return now_ns >= self.attempt_ends_ns()

    def attempt_ends_ns(self) -> int:
        return self._asked_ns + max(ATTEMPT_NS, 2 * self.round_trip_ns)

    def runs(self, now_ns: int) -> bool:
        """Whether the lease holds, also when the messages of this step have left."""
        return self.state is LeaseState.HELD and self._lasts(now_ns, self.until_ns)

    def _lasts(self, now_ns: int, until_ns: int) -> bool:
        margin_ns = self._config.timers.margin_ms * NS_PER_MS
        return self._guards.lease_runs(LeaseClock(now_ns, until_ns, margin_ns))
