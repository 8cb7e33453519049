"""Checks the messages of a line against the actions and guards of the TLA+ model.

Theory
------
Each message is the visible part of one action of `line.tla`: a granted `LeaseAnswer` is `Grant`, a
`RosterAck` is `Keep`, and so on (`JUDGED`). The check follows the state of the model as far as
messages show it: who holds which term at which arbiter, which roster a majority stored, what each
train reports. A message whose action the model does not allow in this state is a `ModelDeviation`,
with the name of the guard as in the model and in the code.

The check needs every message of a line from its start on, in the order of sending. What a receiver
knew when it acted does not show. Where a guard depends on that, the check asks whether *any*
message sent before allows the action, so it accepts more than the model does.
"""

from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from typing import Any, Final, NamedTuple

from firmware_py.trackdb.areas import AreaMap
from zenoh_config.t2t import (
    LAST_TRAIN,
    NO_TRAIN,
    AreaAuthority,
    ClaimKind,
    Heartbeat,
    LeaseAnswer,
    LeaseKind,
    LeaseRequest,
    ObjectClaim,
    ObjectState,
    ObjectStatus,
    Phase,
    RosterAck,
    RosterCommit,
    RosterEntry,
    TrackStatus,
    TrainReport,
)
from zenoh_config.timers import NS_PER_MS, TIMERS_A

TOUCH_M: Final = 1e-3
"""Tolerance for places that travelled as numbers of single precision."""
JUDGED: Final = {
    "Ask": ("unused_term",),
    "Grant": ("term_is_new", "lease_is_free"),
    "Late": ("answers_this_attempt",),
    "Lead": ("granted_by_majority", "OneOwner"),
    "Relies": ("roster_kept",),
    "Keep": ("by_holder",),
    "Propose": ("OrderKept",),
    "Obeys": ("for_this_incarnation", "member.term_not_old"),
    "Accept": ("newer_than_held",),
    "Hear": ("member.term_not_old",),
    "Report": ("latent_authority_m",),
    "Issue": ("lease_runs", "ends_behind_rear", "ends_at_border"),
    "Claim": ("has_promised", "cannot_reach"),
    "Obey": ("object.term_not_old", "newer_claim"),
    "Confirm": ("object_confirmed",),
}
"""Guards of the model that messages can contradict, by action."""
UNSEEN: Final = {
    "granted_until_ns": "rests on clocks of two nodes",
    "waits_after_start": "rests on the instant of an arbiter's start",
    "arbiter.memory": "such an arbiter sends nothing",
    "memory": "such a train sends nothing",
    "comes_in_line": "rests on what the master knew of the area before",
    "left_area": "a train also leaves by axle counts and by a word of supervision",
}
"""Guards of the model that messages cannot contradict, with the reason."""


class ModelDeviation(NamedTuple):
    guard: str
    """Guard or invariant of the model that the message contradicts."""
    what: str


@dataclass(slots=True)
class TermRecord:
    """One term of an area, as messages show it."""

    owner: tuple[int, int] = (NO_TRAIN, 0)
    """Train and incarnation that sent its first heartbeat."""
    granted: set[int] = field(default_factory=set)
    """Arbiters that granted it to the owner."""
    until_ns: int = 0
    """End of the lease by the clock of its holder."""
    returned: bool = False
    """The holder has given the lease back, so an arbiter may grant it before its end."""
    commits: dict[int, tuple[RosterEntry, ...]] = field(default_factory=dict)
    """Proposed rosters by version."""
    acks: dict[int, set[int]] = field(default_factory=dict)
    """Arbiters that stored each version."""
    reported: dict[int, list[TrainReport]] = field(default_factory=dict)
    """By train, reports under this term that show it before or beyond an object."""
    claims: dict[int, int] = field(default_factory=dict)
    """Nonce of the newest claim or release, by object."""
    confirmed: set[tuple[int, int]] = field(default_factory=set)
    """Number and nonce of claims that their object has confirmed as locked."""


class Request(NamedTuple):
    message: LeaseRequest
    voters: set[int]


@dataclass(slots=True)
class ArbiterRecord:
    """One area at one arbiter, as messages show it."""

    term: int = 0
    holder: int = NO_TRAIN
    successor: int = NO_TRAIN
    boot: int = 0
    until_ns: int = 0
    """End of the lease by the arbiter's clock. 0: unknown."""
    roster: tuple[int, int] = (0, 0)
    """Term and version of the stored roster."""


class Conformance:
    """Follows the messages of a line and collects deviations from the model."""

    def __init__(self, areas: AreaMap | None = None) -> None:
        """Without the areas of the line no guard that rests on places of the track is judged."""
        self.deviations: list[ModelDeviation] = []
        self.looked = Counter[str]()
        """Number of times that each guard was judged."""
        self.messages = 0
        self.refused = 0
        """Number of messages of the log that could not be read."""
        self._ends_m = {} if areas is None else {each.number: each.end_m for each in areas.areas}
        self._sections = {} if areas is None else {each.number: each for each in areas.sections}
        self._sites = {} if areas is None else {each.number: each for each in areas.objects}
        self._terms: dict[tuple[int, int], TermRecord] = {}
        self._arbiters: dict[tuple[int, int], ArbiterRecord] = {}
        self._requests: dict[tuple[int, int, int, int], Request] = {}
        self._asked: dict[tuple[int, int], tuple[int, int]] = {}
        self._reports: dict[tuple[int, int], TrainReport] = {}
        self._rears_m: dict[tuple[int, int], float] = {}
        self._authorities: dict[tuple[int, int, int, int], AreaAuthority] = {}
        self._objects: dict[int, ObjectStatus] = {}
        self._claimed: dict[tuple[int, int, int], ClaimKind] = {}
        self._majority = 1
        self._takes: dict[type, Callable[[Any], None]] = {
            LeaseRequest: self._on_request,
            LeaseAnswer: self._on_answer,
            Heartbeat: self._on_heartbeat,
            RosterCommit: self._on_commit,
            RosterAck: self._on_ack,
            TrainReport: self._on_report,
            AreaAuthority: self._on_authority,
            ObjectClaim: self._on_claim,
            ObjectStatus: self._on_status,
            TrackStatus: self._on_track,
        }

    def take(self, message: Any) -> None:
        """Judge one message and follow its action. Messages of other kinds are ignored."""
        follow = self._takes.get(type(message))
        if follow is not None:
            self.messages += 1
            follow(message)

    def _judge(self, guard: str, holds: bool, what: str) -> None:
        self.looked[guard] += 1
        if not holds:
            self.deviations.append(ModelDeviation(guard, what))

    def _term(self, message: Any) -> TermRecord:
        return self._terms.setdefault((message.area, message.term), TermRecord())

    def _is_kept(self, term: TermRecord, version: int) -> bool:
        return len(term.acks.get(version, ())) >= self._majority

    def _owns(self, message: Any) -> None:
        """OneOwner: a term belongs to one train, in one incarnation."""
        owner = self._term(message).owner
        sender = message.source, message.boot
        self._judge("OneOwner", owner == sender, f"{_said(message)}: the term belongs to {owner}")

    # Lease.

    def _on_request(self, message: LeaseRequest) -> None:
        self._majority = message.arbiters // 2 + 1
        key = message.source, message.area, message.nonce, message.stamp_ns
        self._requests[key] = Request(message, set())
        if message.kind is LeaseKind.RELEASE:
            self._term(message).returned = True
            for (_, area), record in self._arbiters.items():
                if area == message.area:
                    record.until_ns = 0
        if message.kind is not LeaseKind.ACQUIRE:
            return
        who = message.source, message.area
        asked = message.term, message.boot
        before = self._asked.get(who, (0, 0))
        seen = self._reports.get(who)
        is_new = asked == before or message.term > before[0]
        above = asked == before or seen is None or message.term > seen.term
        self._judge("unused_term", is_new and above, f"{_said(message)} after term {before[0]}")
        self._asked[who] = asked

    def _on_answer(self, message: LeaseAnswer) -> None:
        record = self._arbiters.setdefault((message.source, message.area), ArbiterRecord())
        same = message.term == record.term and message.holder == record.holder
        self._judge(
            "term_is_new",
            message.term > record.term or same or record.term == 0,
            f"{_said(message)} to {message.holder}, after {record.term} to {record.holder}",
        )
        if message.boot != record.boot:
            record.boot, record.until_ns = message.boot, 0
        key = message.destination, message.area, message.nonce, message.echo_ns
        request = self._requests.get(key)
        if message.granted and request is not None:
            self._grant(message, request, record)
        record.term, record.holder = message.term, message.holder

    def _grant(self, answer: LeaseAnswer, request: Request, record: ArbiterRecord) -> None:
        asked = request.message
        self._judge(
            "answers_this_attempt",
            (answer.term, answer.holder) == (asked.term, asked.source),
            f"{_said(answer)} answers a request for term {asked.term}",
        )
        if asked.source not in (record.holder, record.successor):
            self._judge(
                "lease_is_free",
                answer.stamp_ns >= record.until_ns,
                f"{_said(answer)}: the lease of train {record.holder} still runs there",
            )
        if asked.kind is LeaseKind.ACQUIRE:
            record.successor = NO_TRAIN
            stored = answer.roster_term, answer.roster_version
            self._judge(
                "RosterAdopted",
                record.roster in ((0, 0), stored),
                f"{_said(answer)} gives roster {stored}; the arbiter stored {record.roster}",
            )
        else:
            record.successor = asked.successor
        lease_ns, drift_ratio = asked.lease_ms * NS_PER_MS, TIMERS_A.drift_ratio
        request.voters.add(answer.source)
        term = self._term(asked)
        if not term.returned:
            runs_ns = round(lease_ns * (1.0 + drift_ratio)) - asked.less_ns
            record.until_ns = max(record.until_ns, answer.stamp_ns + runs_ns)
        term.granted.add(answer.source)
        if len(request.voters) >= self._majority:
            runs_ns = round(lease_ns * (1.0 - drift_ratio)) - asked.less_ns
            term.until_ns = max(term.until_ns, asked.stamp_ns + runs_ns)

    # Roster.

    def _on_heartbeat(self, message: Heartbeat) -> None:
        term = self._term(message)
        if term.owner[0] == NO_TRAIN:
            self._judge(
                "granted_by_majority",
                len(term.granted) >= self._majority,
                f"{_said(message)}: arbiters {sorted(term.granted)} granted it",
            )
            term.owner = message.source, message.boot
        self._owns(message)
        if message.phase is Phase.ISSUING:
            kept = any(self._is_kept(term, version) for version in term.acks)
            self._judge("roster_kept", kept, f"{_said(message)}: no majority stored a roster")

    def _on_commit(self, message: RosterCommit) -> None:
        term = self._term(message)
        before = term.commits.get(message.version - 1)
        if message.version not in term.commits and before is not None:
            version = message.version - 1
            is_kept = self._is_kept(term, version)
            self._judge("roster_kept", is_kept, f"{_said(message)} before {version} was stored")
            names, earlier = _stayed(message.roster, before), _stayed(before, message.roster)
            self._judge("OrderKept", names == earlier, f"{_said(message)}: {names}, was {earlier}")
        same = term.commits.setdefault(message.version, message.roster)
        told = f"{_said(message)}: two rosters of version {message.version}"
        self._judge("OneOwner", _names(same) == _names(message.roster), told)
        for entry in message.roster:
            self._saw_rear(entry.train, message.area, entry.rear_m)

    def _on_ack(self, message: RosterAck) -> None:
        record = self._arbiters.setdefault((message.source, message.area), ArbiterRecord())
        holder = record.term, record.holder
        self._judge(
            "by_holder",
            record.term == 0 or holder == (message.term, message.destination),
            f"{_said(message)} to train {message.destination}: it had granted {holder}",
        )
        stored = message.term, message.version
        record.roster = max(record.roster, stored)
        self._term(message).acks.setdefault(message.version, set()).add(message.source)

    # Fence and authority.

    def _on_report(self, message: TrainReport) -> None:
        who = message.source, message.area
        before = self._reports.get(who)
        self._judge(
            "member.term_not_old",
            before is None or message.term >= before.term,
            f"{_said(message)} after term {0 if before is None else before.term}",
        )
        self._judge_held(message, before)
        if message.localised:
            least_m = max(message.held_end_m, message.front_max_m) - TOUCH_M
            told = f"{_said(message)}: it may reach {message.latent_m:.2f} m, holds {least_m:.2f} m"
            self._judge("latent_authority_m", message.latent_m >= least_m, told)
            self._saw_rear(*who, max(message.rear_min_m, message.protected_m))
        self._reports[who] = message
        self._term(message).reported.setdefault(message.source, []).append(message)

    def _judge_held(self, message: TrainReport, before: TrainReport | None) -> None:
        held = message.held_term, message.held_sequence
        same_boot = before is not None and before.boot == message.boot
        if held[0] == 0 or held[1] < 0:
            return
        if before is not None and same_boot:
            was = before.held_term, before.held_sequence
            self._judge(
                "newer_than_held", held >= was, f"{_said(message)} holds {held} after {was}"
            )
            if held != was and held[1] >= 0:
                told = f"{_said(message)} accepted term {held[0]} after it had stored {before.term}"
                self._judge("member.term_not_old", held[0] >= before.term, told)
        sent = self._authorities.get((message.source, message.area, *held))
        own = self._terms.get((message.area, held[0]), TermRecord()).owner[0] == message.source
        if not own:
            told = f"{_said(message)} holds {held}, which was not sent to this incarnation"
            is_own = sent is not None and sent.to_boot == message.boot
            self._judge("for_this_incarnation", is_own, told)

    def _saw_rear(self, train: int, area: int, rear_m: float) -> None:
        known_m = self._rears_m.get((train, area), rear_m)
        self._rears_m[train, area] = max(known_m, rear_m)

    def _on_track(self, message: TrackStatus) -> None:
        """Advance trains, perhaps silent ones, whose sections are clear behind them."""
        sections = [
            self._sections[e.section] for e in message.sections if e.section in self._sections
        ]
        occupied = {each.section for each in message.sections if each.occupied}
        for (train, area), rear_m in self._rears_m.items():
            beyond = [each for each in sections if each.end_m > rear_m]
            if area == message.area and beyond:
                there = [each.start_m for each in beyond if each.number in occupied]
                self._saw_rear(train, area, there[0] if there else beyond[-1].end_m)

    def _on_authority(self, message: AreaAuthority) -> None:
        self._owns(message)
        term, said = self._term(message), _said(message)
        key = message.destination, message.area, message.term, message.sequence
        self._authorities[key] = message
        late_ms = (message.stamp_ns - term.until_ns) / NS_PER_MS
        told = f"{said} {late_ms:.1f} ms after the end of its lease"
        self._judge("lease_runs", late_ms < 0, told)
        kept = [version for version in term.commits if self._is_kept(term, version)]
        names = _names(term.commits[max(kept)]) if kept else []
        told = f"{said} to train {message.destination}: stored roster {names}"
        self._judge("roster_kept", message.destination in names, told)
        if message.behind != NO_TRAIN and self._ends_m:
            rear_m = self._rears_m.get((message.behind, message.area), float("-inf"))
            told = f"{said} to {message.end_m:.2f} m: train {message.behind} is at {rear_m:.2f} m"
            self._judge("ends_behind_rear", message.end_m <= rear_m + TOUCH_M, told)
        if message.area in self._ends_m:
            end_m = self._ends_m[message.area]
            told = f"{said} to {message.end_m:.2f} m: the area ends at {end_m:.2f} m"
            self._judge("ends_at_border", message.end_m <= end_m + TOUCH_M, told)
        self._judge_objects(message, term)

    def _judge_objects(self, message: AreaAuthority, term: TermRecord) -> None:
        report = self._reports.get((message.destination, message.area))
        for number, nonce in term.claims.items():
            site = self._sites.get(number)
            if site is None or report is None or report.front_max_m > site.start_m:
                continue
            if message.end_m > site.start_m:
                told = f"{_said(message)} over object {number}, which has not confirmed its lock"
                self._judge("object_confirmed", (number, nonce) in term.confirmed, told)

    # Objects.

    def _on_claim(self, message: ObjectClaim) -> None:
        self._owns(message)
        term = self._term(message)
        term.claims[message.number] = max(term.claims.get(message.number, 0), message.nonce)
        self._claimed[message.number, message.term, message.nonce] = message.kind
        if message.kind is ClaimKind.CLAIM:
            return
        newest = term.commits[max(term.commits)] if term.commits else ()
        for name in _names(newest):
            reports = term.reported.get(name, [])
            told = f"{_said(message)} of object {message.number}: train {name} "
            self._judge("has_promised", bool(reports), told + "has not acknowledged the term")
            site = self._sites.get(message.number)
            if site is not None and reports:
                passes = any(
                    each.localised
                    and (each.latent_m <= site.start_m or each.rear_min_m >= site.end_m)
                    for each in reports
                )
                self._judge("cannot_reach", passes, told + "never reported that it cannot reach it")

    def _on_status(self, message: ObjectStatus) -> None:
        before = self._objects.get(message.number)
        claim = message.claim_term, message.nonce
        if before is not None:
            was = before.claim_term, before.nonce
            told = f"{_said(message)} of object {message.number} obeyed {claim} after {was}"
            self._judge("newer_claim", claim >= was, told)
            told = f"{_said(message)} of object {message.number} after term {before.term}"
            self._judge("object.term_not_old", message.term >= before.term, told)
        kind = self._claimed.get((message.number, *claim))
        locked = message.state is ObjectState.LOCKED
        if kind is not None and locked:
            told = f"{_said(message)} of object {message.number} is locked by a release"
            self._judge("newer_claim", kind is ClaimKind.CLAIM, told)
        if locked:
            record = self._terms.setdefault((message.area, claim[0]), TermRecord())
            record.confirmed.add((message.number, message.nonce))
        self._objects[message.number] = message


def check(messages: Iterable[Any], areas: AreaMap | None = None) -> Conformance:
    """Judge all messages of a line, in the order of sending."""
    conformance = Conformance(areas)
    for message in messages:
        conformance.take(message)
    return conformance


def _names(roster: Sequence[RosterEntry]) -> list[int]:
    return [entry.train for entry in roster]


def _stayed(roster: Sequence[RosterEntry], other: Sequence[RosterEntry]) -> list[int]:
    """Trains that are in both rosters in the same incarnation, in the order of the first."""
    there = {(entry.train, entry.boot) for entry in other}
    return [entry.train for entry in roster if (entry.train, entry.boot) in there]


def _said(message: Any) -> str:
    who = f"train {message.source}" if message.source <= LAST_TRAIN else f"{message.source}"
    return f"{who}, {type(message).__name__} in area {message.area}, term {message.term}"
