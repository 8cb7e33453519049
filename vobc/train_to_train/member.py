"""A train as member of one area: the terms it knows, its authority and how far it may still run."""

import math
from collections.abc import Callable

from vobc.train_to_train.guards import Fence, Latency, MemberGuards, Offer, TermProof, TermStep
from vobc.train_to_train.vocabulary import AreaMemory, OwnTrain, T2tConfig
from zenoh_config.t2t import NO_TRAIN, AreaAuthority, Heartbeat, T2tMessage
from zenoh_config.term_grants import TermGrant
from zenoh_config.timers import NS_PER_MS

RANK_OF_A_STRANGER: int = 4
"""Candidacy rank of a train that is not on the roster. The members of the roster apply before it.
"""


class AreaMember:
    """State of the train as member of one of the areas that concern it."""

    def __init__(
        self,
        config: T2tConfig,
        guards: MemberGuards,
        *,
        boot: int,
        memory: AreaMemory,
        now_ns: int,
    ) -> None:
        self._config, self._timers, self._guards = config, config.timers, guards
        self._boot = boot
        self.memory = memory
        """Memory of the area. The caller stores it whenever it changes."""
        self.confirmed_term = memory.seen_term
        """Highest term that an arbiter has confirmed to this train. After a restart: the highest
        one that it had received before."""
        self.held: AreaAuthority | None = None
        self.newest = (0, -1)
        """Term and sequence number of the newest authority that the train accepted."""
        self.latent_m: float | None = None
        """Farthest place that the front may still reach by authorities of this area, as last
        reported. None: the train has not been localised yet."""
        self.master_heard_ns = now_ns
        """When the train last received a message of the master, or began to listen."""
        self.beat_ns = 0
        """`stamp_ns` of the newest heartbeat of the highest known term. 0: none received."""
        self.standby = NO_TRAIN
        self.rank = RANK_OF_A_STRANGER
        self.new_promise = False
        """A new term was received, and the train must acknowledge it at once."""
        self._limit_m = math.inf
        self._unproven: set[int] = set()
        """Senders that showed an invalid grant in this step. Their next ones wait for the next
        step, because a check takes long."""

    def fences(self, message: T2tMessage) -> bool:
        """Whether the term of the message allows to process it. A new term is remembered."""
        memory = self.memory
        fence = Fence(message.term, message.source, memory.seen_term, memory.owner)
        if not self._guards.term_not_old(fence) or not self._guards.owner_of_term(fence):
            return False
        if not self.in_reach(message.term):
            return False
        if message.term > memory.seen_term:
            if not self._guards.term_proven(self._proof(message)):
                return False
            self.memory = memory._replace(seen_term=message.term, owner=message.source)
            self.new_promise = True
            self.beat_ns = 0
        return True

    def _proof(self, message: T2tMessage) -> TermProof:
        """Check the signed grants that a heartbeat shows, up to the first invalid one.

        Other messages prove no term. Heartbeats are frequent, so trains learn it from the next one.
        """
        check = self._config.grants
        if check is None:
            return TermProof(0, 0)
        needed, valid = self._config.majority, set[int]()
        if isinstance(message, Heartbeat) and message.source not in self._unproven:
            for each in message.grants[:needed]:
                head = (message.area, message.term, message.source, each.arbiter, each.end_ns)
                counts = each.arbiter in self._config.arbiters and message.stamp_ns < each.end_ns
                if not (counts and check.holds(TermGrant(*head), each.signature)):
                    self._unproven.add(message.source)
                    break
                valid.add(each.arbiter)
        return TermProof(len(valid), needed)

    def believes_reported(self, term: int) -> bool:
        """Whether a higher term in a train's report may be true.

        A report proves no term. Where terms are proven, a master learns a higher one from the
        arbiters, which do not renew its lease.
        """
        return self._config.grants is None and self.in_reach(term)

    def in_reach(self, term: int) -> bool:
        """Whether the term may be that of a master, by what the arbiters have confirmed."""
        return self._guards.term_in_reach(TermStep(term, self.confirmed_term))

    def confirm(self, confirmed_term: int, owner_of: Callable[[int], int]) -> None:
        """Take over what the arbiters report. They know better who owns the term than its senders.

        Args:
            owner_of: the train to which a majority granted a term. 0: unknown.
        """
        self.confirmed_term = max(self.confirmed_term, confirmed_term)
        owner = owner_of(self.memory.seen_term)
        if owner not in (NO_TRAIN, self.memory.owner):
            self.memory = self.memory._replace(owner=owner)
            self.beat_ns = 0
            # What another train sent under this term does not count. The owner's numbers are lower.
            self.newest = (self.memory.seen_term, -1)

    def on_heartbeat(self, heartbeat: Heartbeat, now_ns: int) -> bool:
        if not self.fences(heartbeat):
            return False
        self.master_heard_ns = now_ns
        self.beat_ns = heartbeat.stamp_ns
        self.standby = heartbeat.standby
        return True

    def takes(self, authority: AreaAuthority, now_ns: int) -> str:
        """Accept the authority. The result is the reason of a refusal, or empty if accepted."""
        guards = self._guards
        offer = Offer(
            authority, now_ns, self._boot, self.newest, self._timers.authority_ms * NS_PER_MS
        )
        if not guards.for_this_incarnation(offer):
            return "wrong boot incarnation"
        if not guards.young_enough(offer):
            return "too old"
        if not self.fences(authority):
            return "old term"
        if not guards.newer_than_held(offer):
            return "repeated or out of order"
        self.held = authority
        self.newest = (authority.term, authority.sequence)
        self.rank = authority.rank
        self.master_heard_ns = now_ns
        return ""

    def settle(self, now_ns: int, own: OwnTrain, *, limit_m: float = math.inf) -> None:
        """Discard an expired authority and update how far the train may still run.

        Called once a step, after all messages of the step.

        Args:
            limit_m: farthest end of any authority, by what the train itself receives.
        """
        self._limit_m = limit_m
        self._unproven.clear()
        if own.standstill and not self.is_young(now_ns):
            self.held = None
        if not own.localised:
            if self.held is not None and self.latent_m is not None:
                self.latent_m = max(self.latent_m, self.held.end_m)
            return
        # Authorities of an earlier incarnation are unknown. They cannot carry the train beyond its
        # emergency braking distance.
        before_m = own.reach_m if self.latent_m is None else self.latent_m
        end_m = None if self.held is None else self.held.end_m
        self.latent_m = self._guards.latent_authority_m(
            Latency(before_m, end_m, max(own.reach_m, own.front_max_m), own.front_max_m)
        )

    def held_end_m(self, front_max_m: float) -> float:
        """End of the held authority as far as the train uses it. Without one: its front."""
        if self.held is None:
            return front_max_m
        return min(self.held.end_m, max(self._limit_m, front_max_m))

    def is_young(self, now_ns: int) -> bool:
        """Whether the train holds an authority that has not expired."""
        held = self.held
        age_max_ns = self._timers.authority_ms * NS_PER_MS
        return held is not None and now_ns - held.echo_ns <= age_max_ns
