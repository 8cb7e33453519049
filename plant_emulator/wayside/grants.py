"""Which train holds which term, as the arbiters' answers on the radio show it."""

from typing import Protocol

from plant_emulator.wayside.t2t_vocabulary import LeaseMemory
from zenoh_config.t2t import LeaseAnswer, T2tMessage


class Grants(Protocol):
    """The terms that an arbiter has granted: its own state, or what another program knows of it."""

    def has_granted(self, message: T2tMessage) -> bool:
        """Tell whether the message's term was granted to its sender."""
        ...


class ObservedArbiter:
    """What the answers of one arbiter show to a program that has no arbiter itself.

    Every answer, also a refusal, names the highest granted term of its area and the holder.
    """

    def __init__(self, address: int) -> None:
        self.address = address
        self._leases: dict[int, LeaseMemory] = {}
        """By area, highest granted term with its holder, and the last roster that was sent."""

    def on_answer(self, answer: LeaseAnswer) -> tuple[LeaseMemory, LeaseMemory] | None:
        """Note an answer, and return what was known of its area before and what is known now.

        None if nothing changed. Terms of an area only grow, so an old answer changes nothing.
        """
        before = self._leases.get(answer.area, LeaseMemory(answer.area))
        if answer.source != self.address or answer.term < before.promised:
            return None
        now = before._replace(promised=answer.term, holder=answer.holder)
        if answer.roster_term:
            roster = (answer.roster_term, answer.roster_version, answer.roster)
            now = LeaseMemory(answer.area, answer.term, answer.holder, 0, *roster)
        if now == before:
            return None
        self._leases[answer.area] = now
        return before, now

    def has_granted(self, message: T2tMessage) -> bool:
        lease = self._leases.get(message.area)
        return lease is not None and (lease.promised, lease.holder) == (
            message.term,
            message.source,
        )
