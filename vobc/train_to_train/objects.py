"""Switches, crossings and platform tracks as a master handles them: claim, confirm, release."""

from collections.abc import Callable, Sequence
from typing import NamedTuple

from firmware_py.trackdb.areas import ObjectSite
from vobc.train_to_train.authority import Bar, BarredTrack
from vobc.train_to_train.guards import Claimed, MasterGuards, Reach
from zenoh_config.t2t import ClaimKind, ObjectState, ObjectStatus


class Claim(NamedTuple):
    kind: ClaimKind
    nonce: int


class TrackObjects:
    """Objects of one area under one term. Nonces grow, so that an old claim never undoes a newer
    one.
    """

    def __init__(self, term: int, sites: Sequence[ObjectSite], guards: MasterGuards) -> None:
        self.statuses: dict[int, ObjectStatus] = {}
        self._term, self._sites, self._guards = term, sites, guards
        self._claims: dict[int, Claim] = {}
        self._nonce = 0

    def on_message(self, status: ObjectStatus) -> None:
        if any(site.number == status.number for site in self._sites):
            self.statuses[status.number] = status

    def plan(
        self,
        *,
        needed: Callable[[ObjectSite], bool],
        reaches: Callable[[ObjectSite], Sequence[Reach]],
    ) -> list[tuple[ObjectSite, Claim]]:
        """Claims and releases to send now: those that the object has not confirmed yet.

        Args:
            needed: whether a train comes near an object.
            reaches: every train of the roster, as seen from the object.
        """
        sent = []
        for site in self._sites:
            status = self.statuses.get(site.number)
            if status is None or status.state is ObjectState.FAILED:
                continue
            claim = self._wish(site, status, needed, reaches)
            if claim is not None and not self._carried_out(claim, status):
                sent.append((site, claim))
        return sent

    def _wish(
        self,
        site: ObjectSite,
        status: ObjectStatus,
        needed: Callable[[ObjectSite], bool],
        reaches: Callable[[ObjectSite], Sequence[Reach]],
    ) -> Claim | None:
        held = self._claims.get(site.number)
        if status.release_wanted:
            if status.state is ObjectState.FREE:
                return None
            if held is not None and held.kind is ClaimKind.RELEASE:
                return held
            if all(self._guards.cannot_reach(reach) for reach in reaches(site)):
                return self._claim(site, ClaimKind.RELEASE)
        elif not needed(site) and (held is None or held.kind is ClaimKind.RELEASE):
            return None
        if held is None or held.kind is ClaimKind.RELEASE:
            return self._claim(site, ClaimKind.CLAIM)
        return held

    def _claim(self, site: ObjectSite, kind: ClaimKind) -> Claim:
        self._nonce += 1
        self._claims[site.number] = Claim(kind, self._nonce)
        return self._claims[site.number]

    def _carried_out(self, claim: Claim, status: ObjectStatus) -> bool:
        return (status.claim_term, status.nonce) == (self._term, claim.nonce)

    def stretches(self) -> list[BarredTrack]:
        """Objects that trains may not pass freely."""
        barred = [(site, self._bar(site)) for site in self._sites]
        return [
            BarredTrack(site.start_m, site.end_m, bar) for site, bar in barred if bar is not None
        ]

    def _bar(self, site: ObjectSite) -> Bar | None:
        status = self.statuses.get(site.number)
        claim = self._claims.get(site.number)
        nonce = claim.nonce if claim is not None and claim.kind is ClaimKind.CLAIM else 0
        if not self._guards.object_confirmed(Claimed(status, self._term, nonce)):
            locked = status is None or status.state is ObjectState.LOCKED
            return Bar.UNSURE if locked else Bar.SHUT
        return Bar.CLOSING if status is not None and status.release_wanted else None
