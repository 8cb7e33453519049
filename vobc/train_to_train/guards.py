"""Guards: the conditions under which a train obeys, commands or releases. Each is replaceable.

Tests and simulators remove a guard with `without` and must detect the effect. Nothing else replaces
a guard.
"""

import dataclasses
from collections.abc import Callable
from typing import Any, NamedTuple, TypeVar

from zenoh_config.t2t import (
    NO_TRAIN,
    TERM_STEP_MAX,
    AreaAuthority,
    ObjectState,
    ObjectStatus,
)


class Offer(NamedTuple):
    """A received authority with the inputs that decide whether the train accepts it."""

    authority: AreaAuthority
    now_ns: int
    boot: int
    """Incarnation of the receiver."""
    newest: tuple[int, int]
    """Term and sequence number of the newest accepted authority."""
    age_max_ns: int


def for_this_incarnation(offer: Offer) -> bool:
    return offer.authority.to_boot == offer.boot


def young_enough(offer: Offer) -> bool:
    """The age counts by the receiver's clock, from the sending of the report that is answered."""
    return 0 <= offer.now_ns - offer.authority.echo_ns <= offer.age_max_ns


def newer_than_held(offer: Offer) -> bool:
    return (offer.authority.term, offer.authority.sequence) > offer.newest


class Fence(NamedTuple):
    """Term of a received message, with the highest known term and its owner."""

    term: int
    source: int
    seen_term: int
    owner: int


def term_not_old(fence: Fence) -> bool:
    return fence.term >= fence.seen_term


def owner_of_term(fence: Fence) -> bool:
    """Each term has one owner, because a majority grants a term only once. The first accepted
    sender under a new term is its owner.
    """
    return fence.term != fence.seen_term or fence.source == fence.owner


class TermStep(NamedTuple):
    """A received term, with the highest one that an arbiter has confirmed to this train."""

    term: int
    confirmed_term: int


def term_in_reach(step: TermStep) -> bool:
    """The term is at most 10,000 above the highest one that an arbiter has confirmed.

    A train that refuses a higher term asks the arbiters, and learns from their answer how far terms
    have come.
    """
    return step.term <= step.confirmed_term + TERM_STEP_MAX


class TermProof(NamedTuple):
    """Grants that a message shows for a term that is new to the train."""

    valid: int
    """Number of arbiters whose signed grant of this term to the sender is valid and has not
    ended."""
    needed: int
    """Majority of the arbiters. 0 on a line without signed grants, where no term is proven."""


def term_proven(proof: TermProof) -> bool:
    """On a secured line, a heartbeat proves a new term by the signed grants of a majority of
    arbiters."""
    return proof.valid >= proof.needed


class TrainAhead(NamedTuple):
    rear_m: float
    """Protected rear of the nearest train received ahead. Infinite: there is none."""
    behind_rear_m: float
    """Track kept free behind it."""


def behind_train_ahead_m(ahead: TrainAhead) -> float:
    """Farthest end of an authority, whatever a master grants."""
    return ahead.rear_m - ahead.behind_rear_m


class Latency(NamedTuple):
    """Bounds of how far a train's front may still run on the authority of one area."""

    before_m: float
    """Farthest place as last reported."""
    held_end_m: float | None
    """End of the held authority, whether expired or not. None: no authority is held."""
    reach_m: float
    """Farthest place with the emergency brake applied from now."""
    front_max_m: float


def latent_authority_m(inputs: Latency) -> float:
    """Farthest place that the front may still reach.

    A shorter authority binds at once, but the train still needs its braking distance.
    """
    still_m = min(inputs.before_m, inputs.reach_m)
    held_m = inputs.front_max_m if inputs.held_end_m is None else inputs.held_end_m
    return max(max(held_m, still_m), inputs.front_max_m)


@dataclasses.dataclass(frozen=True, slots=True)
class MemberGuards:
    """Guards of a train that obeys."""

    for_this_incarnation: Callable[[Offer], bool] = for_this_incarnation
    young_enough: Callable[[Offer], bool] = young_enough
    newer_than_held: Callable[[Offer], bool] = newer_than_held
    term_not_old: Callable[[Fence], bool] = term_not_old
    owner_of_term: Callable[[Fence], bool] = owner_of_term
    term_in_reach: Callable[[TermStep], bool] = term_in_reach
    term_proven: Callable[[TermProof], bool] = term_proven
    latent_authority_m: Callable[[Latency], float] = latent_authority_m
    """A formula. A test replaces it by a wrong one instead of removing it."""
    behind_train_ahead_m: Callable[[TrainAhead], float] = behind_train_ahead_m
    """A formula, like `latent_authority_m`."""


class Votes(NamedTuple):
    """Number of arbiters that granted one request of a train."""

    granted: int
    majority: int


def granted_by_majority(votes: Votes) -> bool:
    return votes.granted >= votes.majority


class LeaseClock(NamedTuple):
    now_ns: int
    until_ns: int
    """End of the lease by the holder's clock."""
    margin_ns: int


def lease_runs(clock: LeaseClock) -> bool:
    """Whether the lease still holds when the messages of this step have left."""
    return clock.now_ns + clock.margin_ns < clock.until_ns


class Granted(NamedTuple):
    """A request that a majority granted. Times are by the holder's clock."""

    sent_ns: int
    whole_ns: int
    """Length of a full lease as the holder may assume it."""
    less_ns: int
    """Reduction that the request asked for."""


def granted_until_ns(granted: Granted) -> int:
    """End of the lease. Arbiters and holder both apply the reduction of the request."""
    return granted.sent_ns + granted.whole_ns - granted.less_ns


class Attempt(NamedTuple):
    """An arbiter's answer, with the request that it should answer."""

    term: int
    nonce: int
    asked_term: int
    asked_nonce: int | None
    """Nonce of the open request. None: no request with this nonce is open."""


def answers_this_attempt(attempt: Attempt) -> bool:
    return attempt.nonce == attempt.asked_nonce and attempt.term == attempt.asked_term


class Terms(NamedTuple):
    seen: int
    refused: int
    """Highest acknowledged term that a refusing arbiter reported."""
    tried: int


def unused_term(terms: Terms) -> int:
    """A term above every term received and every term requested. A train never requests a term
    twice.
    """
    return max(terms.seen, terms.refused, terms.tried) + 1


@dataclasses.dataclass(frozen=True, slots=True)
class LeaseGuards:
    """Guards of a train that wants to command."""

    granted_by_majority: Callable[[Votes], bool] = granted_by_majority
    lease_runs: Callable[[LeaseClock], bool] = lease_runs
    answers_this_attempt: Callable[[Attempt], bool] = answers_this_attempt
    unused_term: Callable[[Terms], int] = unused_term
    """A formula, like `latent_authority_m`."""
    granted_until_ns: Callable[[Granted], int] = granted_until_ns
    """A formula, like `latent_authority_m`."""


class Acknowledgement(NamedTuple):
    """Term that a train's newest report acknowledges, with the master's own term."""

    reported_term: int
    term: int


def has_promised(promise: Acknowledgement) -> bool:
    """The train has acknowledged the master's term and obeys no lower one."""
    return promise.reported_term == promise.term


class Commitment(NamedTuple):
    acks: int
    majority: int


def roster_kept(commitment: Commitment) -> bool:
    """A majority of arbiters stored the roster, so every later majority contains one of them."""
    return commitment.acks >= commitment.majority


class Freshness(NamedTuple):
    age_ns: int
    age_max_ns: int


def report_alive(freshness: Freshness) -> bool:
    return 0 <= freshness.age_ns <= freshness.age_max_ns


def report_recent(freshness: Freshness) -> bool:
    """The report echoes a recent heartbeat, so its transmission was short.

    The train is therefore near the reported position.
    """
    return 0 <= freshness.age_ns <= freshness.age_max_ns


def track_known(freshness: Freshness) -> bool:
    """The track status dates from the present term, so closures and occupancy are known."""
    return 0 <= freshness.age_ns <= freshness.age_max_ns


class Neighbours(NamedTuple):
    """Places of an applicant and of the trains between which it would stand."""

    behind_m: float
    """Farthest place that the authorities of the trains behind may reach."""
    rear_m: float
    """Rear of the applicant, less the track kept free behind it."""
    front_m: float
    ahead_m: float
    """Rear of the next train ahead, less the allowance for rolling back."""


def placed_apart(place: Neighbours) -> bool:
    return place.behind_m <= place.rear_m and place.front_m <= place.ahead_m


class InLine(NamedTuple):
    """Relation of an applicant in the preceding area to the roster that it wants to join."""

    comes_over_border: bool
    has_authority_there: bool
    behind: int
    """Train ahead of the applicant in the preceding area, from its authority. 0: none up to
    the border."""
    ahead: int
    """Train that would be ahead of the applicant in this area."""


def comes_in_line(line: InLine) -> bool:
    """No unregistered train can be between the applicant and the train ahead."""
    if not line.comes_over_border:
        return True
    return line.has_authority_there and line.behind in (NO_TRAIN, line.ahead)


class Claimed(NamedTuple):
    """Reported status of an object, with the claim that its master made."""

    status: ObjectStatus | None
    term: int
    nonce: int
    """Number of the claim. 0: there is no claim."""


def object_confirmed(claimed: Claimed) -> bool:
    """The object is locked by this very claim. Any other status may be outdated."""
    status = claimed.status
    return (
        status is not None
        and status.state is ObjectState.LOCKED
        and claimed.nonce != 0
        and (status.claim_term, status.nonce) == (claimed.term, claimed.nonce)
    )


class Reach(NamedTuple):
    """A train of the roster and an object that should be released."""

    reserved_m: float
    """Farthest place that the train may reach by any authority, as far as that is known."""
    rear_m: float
    """Protected rear, less the track kept free behind it."""
    start_m: float
    end_m: float


def cannot_reach(reach: Reach) -> bool:
    """The train has passed the object for good, or all its authorities end before the object."""
    return reach.rear_m >= reach.end_m or reach.reserved_m <= reach.start_m


def cleared_after(later_ns: int) -> bool:
    """The sections were read as clear after the last report of the silent train."""
    return later_ns >= 0


class Vanished(NamedTuple):
    """A train that an operator declares gone."""

    silent: bool
    """The train has been silent for longer than any train obeys an authority."""
    explained: bool
    """Reporting trains at standstill account for all axles where the train may be."""


def vanished(inputs: Vanished) -> bool:
    return inputs.silent and inputs.explained


def sieved(shown: bool) -> bool:
    """Secondary detection has shown that no shadow train is next to the train."""
    return shown


@dataclasses.dataclass(frozen=True, slots=True)
class MasterGuards:
    """Guards of a train that commands."""

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
    """Always true. `without` puts it in place of a removed guard."""
    return True


def without(guards: T, *names: str) -> T:
    """Copy of the guards with the named ones always true. Only for tests and simulators."""
    return dataclasses.replace(guards, **dict.fromkeys(names, holds))
