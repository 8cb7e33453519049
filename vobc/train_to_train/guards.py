"""What must hold before a train obeys, commands or lets go: every guard by name, each replaceable.

Tests and simulators take one away with `without` and have to notice; nothing else replaces any.
"""

import dataclasses
from collections.abc import Callable
from typing import Any, NamedTuple, TypeVar

from zenoh_config.t2t import NOBODY, AreaAuthority, ObjectState, ObjectStatus


class Offer(NamedTuple):
    """An authority that was heard, beside what decides whether it is taken."""

    authority: AreaAuthority
    now_ns: int
    boot: int
    """Of the receiver."""
    newest: tuple[int, int]
    """Term and sequence of the newest that was taken."""
    age_max_ns: int


def for_this_incarnation(offer: Offer) -> bool:
    return offer.authority.to_boot == offer.boot


def young_enough(offer: Offer) -> bool:
    """By the receiver's own clock, since it sent the report that is answered."""
    return 0 <= offer.now_ns - offer.authority.echo_ns <= offer.age_max_ns


def newer_than_held(offer: Offer) -> bool:
    return (offer.authority.term, offer.authority.sequence) > offer.newest


class Fence(NamedTuple):
    """A term that was heard, and what is known of terms."""

    term: int
    source: int
    seen_term: int
    owner: int


def term_not_old(fence: Fence) -> bool:
    return fence.term >= fence.seen_term


def owner_of_term(fence: Fence) -> bool:
    """A term has one owner. Who first speaks under a new one is its owner: only one can have it."""
    return fence.term != fence.seen_term or fence.source == fence.owner


class Latency(NamedTuple):
    """What bounds how far a train's front may still come by the authority of one area."""

    before_m: float
    """As told last."""
    held_end_m: float | None
    """Of the authority that is held, of whatever age, in force or not."""
    reach_m: float
    """With the emergency brake from now."""
    front_max_m: float


def latent_authority_m(seen: Latency) -> float:
    """A shorter authority binds at once, but the train still has to stop for it."""
    still_m = min(seen.before_m, seen.reach_m)
    held_m = seen.front_max_m if seen.held_end_m is None else seen.held_end_m
    return max(max(held_m, still_m), seen.front_max_m)


@dataclasses.dataclass(frozen=True, slots=True)
class MemberGuards:
    """Of a train that obeys."""

    for_this_incarnation: Callable[[Offer], bool] = for_this_incarnation
    young_enough: Callable[[Offer], bool] = young_enough
    newer_than_held: Callable[[Offer], bool] = newer_than_held
    term_not_old: Callable[[Fence], bool] = term_not_old
    owner_of_term: Callable[[Fence], bool] = owner_of_term
    latent_authority_m: Callable[[Latency], float] = latent_authority_m
    """No guard that can be taken away, but a formula that can be replaced by a wrong one."""


class Votes(NamedTuple):
    """Arbiters that granted one request of a train."""

    granted: int
    majority: int


def granted_by_majority(votes: Votes) -> bool:
    return votes.granted >= votes.majority


class LeaseClock(NamedTuple):
    now_ns: int
    until_ns: int
    """The lease holds before this instant, by the holder's clock."""
    margin_ns: int


def lease_runs(clock: LeaseClock) -> bool:
    """Also still when what is decided now has left."""
    return clock.now_ns + clock.margin_ns < clock.until_ns


class Granted(NamedTuple):
    """One request that a majority granted, by the holder's clock."""

    sent_ns: int
    whole_ns: int
    """A whole lease, as its holder may count on it."""
    less_ns: int
    """As the request said."""


def granted_until_ns(granted: Granted) -> int:
    """Arbiters keep to what was asked for, and so does the holder."""
    return granted.sent_ns + granted.whole_ns - granted.less_ns


class Attempt(NamedTuple):
    """An arbiter's answer beside the request it should answer."""

    term: int
    nonce: int
    asked_term: int
    asked_nonce: int | None
    """None: no such request is on its way."""


def answers_this_attempt(attempt: Attempt) -> bool:
    return attempt.nonce == attempt.asked_nonce and attempt.term == attempt.asked_term


class Terms(NamedTuple):
    seen: int
    refused: int
    """Highest that an arbiter said it had promised when it refused."""
    tried: int


def unused_term(terms: Terms) -> int:
    """Above everything heard, and above everything asked for: a term is never asked for twice."""
    return max(terms.seen, terms.refused, terms.tried) + 1


@dataclasses.dataclass(frozen=True, slots=True)
class LeaseGuards:
    """Of a train that wants to command."""

    granted_by_majority: Callable[[Votes], bool] = granted_by_majority
    lease_runs: Callable[[LeaseClock], bool] = lease_runs
    answers_this_attempt: Callable[[Attempt], bool] = answers_this_attempt
    unused_term: Callable[[Terms], int] = unused_term
    """A formula, as `latent_authority_m` is."""
    granted_until_ns: Callable[[Granted], int] = granted_until_ns
    """A formula, too."""


class Acknowledgement(NamedTuple):
    """What a train's newest report says of terms, beside the master's own term."""

    reported_term: int
    term: int


def has_promised(promise: Acknowledgement) -> bool:
    """The train obeys no lower term any more."""
    return promise.reported_term == promise.term


class Commitment(NamedTuple):
    acks: int
    majority: int


def roster_kept(commitment: Commitment) -> bool:
    """At so many arbiters that whoever commands next finds it."""
    return commitment.acks >= commitment.majority


class Freshness(NamedTuple):
    age_ns: int
    age_max_ns: int


def report_alive(freshness: Freshness) -> bool:
    return 0 <= freshness.age_ns <= freshness.age_max_ns


def report_recent(freshness: Freshness) -> bool:
    """Since the heartbeat that it echoes: what a train says of its place has not been long on its
    way, so that it is not far from there.
    """
    return 0 <= freshness.age_ns <= freshness.age_max_ns


def track_known(freshness: Freshness) -> bool:
    """What supervision closed and what is occupied is known from the time of this very term."""
    return 0 <= freshness.age_ns <= freshness.age_max_ns


class Neighbours(NamedTuple):
    """An applicant and the trains that it would stand between."""

    behind_m: float
    """No train behind may come farther than this: the farthest that they may have been granted."""
    rear_m: float
    """The applicant's, less the allowance for rolling back."""
    front_m: float
    ahead_m: float
    """The rear of the next train ahead, less the allowance."""


def placed_apart(place: Neighbours) -> bool:
    return place.behind_m <= place.rear_m and place.front_m <= place.ahead_m


class InLine(NamedTuple):
    """An applicant from the area before, and the roster that it wants to join."""

    comes_over_border: bool
    has_authority_there: bool
    behind: int
    """Who is ahead of it there by its authority; NOBODY: none up to the border."""
    ahead: int
    """Who would be ahead of it here."""


def comes_in_line(line: InLine) -> bool:
    """Nobody who is not on the roster can be between the applicant and the train ahead."""
    if not line.comes_over_border:
        return True
    return line.has_authority_there and line.behind in (NOBODY, line.ahead)


class Claimed(NamedTuple):
    """What an object says, beside the claim that its master made."""

    status: ObjectStatus | None
    term: int
    nonce: int
    """0: there is no claim."""


def object_confirmed(claimed: Claimed) -> bool:
    """Locked by this claim: any other status may be older than what came between."""
    status = claimed.status
    return (
        status is not None
        and status.state is ObjectState.LOCKED
        and claimed.nonce != 0
        and (status.claim_term, status.nonce) == (claimed.term, claimed.nonce)
    )


class Reach(NamedTuple):
    """One train of the roster beside an object that shall be released."""

    reserved_m: float
    """The farthest that it may come by anything that it was granted, as far as that is known."""
    rear_m: float
    """Protected rear, less the allowance."""
    start_m: float
    end_m: float


def cannot_reach(reach: Reach) -> bool:
    """It is past the object for good, or all that it may act upon ends before it."""
    return reach.rear_m >= reach.end_m or reach.reserved_m <= reach.start_m


def cleared_after(later_ns: int) -> bool:
    """Sections were seen clear when the silent train had been heard already, so much later."""
    return later_ns >= 0


class Vanished(NamedTuple):
    """A train that a person says is not there any more."""

    silent: bool
    """For longer than any authority is obeyed."""
    explained: bool
    """All axles where it may be are those of trains that say that they stand there."""


def vanished(seen: Vanished) -> bool:
    return seen.silent and seen.explained


def sieved(shown: bool) -> bool:
    """Secondary detection has shown that nothing hides near the train."""
    return shown


@dataclasses.dataclass(frozen=True, slots=True)
class MasterGuards:
    """Of a train that commands."""

    has_promised: Callable[[Acknowledgement], bool] = has_promised
    roster_kept: Callable[[Commitment], bool] = roster_kept
    report_alive: Callable[[Freshness], bool] = report_alive
    report_recent: Callable[[Freshness], bool] = report_recent
    track_known: Callable[[Freshness], bool] = track_known
    placed_apart: Callable[[Neighbours], bool] = placed_apart
    comes_in_line: Callable[[InLine], bool] = comes_in_line
    object_confirmed: Callable[[Claimed], bool] = object_confirmed
    cannot_reach: Callable[[Reach], bool] = cannot_reach
    sieved: Callable[[bool], bool] = sieved
    cleared_after: Callable[[int], bool] = cleared_after
    vanished: Callable[[Vanished], bool] = vanished


@dataclasses.dataclass(frozen=True, slots=True)
class TrainGuards:
    member: MemberGuards = dataclasses.field(default_factory=MemberGuards)
    lease: LeaseGuards = dataclasses.field(default_factory=LeaseGuards)
    master: MasterGuards = dataclasses.field(default_factory=MasterGuards)


T = TypeVar("T", MemberGuards, LeaseGuards, MasterGuards)


def holds(*_: Any) -> bool:
    """Stands where a guard was taken away."""
    return True


def without(guards: T, *names: str) -> T:
    """The same guards but for those, which let everything pass. For tests and simulators only."""
    return dataclasses.replace(guards, **dict.fromkeys(names, holds))
