"""A train as one area's member: the terms it has seen, the authority it holds, what is latent."""

from vobc.train_to_train.guards import Fence, Latency, MemberGuards, Offer
from vobc.train_to_train.vocabulary import AreaMemory, OwnTrain
from zenoh_config.t2t import NOBODY, AreaAuthority, Heartbeat, T2tMessage
from zenoh_config.timers import NS_PER_MS, LineTimers

RANK_OF_A_STRANGER: int = 4
"""Members of the roster go first."""


class AreaMember:
    """One for each area that the train has to do with."""

    def __init__(
        self,
        timers: LineTimers,
        guards: MemberGuards,
        *,
        boot: int,
        memory: AreaMemory,
        now_ns: int,
    ) -> None:
        self._timers, self._guards = timers, guards
        self._boot = boot
        self.memory = memory
        """To be stored whenever it is another than before."""
        self.held: AreaAuthority | None = None
        self.newest = (0, -1)
        """Term and sequence of the newest authority that was taken."""
        self.latent_m: float | None = None
        """As told last; None before the train first knew where it is."""
        self.master_heard_ns = now_ns
        """When the master was last heard, or when listening began."""
        self.beat_ns = 0
        """`stamp_ns` of the newest heartbeat of the term that was seen last; 0: none was heard."""
        self.standby = NOBODY
        self.rank = RANK_OF_A_STRANGER
        self.promised_anew = False
        """A new term was seen: it wants to be acknowledged at once."""

    def fences(self, message: T2tMessage) -> bool:
        """Whether to hear the message at all by its term; a new term is remembered."""
        memory = self.memory
        fence = Fence(message.term, message.source, memory.seen_term, memory.owner)
        if not self._guards.term_not_old(fence) or not self._guards.owner_of_term(fence):
            return False
        if message.term > memory.seen_term:
            self.memory = memory._replace(seen_term=message.term, owner=message.source)
            self.promised_anew = True
            self.beat_ns = 0
        return True

    def hears_heartbeat(self, heartbeat: Heartbeat, now_ns: int) -> bool:
        if not self.fences(heartbeat):
            return False
        self.master_heard_ns = now_ns
        self.beat_ns = heartbeat.stamp_ns
        self.standby = heartbeat.standby
        return True

    def takes(self, authority: AreaAuthority, now_ns: int) -> str:
        """Take it or say why not; empty: taken."""
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

    def settle(self, now_ns: int, own: OwnTrain) -> None:
        """Once a step, after everything heard: drop what ran out, and see what is still latent."""
        if own.standstill and not self.is_young(now_ns):
            self.held = None
        if not own.localised:
            if self.held is not None and self.latent_m is not None:
                self.latent_m = max(self.latent_m, self.held.end_m)
            return
        # Of what an earlier life was granted nothing is known but how far that can carry the train.
        before_m = own.reach_m if self.latent_m is None else self.latent_m
        end_m = None if self.held is None else self.held.end_m
        self.latent_m = self._guards.latent_authority_m(
            Latency(before_m, end_m, max(own.reach_m, own.front_max_m), own.front_max_m)
        )

    def is_young(self, now_ns: int) -> bool:
        """The held authority has not run out."""
        held = self.held
        age_max_ns = self._timers.authority_ms * NS_PER_MS
        return held is not None and now_ns - held.echo_ns <= age_max_ns
